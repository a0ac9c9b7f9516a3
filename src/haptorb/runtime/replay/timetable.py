"""Which recorded tick each tick of a replay plays, when, and what was commanded before it."""

from __future__ import annotations

from typing import final

import numpy as np

from haptorb.numerics.arrays import Array
from haptorb.runtime.tick.tick_log import MODEL, NO_TICK, TickCommand

__all__ = ["Timetable"]

_MODES = int(TickCommand.TRANSLATE | TickCommand.ROTATE)
_CLUTCH = int(TickCommand.HOLD | TickCommand.RELEASE)
_SAME = 1e-7  #: by which two times may differ and be one [s]


@final
class Timetable:
    """For recorded ticks at `t` (n,) [s] with `commands` (n,): as they were, or at another `rate` [Hz].

    At another rate every tick plays the newest sample that there was at its time, so much older; a command acts in the
    first tick after it.

    index     (k,) of the recorded tick
    t         (k,) when it is replayed [s]
    commands  (k,) all that were given since the tick before
    """

    def __init__(self, t: Array, commands: Array, rate: float | None = None) -> None:
        if rate is None:
            self.index, self.t, self.commands = np.arange(len(t)), t, commands
            return
        live = commands != NO_TICK
        last = int(np.flatnonzero(live)[-1]) if live.any() else 0
        count = int(np.floor((t[last] - t[0]) * rate + _SAME)) + 1
        self.t = t[0] + np.arange(count) / rate
        self.index = np.clip(np.searchsorted(t[: last + 1], self.t + _SAME, side="right") - 1, 0, last)
        before = np.concatenate(([-1], self.index[:-1]))
        self.commands = np.zeros(count)
        given = np.flatnonzero(np.nan_to_num(commands[: last + 1]) > 0.0)
        for at in given.tolist():
            tick = int(np.searchsorted(self.index, at))
            if tick < count and before[tick] < at:
                self.commands[tick] = _join(int(self.commands[tick]), int(commands[at]))

    def cut(self, first: int, last: int) -> Timetable:
        """Its ticks from `first` up to `last`."""
        part = Timetable(self.t[:1], self.commands[:1])
        part.index = self.index[first:last].copy()
        part.t, part.commands = self.t[first:last].copy(), self.commands[first:last].copy()
        return part

    def __len__(self) -> int:
        return len(self.index)


def _join(first: int, then: int) -> int:
    """Both at once; of two modes, models or words to the clutch the later one.

    >>> _join(int(TickCommand.TRANSLATE), int(TickCommand.ROTATE)) == TickCommand.ROTATE
    True
    """
    flags, model = first % MODEL, first // MODEL
    for group in (_MODES, _CLUTCH):
        if then & group:
            flags &= ~group
    return (flags | then % MODEL) + MODEL * (then // MODEL or model)
