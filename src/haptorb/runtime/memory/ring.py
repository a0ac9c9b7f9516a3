"""The last rows of the loop in shared memory: one writer, any number of readers, none waits for another.

The writer copies a row, then raises the count. A reader copies, then looks at the count again: rows that the writer
may have reached meanwhile are dropped, so a torn row is never returned. This relies on stores becoming visible in
order (x86-64; on weaker machines the interpreter's own work between the two makes a mix-up improbable, not impossible).
"""

from __future__ import annotations

from typing import final

import numpy as np

from haptorb.numerics.arrays import Array

__all__ = ["RingBuffer"]


@final
class RingBuffer:
    """Rows (capacity, width) and, in `words[at]`, how many rows were ever published."""

    def __init__(self, words: memoryview, at: int, rows: Array) -> None:
        self._words, self._at, self._rows = words, at, rows
        self.capacity, self.width = rows.shape

    @property
    def count(self) -> int:
        """Rows published since the start."""
        return int(self._words[self._at])

    def publish(self, row: Array) -> None:
        """Append a copy of `row` (width,); for the one writer."""
        self.slot()[:] = row
        self.publish_slot()

    def slot(self) -> Array:
        """(width,) where the next row goes; readers do not see it before `publish_slot`. For the one writer."""
        slot: Array = self._rows[self._words[self._at] % self.capacity]
        return slot

    def publish_slot(self) -> None:
        """The next row is in its slot."""
        self._words[self._at] += 1

    def read_since(self, cursor: int) -> tuple[int, Array]:
        """(new cursor, rows (n, width)) published after the first `cursor` rows, oldest first, as a copy.

        Where the writer was faster than the reader, the oldest rows are gone: (new cursor − cursor − n) of them.
        """
        capacity = self.capacity
        end = self.count
        # The slot of row `end` may be half written at any time; it is the slot of row `end − capacity`.
        start = min(max(cursor, end - capacity + 1, 0), end)
        first, last = start % capacity, end % capacity
        rows: Array
        if start == end:
            rows = self._rows[:0].copy()
        elif first < last:
            rows = self._rows[first:last].copy()
        else:
            rows = np.concatenate((self._rows[first:], self._rows[:last]))
        overtaken = self.count - capacity + 1 - start
        return end, rows[max(overtaken, 0) :]

    def latest(self) -> Array | None:
        """(width,) the newest row as a copy; None before the first."""
        while self.count:
            _, rows = self.read_since(self.count - 1)
            if len(rows):
                newest: Array = rows[-1]
                return newest
        return None
