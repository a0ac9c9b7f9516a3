"""Minimum distance of round parts while one side turns: points on their surfaces at many poses.

Nothing is shared with `haptorb.devices.turning_clearance`: no symmetry is used, every part is a cloud of points in
space, turned as a whole.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

Array = np.ndarray


def draw_surface(low: float, high: float, inner: float, outer: float, count: int, draw: np.random.Generator) -> Array:
    """(n, 3) points on the surface of a cylinder, or ring, about z: drawn on its sides, evenly on its edges."""
    phi = draw.uniform(0, 2 * np.pi, count)
    z = draw.uniform(low, high, count)
    rho = np.sqrt(draw.uniform(inner**2, outer**2, count))
    rows = [(outer, z), (rho, low), (rho, high)] + ([(inner, z)] if inner else [])
    clouds = [np.stack(np.broadcast_arrays(r * np.cos(phi), r * np.sin(phi), h), axis=1) for r, h in rows]
    around = 2 * np.pi * np.arange(120) / 120
    for r in {inner, outer}:
        for h in (low, high):
            clouds.append(np.stack(np.broadcast_arrays(r * np.cos(around), r * np.sin(around), h), axis=1))
    return np.concatenate(clouds)


def stand_along(points: Array, directions: Array) -> Array:
    """Clouds of `points` (n, 3) about z, one along each of `directions` (k, 3), together (k·n, 3)."""
    turned = []
    for direction in np.atleast_2d(directions):
        side = np.cross([0.0, 0.0, 1.0], direction)
        sine = np.linalg.norm(side)
        angle = np.arctan2(sine, direction[2])
        axis = side / sine if sine > 1e-12 else np.array([1.0, 0.0, 0.0])
        turned.append(Rotation.from_rotvec(angle * axis).apply(points))
    return np.concatenate(turned)


def draw_poses(tilt: float, count: int, draw: np.random.Generator) -> list[Rotation]:
    """Rotations Rx(ψ) Ry(λ) Rz(φ): the four corners of the workspace, its border, and drawn ones, at drawn spins."""
    corners = [(a * tilt, b * tilt) for a in (-1, 1) for b in (-1, 1)]
    border = [(a * tilt, b) for a in (-1, 1) for b in draw.uniform(-tilt, tilt, count)]
    border += [(b, a) for a, b in border]
    inside = list(draw.uniform(-tilt, tilt, (count, 2)))
    return [
        Rotation.from_euler("XYZ", [psi, lam, draw.uniform(0, 2 * np.pi)])
        for psi, lam in [*corners * 2, *border, *inside]
    ]


def least_distance(moving: Array, standing: Array, poses: list[Rotation]) -> float:
    """Least distance [m] of the clouds `moving` and `standing` over `poses` of the moving one."""
    tree = cKDTree(standing)
    return min(float(tree.query(pose.apply(moving))[0].min()) for pose in poses)
