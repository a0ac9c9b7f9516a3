"""Least heat for a torque when every current has a limit: a compiled solver for three torques and any channels.

    minimise ½ Σ w_j i_j²   such that   K i = T,   |i_j| ≤ L_j

has one multiplier μ per torque axis and currents i_j = clip(K_jᵀμ / w_j, ±L_j): `dual_newton` finds them. Beyond the
zonotope of torques within the limits there is no solution, and the dual function falls without end along some μ: that
is the proof. Then either the torque is cut to the zonotope's surface along its own direction, or the nearest torque on
the surface is taken.

Without limits this is Bai 2012 eq. (4): u = Kᵀ (K Kᵀ)⁻¹ T.
"""

from __future__ import annotations

import numpy as np

from haptorb.control.allocation.dual_newton import (
    GIVEN,
    NEAREST,
    NOT_CONVERGED,
    NOT_FINITE,
    SCALED,
    dual_newton,
    orthonormal_rows,
)
from haptorb.control.allocation.zonotope import nearest as nearest_point
from haptorb.control.allocation.zonotope import reach
from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel

__all__ = ["NOT_FINITE", "solve_bounded_power"]

_UNTURNED = 1e-9  # relative part of a torque, about an axis that no channel turns, that is taken for rounding


@kernel
def _least_norm_within(Q: Array, t: Array, box: Array, y: Array) -> float:
    """Where rounding hides the way, limits being many decades apart: the shortest y for t, scaled into the box.

    Less than could be had, but in its direction and within every limit. Returns the share of t that y gives.
    """
    share = 1.0
    for j in range(y.size):
        y[j] = Q[0, j] * t[0] + Q[1, j] * t[1] + Q[2, j] * t[2]
        if abs(y[j]) * share > box[j]:
            share = box[j] / abs(y[j])
    for j in range(y.size):
        y[j] *= share
    return share


@kernel
def solve_bounded_power(
    K: Array, T: Array, limit: Array, resistance: Array, nearest: bool, currents: Array
) -> tuple[int, float]:
    """Write the currents (m,) [A] for torque T (3,) [N·m] into `currents`; return what happened and the scale of T.

    K (3, m) [N·m/A], limit (m,) [A], resistance (m,) in any unit (ratios matter). `nearest` chooses what becomes of
    a torque beyond the limits: the nearest one, else the torque's direction is kept. For use inside compiled code;
    `MinimumPowerAllocator` is the checked door.
    """
    m = K.shape[1]
    total = abs(T[0]) + abs(T[1]) + abs(T[2])
    for j in range(m):
        total += abs(K[0, j]) + abs(K[1, j]) + abs(K[2, j]) + abs(limit[j]) + abs(resistance[j])
    if not np.isfinite(total):
        for j in range(m):
            currents[j] = np.nan
        return NOT_FINITE, np.nan
    greatest, strongest = max(abs(T[0]), abs(T[1]), abs(T[2])), 0.0
    for j in range(m):
        currents[j] = 0.0
        if limit[j] > 0.0:
            for i in range(3):
                strongest = max(strongest, abs(K[i, j]) / np.sqrt(resistance[j]))
    if greatest < 1e-250:
        return GIVEN, 1.0  # nothing asked, or so little that its square is zero
    if strongest * greatest < 1e-250:
        return (NEAREST, 1.0) if nearest else (SCALED, 0.0)

    # y = √R i makes all channels alike: least ‖y‖². Columns without any current allowed take no part. Torque and
    # characteristic are measured by their greatest entries, so that no square is lost to rounding.
    Q = np.empty((3, m))
    box = np.empty(m)
    root = np.empty(m)
    unit = greatest / strongest
    for j in range(m):
        root[j] = np.sqrt(resistance[j])
        box[j] = min(limit[j] * root[j] / unit, 1e100)
        if box[j] < 1e-100:
            box[j] = 0.0
        for i in range(3):
            Q[i, j] = K[i, j] / root[j] / strongest if box[j] > 0.0 else 0.0
    t = np.array((T[0] / greatest, T[1] / greatest, T[2] / greatest))
    asked = t.copy()
    rank = orthonormal_rows(Q, t)
    size = np.sqrt(asked[0] * asked[0] + asked[1] * asked[1] + asked[2] * asked[2])
    outside = 0.0
    for i in range(rank, 3):
        outside = max(outside, abs(t[i]))
        t[i] = 0.0
    status = SCALED
    scale = 1.0
    y = np.zeros(m)
    if outside <= _UNTURNED * size:
        status = dual_newton(Q, t, box, y)
        if status == NOT_CONVERGED and reach(Q, t, box, rank) < 1.0:
            status = SCALED
    if status == SCALED and nearest:
        status = NEAREST
        for i in range(3):
            t[i] = asked[i]
            for j in range(m):
                Q[i, j] = K[i, j] / root[j] / strongest if box[j] > 0.0 else 0.0
        nearest_point(Q, t, box)
        rank = orthonormal_rows(Q, t)
        for i in range(rank, 3):
            t[i] = 0.0
    elif status == SCALED:
        if outside > _UNTURNED * size:
            return SCALED, 0.0  # part of it is about an axis that no channel turns: its direction cannot be kept
        scale = min(reach(Q, t, box, rank), 1.0)
        for i in range(3):
            t[i] *= scale
    if status != GIVEN:
        # On the surface itself the multipliers may be infinite; a hair inside they are not. A hair is nearly always
        # enough; limits many decades apart may need more.
        hair = 1e-9
        while True:
            inside = np.array((t[0] * (1.0 - hair), t[1] * (1.0 - hair), t[2] * (1.0 - hair)))
            if dual_newton(Q, inside, box, y) == GIVEN:
                break
            hair *= 30.0
            if hair > 0.1:
                hair = 1.0 - _least_norm_within(Q, t, box, y)
                break
        if status != NEAREST:
            scale *= 1.0 - hair
            status = SCALED
    for j in range(m):
        # the division may land one rounding above the limit; the limit is a promise
        currents[j] = min(max(y[j] * unit / root[j], -limit[j]), limit[j])
    return status, scale
