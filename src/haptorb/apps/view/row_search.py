"""Finding the row of a time in a recording of any length: a few short reads, not all times."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from haptorb.numerics.arrays import Array

__all__ = ["find_row"]

_PIECE = 64  #: rows that are read at once; a chunk of a recording has about as many


def find_row(read: Callable[[int, int], Array], rows: int, value: float, ends: tuple[float, float]) -> int:
    """The last of `rows` ≥ 1 rows whose number is at most `value`, the first row where none is.

    read  (first, last) → (n,) numbers of these rows, in any unit, that increase
    ends  numbers of the first and the last row

    Times are almost evenly spaced, so the first guess is nearly always right. Where they are not, every second guess
    halves what is left; numbers that do not increase give some row, after as many steps.

    >>> find_row(lambda a, b: np.arange(a, b) / 1000.0, 10_000, 1.2345, (0.0, 9.999))
    1234
    """
    low, high = 0, rows - 1
    least, most = ends
    if not value > least:
        return 0
    if value >= most:
        return rows - 1
    halve = False
    while high - low > 1:
        guess = (low + high) // 2
        if not halve and most > least and math.isfinite(most - least):
            guess = low + int((value - least) / (most - least) * (high - low))
        first = min(max(guess - _PIECE // 2, low), high)
        last = min(first + _PIECE, high + 1)
        piece = read(first, last)
        count = int(np.searchsorted(piece, value, side="right"))
        if 0 < count < len(piece):
            return first + count - 1
        if count == 0:
            high, most = first, float(piece[0])
        else:
            low, least = last - 1, float(piece[-1])
        halve = not halve
    return low
