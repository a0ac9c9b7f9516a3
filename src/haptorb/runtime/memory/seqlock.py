"""A flag and some numbers in shared memory, guarded by a sequence number that is odd while they are being written."""

from __future__ import annotations

from typing import final

__all__ = ["SeqlockWords"]

_TRIES = 8  #: more would let a slow writer hold up the loop


@final
class SeqlockWords:
    """`count` words at `at`, seen both as integers and as floats: the sequence number, the flag, the numbers.

    One writer; a reader never waits, and never sees half of what is written.
    """

    def __init__(self, words: memoryview, floats: memoryview[float], at: int, count: int) -> None:
        self._words, self._floats = words, floats
        self._at, self._flag, self._first, self._end = at, at + 1, at + 2, at + count
        self._known = 0

    def write(self, flag: bool, numbers: tuple[float, ...]) -> None:
        """Replace flag and numbers; for the one writer."""
        words, floats, at = self._words, self._floats, self._at
        sequence = words[at] | 1
        words[at] = sequence
        words[self._flag] = flag
        for i, value in enumerate(numbers, start=self._first):
            floats[i] = value
        words[at] = sequence + 1

    def read_new(self) -> tuple[bool, list[float]] | None:
        """What was written completely since the last call; None if nothing was, or it is being written just now."""
        words, at = self._words, self._at
        for _ in range(_TRIES):
            sequence = words[at]
            if sequence == self._known:
                return None
            if sequence & 1:
                continue
            flag = words[self._flag] != 0
            numbers: list[float] = self._floats[self._first : self._end].tolist()  # type: ignore[assignment]
            if words[at] == sequence:
                self._known = sequence
                return flag, numbers
        return None
