"""Round parts and balls as flat facets with a shade, for a drawing in three dimensions."""

from __future__ import annotations

import numpy as np

from haptorb.devices.geometry import RoundPart
from haptorb.devices.motor.layouts import spherical_frames
from haptorb.numerics.arrays import Array

__all__ = ["ball_facets", "part_facets", "shade"]

_AROUND = 36  #: facets about an axis
_LIGHT = np.array([-0.45, -0.55, 0.70])  #: towards the lamp


def part_facets(part: RoundPart) -> Array:
    """(n, 4, 3) facets of `part` [m]: outer wall, inner wall where it is hollow, both ends."""
    turn = np.linspace(0.0, 2 * np.pi, _AROUND + 1)
    ring = np.stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)], axis=1)
    up = np.array([0.0, 0.0, part.length / 2])
    outer, inner = part.outer_radius * ring, part.inner_radius * ring

    def band(first: Array, second: Array) -> Array:
        return np.stack([first[:-1], first[1:], second[1:], second[:-1]], axis=1)

    walls = [band(outer - up, outer + up), band(outer + up, inner + up), band(inner - up, outer - up)]
    if part.inner_radius > 0:
        walls.append(band(inner + up, inner - up))
    frame = spherical_frames(part.axis[None])[0]
    facets: Array = np.concatenate(walls) @ frame.T + part.position
    return facets


def ball_facets(radius: float) -> Array:
    """(n, 4, 3) facets of a ball about the origin [m]."""
    polar, turn = np.linspace(0.0, np.pi, 19), np.linspace(0.0, 2 * np.pi, _AROUND + 1)
    grid = radius * np.stack(
        [
            np.sin(polar)[:, None] * np.cos(turn),
            np.sin(polar)[:, None] * np.sin(turn),
            np.repeat(np.cos(polar)[:, None], len(turn), axis=1),
        ],
        axis=2,
    )
    facets: Array = np.stack([grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]], axis=2).reshape(-1, 4, 3)
    return facets


def shade(facets: Array, colour: tuple[float, float, float], opacity: float = 1.0) -> Array:
    """(n, 4) colours of `facets` (n, 4, 3) of a body of that `colour`, 0 to 1, under a lamp from the upper left."""
    normals = np.cross(facets[:, 2] - facets[:, 0], facets[:, 3] - facets[:, 1])
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    light = np.clip(normals / np.maximum(length, 1e-30) @ (_LIGHT / np.linalg.norm(_LIGHT)), 0.0, 1.0)
    lit: Array = np.empty((len(facets), 4))
    lit[:, :3] = np.clip(np.asarray(colour) * (0.55 + 0.55 * light[:, None]), 0.0, 1.0)
    lit[:, 3] = opacity
    return lit
