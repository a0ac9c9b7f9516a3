"""Saturation: currents scaled to the limits of coils, supply and wrench, their reach, and the nearest compromise."""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from haptorb.arrays import Array, Record, fields
from haptorb.box_qp import solve_box
from haptorb.compiled import exact_kernel, kernel

__all__ = [
    "AT_CURRENT",
    "AT_POWER",
    "FREE",
    "SATURATIONS",
    "WRENCH_LIMITS",
    "Saturation",
    "find_reach",
    "reach",
    "scale_to_limits",
    "scale_to_power",
    "solve_compromise",
    "zonotope_nearest",
]


class Saturation(IntEnum):
    """Limit that reduces the allocated wrench; the numbers are stored in recordings and never change."""

    NONE = 0
    CURRENT = 1  #: a coil's current limit
    POWER = 2  #: the supply's power limit
    ALONG = 3  #: the guard's limit on the accompanying force or torque
    AXIS = 4  #: no current produces a torque about the magnet's own axis of a tool
    COILS = 5  #: too few coils for force and torque at once: weighted compromise

    @property
    def text(self) -> str:
        """Description of the active limit; empty for none.

        >>> Saturation.POWER.text
        "the supply's power limit"
        """
        return _TEXTS[self]

    @property
    def is_limit(self) -> bool:
        """Whether a higher limit would give a larger wrench in the same direction.

        >>> Saturation.CURRENT.is_limit, Saturation.COILS.is_limit
        (True, False)
        """
        return self in (Saturation.CURRENT, Saturation.POWER, Saturation.ALONG)


_TEXTS = (
    "",
    "a coil's current limit",
    "the supply's power limit",
    "the limit of the accompanying force",
    "the magnet's own axis, about which there is no torque",
    "the number of coils, too few for force and torque together",
)
SATURATIONS = tuple(Saturation)  #: indexed by number: much faster than calling the class


# --------------------------------------------------------------------------------------------------
# Power limit of the supply: all currents are scaled by one common factor, which preserves their direction.


_ROUNDING_MARGIN = 1.0 - 1e-12  #: margin: the rounded sum of squares also stays below the limit


@kernel
def scale_to_power(currents: Array, resistance: Array, power: float) -> float:
    """Scale `currents` (m,) [A] so that Σ R i² with `resistance` (m,) [Ω] is at most `power` [W]; returns the factor.

    A wrench is linear in the currents: scaling them preserves its direction.
    """
    total = 0.0
    for j in range(currents.size):
        total += resistance[j] * currents[j] * currents[j]
    if not total > power:
        return 1.0
    scale = np.sqrt(power / total) * _ROUNDING_MARGIN
    for j in range(currents.size):
        currents[j] *= scale
    return float(scale)


# --------------------------------------------------------------------------------------------------
# Limits on the whole wrench: the supply's power, and force and torque on the mover.


_POWER, _ALONG = int(Saturation.POWER), int(Saturation.ALONG)

WRENCH_LIMITS = fields(
    ("power", "f8"),  # of the supply [W]
    ("force", "f8"),  # limit on the mover [N]
    ("torque", "f8"),  # limit on the mover [N·m]
)


@kernel
def _share_within(passive: Array, active: Array, first: int, greatest: float) -> float:
    """Largest factor on `active` (6,), at most 1, for which three of its components plus `passive` stay within
    `greatest`; 0 where the passive wrench alone exceeds it."""
    a, b, c = 0.0, 0.0, -greatest * greatest
    for i in range(first, first + 3):
        a += active[i] * active[i]
        b += active[i] * passive[i]
        c += passive[i] * passive[i]
    if a + 2.0 * b + c <= 0.0:
        return 1.0
    if c >= 0.0 or a == 0.0:
        return 0.0
    return float(min(1.0, (np.sqrt(b * b - a * c) - b) / a))


