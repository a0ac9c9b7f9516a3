"""The worst orientation of a motor's workspace: an even sample, and a search downhill from its worst points.

A spherical motor is weak in narrow valleys between its poles; a grid of a few thousand orientations still misses 20 %
of the worst heat. Here a few hundred find the valleys, and steps along the three angles go to their bottoms.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from haptorb.numerics.arrays import Array
from haptorb.numerics.rotations import rotation_from_euler

__all__ = ["find_worst", "spread_angles"]

_STARTS = 12  #: worst points of the sample from which the search continues
_ROUNDS = 7
_STEPS = np.array([[i, j, k] for i in (-1.0, 0.0, 1.0) for j in (-1.0, 0.0, 1.0) for k in (-1.0, 0.0, 1.0)])


@lru_cache(maxsize=16)
def spread_angles(tilt: float, count: int) -> Array:
    """(count, 3) angles ψ, λ, φ [rad] that fill the workspace |ψ|, |λ| ≤ `tilt`, 0 ≤ φ < 2π evenly, edges included.

    Kronecker's sequence of the plastic number's kin (Roberts 2018): even for every count, and always the same. ψ and λ
    are scaled by 1.2 and cut at the edge, where motors are weakest.
    """
    root = 1.2207440846057596  # x⁴ = x + 1
    share = np.mod(0.5 + np.outer(np.arange(count), root ** -np.arange(1.0, 4.0)), 1.0)
    tilts = np.clip(1.2 * (2 * share[:, :2] - 1), -1.0, 1.0) * tilt
    angles: Array = np.column_stack([tilts, 2 * np.pi * share[:, 2]])
    angles.flags.writeable = False
    return angles


def find_worst(value: Callable[[Array], Array], tilt: float, count: int) -> tuple[float, Array]:
    """Least of `value`, (n, 3, 3) rotations → (n,), over the workspace, and the angles (3,) ψ, λ, φ [rad] of it.

    `count` orientations are looked at first, and about three times 12 × 27 more on the way to the bottom. The search is
    local: it finds the bottom of every valley that the sample's 12 worst points lie in.
    """
    angles = spread_angles(tilt, count)
    found = value(_rotations(angles))
    order = np.argsort(found, kind="stable")[:_STARTS]
    at, least = angles[order].copy(), found[order]
    step = 2.0 * tilt / max(count, 8) ** (1 / 3)
    for _ in range(_ROUNDS):
        near = at[:, None] + step * _STEPS
        near[..., :2] = np.clip(near[..., :2], -tilt, tilt)
        values = value(_rotations(near.reshape(-1, 3))).reshape(len(at), len(_STEPS))
        best = np.argmin(values, axis=1)
        here = np.arange(len(at))
        at, least = near[here, best], np.minimum(least, values[here, best])
        step *= 0.5
        if len(at) > 4:  # most starts lead to the same few valleys
            keep = np.argsort(least, kind="stable")[: max(4, len(at) // 2)]
            at, least = at[keep], least[keep]
    lowest = int(np.argmin(least))
    return float(least[lowest]), at[lowest]


def _rotations(angles: Array) -> Array:
    return np.ascontiguousarray(rotation_from_euler(angles[:, 0], angles[:, 1], angles[:, 2]))
