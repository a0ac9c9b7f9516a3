"""Box-constrained quadratic programs in compiled code: the same bits on every machine, in a bounded time.

Two convex problems, each with the number of unknowns that it needs:

    few equations     minimise ½ ‖y‖² + ½ ‖Q y − t‖²/σ²   such that  |y_j| ≤ limit_j    (σ = 0: such that Q y = t)
    few variables     minimise ½ xᵀH x + gᵀx              such that  low_j ≤ x_j ≤ high_j

Currents for a wrench are the first: three or six equations for any number of coils. Its dual has one unknown for each
equation, whatever the number of coils, and needs no strictly positive cost of the equations' errors. A plan whose cost
couples all variables is the second, and so is a wrench from fewer coils than it has components.
"""

from __future__ import annotations

import numpy as np

from haptorb.arrays import Array
from haptorb.compiled import exact_kernel

__all__ = ["GIVEN", "NOT_CONVERGED", "SCALED", "dual_newton", "line_search", "orthonormal_rows", "solve_box"]


# --------------------------------------------------------------------------------------------------
# Few equations: semismooth Newton on the dual.
#
# The dual function Σ φ_j(Q_jᵀν) + ½ σ² ‖ν‖² − tᵀν (φ_j: Huber's function) is convex and piecewise quadratic, with one
# unknown for each equation. Its minimum is found by Newton steps with an exact line search; without the exact search
# such a method cycles on a good part of all problems. y_j = Q_jᵀν within its limit. Without slack an infeasible t is
# recognised by a direction ν along which no y reaches as far as t. The rows of Q are made orthonormal first, so that
# an ill-conditioned problem costs no iterations.


GIVEN = 0  #: solved
SCALED = 1  #: infeasible without slack
NOT_CONVERGED = 4  #: with limits many decades apart

_DUAL_NEWTON_STEPS = 60
_LEAST_CURVATURE = 1e-12  # added to directions that have none, for orthonormal rows
_DEPENDENT_ROW_TOLERANCE = 1e-10  # relative norm below which a row of Q is linearly dependent on the others


@exact_kernel
def orthonormal_rows(Q: Array, t: Array) -> int:
    """Orthonormalise the rows of Q (3, m) in place and transform t (3,) likewise: the same equations Q y = t.

    Pivoted Gram–Schmidt, done twice. Returns the rank r; rows from r on are zero, t there is what no current can give.
    """
    m = Q.shape[1]
    whole = 0.0
    for i in range(3):
        s = 0.0
        for j in range(m):
            s += Q[i, j] * Q[i, j]
        whole = max(whole, s)
    rank = 0
    for c in range(3):
        best, longest = c, -1.0
        for i in range(c, 3):
            s = 0.0
            for j in range(m):
                s += Q[i, j] * Q[i, j]
            if s > longest:
                best, longest = i, s
        if best != c:
            for j in range(m):
                Q[c, j], Q[best, j] = Q[best, j], Q[c, j]
            t[c], t[best] = t[best], t[c]
        if longest <= _DEPENDENT_ROW_TOLERANCE * _DEPENDENT_ROW_TOLERANCE * whole or longest == 0.0:
            for i in range(c, 3):
                for j in range(m):
                    Q[i, j] = 0.0
            break
        rank = c + 1
        for p in range(c):  # re-orthogonalise against rounding errors
            d = 0.0
            for j in range(m):
                d += Q[p, j] * Q[c, j]
            t[c] -= d * t[p]
            for j in range(m):
                Q[c, j] -= d * Q[p, j]
        s = 0.0
        for j in range(m):
            s += Q[c, j] * Q[c, j]
        length = np.sqrt(s)
        t[c] /= length
        for j in range(m):
            Q[c, j] /= length
        for i in range(c + 1, 3):
            d = 0.0
            for j in range(m):
                d += Q[c, j] * Q[i, j]
            t[i] -= d * t[c]
            for j in range(m):
                Q[i, j] -= d * Q[c, j]
    return rank


@exact_kernel
def _slope(s: Array, along: Array, limit: Array, step: float) -> tuple[float, float]:
    """First and second derivative of Σ φ_j along a line, at `step` from the point where Q_jᵀν = s_j."""
    first, second = 0.0, 0.0
    for j in range(s.shape[0]):
        at = s[j] + step * along[j]
        if at > limit[j]:
            first += along[j] * limit[j]
        elif at < -limit[j]:
            first -= along[j] * limit[j]
        else:
            first += along[j] * at
            second += along[j] * along[j]
    return first, second


