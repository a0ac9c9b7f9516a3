"""Source of statements in a paper: makes the items of one module with the same paper and place."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import wraps
from typing import ParamSpec, SupportsFloat

from haptorb_papers.reproduce.entry import Entry
from haptorb_papers.reproduce.item import Item, exempt

__all__ = ["ROUNDING", "Citation"]

ROUNDING = "rounding"  #: a reason for a tolerance: the number is kept as it is printed

Arguments = ParamSpec("Arguments")


def _mark_implied(printed: Callable[Arguments, Item]) -> Callable[Arguments, Item]:
    """As `printed`, for a number that is not printed, but follows from the paper's method or statements."""

    @wraps(printed)
    def claim(*words: Arguments.args, **more: Arguments.kwargs) -> Item:
        return replace(printed(*words, **more), implied=True)

    claim.__doc__ = _mark_implied.__doc__
    return claim


@dataclass(frozen=True)
class Citation:
    """A place in a paper.

    paper    key in references.bib
    prefix   of the items' ids
    where    figure, table, equation or section

    >>> table = Citation("bai2012", "t1", "Table 1")
    >>> table.item("a", "radius", 15.875, 15.875, "mm", 1e-9).id
    't1-a'
    >>> table.item("a", "radius", 15.875, Entry(15.875, "pmsm: magnet.radius"), "mm", 1e-9).verdict
    'transcribed'
    >>> table.claim("u1", "opposite", 180.0, 180.0, "°").implied
    True
    """

    paper: str
    prefix: str
    where: str

    def item(
        self,
        name: str,
        what: str,
        published: SupportsFloat,
        computed: SupportsFloat | Entry,
        unit: str = "1",
        tolerance: float = 1e-9,
        why: str = ROUNDING,
        *,
        erratum: str = "",
        corrected: float | None = None,
        where: str = "",
    ) -> Item:
        """A number of the paper against one of ours, in `unit`. An `Entry` is a transcription, or is assumed."""
        found = Item(
            f"{self.prefix}-{name}", self.paper, where or self.where, what, float(published), float(computed), unit,
            float(tolerance), erratum, None if corrected is None else float(corrected), why,
        )  # fmt: skip
        if not isinstance(computed, Entry):
            return found
        reason = computed.assumed and f"assumed: {computed.assumed}"
        return replace(
            found,
            basis="assumed" if computed.assumed else "held",
            held_at=computed.place,
            why=reason or ("" if why == ROUNDING else why),
        )

    claim = _mark_implied(item)

    def assume(
        self,
        name: str,
        what: str,
        published: SupportsFloat,
        computed: SupportsFloat,
        unit: str,
        tolerance: float,
        why: str,
        *,
        where: str = "",
    ) -> Item:
        """A printed number that went into the model: that it comes out again shows that the model can hold it.

        `why` says what was assumed or fitted to it.
        """
        return replace(self.item(name, what, published, computed, unit, tolerance, why, where=where), basis="assumed")

    def set_and_find(
        self,
        name: str,
        what: str,
        given: SupportsFloat,
        computed: SupportsFloat,
        unit: str = "1",
        tolerance: float = 1e-9,
        why: str = ROUNDING,
        *,
        implied: bool = True,
        erratum: str = "",
        where: str = "",
    ) -> Item:
        """A value that was set, and what a computation that starts from it finds; `implied` unless it is printed."""
        item = self.item(name, what, given, computed, unit, tolerance, why, erratum=erratum, where=where)
        return replace(item, basis="set", implied=implied)

    def compare(
        self,
        name: str,
        what: str,
        expected: SupportsFloat,
        computed: SupportsFloat,
        unit: str,
        tolerance: float,
        why: str,
        *,
        erratum: str = "",
        where: str = "",
    ) -> Item:
        """Two numbers of this project against each other, where the paper states neither; `expected` is shown."""
        return replace(
            self.claim(name, what, expected, computed, unit, tolerance, why, erratum=erratum, where=where), basis="own"
        )

    def note(
        self, name: str, what: str, computed: SupportsFloat, unit: str = "1", why: str = "", where: str = "",
        erratum: str = "",
    ) -> Item:  # fmt: skip
        """A number of ours that belongs here, though the paper prints none."""
        return Item(
            f"{self.prefix}-{name}", self.paper, where or self.where, what, None, float(computed), unit, None, erratum,
            why=why, basis="own",
        )  # fmt: skip

    def exempt(self, name: str, what: str, why: str, where: str = "") -> Item:
        """A statement that no computation can check, and why."""
        return exempt(f"{self.prefix}-{name}", self.paper, where or self.where, what, why)
