"""The torques that currents within their limits can give: a zonotope, its surface along a direction, its nearest point.

A torque's direction meets the surface on a facet that two channels span: all pairs are looked at, no iteration; of
many channels a search finds it, see `portal`. The
nearest torque on the surface is found by Wolfe's method: the nearest point of a polytope, from the vertices that lie
furthest its way.
"""

from __future__ import annotations

import numpy as np

from haptorb.control.allocation.portal import find_reach
from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel

__all__ = ["nearest", "reach"]

_MANY = 24  #: channels beyond which all pairs take longer than the search


@kernel
def reach(Q: Array, t: Array, limit: Array, rank: int) -> float:
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
    if m > _MANY:
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
def nearest(Q: Array, t: Array, limit: Array) -> None:
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
            break  # the new corner lies in the plane of the old ones: they hold the nearest point already
        x[:] = 0.0
        for a in range(count):
            x += weights[a] * corral[a]
    for i in range(3):
        t[i] = target[i] + x[i]
