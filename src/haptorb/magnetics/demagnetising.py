"""Demagnetising factors of an ellipsoid: by how much its uniform magnetization weakens the field inside."""

from __future__ import annotations

import math
import sys

import numpy as np
from numpy.typing import ArrayLike

from haptorb.arrays import Array

__all__ = ["demagnetising_factors"]


def demagnetising_factors(axes: ArrayLike) -> Array:
    """(3,) [1] factors along the principal axes of an ellipsoid, whose sum is 1.

    N₃ = a b c/2 ∫₀^∞ dt/((t + c²) √((t + a²)(t + b²)(t + c²))) = a b c/3 R_D(a², b², c²)
    (Stratton, Electromagnetic Theory, 1941, §3.27).

    Parameters
    ----------
    axes : (3,) array_like
        Semi-axes a, b, c [m], greater than 0.

    Returns
    -------
    (3,) numpy.ndarray
        Factor along each axis [1].

    Examples
    --------
    >>> demagnetising_factors([0.02, 0.02, 0.02]).round(12).tolist()
    [0.333333333333, 0.333333333333, 0.333333333333]
    """
    a, b, c = np.asarray(axes, dtype=np.float64).tolist()
    orders = ((b, c, a), (a, c, b), (a, b, c))
    return np.array([a * b * c / 3.0 * _carlson_rd(x * x, y * y, z * z) for x, y, z in orders])


_DISTANCE = (0.25 * sys.float_info.epsilon) ** (-1 / 6)  #: the series' omitted terms are below one rounding error


def _carlson_rd(x: float, y: float, z: float) -> float:
    """Carlson's R_D(x, y, z), by duplication and a series (Carlson, Numer. Algorithms 10, 13, 1995).

    In plain Python: three numbers at a start of the simulated device; scipy.special takes 0.2 s to import.
    """
    mean = start = (x + y + 3.0 * z) / 5.0
    first, second = start - x, start - y
    limit = _DISTANCE * max(abs(first), abs(second), abs(start - z))
    total, share = 0.0, 1.0
    while share * limit >= mean:
        roots = math.sqrt(x), math.sqrt(y), math.sqrt(z)
        step = roots[0] * roots[1] + (roots[0] + roots[1]) * roots[2]
        total += share / (roots[2] * (z + step))
        x, y, z, mean = 0.25 * (x + step), 0.25 * (y + step), 0.25 * (z + step), 0.25 * (mean + step)
        share *= 0.25
    a, b = first * share / mean, second * share / mean
    c = -(a + b) / 3.0
    e2, e3 = a * b - 6.0 * c * c, (3.0 * a * b - 8.0 * c * c) * c
    e4, e5 = 3.0 * (a * b - c * c) * c * c, a * b * c**3
    series = 1.0 - 3 / 14 * e2 + e3 / 6 + 9 / 88 * e2 * e2 - 3 / 22 * e4 - 9 / 52 * e2 * e3 + 3 / 26 * e5
    return 3.0 * total + share * series / (mean * math.sqrt(mean))
