"""What the chain remembered at some ticks of a recording: from there a replay may begin."""

from __future__ import annotations

import re
from bisect import bisect_left
from collections.abc import Iterable, Iterator, Mapping
from typing import final

import numpy as np
from numpy.typing import NDArray

from haptorb.numerics.arrays import Array
from haptorb.numerics.state_arrays import StateArray
from haptorb.runtime.recording.recording import Recording
from haptorb.runtime.recording.state_notes import LAYOUT_NOTE, STATE_NOTE, unpack_arrays

__all__ = ["KeptStates", "choose_beginnings", "find_gaps", "list_gaps"]

_LONGEST_TICK = re.compile(r"[0-9]{1,15}")


@final
class KeptStates:
    """The states that `recording` contains, none of which is read before it is used.

    older  there are some of an older version, pickled: these are not read
    """

    def __init__(self, recording: Recording) -> None:
        self._layout, self._texts, self.older = "", dict[float, str](), False
        for name, values in recording.notes:
            if name == f"haptorb/{LAYOUT_NOTE}":
                self._layout = values.get("arrays", "")
            elif name == f"haptorb/{STATE_NOTE}" and _LONGEST_TICK.fullmatch(tick := values.get("tick", "")):
                if "arrays" in values:
                    self._texts[float(tick)] = values["arrays"]
                else:
                    self.older = True

    def __contains__(self, tick: float) -> bool:
        return tick in self._texts

    def __iter__(self) -> Iterator[float]:
        return iter(self._texts)

    def read(self, tick: float) -> Mapping[str, StateArray]:
        """Name → array of the state after `tick`, each number in its own unit. Raises RecordingError for what is
        none."""
        return unpack_arrays(self._layout, self._texts[tick])


def choose_beginnings(recording: Recording, parts: int) -> list[int]:
    """Rows with a kept state that cut `recording` into at most so many parts of about one length [1].

    The first is 0.
    """
    ticks, count, states = recording["tick"], len(recording), sorted(KeptStates(recording))
    found = {0}
    for number in range(1, parts):
        wanted = number * count // parts
        at = bisect_left(states, float(ticks[wanted]))
        near = states[max(at - 2, 0) : at + 2]
        rows = [bisect_left(range(count), tick, key=lambda row: float(ticks[row])) for tick in near]
        places = [row for row, tick in zip(rows, near, strict=True) if 0 < row < count - 1 and ticks[row] == tick]
        found.update(sorted(places, key=lambda row: abs(row - wanted))[:1])
    return sorted(found)


def list_gaps(ticks: Array) -> NDArray[np.intp]:
    """The rows of `ticks` (n,) [1] after which others are missing."""
    with np.errstate(invalid="ignore"):  # in a damaged file
        return np.flatnonzero(np.diff(ticks) != 1)


def find_gaps(ticks: Array, states: Iterable[float]) -> tuple[NDArray[np.bool_], set[int]]:
    """(n,) True [1] for the rows of `ticks` (n,) of which the chain cannot know what came before, after lost ticks; and
    the rows, with one of the kept `states`, at which it knows again."""
    blind, resume = np.zeros(len(ticks), dtype=np.bool_), set[int]()
    at_ticks = np.array(sorted(states))
    at = np.searchsorted(ticks, at_ticks)
    there = at < len(ticks)
    rows = at[there][ticks[at[there]] == at_ticks[there]]
    for gap in list_gaps(ticks).tolist():
        later = rows[rows > gap]
        end = int(later[0]) if len(later) else len(ticks) - 1
        blind[gap + 1 : end + 1] = True
        if len(later):
            resume.add(end)
    return blind, resume
