"""Two runs of the same ticks, number by number: the same to the bit, or where they differ first, and by how much."""

from __future__ import annotations

from collections.abc import Mapping
from typing import final

import numpy as np

from haptorb.numerics.arrays import Array
from haptorb.numerics.record import record
from haptorb.runtime.recording.data_frames import units_of
from haptorb.runtime.row import Field

__all__ = ["CLOCK_FIELDS", "Difference", "FieldBound", "RunComparison", "are_same"]

#: what the computer's clock said of the run, and no part of the chain
CLOCK_FIELDS = frozenset({"tick", "wall", "lateness", "missed", "stages", "ahead"})


@record
class Difference:
    """One number that is not the same: `recorded` and `replayed` at place `number` of `field`, in its `unit`."""

    tick: int
    t: float  #: [s]
    field: str
    number: int
    unit: str
    recorded: float
    replayed: float

    @property
    def size(self) -> float:
        """How far apart they are, in the field's unit."""
        return abs(self.replayed - self.recorded)


@record
class FieldBound:
    """How far a field differs: in how many ticks, by at most `largest`, where the recorded value is up to `greatest`.

    largest   in the field's unit; NaN: a number stands against none
    """

    field: str
    unit: str
    ticks: int
    first: int
    largest: float
    greatest: float


@final
class RunComparison:
    """Collects blocks of recorded and replayed rows of `fields`.

    compared   ticks looked at
    differing  ticks in which a number is not the same
    first      the first number that is not the same; None: there is none
    """

    def __init__(self, fields: tuple[Field, ...], left_out: frozenset[str] = frozenset()) -> None:
        looked_at = [field for field in fields if field.name not in CLOCK_FIELDS | left_out]
        self._units = {field.name: field.unit for field in looked_at}
        self._unit_of = {field.name: units_of(field) for field in looked_at}
        self._width = sum(field.width for field in looked_at)
        self._bounds: dict[str, FieldBound] = {}
        self.compared = self.differing = self.numbers = 0
        self.first: Difference | None = None

    @property
    def identical(self) -> bool:
        """Every number of every tick is the same, bit for bit."""
        return self.first is None

    @property
    def bounds(self) -> tuple[FieldBound, ...]:
        """Of the fields that differ, those first that differ first."""
        return tuple(sorted(self._bounds.values(), key=lambda one: one.first))

    def add(self, recorded: Mapping[str, Array], replayed: Mapping[str, Array], ticks: Array, t: Array) -> None:
        """A block: field → (n, width) in the field's unit [SI], its `ticks` (n,) and their times t (n,) [s]."""
        n = len(ticks)
        any_differs = np.zeros(n, dtype=np.bool_)
        found: list[tuple[int, str, Array]] = []
        for name in self._units:
            a, b = recorded.get(name), replayed.get(name)
            if a is None or b is None or a.shape != b.shape or not a.shape[1]:
                continue
            self.numbers += a.size
            if np.array_equal(_bits(a), _bits(b)):
                continue
            differs = (_bits(a) != _bits(b)) & ~(np.isnan(a) & np.isnan(b))
            rows = differs.any(axis=1)
            if not rows.any():
                continue
            any_differs |= rows
            found.append((int(np.argmax(rows)), name, differs))
            self._widen(name, a, b, rows, ticks)
        if found and self.first is None:
            at = min(row for row, _, _ in found)
            name, differs = next((name, differs) for row, name, differs in found if row == at)
            number = int(np.argmax(differs[at]))
            self.first = Difference(
                int(ticks[at]), float(t[at]), name, number, self._unit_of[name][number],
                float(recorded[name][at, number]), float(replayed[name][at, number]),
            )  # fmt: skip
        self.compared += n
        self.differing += int(any_differs.sum())

    def add_same(self, n: int) -> None:
        """A block of `n` ticks of which `are_same` says that every number of every field is the same."""
        self.numbers, self.compared = self.numbers + n * self._width, self.compared + n

    def merge(self, later: RunComparison) -> None:
        """Take in what `later` has found in the ticks that follow."""
        self.first = self.first or later.first
        self.compared, self.differing = self.compared + later.compared, self.differing + later.differing
        self.numbers += later.numbers
        for name, one in later._bounds.items():
            before = self._bounds.get(name)
            self._bounds[name] = one if before is None else _join(before, one)

    def _widen(self, name: str, a: Array, b: Array, rows: Array, ticks: Array) -> None:
        with np.errstate(invalid="ignore", over="ignore"):
            apart = np.abs(a - b)
        largest = float(np.nanmax(apart)) if np.isfinite(apart).any() else float("nan")
        finite = np.abs(a[np.isfinite(a)])
        greatest = float(finite.max()) if finite.size else float("nan")
        first = int(ticks[int(np.argmax(rows))])
        found = FieldBound(name, self._units[name], int(rows.sum()), first, largest, greatest)
        before = self._bounds.get(name)
        self._bounds[name] = found if before is None else _join(before, found)


def are_same(recorded: Array, replayed: Array) -> bool:
    """Whether rows (n, width) are the same bit for bit, each number in the unit [..] of its field: much faster than to
    look at each field."""
    return np.array_equal(recorded.view(np.uint64), replayed.view(np.uint64))


def _join(before: FieldBound, after: FieldBound) -> FieldBound:
    return FieldBound(
        before.field, before.unit, before.ticks + after.ticks, before.first,
        float(np.fmax(before.largest, after.largest)), float(np.fmax(before.greatest, after.greatest)),
    )  # fmt: skip


def _bits(values: Array) -> Array:
    bits: Array = np.ascontiguousarray(values).view(np.uint64)
    return bits