@exact_kernel
def _next_kink(s: Array, along: Array, limit: Array, step: float) -> float:
    """Next step beyond `step` at which a channel enters or leaves its limit; infinity if there is none."""
    nearest = np.inf
    for j in range(s.shape[0]):
        if along[j] != 0.0:
            for side in (-limit[j], limit[j]):
                kink = (side - s[j]) / along[j]
                if kink > step:
                    nearest = min(nearest, kink)
    return nearest


@exact_kernel
def line_search(s: Array, along: Array, limit: Array, linear: float, bend: float) -> float:
    """Step that minimises the dual function along a line: the zero of an increasing, piecewise linear slope.

    The slope is Σ φ_j' + linear + bend · step. Returns infinity if it never becomes positive.
    """
    final = linear
    for j in range(s.shape[0]):
        final += abs(along[j]) * limit[j]
    if final <= 0.0 and bend == 0.0:
        return np.inf
    low, high, slope_low, slope_high = 0.0, np.inf, -np.inf, np.inf
    first, second = _slope(s, along, limit, 0.0)
    begin = first + linear
    step = 1.0
    for turn in range(100):
        first, second = _slope(s, along, limit, step)
        slope, second = first + linear + bend * step, second + bend
        if abs(slope) <= 1e-10 * abs(begin):
            break
        if slope < 0.0:
            low, slope_low = step, slope
        else:
            high, slope_high = step, slope
        trial = step - slope / second if second > 0.0 else np.nan
        if not (low < trial < high):
            if high == np.inf:
                trial = _next_kink(s, along, limit, low)  # flat and falling: nothing changes before the next kink
                trial *= 1.0 + 1e-15
                if not np.isfinite(trial):
                    break
            elif turn % 2 == 0 and slope_low > -np.inf:
                trial = low - slope_low * (high - low) / (slope_high - slope_low)
            else:
                trial = 0.5 * (low + high)
        if trial == step or not (low <= trial <= high):
            break
        step = trial
    return step


@exact_kernel
def dual_newton(Q: Array, t: Array, slack: float, limit: Array, tolerance: float, nu: Array, y: Array) -> int:
    """Minimise ½ ‖y‖² + ½ ‖Q y − t‖²/slack² within |y_j| ≤ limit_j; slack 0: with Q y = t.

    Q (n, m), t (n,), limit (m,). nu (n,): multipliers, the start on entry. y (m,) is the result. Ends where no equation
    is off by more than `tolerance`. Returns GIVEN, SCALED if there is no solution, or NOT_CONVERGED.
    """
    n, m = Q.shape
    lines, square = np.empty((2, m)), np.empty((n + 1, n))
    s, along, step, H = lines[0], lines[1], square[0], square[1:]
    softness = slack * slack
    curvature = softness if slack > 0.0 else _LEAST_CURVATURE
    for _ in range(_DUAL_NEWTON_STEPS):
        _combine(Q, nu, s)
        asked, left, reach = 0.0, 0.0, 0.0
        for j in range(m):
            y[j] = min(max(s[j], -limit[j]), limit[j])
            reach += limit[j] * abs(s[j])
        for i in range(n):
            total = t[i]
            for j in range(m):
                total -= Q[i, j] * y[j]
            step[i] = total - softness * nu[i]
            asked += t[i] * nu[i]
            left = max(left, abs(step[i]))
        if left <= tolerance:
            return GIVEN
        if slack == 0.0 and reach < asked:
            return SCALED  # no feasible t reaches that far along ν: certificate that it is infeasible
        # Where variables at their limits leave a direction without curvature, a small regularisation makes the step
        # follow the gradient there; the line search finds the length.
        H[:] = 0.0
        for j in range(m):
            if y[j] == s[j]:
                for i in range(n):
                    for k in range(i + 1):
                        H[i, k] += Q[i, j] * Q[k, j]
        for i in range(n):
            H[i, i] += curvature
        _solve_positive(H, step, 0.5 * curvature)
        slope, bend = 0.0, 0.0
        for i in range(n):
            slope += (t[i] - softness * nu[i]) * step[i]
            bend += softness * step[i] * step[i]
        _combine(Q, step, along)
        length = line_search(s, along, limit, -slope, bend)
        if not np.isfinite(length):
            return SCALED if slack == 0.0 and length == np.inf else NOT_CONVERGED
        for i in range(n):
            nu[i] += length * step[i]
    return NOT_CONVERGED


@exact_kernel
def _combine(Q: Array, weights: Array, out: Array) -> None:
    """out (m,) = Qᵀ weights."""
    for j in range(out.size):
        out[j] = Q[0, j] * weights[0]
    for i in range(1, weights.size):
        for j in range(out.size):
            out[j] += Q[i, j] * weights[i]


