"""What a point dipole at the device's centre does to the tool: as two point dipoles, or to a ring of its true size.

Both answer with a map (6, 3): force and torque about the magnet's centre per moment m_e of the electromagnet, because
both are linear in m_e. With the calibrated m_e per ampere that is the wrench map of the device.
"""

from __future__ import annotations

import numpy as np

from haptorb.devices.electromagnet.passive_pull import pull
from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel, tick_kernel
from haptorb.physics.sources.charged_ring import dipole_on_charges
from haptorb.physics.sources.dipole import MU0

__all__ = ["axis_frame", "dipole_per_ampere", "fill_per_ampere", "ring_per_ampere"]

_K = MU0 / (4 * np.pi)


@kernel
def axis_frame(axis: Array, R: Array) -> None:
    """Fill R (3, 3) with the rotation that turns z to the unit vector `axis` by the shortest way."""
    x, y, z = axis[0], axis[1], axis[2]
    if z < -1.0 + 1e-12:
        R[:] = 0.0
        R[0, 0], R[1, 1], R[2, 2] = 1.0, -1.0, -1.0
        return
    k = 1.0 / (1.0 + z)
    R[0, 0], R[0, 1], R[0, 2] = 1.0 - k * x * x, -k * x * y, x
    R[1, 0], R[1, 1], R[1, 2] = -k * x * y, 1.0 - k * y * y, y
    R[2, 0], R[2, 1], R[2, 2] = -x, -y, z


@kernel
def _dipole_map(p: Array, axis: Array, moment: float, out: Array) -> None:
    x, y, z = p[0], p[1], p[2]
    q = 1.0 / (x * x + y * y + z * z)
    near = _K * moment * q * np.sqrt(q)
    c = 3.0 * near * q
    s = x * axis[0] + y * axis[1] + z * axis[2]
    for i in range(3):
        for j in range(3):
            g = axis[j] * p[i] + axis[i] * p[j] - 5.0 * s * q * p[i] * p[j]
            if i == j:
                g += s
            out[i, j] = c * g  # ∇(m_p · B): symmetric in i and j
    for j in range(3):
        bx, by, bz = 3.0 * near * q * p[j] * x, 3.0 * near * q * p[j] * y, 3.0 * near * q * p[j] * z
        if j == 0:
            bx -= near
        elif j == 1:
            by -= near
        else:
            bz -= near
        out[3, j] = axis[1] * bz - axis[2] * by  # m_p × B
        out[4, j] = axis[2] * bx - axis[0] * bz
        out[5, j] = axis[0] * by - axis[1] * bx


@kernel
def _ring_map(rows: Array, p: Array, axis: Array, out: Array) -> None:
    R = np.empty((3, 3))
    axis_frame(axis, R)
    dipole_on_charges(rows, R, p, out)


@kernel
def fill_per_ampere(per_moment: Array, moment_per_current: Array, out: Array) -> None:
    """out (6, m) = per_moment (6, 3) times moment_per_current (3, m)."""
    for i in range(6):
        for k in range(out.shape[1]):
            total = 0.0
            for j in range(3):
                total += per_moment[i, j] * moment_per_current[j, k]
            out[i, k] = total


@kernel
def dipole_per_ampere(moment: float, moment_per_current: Array, p: Array, R: Array, out: Array) -> None:
    """Fill out (6, m) [N/A, N·m/A] for a point dipole of `moment` [A·m²] along the z axis of R, at p.

    The model of Zárate 2020: equations (1) and (2) are its case of a tool on the axis of m_e (sign of e_t as in
    erratum E12).

    >>> K = np.empty((6, 1))
    >>> dipole_per_ampere(2.407, np.array([[0.0], [0.0], [0.2077]]), np.array([0.0, 0.0, 0.05]), np.eye(3), K)
    >>> round(-1e3 * float(K[2, 0]), 1)          # the printed 48 mN/A, averaged over the coils
    48.0
    """
    axis, per_moment = np.empty(3), np.empty((6, 3))
    for i in range(3):
        axis[i] = R[i, 2]
    _dipole_map(p, axis, moment, per_moment)
    fill_per_ampere(per_moment, moment_per_current, out)


@kernel
def _fill_ring(
    rows: Array, table: Array, nearest: float, moment_per_current: Array, p: Array, R: Array, out: Array, passive: Array
) -> None:
    axis, per_moment = np.empty(3), np.empty((6, 3))
    for i in range(3):
        axis[i] = R[i, 2]
        passive[i], passive[3 + i] = 0.0, 0.0
    _ring_map(rows, p, axis, per_moment)
    fill_per_ampere(per_moment, moment_per_current, out)
    pull(table, nearest, p, axis, passive)


@tick_kernel
def ring_per_ampere(
    rows: Array, table: Array, nearest: float, moment_per_current: Array, p: Array, R: Array, out: Array, passive: Array
) -> None:
    """Fill out (6, m) [N/A, N·m/A] and passive (6,) [N, N·m] for a ring magnet turned by R at p over a soft core.

    rows are the ring's charges, table and nearest its `PassivePull`; the magnet is round: only its axis matters.
    """
    _fill_ring(rows, table, nearest, moment_per_current, p, R, out, passive)
