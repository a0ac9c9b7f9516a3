"""The field of the tool's magnet and of the core's answer at the field sensors, with its derivatives, in one kernel.

The magnet is a few charges on its faces; the core answers each with a series (see `physics.soft_sphere`). Written with
t = a²/(|x||s|) and c = x̂·ŝ, the answer at x to a charge q at s is

    B = μ0 q/(4πa|x|) (S1 ŝ − S2 x̂),   S1 = Σ β_l t^(l+1) P_l'(c),   S2 = Σ β_l t^(l+1) P_(l+1)'(c),

because P_(l+1)' = c P_l' + (l+1) P_l. Its derivative by s needs P'' and nothing else; a charge that is carried along
by a turn δ of the magnet moves by δ × (s − p). So the Jacobian is analytic: three columns for the magnet's place, two
for its axis. The turn about the axis changes nothing and is left out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel
from haptorb.numerics.packing import pack, part
from haptorb.physics.sources import dipole
from haptorb.physics.sources.charged_ring import ChargedRing
from haptorb.physics.sources.dipole import MU0
from haptorb.physics.sources.soft_sphere import SoftSphere

__all__ = ["ToolModel", "TrackerModel", "coil_field", "moment_field", "pack_model", "tool_field", "unpack_model"]

_K = MU0 / (4 * np.pi)


class ToolModel(NamedTuple):
    """The tool's magnet, the core and the places of the sensors, as kernels take them."""

    rows: Array  #: (4, n) charges in the mover's frame: x, y, z [m], q [A·m]
    sensors: Array  #: (k, 3) [m]
    core_radius: float  #: [m]
    response: Array  #: (3, L) the core's answer by degree, and (2l + 1)/(l + 1), l/(l + 1) of Legendre's recurrence

    @classmethod
    def of(cls, device: SphericalElectromagnet, *, azimuth: int = 4) -> ToolModel:
        """The model of `device`: one node in ρ² and `azimuth` steps per face.

        Four steps are right to (ρ/r)⁴: 0.3 % where the tool's end is 15 mm from a sensor, below a fortieth of the
        noise elsewhere.

        >>> from haptorb.devices.loader import load
        >>> ToolModel.of(load("omni")).rows.shape
        (4, 8)
        """
        tool, at = device.tool, np.ascontiguousarray(device.hall.positions, dtype=np.float64).reshape(-1, 3)
        sphere = SoftSphere(device.core_radius, device.core_permeability)
        closest = max(device.dome_radius - tool.length / 2, 1.1 * device.core_radius)
        order = sphere.order(closest, float(np.linalg.norm(at, axis=1).min()), precision=1e-3) if len(at) else 1
        ring = ChargedRing(tool.outer_radius, tool.inner_radius, tool.length, tool.remanence, radial=1, azimuth=azimuth)
        degree = np.arange(1, order + 1, dtype=np.float64)
        response = np.stack([sphere.response(order), (2 * degree + 1) / (degree + 1), degree / (degree + 1)])
        return cls(ring.rows, at, float(device.core_radius), response)


class TrackerModel(NamedTuple):
    """What the Hall tracker knows about tool and coils, within compiled code."""

    tool: ToolModel
    per_ampere: Array  #: (3 k, m) field of the coils at the sensors, the core's answer included [T/A]
    columns: Array  #: (m,) squares of the columns of the moment map [m⁴]


def pack_model(device: SphericalElectromagnet, model: ToolModel) -> Array:
    """(n,) all of TrackerModel, [m], [A·m] and [T/A], with `model` for the tool; `unpack_model` takes it apart."""
    columns = (np.asarray(device.moment_per_current, dtype=np.float64) ** 2).sum(axis=0)
    per_ampere = coil_field(device).reshape(3 * device.sensors, -1)
    return pack((model.core_radius,), model.rows, model.sensors, model.response, per_ampere, columns)


@kernel
def unpack_model(model: Array) -> TrackerModel:
    """What `pack_model` made, its parts in their own units."""
    tool = ToolModel(part(model, 1), part(model, 2), part(model, 0)[0, 0], part(model, 3))
    return TrackerModel(tool, part(model, 4), part(model, 5)[0])


def coil_field(device: SphericalElectromagnet) -> Array:
    """(k, 3, m) [T/A] what an ampere in each coil does at each sensor, the core's answer to the coils included.

    As the sensors of `device` tell it, where a calibration measured it.
    """
    correction = device.hall.correction
    if correction is not None:
        return np.ascontiguousarray(correction.per_ampere)
    per_ampere: Array = np.ascontiguousarray(moment_field(device) @ device.moment_per_current)
    return per_ampere


def moment_field(device: SphericalElectromagnet) -> Array:
    """(k, 3, 3) [T/(A·m²)] what a unit moment along x, y, z at the centre does at each sensor."""
    at = device.hall.positions.reshape(-1, 3)
    unit = [dipole.field(np.broadcast_to(e, at.shape), at) for e in np.eye(3)]
    per_moment: Array = np.ascontiguousarray(np.stack(unit, axis=2))
    return per_moment


