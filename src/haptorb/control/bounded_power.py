"""Least heat for a torque when every current has a limit: a compiled solver for three torques and any channels.

    minimise ½ Σ w_j i_j²   such that   K i = T,   |i_j| ≤ L_j

has one multiplier μ per torque axis and currents i_j = clip(K_jᵀμ / w_j, ±L_j): three unknowns, whatever the number of
channels. The dual function Σ φ_j(K_jᵀμ) − Tᵀμ (φ_j: Huber's function) is convex and piecewise quadratic. Its minimum is
found by semismooth Newton steps with an exact line search; without the exact search such a method cycles on a good part
of all problems. The rows of K are first made orthonormal, so that an ill-conditioned K costs no iterations.

The torques within the limits form a zonotope. Beyond it there is no solution, and the dual function falls without end
along some μ: that is the proof. Then either the torque is cut to the zonotope's surface along its own direction (the
surface is met on the facet spanned by two channels: all pairs are looked at, no iteration), or the nearest torque on
the surface is taken (Wolfe's method: the nearest point of a polytope, from the vertices that lie furthest its way).

Without limits this is Bai 2012 eq. (4): u = Kᵀ (K Kᵀ)⁻¹ T.
"""

from __future__ import annotations

import numpy as np

from haptorb.physics.arrays import Array
from haptorb.physics.compiled import kernel

__all__ = ["GIVEN", "NEAREST", "NOT_CONVERGED", "NOT_FINITE", "SCALED", "bounded_power_currents"]

GIVEN = 0  #: the torque is given in full
SCALED = 1  #: beyond the limits: cut, direction kept
NEAREST = 2  #: beyond the limits: the nearest torque there is
NOT_FINITE = 3  #: NaN or infinity came in; the currents are NaN
NOT_CONVERGED = 4  #: within the search only: it failed, as limits many decades apart can make it

_STEPS = 60
_TOLERANCE = 1e-11
_TRACE = 1e-12  # curvature lent to directions that have none
_UNTURNED = 1e-9  # relative part of a torque, about an axis that no channel turns, that is taken for rounding
_DEPENDENT = 1e-10  # relative length below which a row of K is a combination of the others


@kernel
def _orthonormal_rows(Q: Array, t: Array) -> int:
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
def _line_search(s: Array, along: Array, limit: Array, linear: float) -> float:
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
def _dual_newton(Q: Array, t: Array, limit: Array, y: Array) -> int:
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
        step = _line_search(s, along, limit, -(t[0] * d0 + t[1] * d1 + t[2] * d2))
        if step == np.inf:
            return SCALED
        n0 += step * d0
        n1 += step * d1
        n2 += step * d2
    return NOT_CONVERGED


@kernel
def _reach(Q: Array, t: Array, limit: Array, rank: int) -> float:
    """Greatest s with s t = Q y for some |y_j| ≤ limit_j: how far the zonotope of torques goes along t.

    The facets of a zonotope are spanned by pairs of its generators; the nearest supporting plane among them decides.
    """
    m = Q.shape[1]
    least = np.inf
    if rank == 1:
        total = 0.0
        for j in range(m):
            total += abs(Q[0, j]) * limit[j]
        return total / abs(t[0]) if t[0] != 0.0 else np.inf
    if rank == 2:
        for p in range(m):
            against = abs(Q[0, p] * t[1] - Q[1, p] * t[0])
            if against > 0.0:
                total = 0.0
                for j in range(m):
                    total += abs(Q[0, p] * Q[1, j] - Q[1, p] * Q[0, j]) * limit[j]
                least = min(least, total / against)
        return least
    for p in range(m - 1):
        for q in range(p + 1, m):
            x = Q[1, p] * Q[2, q] - Q[2, p] * Q[1, q]
            y = Q[2, p] * Q[0, q] - Q[0, p] * Q[2, q]
            z = Q[0, p] * Q[1, q] - Q[1, p] * Q[0, q]
            against = abs(x * t[0] + y * t[1] + z * t[2])
            if against > 0.0:
                total = 0.0
                for j in range(m):
                    total += abs(x * Q[0, j] + y * Q[1, j] + z * Q[2, j]) * limit[j]
                least = min(least, total / against)
    return least


@kernel
def _vertex(Q: Array, limit: Array, n: Array, out: Array) -> None:
    """The vertex of the zonotope that lies furthest along n."""
    out[:] = 0.0
    for j in range(Q.shape[1]):
        along = Q[0, j] * n[0] + Q[1, j] * n[1] + Q[2, j] * n[2]
        side = limit[j] if along > 0.0 else -limit[j]
        for i in range(3):
            out[i] += side * Q[i, j]


