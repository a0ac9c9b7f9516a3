"""Minimum-power currents for a torque or a wrench: in closed form, and within every channel's current limit.

Each problem with limits is reduced to a form of `haptorb.box_qp`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from haptorb.arrays import Array, check_finite, vectors
from haptorb.box_qp import GIVEN, NOT_CONVERGED, SCALED, dual_newton, orthonormal_rows
from haptorb.compiled import exact_kernel
from haptorb.control.saturation import reach, zonotope_nearest
from haptorb.errors import InputError

__all__ = ["NEAREST", "NOT_FINITE", "minimum_power_currents", "solve_bounded_power", "solve_least_heat"]


NEAREST = 2  #: beyond the limits: the nearest feasible torque; beside GIVEN and SCALED of `haptorb.box_qp`
NOT_FINITE = 3  #: NaN or infinity in the input; the currents are NaN


def minimum_power_currents(K: ArrayLike, T: ArrayLike) -> Array:
    """Currents (..., m) [A] for torque T (..., 3) [N·m], torque characteristic K (..., 3, m) [N·m/A], without limits.

    u = Kᵀ (K Kᵀ)⁻¹ T, Bai 2012 eq. (4): minimum Σ u². Raises InputError if K has rank below three.

    >>> minimum_power_currents(np.eye(3), (1.0, 2.0, 3.0)).tolist()
    [1.0, 2.0, 3.0]
    """
    k = check_finite(K, "K")
    if k.ndim < 2 or k.shape[-2] != 3:
        raise InputError(f"K must be a torque characteristic, shape (..., 3, m); got shape {k.shape}")
    torque = vectors(T, "T")
    left, values, right = np.linalg.svd(k, full_matrices=False)
    if k.shape[-1] < 3 or (values[..., -1] <= 1e-12 * values[..., 0]).any():
        raise InputError(
            "K must have rank 3 (torque about all three axes) for eq. (4); MinimumPowerAllocator reports why not"
        )
    inner = np.einsum("...ij,...i->...j", left, torque) / values
    currents: Array = np.einsum("...ji,...j->...i", right, inner)
    return currents


# --------------------------------------------------------------------------------------------------
# Minimum-power torque with current limits: compiled solver for three torques and any number of channels.
#
#     minimise ½ Σ w_j i_j²   such that   K i = T,   |i_j| ≤ L_j
#
# has one multiplier μ per torque axis and currents i_j = clip(K_jᵀμ / w_j, ±L_j): `dual_newton` finds them. Beyond the
# zonotope of feasible torques there is no solution, and the dual function decreases without bound along some μ: the
# certificate of infeasibility. Then either the torque is scaled to the zonotope's surface along its own direction, or
# the nearest torque on the surface is taken.
#
# Without limits this is Bai 2012 eq. (4): u = Kᵀ (K Kᵀ)⁻¹ T.


# relative torque about an axis that no channel drives, below which it is rounding error
_UNDRIVEN_AXIS_TOLERANCE = 1e-9


_TORQUE_TOLERANCE = 1e-11  #: relative to the torque


@exact_kernel
def _least_norm(Q: Array, t: Array, share: float, box: Array, work: Array, y: Array) -> int:
    """Minimise ‖y‖ with Q y = share · t, |y_j| ≤ box_j, for orthonormal rows of Q (3, m); returns what `dual_newton`
    does. work (2, 3) is overwritten."""
    target, nu, square = work[0], work[1], 0.0
    for i in range(3):
        target[i] = nu[i] = t[i] * share  # already optimal if no current meets its limit
        square += target[i] * target[i]
    status: int = dual_newton(Q, target, 0.0, box, _TORQUE_TOLERANCE * np.sqrt(square), nu, y)
    return status


@exact_kernel
def _least_norm_within(Q: Array, t: Array, box: Array, y: Array) -> float:
    """Fallback where rounding dominates, with limits many decades apart: the minimum-norm y for t, scaled into the box.

    Not optimal, but in the direction of t and within every limit. Returns the share of t that y produces.
    """
    share = 1.0
    for j in range(y.size):
        y[j] = Q[0, j] * t[0] + Q[1, j] * t[1] + Q[2, j] * t[2]
        if abs(y[j]) * share > box[j]:
            share = box[j] / abs(y[j])
    for j in range(y.size):
        y[j] *= share
    return share


@exact_kernel
def solve_bounded_power(
    K: Array, T: Array, limit: Array, resistance: Array, nearest: bool, currents: Array
) -> tuple[int, float]:
    """Write the currents (m,) [A] for torque T (3,) [N·m] into `currents`; return the outcome and the scale of T.

    K (3, m) [N·m/A], limit (m,) [A], resistance (m,) in any unit (only ratios matter). A torque beyond the limits is
    replaced by the nearest feasible one if `nearest`, else scaled. For use inside compiled code;
    `MinimumPowerAllocator` checks its input.
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
        return GIVEN, 1.0  # zero torque, or so small that its square underflows
    if strongest * greatest < 1e-250:
        return (NEAREST, 1.0) if nearest else (SCALED, 0.0)

    # y = √R i normalises the channels: minimise ‖y‖². Columns with zero current limit are left out. Torque and
    # characteristic are scaled by their largest entries, so that no square underflows.
    lines, vectors = np.zeros((6, m)), np.empty((4, 3))
    Q, box, root, y = lines[:3], lines[3], lines[4], lines[5]
    t, asked, start = vectors[0], vectors[1], vectors[2:]
    unit = greatest / strongest
    for j in range(m):
        root[j] = np.sqrt(resistance[j])
        box[j] = min(limit[j] * root[j] / unit, 1e100)
        if box[j] < 1e-100:
            box[j] = 0.0
        for i in range(3):
            Q[i, j] = K[i, j] / root[j] / strongest if box[j] > 0.0 else 0.0
    for i in range(3):
        t[i] = asked[i] = T[i] / greatest
    rank = orthonormal_rows(Q, t)
    size = np.sqrt(asked[0] * asked[0] + asked[1] * asked[1] + asked[2] * asked[2])
    outside = 0.0
    for i in range(rank, 3):
        outside = max(outside, abs(t[i]))
        t[i] = 0.0
    status = SCALED
    scale = 1.0
    if outside <= _UNDRIVEN_AXIS_TOLERANCE * size:
        status = _least_norm(Q, t, 1.0, box, start, y)
        if status == NOT_CONVERGED and reach(Q, t, box, rank) < 1.0:
            status = SCALED
    if status == SCALED and nearest:
        status = NEAREST
        for i in range(3):
            t[i] = asked[i]
            for j in range(m):
                Q[i, j] = K[i, j] / root[j] / strongest if box[j] > 0.0 else 0.0
        zonotope_nearest(Q, t, box)
        rank = orthonormal_rows(Q, t)
        for i in range(rank, 3):
            t[i] = 0.0
    elif status == SCALED:
        if outside > _UNDRIVEN_AXIS_TOLERANCE * size:
            return SCALED, 0.0  # a component is about an axis that no channel drives: the direction cannot be preserved
        scale = min(reach(Q, t, box, rank), 1.0)
        for i in range(3):
            t[i] *= scale
    if status != GIVEN:
        # On the surface itself the multipliers may be infinite; slightly inside they are finite. A tiny margin nearly
        # always suffices; limits many decades apart may need more.
        hair = 1e-9
        while True:
            if _least_norm(Q, t, 1.0 - hair, box, start, y) == GIVEN:
                break
            hair *= 30.0
            if hair > 0.1:
                hair = 1.0 - _least_norm_within(Q, t, box, y)
                break
        if status != NEAREST:
            scale *= 1.0 - hair
            status = SCALED
    for j in range(m):
        # the division may exceed the limit by one rounding; the limit is strict
        currents[j] = min(max(y[j] * unit / root[j], -limit[j]), limit[j])
    return status, scale