@kernel
def tool_field(model: ToolModel, p: Array, R: Array, B: Array, J: Array) -> None:
    """Fill B (k, 3) [T] and J (k, 3, 5): ∂B/∂p [T/m], then per turn about R's x and y axes [T/rad].

    p (3,) [m] the magnet's centre, R (3, 3) any rotation whose third column is the magnet's axis.
    """
    rows, a = model.rows, model.core_radius
    # Per charge: from the magnet's centre, from the core's, its direction, 1/|s|.
    placed = np.empty((rows.shape[1], 10))
    for n in range(rows.shape[1]):
        square = 0.0
        for i in range(3):
            placed[n, i] = R[i, 0] * rows[0, n] + R[i, 1] * rows[1, n] + R[i, 2] * rows[2, n]
            placed[n, 3 + i] = p[i] + placed[n, i]
            square += placed[n, 3 + i] * placed[n, 3 + i]
        placed[n, 9] = 1.0 / np.sqrt(square)
        for i in range(3):
            placed[n, 6 + i] = placed[n, 3 + i] * placed[n, 9]
    for k in range(model.sensors.shape[0]):
        x, y, z = model.sensors[k, 0], model.sensors[k, 1], model.sensors[k, 2]
        reach = 1.0 / np.sqrt(x * x + y * y + z * z)
        ux, uy, uz = x * reach, y * reach, z * reach
        for i in range(3):
            B[k, i] = 0.0
            for j in range(5):
                J[k, i, j] = 0.0
        for n in range(rows.shape[1]):
            q = _K * rows[3, n]
            ax, ay, az = placed[n, 0], placed[n, 1], placed[n, 2]
            sx, sy, sz = placed[n, 3], placed[n, 4], placed[n, 5]
            # The charge itself: q r/r³, and its derivative by s, q (3 r rᵀ/r⁵ − 1/r³).
            rx, ry, rz = x - sx, y - sy, z - sz
            inverse = 1.0 / (rx * rx + ry * ry + rz * rz)
            w = q * inverse * np.sqrt(inverse)
            bx, by, bz = w * rx, w * ry, w * rz
            v = 3.0 * w * inverse
            dxx, dyy, dzz = v * rx * rx - w, v * ry * ry - w, v * rz * rz - w
            dxy, dxz, dyz = v * rx * ry, v * rx * rz, v * ry * rz
            dyx, dzx, dzy = dxy, dxz, dyz
            # The core's answer to it.
            hx, hy, hz, sigma = placed[n, 6], placed[n, 7], placed[n, 8], placed[n, 9]
            c = ux * hx + uy * hy + uz * hz
            t = a * a * reach * sigma
            power = t * t
            p_now, d_before, d_now, e_before, e_now = c, 0.0, 1.0, 0.0, 0.0
            p_before = 1.0
            s1, s1t, s1c, s2, s2t, s2c = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for l in range(1, model.response.shape[1] + 1):
                p_after = model.response[1, l - 1] * c * p_now - model.response[2, l - 1] * p_before
                d_after = d_before + (2 * l + 1) * p_now
                e_after = e_before + (2 * l + 1) * d_now
                weight = model.response[0, l - 1] * power
                s1 += weight * d_now
                s1t += (l + 1) * weight * d_now
                s1c += weight * e_now
                s2 += weight * d_after
                s2t += (l + 1) * weight * d_after
                s2c += weight * e_after
                p_before, p_now = p_now, p_after
                d_before, d_now = d_now, d_after
                e_before, e_now = e_now, e_after
                power *= t
            scale = q / a * reach
            bx += scale * (s1 * hx - s2 * ux)
            by += scale * (s1 * hy - s2 * uy)
            bz += scale * (s1 * hz - s2 * uz)
            # ∂t/∂s = −t ŝ/|s|, ∂c/∂s = (x̂ − c ŝ)/|s|, ∂ŝ/∂s = (1 − ŝŝᵀ)/|s|
            scale *= sigma
            g1, g2 = -s1t - c * s1c, -s2t - c * s2c
            m1x, m1y, m1z = g1 * hx + s1c * ux, g1 * hy + s1c * uy, g1 * hz + s1c * uz
            m2x, m2y, m2z = g2 * hx + s2c * ux, g2 * hy + s2c * uy, g2 * hz + s2c * uz
            dxx += scale * (s1 * (1.0 - hx * hx) + hx * m1x - ux * m2x)
            dxy += scale * (-s1 * hx * hy + hx * m1y - ux * m2y)
            dxz += scale * (-s1 * hx * hz + hx * m1z - ux * m2z)
            dyx += scale * (-s1 * hy * hx + hy * m1x - uy * m2x)
            dyy += scale * (s1 * (1.0 - hy * hy) + hy * m1y - uy * m2y)
            dyz += scale * (-s1 * hy * hz + hy * m1z - uy * m2z)
            dzx += scale * (-s1 * hz * hx + hz * m1x - uz * m2x)
            dzy += scale * (-s1 * hz * hy + hz * m1y - uz * m2y)
            dzz += scale * (s1 * (1.0 - hz * hz) + hz * m1z - uz * m2z)
            B[k, 0] += bx
            B[k, 1] += by
            B[k, 2] += bz
            J[k, 0, 0] += dxx
            J[k, 0, 1] += dxy
            J[k, 0, 2] += dxz
            J[k, 1, 0] += dyx
            J[k, 1, 1] += dyy
            J[k, 1, 2] += dyz
            J[k, 2, 0] += dzx
            J[k, 2, 1] += dzy
            J[k, 2, 2] += dzz
            for j in range(2):
                ex, ey, ez = R[0, j], R[1, j], R[2, j]
                tx, ty, tz = ey * az - ez * ay, ez * ax - ex * az, ex * ay - ey * ax
                J[k, 0, 3 + j] += dxx * tx + dxy * ty + dxz * tz
                J[k, 1, 3 + j] += dyx * tx + dyy * ty + dyz * tz
                J[k, 2, 3 + j] += dzx * tx + dzy * ty + dzz * tz
