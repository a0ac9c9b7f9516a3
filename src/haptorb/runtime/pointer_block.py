"""The host's pointer in shared memory, guarded by a sequence number that is odd while it is being written."""

from __future__ import annotations

from typing import final

import numpy as np

from haptorb.physics.arrays import Array
from haptorb.runtime.pointer import Pointed, PointerSource

__all__ = ["WORDS", "PointerBlock"]

WORDS = 10  #: sequence, held, p (3), q (4), stamp

_TRIES = 8  #: more would let a slow writer hold up the loop


@final
class PointerBlock(PointerSource):
    """Ten words at `at`, seen both as integers and as floats."""

    def __init__(self, words: memoryview, floats: memoryview[float], at: int) -> None:
        self._words, self._floats, self._at = words, floats, at
        self._known = 0
        self._pointed = Pointed(False, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), 0.0)

    def write(self, held: bool, p: Array, q: Array, stamp: float) -> None:
        """Say where the pointer is, `p` (3,) [m] and `q` (4,) (x, y, z, w), at `stamp` [s]; for the one writer."""
        words, floats, at = self._words, self._floats, self._at
        sequence = words[at] | 1
        words[at] = sequence
        words[at + 1] = held
        for i, value in enumerate((*p.tolist(), *q.tolist(), stamp), start=at + 2):
            floats[i] = value
        words[at] = sequence + 1

    def pointed(self) -> Pointed:
        """The pointer as last written completely; if it is being written just now, the one before."""
        words, at = self._words, self._at
        for _ in range(_TRIES):
            sequence = words[at]
            if sequence == self._known:
                break
            if sequence & 1:
                continue
            held = bool(words[at + 1])
            numbers = self._floats[at + 2 : at + WORDS].tolist()
            if words[at] == sequence:
                self._known = sequence
                self._pointed = Pointed(held, np.array(numbers[:3]), np.array(numbers[3:7]), numbers[7])
                break
        return self._pointed
