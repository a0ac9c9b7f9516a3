"""Intervals of shares and means: Wilson for counted answers, Student and Wilson with a design effect over people."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from haptorb.errors import InputError
from haptorb.numerics.arrays import Array

__all__ = ["mean_interval", "share_interval", "wilson"]


def wilson(right: int, of: int, confidence: float = 0.95) -> tuple[float, float]:
    """Wilson's interval for a proportion (Wilson 1927).

    >>> [round(x, 4) for x in wilson(0, 10)]
    [0.0, 0.2775]
    """
    from scipy.special import ndtri

    if not 0 <= right <= of or of < 1:
        raise InputError(f"needs 0 ≤ right ≤ of and of ≥ 1; got {right} of {of}")
    z = float(ndtri((1 + confidence) / 2))
    return _wilson(right / of, of, z)


def share_interval(right: ArrayLike, of: ArrayLike, confidence: float = 0.95) -> tuple[float, float]:
    """Interval of the mean over people of each one's share `right` (people,) out of `of` (people,), of = 0 left out.

    Wilson's interval of as many answers as the people's shares are worth, with Student's quantile. How much the shares
    vary, against the variance of answers drawn alike, is the design effect (Kish 1965); it is taken to be at least what
    2.5 % of groups have by chance, and 1 where all answers are right or all wrong. In the middle of the range this is
    Student's interval; near its ends it stays inside, and it has a width where no answer is wrong. With fewer than
    two people there is no interval: NaN.

    >>> [round(end, 3) for end in share_interval([10, 10, 10, 10, 10, 10], [10, 10, 10, 10, 10, 10])]
    [0.901, 1.0]
    """
    from scipy.special import chdtri, stdtrit

    k, n = np.asarray(right, dtype=float), np.asarray(of, dtype=float)
    known = n > 0
    k, n = k[known], n[known]
    people = len(n)
    if people < 2:
        return np.nan, np.nan
    shares = k / n
    p, single = float(shares.mean()), float((1 / n).mean())
    by_chance = p * (1 - p) * single
    effect = 1.0
    if by_chance > 0:
        least = float(chdtri(people - 1, (1 + confidence) / 2)) / (people - 1)
        effect = max(float(shares.var(ddof=1)) / by_chance, least)
    return _wilson(p, people / (single * effect), float(stdtrit(people - 1, (1 + confidence) / 2)))


def _wilson(p: float, answers: float, quantile: float) -> tuple[float, float]:
    """Where |p̂ − p| is `quantile` standard errors of so many answers at p."""
    square = quantile * quantile / answers
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
