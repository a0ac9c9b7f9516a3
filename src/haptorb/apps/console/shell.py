"""The dome as a mesh: rings of vertices around the zenith, evenly spread, so that colour can be painted per vertex."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from haptorb.numerics.arrays import Array

__all__ = ["shell"]


@lru_cache(maxsize=4)
def shell(rings: int = 45, reach: float = 90.0) -> tuple[Array, Array]:
    """Unit vectors (n, 3) from the zenith down to `reach` [deg], and triangles (m, 3) seen from outside.

    Ring i holds 6 i vertices, as in a sunflower of hexagons: neighbours are about `reach`/`rings` degrees apart.

    >>> directions, triangles = shell(2)
    >>> directions.shape, triangles.shape
    ((19, 3), (24, 3))
    """
    tilt = np.radians(reach) * np.arange(rings + 1) / rings
    directions = [np.array([[0.0, 0.0, 1.0]])]
    for i in range(1, rings + 1):
        azimuth = 2 * np.pi * np.arange(6 * i) / (6 * i)
        level = np.full_like(azimuth, np.cos(tilt[i]))
        directions.append(np.stack([np.sin(tilt[i]) * np.cos(azimuth), np.sin(tilt[i]) * np.sin(azimuth), level], 1))
    triangles = []
    for i in range(1, rings + 1):
        inner, outer = (1 + 3 * (i - 1) * (i - 2) if i > 1 else 0), 1 + 3 * i * (i - 1)
        for side in range(6):
            for k in range(i):
                # The inner ring has one vertex less on each of the six sides.
                here, there = side * i + k, (side * i + k + 1) % (6 * i)
                below = inner + (side * (i - 1) + k) % max(6 * (i - 1), 1)
                triangles.append((below, outer + here, outer + there))
                if k < i - 1:
                    beside = inner + (side * (i - 1) + k + 1) % (6 * (i - 1))
                    triangles.append((below, outer + there, beside))
    return np.concatenate(directions), np.array(triangles)
