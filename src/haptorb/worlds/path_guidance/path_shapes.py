"""Four paths on a sphere about the dome's centre: line, circle, square and spiral."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from haptorb.errors import UnknownName
from haptorb.numerics.arrays import Array
from haptorb.worlds.path_guidance.guidance_path import GuidancePath, make_path

__all__ = ["SHAPES", "make_shape"]

#: in the order of the world's parameter `shape`
SHAPES = ("line", "circle", "square", "spiral")
_FIRST_TILT = 6.0  #: at which the spiral begins [deg]
_PITCH = 9.0  #: by which it widens in a turn [deg]


@lru_cache(maxsize=32)
def make_shape(name: str, size_deg: float = 25.0, radius: float = 0.05) -> GuidancePath:
    """The path `name` of SHAPES within `size_deg` [deg] of the summit, at `radius` [m] from the centre.

    line: over the summit, from `size_deg` on one side to the same on the other. circle: about the summit. square: its
    corners at `size_deg`. spiral: outward from 6°, 9° per turn. Raises UnknownName for another name.

    >>> make_shape("circle").closed, make_shape("spiral").closed
    (True, False)
    """
    if name not in SHAPES:
        raise UnknownName("path", name, SHAPES)
    if name == "line":
        return make_path(_place(np.linspace(-size_deg, size_deg, 9), np.zeros(9), radius), smooth=False)
    if name == "circle":
        turn = np.linspace(0.0, 2 * np.pi, 361)
        return make_path(_place(np.full(361, size_deg), turn, radius), closed=True, smooth=False)
    if name == "square":
        turn = np.radians([45.0, 135.0, 225.0, 315.0])
        return make_path(_place(np.full(4, size_deg), turn, radius), closed=True, smooth=False)
    turns = max((size_deg - _FIRST_TILT) / _PITCH, 0.5)
    turn = np.linspace(0.0, 2 * np.pi * turns, 1 + round(180 * turns))
    return make_path(_place(np.linspace(_FIRST_TILT, size_deg, len(turn)), turn, radius), smooth=False)


def _place(tilt_deg: Array, turn: Array, radius: float) -> Array:
    """(n, 3) [m] the places at `tilt_deg` (n,) [deg] from the summit and `turn` (n,) [rad] about it."""
    tilt = np.radians(tilt_deg)
    return radius * np.column_stack([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
