"""For how long a number has not changed: ticks of a loop, looks of a recorder, processor time of a process."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from time import monotonic
from typing import final

__all__ = ["HangWatch", "StallTime"]

_STEP = 0.5  #: that counts at most between two looks at a process [s]


@final
class StallTime:
    """Counts only time in which the observer was running itself: a computer that was suspended is no stall.

    `step`: at most so much counts between two looks, in any unit of time.
    """

    def __init__(self, step: float) -> None:
        self.time = 0.0  #: since the number changed, in the unit of `step`
        self._step = step
        self._value: int | None = None
        self._last_look = 0.0

    def look(self, now: float, value: int) -> float:
        """The time for which `value` has stayed as it is.

        >>> still = StallTime(step=2.0)
        >>> still.look(10.0, 7), still.look(11.0, 7), still.look(12.0, 8), still.look(99.0, 8)
        (0.0, 1.0, 0.0, 2.0)
        """
        if value != self._value:
            self._value, self.time = value, 0.0
        else:
            self.time += min(now - self._last_look, self._step)
        self._last_look = now
        return self.time


@final
class HangWatch:
    """For how long a process has used no processor time: it is stopped, or waits for what does not come."""

    def __init__(self, pid: int) -> None:
        self._path = Path(f"/proc/{pid}/schedstat")
        self._stall = StallTime(_STEP)

    def look(self) -> float:
        """That time [s]; to be called at least twice a second. 0 where the kernel does not say.

        >>> import os
        >>> HangWatch(os.getpid()).look()
        0.0
        """
        used = -1
        with suppress(OSError, ValueError):
            used = int(self._path.read_text().split()[0])  # [ns]
        return self._stall.look(monotonic(), used) if used >= 0 else 0.0
