"""The place and axis of a magnet that explain what the field sensors read: Gauss–Newton, damped by Levenberg's method.

Five unknowns: three of the place, two turns across the axis. A step solves (N + λ diag N) δ = Jᵀ r, so that metres and
radians need no common scale; a step that makes the misfit greater is taken back and λ raised.

What is not known about the electromagnet's own moment (noise of the measured currents, errors of the calibration) is
one error in all readings together: their covariance is σ² 1 + U S Uᵀ, U (3k, 3) the field of unit moments at the
sensors. Its inverse, by Woodbury, is (1 − U G Uᵀ)/σ² with G = (σ² S⁻¹ + UᵀU)⁻¹: three numbers Uᵀr and three rows UᵀJ
are all that weighting by it adds, like three more unknowns, the moment, with prior knowledge.
"""

from __future__ import annotations

import math

import numpy as np

from haptorb.numerics.arrays import Array, Record, Records
from haptorb.numerics.compiled import kernel
from haptorb.numerics.so3 import turn_by
from haptorb.sensing.tool.tool_field import ToolModel, tool_field

__all__ = ["fit_tool", "weigh_moment"]

_LONGEST = 15e-3  #: longest way of one step [m]: a fifth of the distance to the sensors
_WIDEST = 0.35  #: widest turn of one step [rad]


@kernel
def _inverse(N: Array) -> bool:
    """The inverse of the symmetric, positive N (n, n) in its place (Gauss–Jordan); False if it has none."""
    size = N.shape[0]
    for k in range(size):
        pivot = N[k, k]
        if not pivot > 1e-12:
            return False
        N[k, k] = 1.0
        for j in range(size):
            N[k, j] /= pivot
        for i in range(size):
            if i != k:
                factor = N[i, k]
                N[i, k] = 0.0
                for j in range(size):
                    N[i, j] -= factor * N[k, j]
    return True


@kernel
def weigh_moment(t: Record, columns: Array, currents: Array, lagged: Array, share: float) -> None:
    """Fill the weight of tracker t; zeros, plain least squares, where the moment is known as well as perfectly.

    columns (m,) [m⁴] squares of the moment map's columns, whose entries are known to `share`; currents (m,) [A], and
    lagged (m,) [A] the same through the core's lag, whose share is known to t.eddy_doubt.
    """
    errors, G = t.remanent * t.remanent, t.weight
    for j in range(currents.shape[0]):
        late = t.eddy_doubt * (currents[j] - lagged[j])
        errors += columns[j] * ((share * currents[j]) ** 2 + late * late)
    G[:] = t.moment_noise
    for a in range(3):
        G[a, a] += errors
    if _inverse(G):
        for a in range(3):
            for b in range(3):
                G[a, b] = (t.noise * t.noise + t.lasting * t.lasting) * G[a, b] + t.coupling[a, b]
        if _inverse(G):
            return
    G[:] = 0.0


@kernel
def _normal(t: Record, sensors: Records, B: Array, J: Array, gradient: Array) -> float:
    """Covariance of t = N = Jᵀ W J and gradient = Jᵀ W r with W = 1 − U G Uᵀ; returns the weighted misfit [T²].

    A reading of a certain age [s] saw the tool where it was then: r = field − (B − age J rates).
    """
    N, G, rates = t.covariance, t.weight, t.rates
    N[:] = 0.0
    gradient[:] = 0.0
    misfit = 0.0
    shared, known = np.zeros((3, 6)), np.zeros((3, 6))  # Uᵀ [J, r], and G times it
    for k in range(sensors.size):
        sensor = sensors[k]
        if not sensor.used:
            continue
        for i in range(3):
            r, age = sensor.field[i] - B[k, i], sensor.age[i]
            if age > 0.0:
                for a in range(5):
                    r += age * J[k, i, a] * rates[a]
            misfit += r * r
            for a in range(5):
                gradient[a] += J[k, i, a] * r
                for b in range(a + 1):
                    N[a, b] += J[k, i, a] * J[k, i, b]
            for c in range(3):
                u = sensor.per_moment[i, c]
                for a in range(5):
                    shared[c, a] += u * J[k, i, a]
                shared[c, 5] += u * r
    for c in range(3):
        for d in range(3):
            for a in range(6):
                known[c, a] += G[c, d] * shared[d, a]
    for c in range(3):
        misfit -= shared[c, 5] * known[c, 5]
        for a in range(5):
            gradient[a] -= shared[c, a] * known[c, 5]
            for b in range(a + 1):
                N[a, b] -= shared[c, a] * known[c, b]
    for a in range(5):
        for b in range(a):
            N[b, a] = N[a, b]
    return misfit


