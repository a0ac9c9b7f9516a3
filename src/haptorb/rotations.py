"""Rotations: XYZ Euler angles (ψ, λ, φ) of Bai 2012 eq. (1), unit quaternions, angular velocity from orientations."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from haptorb.arrays import Array, check_finite
from haptorb.compiled import kernel
from haptorb.errors import InputError

__all__ = [
    "correct_rotation",
    "logarithm",
    "product",
    "quaternion",
    "rotate",
    "rotation_from_euler",
    "rotation_of",
    "turn_by",
]


# --------------------------------------------------------------------------------------------------
# Tilt and spin as rotation matrices: the XYZ Euler angles q = (ψ, λ, φ) of Bai 2012 eq. (1).
#
# They are intrinsic: R_SR = Rx(ψ) Ry(λ) Rz(φ), tilt first, then spin about the body's own axis. Only in this order is
# the paper's workspace |ψ|, |λ| ≤ 22.5°, 0 ≤ φ < 360° a cone of tilts with free spin.


def rotation_from_euler(psi: ArrayLike, lam: ArrayLike, phi: ArrayLike) -> Array:
    """Convert XYZ Euler angles (ψ, λ, φ) of Bai 2012 eq. (1) to rotation matrices.

    Parameters
    ----------
    psi : array_like, shape (...)
        Tilt ψ about x [rad].
    lam : array_like, shape (...)
        Tilt λ about the turned y [rad].
    phi : array_like, shape (...)
        Spin φ about the turned z [rad]. The three shapes broadcast together.

    Returns
    -------
    ndarray, shape (..., 3, 3)
        Rotation R_SR = Rx(ψ) Ry(λ) Rz(φ), which turns rotor vectors into stator vectors.

    Raises
    ------
    InputError
        If the angles do not broadcast, or are not finite.

    Examples
    --------
    >>> rotation_from_euler(0.0, 0.0, np.pi / 2).round(12)[:, 0].tolist()      # spin turns x into y
    [0.0, 1.0, 0.0]
    >>> rotation_from_euler(0.1, 0.2, np.zeros(5)).shape
    (5, 3, 3)
    """
    try:
        a, b, c = np.broadcast_arrays(check_finite(psi, "psi"), check_finite(lam, "lam"), check_finite(phi, "phi"))
    except ValueError as cause:
        if isinstance(cause, InputError):
            raise
        raise InputError(f"psi, lam and phi must broadcast together: {cause}") from cause
    ca, sa, cb, sb, cc, sc = np.cos(a), np.sin(a), np.cos(b), np.sin(b), np.cos(c), np.sin(c)
    rows = [
        [cb * cc, -cb * sc, sb],
        [ca * sc + sa * sb * cc, ca * cc - sa * sb * sc, -sa * cb],
        [sa * sc - ca * sb * cc, sa * cc + ca * sb * sc, ca * cb],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


# --------------------------------------------------------------------------------------------------
# Unit quaternions (x, y, z, w): cheaper than a rotation matrix for each of many poses.


def product(a: Array, b: Array) -> Array:
    """Return the rotation b (4,) followed by the rotation a (4,), as a quaternion (4,).

    >>> half = np.array([0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)])       # a quarter turn about z
    >>> product(half, half).round(12).tolist()
    [0.0, 0.0, 1.0, 0.0]
    """
    v = a[3] * b[:3] + b[3] * a[:3] + np.cross(a[:3], b[:3])
    return np.append(v, a[3] * b[3] - a[:3] @ b[:3])


def rotate(q: Array, v: Array) -> Array:
    """Return the vector v (3,) rotated by the unit quaternion q (4,).

    >>> rotate(np.array([0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)]), np.array([1.0, 0.0, 2.0])).round(12)[1:].tolist()
    [1.0, 2.0]
    """
    u = 2.0 * np.cross(q[:3], v)
    out: Array = v + q[3] * u + np.cross(q[:3], u)
    return out


def rotation_of(q: Array) -> Array:
    """Return the rotation matrix (3, 3) of the unit quaternion q (4,).

    >>> rotation_of(np.array([0.0, 0.0, 1.0, 0.0])).diagonal().tolist()      # half a turn about z
    [-1.0, -1.0, 1.0]
    """
    x, y, z, w = q.tolist()
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion(R: Array) -> Array:
    """Return the quaternion (4,) of a rotation (3, 3), computed from its largest component for accuracy (Shepperd).

    >>> quaternion(np.diag([1.0, -1.0, -1.0])).tolist()
    [1.0, 0.0, 0.0, 0.0]
    """
    d, trace = np.diag(R), float(np.trace(R))
    squares = np.append(1.0 + 2.0 * d - trace, 1.0 + trace)
    k = int(np.argmax(squares))
    q = np.empty(4)
    q[k] = 0.5 * np.sqrt(squares[k])
    skew = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    if k == 3:
        q[:3] = skew / (4.0 * q[3])
        return q
    for j in range(3):
        if j != k:
            q[j] = (R[k, j] + R[j, k]) / (4.0 * q[k])
    q[3] = skew[k] / (4.0 * q[k])
    return q


# --------------------------------------------------------------------------------------------------
# Angular velocity from a sequence of orientations: a critically damped α–β filter on rotations.
#
# Orientation and angular velocity are predicted, R⁻ = exp(w dt) R, and corrected by what was measured, e =
# log(R_measured R⁻ᵀ): R = exp(α e) R⁻, w = w⁻ + β e/dt, with α = 1 − θ², β = (1 − θ)², θ = exp(−dt/τ). The velocity
# lags by 2 τ (its transfer function is 1/(1 + τ s)² apart from the zero of the orientation), and white noise of σ [rad]
# at intervals dt becomes about σ √(dt)/(2 τ^1.5) in w.


@kernel
def turn_by(x: float, y: float, z: float, R: Array, out: Array) -> None:
    """Compute out (3, 3) = exp((x, y, z)×) R, orthonormalised, so that many small steps remain a rotation."""
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
    # Gram–Schmidt on the rows: rounding errors would accumulate over millions of ticks
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
    """Compute out (3,), the rotation vector of A Bᵀ, for rotations below half a turn."""
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
    """Run one step of the filter: correct `w` (3,) in place; out (3, 3) is the filtered orientation."""
    theta = math.exp(-dt / tau)
    error = np.empty(3)
    logarithm(measured, predicted, error)
    alpha, beta = 1.0 - theta * theta, (1.0 - theta) * (1.0 - theta)
    for i in range(3):
        w[i] += beta / dt * error[i]
    turn_by(alpha * error[0], alpha * error[1], alpha * error[2], predicted, out)
