"""Ring buffer of the loop's rows: one writer, any number of readers, lock-free.

The writer copies a row, then increments the count. A reader copies, then reads the count again: rows that the writer
may have overwritten meanwhile are dropped, so a torn row is never returned. This relies on stores becoming visible in
order (x86-64; on weaker memory models the interpreter's own work between the two makes reordering improbable, not
impossible).
"""

from __future__ import annotations

from typing import final

import numpy as np

from haptorb.arrays import Array

__all__ = ["RingBuffer"]


@final
class RingBuffer:
    """Ring buffer of rows (capacity, width); `words[at]` counts the rows published since the start."""

    def __init__(self, words: memoryview, at: int, rows: Array) -> None:
        self._words, self._at, self._rows = words, at, rows
        self.capacity, self.width = rows.shape

    @property
    def count(self) -> int:
        """Rows published since the start."""
        return int(self._words[self._at])

    def publish(self, row: Array) -> None:
        """Append a copy of `row` (width,); for the single writer."""
        self.slot()[:] = row
        self.publish_slot()

    def slot(self) -> Array:
        """Slot (width,) of the next row; readers do not see it before `publish_slot`. For the single writer."""
        slot: Array = self._rows[self._words[self._at] % self.capacity]
        return slot

    def publish_slot(self) -> None:
        """Publish the row in the slot."""
        self._words[self._at] += 1

    def read_since(self, cursor: int, most: int | None = None) -> tuple[int, Array]:
        """Return (new cursor, rows (n, width)): a copy of the rows published since `cursor`, oldest first; the newest
        `most` of them if there are more.

        Where the writer was faster than the reader, the oldest rows are lost: (new cursor − cursor − n) of them.
        """
        capacity = self.capacity
        end = self.count
        # The slot of row `end` may be partly written at any time; it is the slot of row `end − capacity`.
        start = min(max(cursor, end - min(capacity - 1, capacity if most is None else most), 0), end)
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
        """Copy of the newest row (width,); None before the first."""
        while self.count:
            _, rows = self.read_since(self.count - 1)
            if len(rows):
                newest: Array = rows[-1]
                return newest
        return None