@kernel
def scale_to_limits(
    matrix: Array, passive: Array, target: Array, resistance: Array, limits: Record, currents: Array, residual: Array,
    scale: float, reason: int,
) -> tuple[float, int]:  # fmt: skip
    """Scale currents (m,) [A] to meet `limits`, a WRENCH_LIMITS; fill residual (6,): target (6,) minus result.

    Returns the updated `scale` and `reason`.
    """
    m = matrix.shape[1]
    share = scale_to_power(currents, resistance, limits.power)  # safety: supply-power-of-wrenches
    if share < 1.0 - 1e-6:
        scale *= share
        reason = _POWER
    active = np.zeros(6)
    for i in range(6):
        for j in range(m):
            active[i] += matrix[i, j] * currents[j]
    share = min(_share_within(passive, active, 0, limits.force), _share_within(passive, active, 3, limits.torque))
    if share < 1.0:  # safety: accompanying-force-is-limited
        scale *= share
        reason = _ALONG
        for j in range(m):
            currents[j] *= share
    for i in range(6):
        residual[i] = target[i] - share * active[i]
    return scale, reason


# --------------------------------------------------------------------------------------------------
# Extent of a zonotope along a direction, for many generators: portal refinement along the ray.
#
# `reach` otherwise tests all pairs of generators, which takes m³ operations: 0.5 ms for 100 channels. Here a
# triangle of points of the zonotope that the ray passes is replaced iteratively by one further out, each found by the
# support function in m operations (Minkowski portal refinement: Snethen, Game Programming Gems 7, 2008, section 2.5).


_PORTAL_STEPS = 200
_PRECISION = 1e-9


@exact_kernel
def _cross(a: Array, b: Array, out: Array) -> None:
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@exact_kernel
def _support(Q: Array, box: Array, n: Array, out: Array) -> None:
    """Support point of the zonotope along n."""
    out[:] = 0.0
    for j in range(Q.shape[1]):
        along = Q[0, j] * n[0] + Q[1, j] * n[1] + Q[2, j] * n[2]
        y = box[j] if along > 0.0 else (-box[j] if along < 0.0 else 0.0)
        for i in range(3):
            out[i] += Q[i, j] * y


@exact_kernel
def _dot(a: Array, b: Array) -> float:
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


@exact_kernel
def _side(a: Array, b: Array, d: Array) -> float:
    """Positive where the ray along d passes to the left of the plane through a and b."""
    return float(
        (a[1] * b[2] - a[2] * b[1]) * d[0] + (a[2] * b[0] - a[0] * b[2]) * d[1] + (a[0] * b[1] - a[1] * b[0]) * d[2]
    )


@exact_kernel
def find_reach(Q: Array, d: Array, box: Array) -> float:
    """Largest s with s d = Q y for some |y_j| ≤ box_j, from below to 1e-9; NaN if the search does not converge.

    Q (3, m) of rank 3, d (3,), box (m,).
    """
    v, n, turned = np.empty((4, 3)), np.empty(3), np.empty(3)
    _support(Q, box, d, v[0])
    _cross(v[0], d, n)
    if _dot(n, n) <= 1e-24 * _dot(v[0], v[0]) * _dot(d, d):
        return float(_dot(v[0], d) / _dot(d, d))
    _support(Q, box, n, v[1])
    _cross(v[0], v[1], n)
    if _dot(n, d) < 0.0:
        for i in range(3):
            v[0, i], v[1, i], n[i] = v[1, i], v[0, i], -n[i]
    passed = False
    for _ in range(_PORTAL_STEPS):
        _support(Q, box, n, v[2])
        if _side(v[0], v[2], d) > 0.0:
            v[1] = v[2]
            _cross(v[0], v[2], n)
        elif _side(v[2], v[1], d) > 0.0:
            v[0] = v[2]
            _cross(v[2], v[1], n)
        else:
            passed = True
            break
    if not passed:
        return np.nan
    for _ in range(_PORTAL_STEPS):
        for i in range(3):
            n[i], turned[i] = v[1, i] - v[0, i], v[2, i] - v[0, i]
        v[3] = n
        _cross(v[3], turned, n)
        forward = _dot(n, d)
        if forward < 0.0:
            for i in range(3):
                v[1, i], v[2, i], n[i] = v[2, i], v[1, i], -n[i]
            forward = -forward
        if not forward > 0.0:
            return np.nan
        _support(Q, box, n, v[3])
        inner, outer = _dot(v[0], n), _dot(v[3], n)
        if outer - inner <= _PRECISION * abs(outer):
            return float(inner / forward)
        _cross(d, v[3], turned)
        if _dot(v[0], turned) > 0.0:
            replaced = 0 if _dot(v[1], turned) > 0.0 else 2
        else:
            replaced = 1 if _dot(v[2], turned) > 0.0 else 0
        v[replaced] = v[3]
    return np.nan