# --------------------------------------------------------------------------------------------------
# Minimum-power allocation of a whole wrench for any number of coils: six equations, some of them soft.
#
#     minimise ½ Σ R_j i_j² + (ρ/2) ‖W (A i − w)‖²   such that   |i_j| ≤ L_j
#
# With y = √R i, Q = W A/√R and slack 1/√ρ this is the first form of `haptorb.box_qp`, for any rank of A. ρ is so large
# that a feasible wrench is met to about 1e-6; no current is spent on a direction that takes more than a thousand times
# the current of the best one, such as the torque about a single magnet's own axis.


_RELATIVE_STIFFNESS = 1e6  #: ρ times the square of the largest singular value of Q, approximately
_LEAST_HEAT_TOLERANCE = 1e-9  #: relative to the largest component of the wrench


@exact_kernel
def solve_least_heat(
    matrix: Array, target: Array, weights: Array, limit: Array, resistance: Array, currents: Array
) -> bool:
    """Write the currents (m,) [A] for `target` (6,) into `currents`; return whether the search converged.

    matrix (6, m) [N/A, N·m/A], weights (6,) of the components, 0: free; limit (m,) [A]; resistance (m,) [Ω]. For use in
    compiled code: all numbers finite.
    """
    m = limit.shape[0]
    Q, t, nu, box, y = np.empty((6, m)), np.empty(6), np.zeros(6), np.empty(m), np.empty(m)
    most, size = 0.0, 0.0
    for j in range(m):
        root, square = 1.0 / np.sqrt(resistance[j]), 0.0
        box[j] = limit[j] / root
        for i in range(6):
            Q[i, j] = weights[i] * matrix[i, j] * root if limit[j] > 0.0 else 0.0
            square += Q[i, j] * Q[i, j]
        most += square
        currents[j] = 0.0
    for i in range(6):
        t[i] = weights[i] * target[i]
        size = max(size, abs(t[i]))
    if most == 0.0 or size == 0.0:
        return True
    slack = np.sqrt(most / _RELATIVE_STIFFNESS)
    converged: bool = dual_newton(Q, t, slack, box, _LEAST_HEAT_TOLERANCE * size, nu, y) == GIVEN
    for j in range(m):
        # the division may exceed the limit by one rounding; the limit is strict
        currents[j] = min(max(y[j] / np.sqrt(resistance[j]), -limit[j]), limit[j])
    return converged
