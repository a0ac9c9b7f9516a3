"""Air between placed windings, and how far they reach from the origin.

Two bodies are nearest where each point is the nearest one of its body to the other: projections to and fro (von
Neumann; Cheney and Goldstein 1959) lead there from a near start, which the best of many rim points is. Each winding is
taken as a cylinder without its hole: nothing is meant to go through it.
"""

from __future__ import annotations

import numpy as np

from haptorb.devices.coil_array.parts import PlacedCoils
from haptorb.devices.state import rotation_to_axis
from haptorb.numerics.arrays import Array

__all__ = ["find_farthest", "find_spacing"]

_STEPS = 64  #: points around each rim
_ROUNDS = 100


def find_farthest(coils: PlacedCoils) -> Array:
    """(m,) distance of the farthest point of each winding from the origin [m]: on an outer rim."""
    along = (coils.position * coils.axis).sum(axis=1)
    across = np.sqrt(np.maximum((coils.position**2).sum(axis=1) - along**2, 0.0))
    far: Array = np.hypot(across + coils.outer_radius, np.abs(along) + coils.length / 2)
    return far


def find_spacing(coils: PlacedCoils) -> float:
    """Least distance between two windings [m]; 0 where they touch or overlap, infinite for a single one."""
    reach = np.hypot(coils.outer_radius, coils.length / 2)
    first, second = np.triu_indices(len(coils.position), 1)
    least_gap = np.linalg.norm(coils.position[first] - coils.position[second], axis=1) - reach[first] - reach[second]
    found = np.inf
    for row in np.argsort(least_gap, kind="stable"):
        if least_gap[row] >= found:
            break
        found = min(found, _distance(coils, int(first[row]), int(second[row])))
    return float(found)


def _distance(coils: PlacedCoils, i: int, j: int) -> float:
    gaps, starts = [], []
    for one, other in ((i, j), (j, i)):
        points = _list_rims(coils, one)
        away = np.linalg.norm(points - _project(coils, other, points), axis=1)
        nearest = int(np.argmin(away))
        gaps.append(float(away[nearest]))
        starts.append(points[nearest])
    point, best = starts[int(np.argmin(gaps))], min(gaps)
    for _ in range(_ROUNDS):
        there = _project(coils, j, point[None])
        point = _project(coils, i, there)[0]
        gap = float(np.linalg.norm(point - there[0]))
        if gap > best - 1e-9:
            return min(gap, best)
        best = gap
    return best


def _list_rims(coils: PlacedCoils, number: int) -> Array:
    """(n, 3) points on the outer rims and between them, stator frame [m]."""
    angle = 2 * np.pi * np.arange(_STEPS) / _STEPS
    radius, half = float(coils.outer_radius[number]), float(coils.length[number]) / 2
    z, phi = np.meshgrid(np.linspace(-half, half, 5), angle)
    own = np.stack([radius * np.cos(phi), radius * np.sin(phi), z], axis=-1).reshape(-1, 3)
    placed: Array = own @ rotation_to_axis(coils.axis[number]).T + coils.position[number]
    return placed


def _project(coils: PlacedCoils, number: int, points: Array) -> Array:
    """(n, 3) the point of winding `number` that is nearest to each of `points` (n, 3)."""
    axis, half = coils.axis[number], coils.length[number] / 2
    away = points - coils.position[number]
    along = away @ axis
    across = away - along[:, None] * axis
    size = np.linalg.norm(across, axis=1, keepdims=True)
    across *= np.minimum(coils.outer_radius[number] / np.maximum(size, 1e-300), 1.0)
    inside: Array = coils.position[number] + across + np.clip(along, -half, half)[:, None] * axis
    return inside