# --------------------------------------------------------------------------------------------------
# Zonotope of the torques of currents within their limits: its surface along a direction, and its nearest point.
#
# A torque's direction meets the surface on a facet spanned by two channels: all pairs are tested, without iteration;
# for many channels the facet is found iteratively, see `find_reach`. The nearest torque on the surface is found by
# Wolfe's method: the nearest point of a polytope, from its support points.


_MAX_PAIR_CHANNELS = 24  #: number of channels above which testing all pairs is slower than the search


@exact_kernel
def reach(Q: Array, t: Array, limit: Array, rank: int) -> float:
    """Largest s with s t = Q y for some |y_j| ≤ limit_j: the extent of the zonotope of torques along t.

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
    if m > _MAX_PAIR_CHANNELS:
        found = find_reach(Q, t, limit)
        if np.isfinite(found):
            return found
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


@exact_kernel
def _vertex(Q: Array, limit: Array, n: Array, out: Array) -> None:
    """Vertex of the zonotope that lies furthest along n."""
    out[:] = 0.0
    for j in range(Q.shape[1]):
        along = Q[0, j] * n[0] + Q[1, j] * n[1] + Q[2, j] * n[2]
        side = limit[j] if along > 0.0 else -limit[j]
        for i in range(3):
            out[i] += side * Q[i, j]


@exact_kernel
def _affine_weights(corral: Array, count: int, weights: Array) -> bool:
    """Weights (sum 1) of the point of the affine hull of `count` corners nearest to the origin; False if degenerate.

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


@exact_kernel
def zonotope_nearest(Q: Array, t: Array, limit: Array) -> None:
    """Move t (3,) to the nearest point of the zonotope of torques Q y, |y_j| ≤ limit_j: Wolfe 1976, up to 4 corners."""
    target = np.array((t[0], t[1], t[2]))
    corral = np.zeros((5, 3))  # corners, relative to the target
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
            remaining = 0
            for a in range(count):
                weight = weights[a] + share * (wanted[a] - weights[a])
                if share == 1.0 or weight > 1e-15:
                    corral[remaining] = corral[a]
                    weights[remaining] = max(weight, 0.0)
                    remaining += 1
            count = remaining
            if share == 1.0:
                break
        if flat:
            break  # the new corner lies in the plane of the current ones: they already contain the nearest point
        x[:] = 0.0
        for a in range(count):
            x += weights[a] * corral[a]
    for i in range(3):
        t[i] = target[i] + x[i]


# --------------------------------------------------------------------------------------------------
# Nearest feasible wrench of too few coils, by weighted least squares.
#
#     minimise ½ ‖W (A i − w)‖²   such that   |i_j| ≤ L_j,   Σ R_j i_j² ≤ P
#
# With H = AᵀW²A and g = AᵀW²w this is a convex problem of m unknowns; a small heat term regularises it where H is
# singular. Where the power limit is active, its multiplier λ ≥ 0 is added as λR to H and found by a bracketed secant:
# the power falls as λ rises.


#: active limit at the solution
FREE, AT_CURRENT, AT_POWER = int(Saturation.NONE), int(Saturation.CURRENT), int(Saturation.POWER)

