"""Intervals of one person's share of answers (Wilson) and of means over people (Student)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from haptorb.errors import InputError
from haptorb.numerics.arrays import Array

__all__ = ["mean_interval", "wilson"]


def wilson(right: int, of: int, confidence: float = 0.95) -> tuple[float, float]:
    """Wilson's interval for a proportion (Wilson 1927).

    >>> [round(x, 4) for x in wilson(0, 10)]
    [0.0, 0.2775]
    """
    from scipy.special import ndtri

    if not 0 <= right <= of or of < 1:
        raise InputError(f"needs 0 ≤ right ≤ of and of ≥ 1; got {right} of {of}")
    p, square = right / of, float(ndtri((1 + confidence) / 2)) ** 2 / of
    middle = (p + square / 2) / (1 + square)
    half = float(np.sqrt(square * p * (1 - p) + square * square / 4)) / (1 + square)
    return max(0.0, middle - half), min(1.0, middle + half)


def mean_interval(values: ArrayLike, confidence: float = 0.95) -> tuple[Array, Array]:
    """(low, high), shape (...), Student's interval of the mean over people; values (people, ...), NaN left out.

    People are the units that a study draws: with few of them a percentile bootstrap is too narrow, by (n − 1)/n in
    the variance and by the normal quantile in place of t. With fewer than two people there is no interval: NaN.

    >>> [round(float(end), 4) for end in mean_interval([1.0, 2.0, 3.0])]
    [-0.4841, 4.4841]
    """
    from scipy.special import stdtrit

    x = np.asarray(values, dtype=float)
    known = np.isfinite(x)
    n = known.sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(known, x, 0.0).sum(axis=0) / n
        variance = np.where(known, (x - mean) ** 2, 0.0).sum(axis=0) / (n - 1)
        half = stdtrit(np.maximum(n - 1, 1), (1 + confidence) / 2) * np.sqrt(variance / n)
    half = np.where(n > 1, half, np.nan)
    return mean - half, mean + half
