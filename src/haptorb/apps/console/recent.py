"""The rows of the last two seconds, read from the servo once for all pages."""

from __future__ import annotations

from collections import deque
from typing import final

import numpy as np

from haptorb.apps.console.running_servo import RunningServo
from haptorb.numerics.arrays import Array

__all__ = ["BACKLOG", "RecentRows"]

#: rows older than this are not worth sending to a page that was too slow [s]
BACKLOG = 2.0


@final
class RecentRows:
    """A page says up to which row it has seen them, and gets what is newer; who is too slow misses the oldest."""

    def __init__(self, servo: RunningServo) -> None:
        self._servo = servo
        self._t = servo.layout["t"].start
        self._pieces: deque[tuple[int, Array]] = deque()  # number of the first row, rows (n, width)
        self.end = 0  #: how many rows there were in all

    def look(self) -> int:
        """Read what is new, forget what is old; returns `end`."""
        self.end, rows = self._servo.rows(self.end)
        if not len(rows):
            return self.end
        first = int(np.searchsorted(rows[:, self._t], rows[-1, self._t] - BACKLOG))
        # A copy of the part that is kept, or the whole would stay in memory with it.
        self._pieces.append((self.end - len(rows) + first, rows[first:].copy() if first else rows))
        while self._pieces[0][1][-1, self._t] < rows[-1, self._t] - BACKLOG:
            self._pieces.popleft()
        return self.end

    def read_since(self, index: int) -> Array:
        """(n, width) the rows after the first `index`, oldest first; at least one must be newer."""
        wanted = []
        for first, rows in reversed(self._pieces):
            if first + len(rows) <= index:
                break
            wanted.append(rows[max(index - first, 0) :])
        return np.concatenate(wanted[::-1])
