"""What the chain remembered at some ticks of a recording: from there a replay may begin."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from haptorb.numerics.arrays import Array
from haptorb.runtime.recording.recording import Recording

__all__ = ["choose_beginnings", "find_gaps", "list_states"]


def list_states(recording: Recording) -> dict[float, str]:
    """Tick → the text of the state after it, for `unpack_state`."""
    found = {}
    for name, values in recording.notes:
        if name == "haptorb/state" and values.get("tick", "").isdecimal():
            found[float(values["tick"])] = values.get("state", "")
    return found


def choose_beginnings(recording: Recording, parts: int) -> list[int]:
    """Rows with a kept state that cut `recording` into at most so many parts of about one length [1].

    The first is 0.
    """
    ticks, count, states = recording["tick"], len(recording), sorted(list_states(recording))
    found = {0}
    for number in range(1, parts):
        wanted = number * count // parts
        at = bisect_left(states, float(ticks[wanted]))
        near = states[max(at - 2, 0) : at + 2]
        rows = [bisect_left(range(count), tick, key=lambda row: float(ticks[row])) for tick in near]
        places = [row for row, tick in zip(rows, near, strict=True) if 0 < row < count - 1 and ticks[row] == tick]
        found.update(sorted(places, key=lambda row: abs(row - wanted))[:1])
    return sorted(found)


def find_gaps(ticks: Array, states: Mapping[float, str]) -> tuple[NDArray[np.bool_], set[int]]:
    """(n,) True [1] for the rows of `ticks` (n,) of which the chain cannot know what came before, after lost ticks; and
    the rows, with one of the kept `states`, at which it knows again."""
    blind, resume = np.zeros(len(ticks), dtype=np.bool_), set[int]()
    at_ticks = np.array(sorted(states))
    at = np.searchsorted(ticks, at_ticks)
    there = at < len(ticks)
    rows = at[there][ticks[at[there]] == at_ticks[there]]
    for gap in np.flatnonzero(np.diff(ticks) != 1).tolist():
        later = rows[rows > gap]
        end = int(later[0]) if len(later) else len(ticks) - 1
        blind[gap + 1 : end + 1] = True
        if len(later):
            resume.add(end)
    return blind, resume
