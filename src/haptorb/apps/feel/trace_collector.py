"""Which of a servo's rows belong to which trial: by the number of the world in a row."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol, final

from haptorb.apps.feel.session import FeelSession
from haptorb.apps.feel.trace import Trace, is_felt, trace_rows
from haptorb.numerics.arrays import Array
from haptorb.runtime.row import RowLayout

__all__ = ["FeltServo", "LiveFeeling", "TraceCollector", "keep_feeling", "world_key"]

_LONGEST = 600_000  #: ticks of one feeling that are kept: ten minutes


def world_key(number: int) -> str:
    """The name by which a session's servo knows the world of design `number`, from 0 on: not a world's own name."""
    return f"design {number}"


class FeltServo(Protocol):
    """What a session needs of a servo."""

    @property
    def layout(self) -> RowLayout:
        """Which numbers of a row are what."""
        ...

    def rows(self, cursor: int = 0) -> tuple[int, Array]:
        """All rows (n, width) since `cursor`, and the cursor after them."""
        ...

    def set_world(self, name: str, values: Mapping[str, Any] | None = None) -> None:
        """Returns when the servo took it."""
        ...

    def set_torque_scale(self, scale: float) -> None:
        """All torques of the handle times `scale`."""
        ...


@dataclass
class LiveFeeling:
    """One feeling, from when a design is chosen until the next one is."""

    trace: Trace
    file: str  #: of the trace
    id: str
    person: str
    blind: bool
    scale: float  #: all torques of the handle times this
    score: int | None = None
    felt: bool = False  #: whether something could be felt of it so far, see `trace.is_felt`
    first: Array | None = None  #: its first tick


@final
class TraceCollector:
    """Feelings by the number of their world in the servo's rows; every new world is a feeling."""

    def __init__(self) -> None:
        self._feelings: dict[int, LiveFeeling] = {}
        self._world = 0

    def begin(self, feeling: LiveFeeling, *, served: bool = False) -> None:
        """From now on `feeling`; `served`: a servo has just been given its world."""
        self._world += served
        self._feelings[self._world] = feeling

    def collect(self, layout: RowLayout, rows: Array) -> list[LiveFeeling]:
        """Take `rows` (n, width) into the traces; returns the feelings that ended."""
        worlds = rows[:, layout["world"].start]
        for number, feeling in self._feelings.items():
            room = max(_LONGEST - len(feeling.trace), 0)
            found = trace_rows(layout, rows[worlds == number])
            feeling.trace.extend(found[:room])
            if len(found) and not feeling.felt:
                feeling.first = found[0] if feeling.first is None else feeling.first
                feeling.felt = is_felt(found, feeling.first)
        ended = [number for number in self._feelings if len(worlds) and number < worlds[-1]]
        return [self._feelings.pop(number) for number in ended]

    def end(self) -> list[LiveFeeling]:
        """What was not ended by another feeling."""
        left, self._feelings = list(self._feelings.values()), {}
        return left


def keep_feeling(session: FeelSession, feeling: LiveFeeling, *, gently: bool) -> None:
    """Write the trace of `feeling`, unless it is empty."""
    if len(feeling.trace):
        session.keep(
            feeling.trace, name=feeling.file, person=feeling.person, feeling=feeling.id, blind=feeling.blind,
            scale=feeling.scale, gently=gently,
        )  # fmt: skip