@exact_kernel
def _solve_positive(H: Array, g: Array, least: float) -> None:
    """Solve H x = g in place for a symmetric positive H (n, n), of which the lower half is overwritten; g (n,) becomes
    x: Cholesky, with no pivot below `least`."""
    n = g.size
    for i in range(n):
        for j in range(i + 1):
            total = H[i, j]
            for k in range(j):
                total -= H[i, k] * H[j, k]
            H[i, j] = np.sqrt(max(total, least)) if i == j else total / H[j, j]
    for i in range(n):
        for k in range(i):
            g[i] -= H[i, k] * g[k]
        g[i] /= H[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            g[i] -= H[k, i] * g[k]
        g[i] /= H[i, i]


# --------------------------------------------------------------------------------------------------
# Few variables: projected Newton method.
#
# In every step the variables at an active bound are fixed; the others take a Newton step that is projected onto their
# bounds and shortened until the cost decreases (Bertsekas 1982); where no step is short enough, because the bounds are
# too near, the variables that they stop are fixed too. Warm-started, it takes two or three steps; the result is within
# the bounds even if the number of steps was not sufficient.


_HALVINGS = 20


@exact_kernel
def _project(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)


@exact_kernel
def _multiply(hessian: Array, x: Array, i: int) -> float:
    """Component i of H x."""
    total = 0.0
    for j in range(x.size):
        total += hessian[i, j] * x[j]
    return total


@exact_kernel
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


@exact_kernel
def solve_box(
    hessian: Array, linear: Array, low: Array, high: Array, x: Array, work: Array, most: int, tolerance: float
) -> int:
    """Minimise over x (n,), from its current value; returns the number of Newton steps.

    hessian (n, n), positive definite; linear, low, high (n,); work (n + 4, n) is overwritten. At the end no
    variable could change by more than `tolerance` [unit of x] along the scaled gradient. Returns −1 if `most` steps or
    the resolution of numbers were not enough for that, −2 if H is not positive definite or the problem is not finite;
    x is within its bounds then, too.
    """
    n = x.size
    gradient, step, free, moved, factor = work[n], work[n + 1], work[n + 2], work[n + 3], work[:n]
    for i in range(n):
        x[i] = _project(x[i], low[i], high[i]) if np.isfinite(x[i]) else low[i]
    for count in range(most + 1):
        worst, finite = 0.0, True
        for i in range(n):
            gradient[i] = _multiply(hessian, x, i) + linear[i]
            finite = finite and np.isfinite(gradient[i])
            scaled = gradient[i] / hessian[i, i]
            worst = max(worst, abs(x[i] - _project(x[i] - scaled, low[i], high[i])))
            held = (x[i] <= low[i] and gradient[i] > 0.0) or (x[i] >= high[i] and gradient[i] < 0.0)
            free[i] = 0.0 if held else 1.0
        if not finite:
            return -2
        if not worst > tolerance:
            return count
        if count == most:
            break
        share = 0.0
        while share == 0.0:
            if not _newton(hessian, gradient, free, factor, step):
                return -2
            share = _find_share(hessian, gradient, low, high, x, step, moved)
            if share == 0.0 and not _hold_blocked(low, high, x, step, free):
                return -1
        for i in range(n):
            x[i] = _project(x[i] + share * step[i], low[i], high[i])
    return -1


@exact_kernel
def _find_share(hessian: Array, gradient: Array, low: Array, high: Array, x: Array, step: Array, moved: Array) -> float:
    """Share of the step with which the cost decreases enough, the projection included; 0 if none is found.

    moved (n,) is overwritten."""
    share = 1.0
    for _ in range(_HALVINGS):
        expected, bend = 0.0, 0.0
        for i in range(x.size):
            moved[i] = _project(x[i] + share * step[i], low[i], high[i]) - x[i]
            expected += gradient[i] * moved[i]
        for i in range(x.size):
            bend += moved[i] * _multiply(hessian, moved, i)
        # the decrease itself, not the difference of two costs, which would be rounding near the solution
        if expected + 0.5 * bend <= 1e-4 * expected:
            return share
        share *= 0.5
    return 0.0


@exact_kernel
def _hold_blocked(low: Array, high: Array, x: Array, step: Array, free: Array) -> bool:
    """Fix the variables that the shortest step tried would bring beyond a bound; whether there are any."""
    found, share = False, 0.5 ** (_HALVINGS - 1)
    for i in range(x.size):
        if free[i] != 0.0 and not low[i] <= x[i] + share * step[i] <= high[i]:
            free[i], found = 0.0, True
    return found
