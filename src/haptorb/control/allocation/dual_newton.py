"""The shortest vector within a box that solves three equations: semismooth Newton on the dual, in compiled code.

The dual function Σ φ_j(Q_jᵀν) − tᵀν (φ_j: Huber's function) is convex and piecewise quadratic, with three unknowns
for any number of channels. Its minimum is found by Newton steps with an exact line search; without the exact
search such a method cycles on a good part of all problems. The rows of Q are made orthonormal first, so that an
ill-conditioned problem costs no iterations.
"""

from __future__ import annotations

import numpy as np

from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel

__all__ = [
    "GIVEN",
    "NEAREST",
    "NOT_CONVERGED",
    "NOT_FINITE",
    "SCALED",
    "dual_newton",
    "line_search",
    "orthonormal_rows",
]

GIVEN = 0  #: the torque is given in full
SCALED = 1  #: beyond the limits: cut, direction kept
NEAREST = 2  #: beyond the limits: the nearest torque there is
NOT_FINITE = 3  #: NaN or infinity came in; the currents are NaN
NOT_CONVERGED = 4  #: within the search only: it failed, as limits many decades apart can make it

_STEPS = 60
_TOLERANCE = 1e-11
_TRACE = 1e-12  # curvature lent to directions that have none
_DEPENDENT = 1e-10  # relative length below which a row of K is a combination of the others


@kernel
def orthonormal_rows(Q: Array, t: Array) -> int:
    """Make the rows of Q (3, m) orthonormal in place and turn t (3,) with them: the same equations Q y = t.

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
        if longest <= _DEPENDENT * _DEPENDENT * whole or longest == 0.0:
            for i in range(c, 3):
                for j in range(m):
                    Q[i, j] = 0.0
            break
        rank = c + 1
        for p in range(c):  # once more: what rounding left of the earlier rows
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


@kernel
def _slope(s: Array, along: Array, limit: Array, step: float) -> tuple[float, float]:
    """First and second derivative of Σ φ_j along a line, `step` from where K_jᵀμ = s_j."""
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


@kernel
def _next_kink(s: Array, along: Array, limit: Array, step: float) -> float:
    """The next step beyond `step` at which a channel enters or leaves its limit; infinity if there is none."""
    nearest = np.inf
    for j in range(s.shape[0]):
        if along[j] != 0.0:
            for side in (-limit[j], limit[j]):
                kink = (side - s[j]) / along[j]
                if kink > step:
                    nearest = min(nearest, kink)
    return nearest


@kernel
def line_search(s: Array, along: Array, limit: Array, linear: float) -> float:
    """The step at which the dual function is least along a line: the zero of an increasing, piecewise linear slope.

    The slope is Σ φ_j' + linear. Returns infinity if it never becomes positive.
    """
    final = linear
    for j in range(s.shape[0]):
        final += abs(along[j]) * limit[j]
    if final <= 0.0:
        return np.inf
    low, high, slope_low, slope_high = 0.0, np.inf, -np.inf, np.inf
    first, second = _slope(s, along, limit, 0.0)
    begin = first + linear
    step = 1.0
    for turn in range(100):
        first, second = _slope(s, along, limit, step)
        slope = first + linear
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


@kernel
def dual_newton(Q: Array, t: Array, limit: Array, y: Array) -> int:
    """Least ‖y‖² with Q y = t, |y_j| ≤ limit_j. Returns GIVEN, SCALED if there is none, or NOT_CONVERGED."""
    m = Q.shape[1]
    s = np.empty(m)
    along = np.empty(m)
    size = np.sqrt(t[0] * t[0] + t[1] * t[1] + t[2] * t[2])
    wanted = _TOLERANCE * size
    n0, n1, n2 = t[0], t[1], t[2]  # right at once if no current meets its limit
    for _ in range(_STEPS):
        g0, g1, g2 = -t[0], -t[1], -t[2]
        a, b, c, d, e, f = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0  # the Hessian: a b c / b d e / c e f
        reach = 0.0
        for j in range(m):
            q0, q1, q2 = Q[0, j], Q[1, j], Q[2, j]
            at = q0 * n0 + q1 * n1 + q2 * n2
            s[j] = at
            reach += limit[j] * abs(at)
            if at > limit[j]:
                at = limit[j]
            elif at < -limit[j]:
                at = -limit[j]
            else:
                a += q0 * q0
                b += q0 * q1
                c += q0 * q2
                d += q1 * q1
                e += q1 * q2
                f += q2 * q2
            y[j] = at
            g0 += q0 * at
            g1 += q1 * at
            g2 += q2 * at
        if abs(g0) <= wanted and abs(g1) <= wanted and abs(g2) <= wanted:
            return GIVEN
        asked = t[0] * n0 + t[1] * n1 + t[2] * n2
        if reach < asked:
            return SCALED  # no torque within the limits reaches so far along ν: the proof that T is beyond them
        # Where channels at their limits leave a direction without curvature, a trace of it makes the step follow the
        # gradient there; the line search finds the length.
        a += _TRACE
        d += _TRACE
        f += _TRACE
        # Cholesky of the 3×3 Hessian, with a floor under the pivots
        l00 = np.sqrt(a)
        l10 = b / l00
        l20 = c / l00
        l11 = np.sqrt(max(d - l10 * l10, 0.5 * _TRACE))
        l21 = (e - l20 * l10) / l11
        l22 = np.sqrt(max(f - l20 * l20 - l21 * l21, 0.5 * _TRACE))
        z0 = -g0 / l00
        z1 = (-g1 - l10 * z0) / l11
        z2 = (-g2 - l20 * z0 - l21 * z1) / l22
        d2 = z2 / l22
        d1 = (z1 - l21 * d2) / l11
        d0 = (z0 - l10 * d1 - l20 * d2) / l00
        for j in range(m):
            along[j] = Q[0, j] * d0 + Q[1, j] * d1 + Q[2, j] * d2
        step = line_search(s, along, limit, -(t[0] * d0 + t[1] * d1 + t[2] * d2))
        if step == np.inf:
            return SCALED
        n0 += step * d0
        n1 += step * d1
        n2 += step * d2
    return NOT_CONVERGED
