"""Trace collector: assignment of the servo's rows to presentations, by the world's number in a row."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from haptorb.arrays import Array
from haptorb.recording.row import RowLayout
from haptorb_study.feel.session import FeelSession
from haptorb_study.feel.trace import Trace, is_felt, trace_rows

__all__ = ["LiveFeeling", "TraceCollector", "store_feeling", "world_key"]


_MAX_TRACE_TICKS = 600_000  #: ticks recorded of one presentation: ten minutes


def world_key(number: int) -> str:
    """Name of the world of design `number` (from 0) in the session's servo; never the name of a catalogue world."""
    return f"design {number}"


@dataclass
class LiveFeeling:
    """One presentation of a design: from its selection to the next."""

    trace: Trace
    file: str  #: of the trace
    id: str
    person: str
    blind: bool
    scale: float  #: factor of all torques of the handle
    score: int | None = None
    felt: bool = False  #: whether it exceeded the perception limits so far, see `trace.is_felt`
    first: Array | None = None  #: its first tick


@final
class TraceCollector:
    """Collects the presentations by the world's number in the servo's rows; every new world is a presentation."""

    def __init__(self) -> None:
        self._feelings: dict[int, LiveFeeling] = {}
        self._world = 0

    def begin(self, feeling: LiveFeeling, *, served: bool = False) -> None:
        """Start `feeling`; `served`: a servo has just been given its world."""
        self._world += served
        self._feelings[self._world] = feeling

    def collect(self, layout: RowLayout, rows: Array) -> list[LiveFeeling]:
        """Append `rows` (n, width) to the traces; returns the presentations that ended."""
        worlds = rows[:, layout["world"].start]
        for number, feeling in self._feelings.items():
            room = max(_MAX_TRACE_TICKS - len(feeling.trace), 0)
            found = trace_rows(layout, rows[worlds == number])
            feeling.trace.extend(found[:room])
            if len(found) and not feeling.felt:
                feeling.first = found[0] if feeling.first is None else feeling.first
                feeling.felt = is_felt(found, feeling.first)
        ended = [number for number in self._feelings if len(worlds) and number < worlds[-1]]
        return [self._feelings.pop(number) for number in ended]

    def end(self) -> list[LiveFeeling]:
        """End the presentations that are still open."""
        left, self._feelings = list(self._feelings.values()), {}
        return left


def store_feeling(session: FeelSession, feeling: LiveFeeling, *, gently: bool) -> None:
    """Write the trace of `feeling`, unless it is empty."""
    if len(feeling.trace):
        session.store_trace(
            feeling.trace, name=feeling.file, person=feeling.person, feeling=feeling.id, blind=feeling.blind,
            scale=feeling.scale, gently=gently,
        )  # fmt: skip
