"""Torque characteristic and sensor field of a whole device from pair tables, at servo speed, with their derivatives.

All kernels take many orientations R (n, 3, 3) at once and write into `out`. Axes are unit vectors: magnets (p, 3) in
the rotor's frame, coils and sensors in the stator's; `strength` (p,) multiplies the table's magnet (−1 for one
polarized inward). Derivatives are by a small rotation vector δ [rad] in the stator frame that turns the rotor on:
R → exp(δ×) R.
An orientation that is not finite gives NaN, never a look-up outside the table.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel, vector_kernel

__all__ = ["sensor_field", "sensor_field_gradient", "torque_characteristic"]

_NEAR = 1e-9  #: on the axis itself slope/x is 0/0: the slope vanishes there, and so does what it multiplies
Places: TypeAlias = NDArray[np.int32]


@kernel
def _turn_axes(R: Array, axes: Array, out: Array) -> None:
    """Structure of arrays: out[:, i] = R axes[i]."""
    for i in range(axes.shape[0]):
        x, y, z = axes[i, 0], axes[i, 1], axes[i, 2]
        out[0, i] = R[0, 0] * x + R[0, 1] * y + R[0, 2] * z
        out[1, i] = R[1, 0] * x + R[1, 1] * y + R[1, 2] * z
        out[2, i] = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z


@vector_kernel
def _locate_pieces(u: Array, x: float, y: float, z: float, scale: float, last: int, t: Array, piece: Places) -> None:
    """Piece and place in it for the chords from (x, y, z) to all u: a loop of its own, as it runs in SIMD so."""
    a = 2.0 * scale * scale
    bx, by, bz = a * x, a * y, a * z
    for i in range(u.shape[1]):
        chord = math.sqrt(abs(a - (u[0, i] * bx + u[1, i] * by + u[2, i] * bz)))
        where = min(max(np.int32(chord), np.int32(0)), np.int32(last))
        piece[i] = where
        t[i] = chord - where


@kernel
def torque_characteristic(
    cells: Array, scale: float, magnets: Array, strength: Array, coils: Array, R: Array, out: Array
) -> None:
    """out (n, 3, m) [N·m/A] = Σ strength k(u·c) u × c: torque on the rotor about the centre, Bai 2012 eq. (2)."""
    count, last = magnets.shape[0], cells.shape[0] - 1
    u, place, piece = np.empty((3, count)), np.empty(count), np.empty(count, np.int32)
    for n in range(R.shape[0]):
        _turn_axes(R[n], magnets, u)
        for j in range(coils.shape[0]):
            cx, cy, cz = coils[j, 0], coils[j, 1], coils[j, 2]
            _locate_pieces(u, cx, cy, cz, scale, last, place, piece)
            x, y, z = 0.0, 0.0, 0.0
            for i in range(count):
                p, t = piece[i], place[i]
                t2 = t * t
                high = cells[p, 2] + t * cells[p, 3] + t2 * (cells[p, 4] + t * cells[p, 5])
                k = strength[i] * (cells[p, 0] + t * cells[p, 1] + t2 * high)
                x += k * u[0, i]
                y += k * u[1, i]
                z += k * u[2, i]
            # Σ k (u × c) = (Σ k u) × c
            out[n, 0, j] = y * cz - z * cy
            out[n, 1, j] = z * cx - x * cz
            out[n, 2, j] = x * cy - y * cx


@kernel
def sensor_field(
    cells: Array, scale: float, magnets: Array, strength: Array, sensors: Array, R: Array, out: Array
) -> None:
    """out (n, k, 3) [T] = Σ strength [f(u·s) u + g(u·s) s]: flux density at every sensor, stator frame."""
    count, last = magnets.shape[0], cells.shape[0] - 1
    u, place, piece = np.empty((3, count)), np.empty(count), np.empty(count, np.int32)
    for n in range(R.shape[0]):
        _turn_axes(R[n], magnets, u)
        for j in range(sensors.shape[0]):
            sx, sy, sz = sensors[j, 0], sensors[j, 1], sensors[j, 2]
            _locate_pieces(u, sx, sy, sz, scale, last, place, piece)
            x, y, z, along = 0.0, 0.0, 0.0, 0.0
            for i in range(count):
                p, t = piece[i], place[i]
                t2 = t * t
                high = cells[p, 2] + t * cells[p, 3] + t2 * (cells[p, 4] + t * cells[p, 5])
                f = strength[i] * (cells[p, 0] + t * cells[p, 1] + t2 * high)
                high = cells[p, 8] + t * cells[p, 9] + t2 * (cells[p, 10] + t * cells[p, 11])
                along += strength[i] * (cells[p, 6] + t * cells[p, 7] + t2 * high)
                x += f * u[0, i]
                y += f * u[1, i]
                z += f * u[2, i]
            out[n, j, 0] = x + along * sx
            out[n, j, 1] = y + along * sy
            out[n, j, 2] = z + along * sz


@kernel
def sensor_field_gradient(
    cells: Array, scale: float, magnets: Array, strength: Array, sensors: Array, R: Array, field: Array, out: Array
) -> None:
    """field (n, k, 3) [T] as `sensor_field`, and out (n, k, 3, 3) [T/rad], [n, j, i, a] = ∂B_i/∂δ_a at sensor j.

    ∂B/∂δ = Σ strength [(f′ u + g′ s) wᵀ − f (u×)], w = u × s.
    """
    count, last = magnets.shape[0], cells.shape[0] - 1
    u, place, piece = np.empty((3, count)), np.empty(count), np.empty(count, np.int32)
    for n in range(R.shape[0]):
        _turn_axes(R[n], magnets, u)
        for j in range(sensors.shape[0]):
            sx, sy, sz = sensors[j, 0], sensors[j, 1], sensors[j, 2]
            _locate_pieces(u, sx, sy, sz, scale, last, place, piece)
            x, y, z, along = 0.0, 0.0, 0.0, 0.0
            # Σ f′ u uᵀ, from which Σ f′ u wᵀ = (Σ f′ u uᵀ) (s×)ᵀ; and Σ g′ u, from which Σ g′ w = (Σ g′ u) × s
            xx, yy, zz, xy, xz, yz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            gx, gy, gz = 0.0, 0.0, 0.0
            for i in range(count):
                ux, uy, uz, p, t = u[0, i], u[1, i], u[2, i], piece[i], place[i]
                by_cosine = -strength[i] * scale * scale / max(p + t, _NEAR)
                c1, c2, c3, c4, c5 = cells[p, 1], cells[p, 2], cells[p, 3], cells[p, 4], cells[p, 5]
                f = strength[i] * (cells[p, 0] + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * c5)))))
                df = by_cosine * (c1 + t * (2.0 * c2 + t * (3.0 * c3 + t * (4.0 * c4 + t * 5.0 * c5))))
                c1, c2, c3, c4, c5 = cells[p, 7], cells[p, 8], cells[p, 9], cells[p, 10], cells[p, 11]
                along += strength[i] * (cells[p, 6] + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * c5)))))
                dg = by_cosine * (c1 + t * (2.0 * c2 + t * (3.0 * c3 + t * (4.0 * c4 + t * 5.0 * c5))))
                x += f * ux
                y += f * uy
                z += f * uz
                gx += dg * ux
                gy += dg * uy
                gz += dg * uz
                xx += df * ux * ux
                yy += df * uy * uy
                zz += df * uz * uz
                xy += df * ux * uy
                xz += df * ux * uz
                yz += df * uy * uz
            field[n, j, 0] = x + along * sx
            field[n, j, 1] = y + along * sy
            field[n, j, 2] = z + along * sz
            wx, wy, wz = gy * sz - gz * sy, gz * sx - gx * sz, gx * sy - gy * sx
            out[n, j, 0, 0] = xy * sz - xz * sy + sx * wx
            out[n, j, 0, 1] = xz * sx - xx * sz + sx * wy + z
            out[n, j, 0, 2] = xx * sy - xy * sx + sx * wz - y
            out[n, j, 1, 0] = yy * sz - yz * sy + sy * wx - z
            out[n, j, 1, 1] = yz * sx - xy * sz + sy * wy
            out[n, j, 1, 2] = xy * sy - yy * sx + sy * wz + x
            out[n, j, 2, 0] = yz * sz - zz * sy + sz * wx + y
            out[n, j, 2, 1] = zz * sx - xz * sz + sz * wy - x
            out[n, j, 2, 2] = xz * sy - yz * sx + sz * wz
