"""A path as the console draws it: a thin tube."""

from __future__ import annotations

import numpy as np

from haptorb.worlds.path_guidance.guidance_path import GuidancePath
from haptorb.worlds.shape import Shape

__all__ = ["draw_path"]

_RADIUS = 0.35e-3  #: of the tube [m]
_APART = 1.5e-3  #: of two rings, unless there are `_MOST` [m]
_MOST = 320  #: rings: a path of 2 m is no load for the page
_SIDES = 4


def draw_path(path: GuidancePath, lower: float = 0.0) -> Shape:
    """A tube along `path`, open at its ends, or closed as the path is; `lower` [m] nearer to the centre: the path
    of the tip below the tool's magnet.

    >>> from haptorb.worlds.path_guidance.path_shapes import make_shape
    >>> draw_path(make_shape("line")).kind
    'mesh'
    """
    last = len(path.places) - 1
    count = min(max(int(np.ceil(path.length / _APART)), 2), _MOST)
    rings = np.round(np.linspace(0, last, count + 1)).astype(int)
    centres, along = path.places[rings], path.tangents[rings]
    outward = centres / np.linalg.norm(centres, axis=1, keepdims=True)
    side = np.cross(along, outward)
    steep = np.linalg.norm(side, axis=1) < 0.1  # straight away from the centre: any direction across will do
    side[steep] = np.cross(along[steep], (0.6, 0.8, 0.0))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    turn = np.arange(_SIDES) * 2 * np.pi / _SIDES
    across = np.cos(turn)[:, None] * side[:, None] + np.sin(turn)[:, None] * np.cross(side, along)[:, None]
    points = (centres[:, None] - lower * outward[:, None] + _RADIUS * across).round(5)
    here = _SIDES * np.arange(count)[:, None] + np.arange(_SIDES)
    beside = _SIDES * np.arange(count)[:, None] + (np.arange(_SIDES) + 1) % _SIDES
    corners = np.stack([here, beside, here + _SIDES, beside, beside + _SIDES, here + _SIDES], axis=-1)
    at = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    return Shape(
        "path", "mesh", (), "", at=at, role="path", points=tuple(points.ravel().tolist()),
        corners=tuple(corners.ravel().tolist()),
    )  # fmt: skip
