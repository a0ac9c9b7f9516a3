"""Directions spread evenly over a part of the sphere."""

from __future__ import annotations

import numpy as np

from haptorb.numerics.arrays import Array

__all__ = ["cap_directions"]


def cap_directions(half_angle: float, points: int) -> Array:
    """(points, 3) unit vectors spread evenly (a Fibonacci spiral) over the cap of `half_angle` [rad] about +z.

    >>> bool((cap_directions(0.5, 20)[:, 2] > np.cos(0.5)).all())
    True
    """
    n = np.arange(points) + 0.5
    z = 1 - n / points * (1 - np.cos(half_angle))
    turn = np.pi * (1 + np.sqrt(5)) * n
    s = np.sqrt(1 - z * z)
    return np.column_stack([s * np.cos(turn), s * np.sin(turn), z])
