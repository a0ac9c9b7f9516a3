"""What the chain remembered at some ticks of a recording: from there a replay may begin."""

from __future__ import annotations

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


def choose_beginnings(recording: Recording, ticks: Array, parts: int) -> list[int]:
    """Rows with a kept state that cut a recording of `ticks` (n,) into at most so many parts of about one length [1].

    The first is 0.
    """
    at_ticks = np.array(sorted(list_states(recording)))
    at = np.searchsorted(ticks, at_ticks)
    at = at[(at > 0) & (at < len(ticks) - 1)]
    at = at[np.isin(ticks[at], at_ticks)]
    wanted = np.arange(1, parts) * len(ticks) / parts
    near = {int(at[int(np.argmin(np.abs(at - place)))]) for place in wanted} if len(at) else set()
    return [0, *sorted(near)]


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
