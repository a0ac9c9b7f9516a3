"""A whole wrench from any number of coils with the least heat within their limits: six equations, some of them soft.

    minimise ½ Σ R_j i_j² + (ρ/2) ‖W (A i − w)‖²   such that   |i_j| ≤ L_j

With y = √R i, Q = W A/√R and slack ν/ρ this has one multiplier per component of the wrench and y_j = clip(Q_jᵀν): the
dual function is convex, piecewise quadratic and strictly so by ν²/2ρ, for any rank of A. Newton steps with the exact
line search of `dual_newton` find its minimum. ρ is so large that a wrench that can be had is given to about 1e-6; in a
direction that takes more than a thousand times the current of the best one, such as the torque about a single magnet's
own axis, nothing is spent.
"""

from __future__ import annotations

import numpy as np

from haptorb.control.allocation.dual_newton import line_search
from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel

__all__ = ["solve_least_heat"]

_RIGID = 1e6  #: ρ times the square of the greatest singular value of Q, about
_STEPS = 60
_TOLERANCE = 1e-9
_NO_LIMIT = 1e100


@kernel
def _solve_positive(H: Array, g: Array) -> None:
    """g (6,) becomes H⁻¹ g for a symmetric positive H (6, 6), which is overwritten: Cholesky."""
    for i in range(6):
        for j in range(i + 1):
            total = H[i, j]
            for k in range(j):
                total -= H[i, k] * H[j, k]
            H[i, j] = np.sqrt(max(total, 1e-300)) if i == j else total / H[j, j]
    for i in range(6):
        for k in range(i):
            g[i] -= H[i, k] * g[k]
        g[i] /= H[i, i]
    for i in range(5, -1, -1):
        for k in range(i + 1, 6):
            g[i] -= H[k, i] * g[k]
        g[i] /= H[i, i]


@kernel
def solve_least_heat(
    matrix: Array, target: Array, weights: Array, limit: Array, resistance: Array, currents: Array
) -> bool:
    """Write the currents (m,) [A] for `target` (6,) into `currents`; whether the search converged.

    matrix (6, m) [N/A, N·m/A], weights (6,) of the components, 0: free; limit (m,) [A]; resistance (m,) [Ω]. For use in
    compiled code: all numbers finite.
    """
    m = limit.shape[0]
    Q, along, s, box = np.zeros((m + 6, 6)), np.empty(m + 6), np.empty(m + 6), np.empty(m + 6)
    t, nu, step, H = np.empty(6), np.zeros(6), np.empty(6), np.empty((6, 6))
    most, size = 0.0, 0.0
    for j in range(m):
        root, square = 1.0 / np.sqrt(resistance[j]), 0.0
        box[j] = limit[j] / root
        for i in range(6):
            Q[j, i] = weights[i] * matrix[i, j] * root if limit[j] > 0.0 else 0.0
            square += Q[j, i] * Q[j, i]
        most += square
        currents[j] = 0.0
    for i in range(6):
        t[i] = weights[i] * target[i]
        size = max(size, abs(t[i]))
    if most == 0.0 or size == 0.0:
        return True
    slack = np.sqrt(most / _RIGID)
    for i in range(6):
        Q[m + i, i], box[m + i] = slack, _NO_LIMIT
    converged = False
    for _ in range(_STEPS):
        H[:] = 0.0
        for i in range(6):
            step[i] = t[i]
        for j in range(m + 6):
            at = 0.0
            for i in range(6):
                at += Q[j, i] * nu[i]
            s[j] = at
            if at > box[j]:
                at = box[j]
            elif at < -box[j]:
                at = -box[j]
            else:
                for i in range(6):
                    for k in range(i + 1):
                        H[i, k] += Q[j, i] * Q[j, k]
            for i in range(6):
                step[i] -= Q[j, i] * at
        left = 0.0
        for i in range(6):
            left = max(left, abs(step[i]))
        if left <= _TOLERANCE * size:
            converged = True
            break
        slope = 0.0
        _solve_positive(H, step)
        for i in range(6):
            slope -= t[i] * step[i]
        for j in range(m + 6):
            along[j] = 0.0
            for i in range(6):
                along[j] += Q[j, i] * step[i]
        length = line_search(s, along, box, slope)
        if not np.isfinite(length):
            break
        for i in range(6):
            nu[i] += length * step[i]
    for j in range(m):
        y = min(max(s[j], -box[j]), box[j])
        # the division may land one rounding above the limit; the limit is a promise
        currents[j] = min(max(y / np.sqrt(resistance[j]), -limit[j]), limit[j])
    return converged