@kernel
def fit_tool(
    t: Record, sensors: Records, model: ToolModel, near: float, turn: float, most: int, p: Array, R: Array
) -> tuple[bool, float]:
    """Improve p (3,) [m] and R (3, 3) in their places until a step is below `near` [m] and `turn` [rad].

    The fields of `sensors`, (k,) SENSOR, are explained, with the weight of the tracker t (zeros for plain least
    squares) and with its rates since those were read; at most `most` evaluations. Its covariance becomes (JᵀWJ)⁻¹, per
    T² of the readings' own variance. Returns (converged, misfit [T²] as the last step predicts it).
    """
    places, covariance = sensors.size, t.covariance
    B, J = np.empty((places, 3)), np.empty((places, 3, 5))
    N, gradient, step, damped = np.empty((5, 5)), np.empty(5), np.empty(5), np.empty((5, 5))
    scale = np.empty(5)
    last_p, last_R, turned = p.copy(), R.copy(), np.empty((3, 3))
    best, damping = np.inf, 0.0
    for _ in range(most):
        tool_field(model, p, R, B, J)
        misfit = _normal(t, sensors, B, J, gradient)
        if not misfit <= best * (1.0 + 1e-9):  # worse, or not a number: back, and more carefully
            p[:] = last_p
            R[:] = last_R
            damping = max(8.0 * damping, 1e-3)
            if damping > 1e6 or not best < np.inf:  # at the very first: there is nothing to go back to
                return False, best
        else:
            best = misfit
            last_p[:] = p
            last_R[:] = R
            damping *= 0.125
            if damping < 1e-6:
                damping = 0.0
            for a in range(5):  # unit diagonal: the columns differ by powers of ten
                if not covariance[a, a] > 0.0:
                    return False, best
                scale[a] = 1.0 / math.sqrt(covariance[a, a])
            for a in range(5):
                for b in range(5):
                    N[a, b] = scale[a] * covariance[a, b] * scale[b]
            old = gradient * scale
        damped[:] = N
        for a in range(5):
            damped[a, a] += damping
        if not _inverse(damped):
            damping = max(8.0 * damping, 1e-3)
            continue
        gain = 0.0
        for a in range(5):
            total = 0.0
            for b in range(5):
                total += damped[a, b] * old[b]
            step[a] = scale[a] * total
            gain += total * old[a]
        way = math.sqrt(step[0] ** 2 + step[1] ** 2 + step[2] ** 2)
        wide = math.sqrt(step[3] ** 2 + step[4] ** 2)
        shorter = min(1.0, _LONGEST / max(way, 1e-12), _WIDEST / max(wide, 1e-12))
        for i in range(3):
            p[i] = last_p[i] + shorter * step[i]
        wx, wy = shorter * step[3], shorter * step[4]
        turn_by(
            last_R[0, 0] * wx + last_R[0, 1] * wy, last_R[1, 0] * wx + last_R[1, 1] * wy,
            last_R[2, 0] * wx + last_R[2, 1] * wy, last_R, turned,
        )  # fmt: skip
        R[:] = turned
        if damping < 1e-3 and way < near and wide < turn:
            for a in range(5):
                for b in range(5):
                    covariance[a, b] = scale[a] * damped[a, b] * scale[b]
            return True, max(best - gain, 0.0)
    return False, best