@kernel
def _affine_weights(corral: Array, count: int, weights: Array) -> bool:
    """Weights (summing to one) of the point nearest to the origin in the plane through `count` corners; False if flat.

    Solved by Gaussian elimination on the edges' Gram matrix, with pivoting.
    """
    k = count - 1
    G = np.zeros((3, 4))
    for a in range(k):
        for b in range(k):
            for i in range(3):
                G[a, b] += (corral[a + 1, i] - corral[0, i]) * (corral[b + 1, i] - corral[0, i])
        for i in range(3):
            G[a, 3] -= (corral[a + 1, i] - corral[0, i]) * corral[0, i]
    whole = 0.0
    for a in range(k):
        whole = max(whole, G[a, a])
    for a in range(k):
        best = a
        for b in range(a + 1, k):
            if abs(G[b, a]) > abs(G[best, a]):
                best = b
        if abs(G[best, a]) <= 1e-14 * whole:
            return False
        for b in range(4):
            G[a, b], G[best, b] = G[best, b], G[a, b]
        for b in range(k):
            if b != a:
                factor = G[b, a] / G[a, a]
                for c in range(4):
                    G[b, c] -= factor * G[a, c]
    weights[0] = 1.0
    for a in range(k):
        weights[a + 1] = G[a, 3] / G[a, a]
        weights[0] -= weights[a + 1]
    return True


@kernel
def _nearest(Q: Array, t: Array, limit: Array) -> None:
    """Move t (3,) to the nearest point of the zonotope of torques Q y, |y_j| ≤ limit_j: Wolfe 1976, up to 4 corners."""
    target = np.array((t[0], t[1], t[2]))
    corral = np.zeros((5, 3))  # corners, seen from the target
    weights = np.zeros(5)
    wanted = np.zeros(5)
    corner = np.empty(3)
    _vertex(Q, limit, target, corner)
    x = corner - target
    corral[0] = x
    weights[0] = 1.0
    count = 1
    for _ in range(200):
        square = x[0] * x[0] + x[1] * x[1] + x[2] * x[2]
        if square == 0.0:
            break
        _vertex(Q, limit, -x, corner)
        gain, long = square, 0.0
        for i in range(3):
            corral[count, i] = corner[i] - target[i]
            gain -= x[i] * corral[count, i]
            long = max(long, abs(target[i]))
        if gain <= 1e-13 * (square + np.sqrt(square) * long) or count == 4:
            break
        weights[count] = 0.0
        count += 1
        flat = False
        while True:
            if not _affine_weights(corral, count, wanted):
                flat = True
                break
            share = 1.0
            for a in range(count):
                if wanted[a] < 0.0 and weights[a] - wanted[a] > 0.0:
                    share = min(share, weights[a] / (weights[a] - wanted[a]))
            kept = 0
            for a in range(count):
                weight = weights[a] + share * (wanted[a] - weights[a])
                if share == 1.0 or weight > 1e-15:
                    corral[kept] = corral[a]
                    weights[kept] = max(weight, 0.0)
                    kept += 1
            count = kept
            if share == 1.0:
                break
        if flat:
            break  # the new corner lies in the plane of the old ones: they hold the nearest point already
        x[:] = 0.0
        for a in range(count):
            x += weights[a] * corral[a]
    for i in range(3):
        t[i] = target[i] + x[i]


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
def bounded_power_currents(
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
    rank = _orthonormal_rows(Q, t)
    size = np.sqrt(asked[0] * asked[0] + asked[1] * asked[1] + asked[2] * asked[2])
    outside = 0.0
    for i in range(rank, 3):
        outside = max(outside, abs(t[i]))
        t[i] = 0.0
    status = SCALED
    scale = 1.0
    y = np.zeros(m)
    if outside <= _UNTURNED * size:
        status = _dual_newton(Q, t, box, y)
        if status == NOT_CONVERGED and _reach(Q, t, box, rank) < 1.0:
            status = SCALED
    if status == SCALED and nearest:
        status = NEAREST
        for i in range(3):
            t[i] = asked[i]
            for j in range(m):
                Q[i, j] = K[i, j] / root[j] / strongest if box[j] > 0.0 else 0.0
        _nearest(Q, t, box)
        rank = _orthonormal_rows(Q, t)
        for i in range(rank, 3):
            t[i] = 0.0
    elif status == SCALED:
        if outside > _UNTURNED * size:
            return (
                SCALED,
                0.0,
            )  # part of the torque is about an axis that no channel turns: its direction cannot be kept
        scale = min(_reach(Q, t, box, rank), 1.0)
        for i in range(3):
            t[i] *= scale
    if status != GIVEN:
        # On the surface itself the multipliers may be infinite; a hair inside they are not. A hair is nearly always
        # enough; limits many decades apart may need more.
        hair = 1e-9
        while True:
            inside = np.array((t[0] * (1.0 - hair), t[1] * (1.0 - hair), t[2] * (1.0 - hair)))
            if _dual_newton(Q, inside, box, y) == GIVEN:
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
