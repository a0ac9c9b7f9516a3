"""A cubic spline through evenly spaced values, where loading scipy for one would be most of a program's start."""

from __future__ import annotations

import numpy as np

from haptorb.errors import InputError
from haptorb.numerics.arrays import Array

__all__ = ["cubic_spline"]

_FEWEST = 4  #: with fewer places there is no cubic of the first three intervals


def cubic_spline(values: Array, step: float) -> Array:
    """(n - 1, 4) coefficients of the cubics between `values` (n,), one per `step`; highest power first.

    The value t beyond place k is c[k, 0] t³ + c[k, 1] t² + c[k, 2] t + c[k, 3]. First and second derivative are
    continuous, and the third at the second place from either end ("not a knot"): with h = step and the slopes s,
    s[k-1] + 4 s[k] + s[k+1] = 3 (m[k-1] + m[k]), where m[k] = (y[k+1] - y[k])/h.

    >>> cubic_spline(np.arange(6.0) ** 3, 1.0)[2].round(12).tolist()
    [1.0, 6.0, 12.0, 8.0]
    """
    y = np.asarray(values, dtype=float)
    if y.ndim != 1 or len(y) < _FEWEST:
        raise InputError(f"a cubic spline needs a list of at least {_FEWEST} values; got shape {y.shape}")
    m = np.diff(y) / step
    right = np.concatenate(([(5 * m[0] + m[1]) / 2], 3 * (m[:-1] + m[1:]), [(5 * m[-1] + m[-2]) / 2]))
    slopes = _solve(right.tolist())
    bend = (slopes[:-1] + slopes[1:] - 2 * m) / step
    return np.stack((bend / step, (m - slopes[:-1]) / step - bend, slopes[:-1], y[:-1]), axis=1)


def _solve(right: list[float]) -> Array:
    """Slopes from the right sides: rows (1, 2), (1, 4, 1) ..., (2, 1), by elimination from above."""
    diagonals, upper = [1.0], [2.0]
    for k in range(1, len(right)):
        last = k == len(right) - 1
        share = (2.0 if last else 1.0) / diagonals[-1]
        diagonals.append((1.0 if last else 4.0) - share * upper[-1])
        upper.append(1.0)
        right[k] -= share * right[k - 1]
    slopes = np.empty(len(right))
    slopes[-1] = right[-1] / diagonals[-1]
    for k in range(len(right) - 2, -1, -1):
        slopes[k] = (right[k] - upper[k] * slopes[k + 1]) / diagonals[k]
    return slopes
