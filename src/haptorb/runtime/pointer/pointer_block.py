"""The host's pointer in shared memory, never half of it."""

from __future__ import annotations

from typing import final

import numpy as np

from haptorb.numerics.arrays import Array
from haptorb.runtime.memory.seqlock import SeqlockWords
from haptorb.runtime.pointer.pointer import PointerSource, PointerState

__all__ = ["WORDS", "PointerBlock"]

WORDS = 11  #: sequence, held, p (3), q (4), stamp, patience


@final
class PointerBlock(PointerSource):
    """Eleven words at `at`, seen both as integers and as floats."""

    def __init__(self, words: memoryview, floats: memoryview[float], at: int) -> None:
        self._words = SeqlockWords(words, floats, at, WORDS)
        self._pointed = PointerState(False, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), 0.0)

    def write(self, held: bool, p: Array, q: Array, stamp: float, patience: float = 0.0) -> None:
        """Say where the pointer is, `p` (3,) [m] and `q` (4,) (x, y, z, w), at `stamp` [s]; for the one writer.

        A simulated hand stays there for `patience` [s] without another word.
        """
        self._words.write(held, (*p.tolist(), *q.tolist(), stamp, patience))

    def read_pointer(self) -> PointerState:
        """The pointer as last written completely; if it is being written just now, the one before."""
        latest = self._words.read_new()
        if latest is not None:
            held, n = latest
            self._pointed = PointerState(held, np.array(n[:3]), np.array(n[3:7]), n[7], n[8])
        return self._pointed
