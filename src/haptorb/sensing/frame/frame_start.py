"""Tip, sphere, frame and axis in closed form, each by itself: where least squares over everything begins.

None of them needs another's answer but the tip, so they are also what that answer is held against.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from haptorb.numerics.arrays import Array
from haptorb.sensing.frame.touches import Touches

__all__ = ["Pivot", "Roll", "find_roll", "fit_points", "pivot", "sphere"]

_ROUNDS = 6  #: of leaving out what does not lie on the sphere
_LEFT_OUT = 4.0  #: robust standard deviations from which a touch does not lie on it
_LEAST = 0.3e-3  #: nor is one left out that is nearer to it than this [m]


@final
@dataclass(frozen=True)
class Pivot:
    """A tip that stood in several places while its body was turned about it."""

    tip: Array  #: (3,) in the body [m]
    places: Array  #: (k, 3) of the tip, tracker frame [m]
    rms: float  #: of what is left per axis [m]
    weakest: float  #: smallest singular value per root of poses: how far the tilts determine the tip, 0 … 1


def pivot(stands: Sequence[Touches]) -> Pivot:
    """The tip and the places in which it stood: P + Q a = b is linear in both."""
    poses = sum(len(one) for one in stands)
    rows, right = np.zeros((3 * poses, 3 + 3 * len(stands))), np.empty(3 * poses)
    at = 0
    for k, one in enumerate(stands):
        end = at + 3 * len(one)
        rows[at:end, :3] = one.R.reshape(-1, 3)
        rows[at:end, 3 + 3 * k : 6 + 3 * k] = -np.tile(np.eye(3), (len(one), 1))
        right[at:end] = -one.p.ravel()
        at = end
    found = np.asarray(np.linalg.lstsq(rows, right, rcond=None)[0], dtype=np.float64)
    left = rows @ found - right
    # what the tilts say of the tip alone: the places are free
    spread = np.concatenate([(one.R - one.R.mean(axis=0)).reshape(-1, 3) for one in stands])
    weakest = float(np.linalg.svd(spread, compute_uv=False)[-1] / np.sqrt(poses))
    return Pivot(found[:3], found[3:].reshape(-1, 3), float(np.sqrt((left**2).mean())), weakest)


def sphere(points: Array) -> tuple[Array, float, Array]:
    """(centre (3,), radius [m], (n,) which points lie on it): |x|² = 2 c·x + (r² − |c|²) is linear in c and the rest.

    Points far off it, where the tip was lifted, are left out round by round.
    """
    middle = np.median(points, axis=0)
    x = points - middle
    on = np.ones(len(x), dtype=bool)
    centre, radius = np.zeros(3), 0.0
    for _ in range(_ROUNDS):
        rows = np.column_stack([2.0 * x[on], np.ones(int(on.sum()))])
        found, *_ = np.linalg.lstsq(rows, (x[on] ** 2).sum(axis=1), rcond=None)
        centre = found[:3]
        radius = float(np.sqrt(max(found[3] + centre @ centre, 0.0)))
        off = np.linalg.norm(x - centre, axis=1) - radius
        scale = 1.4826 * float(np.median(np.abs(off[on] - np.median(off[on]))))
        before, on = on, np.abs(off) <= max(_LEFT_OUT * scale, _LEAST)
        if (on == before).all() or on.sum() < 4:
            break
    return centre + middle, radius, on


def fit_points(places: Array, known: Array, *, mirrored: bool = False) -> tuple[Array, Array, float]:
    """(R (3, 3), t (3,), rms [m]): the rotation, or the reflection, that lays places (k, 3) onto known (k, 3) best.

    R places + t ≈ known, by the singular value decomposition of their covariance (Kabsch).
    """
    a, b = places.mean(axis=0), known.mean(axis=0)
    U, _, Vt = np.linalg.svd((known - b).T @ (places - a))
    sign = np.linalg.det(U @ Vt) * (-1.0 if mirrored else 1.0)
    R = U @ np.diag([1.0, 1.0, np.sign(sign)]) @ Vt
    t = b - R @ a
    return R, t, float(np.sqrt(((places @ R.T + t - known) ** 2).sum(axis=1).mean()))


@final
@dataclass(frozen=True)
class Roll:
    """A body that was turned about one of its own axes."""

    axis: Array  #: (3,) unit vector in the body; its sense is not known
    wobble: float  #: rms angle by which the axis moved [rad]
    angle: float  #: by how much it was turned, up to a whole turn [rad]


def find_roll(poses: Touches) -> Roll:
    """The axis u whose directions Q u differ least: the longest mean of all, so the first eigenvector of Q̄ᵀ Q̄."""
    mean = poses.R.mean(axis=0)
    axis: Array = np.linalg.eigh(mean.T @ mean)[1][:, -1]
    directions = poses.R @ axis
    middle = directions.mean(axis=0)
    middle /= np.linalg.norm(middle)
    wobble = float(np.sqrt((np.linalg.norm(np.cross(directions, middle), axis=1) ** 2).mean()))
    across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    across /= np.linalg.norm(across)
    shown, flat = poses.R @ across, np.cross(middle, poses.R[0] @ across)
    turned = np.sort(np.arctan2(shown @ flat, shown @ np.cross(flat, middle)))
    gaps = np.diff(np.append(turned, turned[0] + 2 * np.pi))
    return Roll(axis, wobble, float(2 * np.pi - gaps.max()))