_COMPROMISE_STEPS = 30
_COMPROMISE_TOLERANCE = 1e-11  #: of a current, relative to the largest
_HEAT_WEIGHT = 1e-12  #: relative to the largest entry of H: selects the solution where H is singular
_HEAT_WEIGHT_FACTOR, _HEAT_WEIGHTS = 100.0, 4  #: raised by this factor, so often, where rounding makes H indefinite
_POWER_TOLERANCE = 1e-9  #: relative tolerance of the power
_ROUNDS = 60


@exact_kernel
def _descend(
    H: Array, g: Array, limit: Array, resistance: Array, heat: float, tolerance: float, currents: Array, work: Array
) -> float:
    """Bring `currents` (m,) to the minimum of ½ iᵀ(H + heat R) i − gᵀi within ±limit; returns the power Σ R i² [W].

    work (2 m + 6, m) is overwritten."""
    m = g.shape[0]
    weighed, low, linear = work[m + 4 : 2 * m + 4], work[2 * m + 4], work[2 * m + 5]
    for j in range(m):
        low[j], linear[j] = -limit[j], -g[j]
    for _ in range(_HEAT_WEIGHTS):
        for j in range(m):
            for k in range(m):
                weighed[j, k] = H[j, k]
            weighed[j, j] += heat * resistance[j]
        if solve_box(weighed, linear, low, limit, currents, work[: m + 4], _COMPROMISE_STEPS, tolerance) > -2:
            break
        heat *= _HEAT_WEIGHT_FACTOR
    power = 0.0
    for j in range(m):
        power += resistance[j] * currents[j] * currents[j]
    return power


@exact_kernel
def solve_compromise(H: Array, g: Array, limit: Array, resistance: Array, power: float, currents: Array) -> int:
    """Write the minimum into `currents` (m,) [A]; return the active limit: FREE, AT_CURRENT or AT_POWER.

    H (m, m), g (m,), limit (m,) [A], resistance (m,) [Ω], power [W], inf for no limit. For use inside compiled code.
    """
    m = g.shape[0]
    greatest, hottest, size = 0.0, 0.0, 0.0
    for j in range(m):
        currents[j] = 0.0
        greatest = max(greatest, H[j, j])
        hottest = max(hottest, resistance[j])
        if H[j, j] > 0.0:
            size = max(size, min(abs(g[j]) / H[j, j], limit[j]))
    if greatest == 0.0:
        return FREE
    work, tolerance = np.empty((2 * m + 6, m)), _COMPROMISE_TOLERANCE * size
    low, high = _HEAT_WEIGHT * greatest / hottest, greatest / hottest
    needed = _descend(H, g, limit, resistance, low, tolerance, currents, work)
    if needed > power:
        # 1/√(Σ R i²) is nearly linear in λ: a secant finds it, kept within bounds
        wanted = 1.0 / np.sqrt(power)
        below = 1.0 / np.sqrt(needed) - wanted
        needed = _descend(H, g, limit, resistance, high, tolerance, currents, work)
        while needed > power:
            low, below = high, 1.0 / np.sqrt(needed) - wanted
            high *= 8.0
            needed = _descend(H, g, limit, resistance, high, tolerance, currents, work)
        above = 1.0 / np.sqrt(needed) - wanted
        for _ in range(_ROUNDS):
            middle = low - below * (high - low) / (above - below)
            if not low < middle < high:
                break
            at = 1.0 / np.sqrt(_descend(H, g, limit, resistance, middle, tolerance, currents, work)) - wanted
            if abs(at) <= _POWER_TOLERANCE * wanted:
                break
            if at < 0.0:
                low, below = middle, at
                above *= 0.5  # Illinois method: otherwise one end of the bracket would not move
            else:
                high, above = middle, at
                below *= 0.5
        return AT_POWER
    for j in range(m):
        if abs(currents[j]) >= limit[j]:
            return AT_CURRENT
    return FREE
