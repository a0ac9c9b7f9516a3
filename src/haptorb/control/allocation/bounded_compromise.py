"""Weighted least squares within limits: the compromise nearest to a wrench that few coils cannot give whole.

    minimise ½ ‖W (A i − w)‖²   such that   |i_j| ≤ L_j,   Σ R_j i_j² ≤ P

With H = AᵀW²A and g = AᵀW²w this is a convex problem of m unknowns. Coordinate descent, each current in turn moved to
its best value within its limit, ends at its only minimum (H is regular; a trace of heat makes it so elsewhere). Where
the supply's power holds, its multiplier λ ≥ 0 is added as λR to H and found by a bracketed secant: the power falls as
λ rises.
"""

from __future__ import annotations

import numpy as np

from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel

__all__ = ["AT_CURRENT", "AT_POWER", "FREE", "solve_compromise"]

FREE, AT_CURRENT, AT_POWER = 0, 1, 2  #: which limit the answer stands at

_SWEEPS = 2000
_PRECISE = 1e-11  #: change of a current in a sweep, relative to the greatest current, at which it is found
_TRACE = 1e-12  #: heat's weight, relative to the greatest of H: decides where H does not
_EXACT = 1e-9  #: relative, of the power
_ROUNDS = 60


@kernel
def _descend(H: Array, g: Array, limit: Array, resistance: Array, heat: float, currents: Array) -> float:
    """Bring `currents` (m,) to the minimum of ½ iᵀ(H + heat R) i − gᵀi within ±limit; the power Σ R i² there [W]."""
    m = g.shape[0]
    for _ in range(_SWEEPS):
        moved, largest = 0.0, 0.0
        for j in range(m):
            slope, curvature = g[j], H[j, j] + heat * resistance[j]
            if curvature <= 0.0:
                continue
            for k in range(m):
                if k != j:
                    slope -= H[j, k] * currents[k]
            best = min(max(slope / curvature, -limit[j]), limit[j])
            moved = max(moved, abs(best - currents[j]))
            largest = max(largest, abs(best))
            currents[j] = best
        if moved <= _PRECISE * largest:
            break
    power = 0.0
    for j in range(m):
        power += resistance[j] * currents[j] * currents[j]
    return power


@kernel
def solve_compromise(H: Array, g: Array, limit: Array, resistance: Array, power: float, currents: Array) -> int:
    """Write the minimum into `currents` (m,) [A]; FREE, AT_CURRENT or AT_POWER.

    H (m, m), g (m,), limit (m,) [A], resistance (m,) [Ω], power [W], inf for no limit. For use inside compiled code.
    """
    m = g.shape[0]
    greatest, hottest = 0.0, 0.0
    for j in range(m):
        currents[j] = 0.0
        greatest = max(greatest, H[j, j])
        hottest = max(hottest, resistance[j])
    if greatest == 0.0:
        return FREE
    trace = _TRACE * greatest / hottest
    if _descend(H, g, limit, resistance, trace, currents) > power:
        # 1/√(Σ R i²) is nearly a straight line of λ: a secant finds it, kept between bounds
        low, high = trace, greatest / hottest
        while _descend(H, g, limit, resistance, high, currents) > power:
            low, high = high, 8.0 * high
        wanted = 1.0 / np.sqrt(power)
        below = 1.0 / np.sqrt(_descend(H, g, limit, resistance, low, currents)) - wanted
        above = 1.0 / np.sqrt(_descend(H, g, limit, resistance, high, currents)) - wanted
        for _ in range(_ROUNDS):
            middle = low - below * (high - low) / (above - below)
            if not low < middle < high:
                break
            at = 1.0 / np.sqrt(_descend(H, g, limit, resistance, middle, currents)) - wanted
            if abs(at) <= _EXACT * wanted:
                break
            if at < 0.0:
                low, below = middle, at
                above *= 0.5  # Illinois: else one end would never move
            else:
                high, above = middle, at
                below *= 0.5
        return AT_POWER
    for j in range(m):
        if abs(currents[j]) >= limit[j]:
            return AT_CURRENT
    return FREE
