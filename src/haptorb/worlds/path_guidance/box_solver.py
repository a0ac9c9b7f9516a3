"""A small convex problem with bounds, solved exactly within a bounded time: projected Newton steps.

min ½ xᵀHx + gᵀx, low ≤ x ≤ high. In every step the variables at an active bound are fixed; the others take a Newton
step that is projected onto their bounds and shortened until the cost decreases (Bertsekas 1982). From the last
solution it takes two or three steps; the result is within the bounds even if the number of steps was not enough.
"""

from __future__ import annotations

import numpy as np

from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel

__all__ = ["solve_box"]

_HALVINGS = 20


@kernel
def _project(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)


@kernel
def _gradient(hessian: Array, linear: Array, x: Array, out: Array) -> float:
    """out (n,) = H x + g; returns the cost ½ xᵀHx + gᵀx."""
    cost = 0.0
    for i in range(x.size):
        total = 0.0
        for j in range(x.size):
            total += hessian[i, j] * x[j]
        out[i] = total + linear[i]
        cost += x[i] * (0.5 * total + linear[i])
    return cost


@kernel
def _newton(hessian: Array, gradient: Array, free: Array, factor: Array, step: Array) -> bool:
    """step (n,) solves H step = −gradient among the `free` (n,) variables, by Cholesky; False if H is not positive."""
    n = gradient.size
    for i in range(n):
        step[i] = 0.0
        if free[i] == 0.0:
            continue
        for j in range(i + 1):
            if free[j] == 0.0:
                continue
            total = hessian[i, j]
            for k in range(j):
                if free[k] != 0.0:
                    total -= factor[i, k] * factor[j, k]
            if i == j:
                if not total > 0.0:
                    return False
                factor[i, i] = np.sqrt(total)
            else:
                factor[i, j] = total / factor[j, j]
        total = -gradient[i]
        for k in range(i):
            if free[k] != 0.0:
                total -= factor[i, k] * step[k]
        step[i] = total / factor[i, i]
    for i in range(n - 1, -1, -1):
        if free[i] == 0.0:
            continue
        total = step[i]
        for k in range(i + 1, n):
            if free[k] != 0.0:
                total -= factor[k, i] * step[k]
        step[i] = total / factor[i, i]
    return True


@kernel
def solve_box(
    hessian: Array, linear: Array, low: Array, high: Array, x: Array, work: Array, most: int, tolerance: float
) -> int:
    """Minimise over x (n,), from its current value; returns the number of Newton steps, or −1 if `most` were not
    enough.

    hessian (n, n), positive definite; linear, low, high (n,); work (n + 4, n) is overwritten. At the end no
    variable could decrease by more than `tolerance` [unit of x] along the scaled gradient. Raises nothing; a problem
    that is not finite leaves x at the bounds.
    """
    n = x.size
    gradient, step, free, trial, factor = work[n], work[n + 1], work[n + 2], work[n + 3], work[:n]
    for i in range(n):
        x[i] = _project(x[i], low[i], high[i]) if np.isfinite(x[i]) else low[i]
    cost = _gradient(hessian, linear, x, gradient)
    for count in range(most + 1):
        worst = 0.0
        for i in range(n):
            scaled = gradient[i] / hessian[i, i]
            worst = max(worst, abs(x[i] - _project(x[i] - scaled, low[i], high[i])))
            held = (x[i] <= low[i] and gradient[i] > 0.0) or (x[i] >= high[i] and gradient[i] < 0.0)
            free[i] = 0.0 if held else 1.0
        if not worst > tolerance:
            return count
        if count == most or not _newton(hessian, gradient, free, factor, step):
            break
        share = 1.0
        for _ in range(_HALVINGS):
            expected = 0.0
            for i in range(n):
                trial[i] = _project(x[i] + share * step[i], low[i], high[i])
                expected += gradient[i] * (trial[i] - x[i])
            trial_cost = _cost(hessian, linear, trial)
            if trial_cost <= cost + 1e-4 * expected:
                break
            share *= 0.5
        x[:] = trial
        cost = _gradient(hessian, linear, x, gradient)
    return -1


@kernel
def _cost(hessian: Array, linear: Array, x: Array) -> float:
    cost = 0.0
    for i in range(x.size):
        total = 0.0
        for j in range(x.size):
            total += hessian[i, j] * x[j]
        cost += x[i] * (0.5 * total + linear[i])
    return cost
