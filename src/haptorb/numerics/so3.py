"""Angular velocity from a row of orientations: an α–β filter on the rotations, critically damped.

Orientation and angular velocity are predicted, R⁻ = exp(w dt) R, and corrected by what was measured,
e = log(R_measured R⁻ᵀ): R = exp(α e) R⁻, w = w⁻ + β e/dt, with α = 1 − θ², β = (1 − θ)², θ = exp(−dt/τ). The velocity
lags by 2 τ (its transfer function is 1/(1 + τ s)² apart from the zero of the orientation), and white noise of σ [rad]
at intervals dt becomes about σ √(dt)/(2 τ^1.5) in w.
"""

from __future__ import annotations

import math

import numpy as np

from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel

__all__ = ["correct_rotation", "logarithm", "turn_by"]


@kernel
def turn_by(x: float, y: float, z: float, R: Array, out: Array) -> None:
    """out (3, 3) = exp((x, y, z)×) R, made orthonormal again: a small step after a small step stays a rotation."""
    angle2 = x * x + y * y + z * z
    if angle2 < 1e-8:
        a, b = 1.0 - angle2 / 6.0, 0.5 - angle2 / 24.0
    else:
        angle = math.sqrt(angle2)
        a, b = math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle2
    c = 1.0 - b * angle2
    e00, e01, e02 = c + b * x * x, b * x * y - a * z, b * x * z + a * y
    e10, e11, e12 = b * x * y + a * z, c + b * y * y, b * y * z - a * x
    e20, e21, e22 = b * x * z - a * y, b * y * z + a * x, c + b * z * z
    for j in range(3):
        r0, r1, r2 = R[0, j], R[1, j], R[2, j]
        out[0, j] = e00 * r0 + e01 * r1 + e02 * r2
        out[1, j] = e10 * r0 + e11 * r1 + e12 * r2
        out[2, j] = e20 * r0 + e21 * r1 + e22 * r2
    # Gram–Schmidt on the rows: rounding would add up over millions of ticks
    n = 1.0 / math.sqrt(out[0, 0] ** 2 + out[0, 1] ** 2 + out[0, 2] ** 2)
    for j in range(3):
        out[0, j] *= n
    d = out[0, 0] * out[1, 0] + out[0, 1] * out[1, 1] + out[0, 2] * out[1, 2]
    for j in range(3):
        out[1, j] -= d * out[0, j]
    n = 1.0 / math.sqrt(out[1, 0] ** 2 + out[1, 1] ** 2 + out[1, 2] ** 2)
    for j in range(3):
        out[1, j] *= n
    out[2, 0] = out[0, 1] * out[1, 2] - out[0, 2] * out[1, 1]
    out[2, 1] = out[0, 2] * out[1, 0] - out[0, 0] * out[1, 2]
    out[2, 2] = out[0, 0] * out[1, 1] - out[0, 1] * out[1, 0]


@kernel
def logarithm(A: Array, B: Array, out: Array) -> None:
    """out (3,) the rotation vector of A Bᵀ, for turns below half a turn."""
    m = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            m[i, j] = A[i, 0] * B[j, 0] + A[i, 1] * B[j, 1] + A[i, 2] * B[j, 2]
    x, y, z = 0.5 * (m[2, 1] - m[1, 2]), 0.5 * (m[0, 2] - m[2, 0]), 0.5 * (m[1, 0] - m[0, 1])
    sine = math.sqrt(x * x + y * y + z * z)
    cosine = 0.5 * (m[0, 0] + m[1, 1] + m[2, 2] - 1.0)
    factor = 1.0 + sine * sine / 6.0 if sine < 1e-4 and cosine > 0.0 else math.atan2(sine, cosine) / max(sine, 1e-12)
    out[0], out[1], out[2] = factor * x, factor * y, factor * z


@kernel
def correct_rotation(predicted: Array, measured: Array, w: Array, dt: float, tau: float, out: Array) -> None:
    """One step of the filter: `w` (3,) is corrected in place, out (3, 3) is the filtered orientation."""
    theta = math.exp(-dt / tau)
    error = np.empty(3)
    logarithm(measured, predicted, error)
    alpha, beta = 1.0 - theta * theta, (1.0 - theta) * (1.0 - theta)
    for i in range(3):
        w[i] += beta / dt * error[i]
    turn_by(alpha * error[0], alpha * error[1], alpha * error[2], predicted, out)
