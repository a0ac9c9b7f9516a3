"""Pose of a magnet from the field sensors: Gauss–Newton, damped by Levenberg's method.

Five unknowns: three of the place, two turns across the axis. A step solves (N + λ diag N) δ = Jᵀ r, so that metres and
radians need no common scale; a step that increases the misfit is reverted and λ increased.

The uncertainty of the electromagnet's own moment (noise of the measured currents, errors of the calibration) is an
error common to all readings: their covariance is σ² 1 + U S Uᵀ, U (3k, 3) the field of unit moments at the
sensors. Its inverse, by Woodbury, is (1 − U G Uᵀ)/σ² with G = (σ² S⁻¹ + UᵀU)⁻¹: three numbers Uᵀr and three rows UᵀJ
are the whole additional cost, equivalent to three more unknowns (the moment) with a prior.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from haptorb.arrays import Array, Record, Records, check_finite, vectors
from haptorb.compiled import kernel, pack, part
from haptorb.devices.base import rotation_to_axis
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.errors import InputError
from haptorb.magnetics.dipole import MU0_OVER_4PI, point_field
from haptorb.magnetics.magnets import ChargedRing
from haptorb.magnetics.soft_sphere import SoftSphere
from haptorb.rotations import turn_by

__all__ = [
    "ToolModel",
    "TrackerModel",
    "better_sensors",
    "coil_field",
    "fit_tool",
    "moment_field",
    "pack_model",
    "position_accuracy",
    "tool_field",
    "unpack_model",
    "weigh_moment",
    "with_sensors",
]


# --------------------------------------------------------------------------------------------------
# Field of the tool's magnet and of the core's response at the field sensors, with derivatives, in one kernel.
#
# The magnet is modelled by charges on its faces; the core's response to each is a series (see `magnetics.soft_sphere`).
# With t = a²/(|x||s|) and c = x̂·ŝ, the response at x to a charge q at s is
#
#     B = μ0 q/(4πa|x|) (S1 ŝ − S2 x̂),   S1 = Σ β_l t^(l+1) P_l'(c),   S2 = Σ β_l t^(l+1) P_(l+1)'(c),
#
# because P_(l+1)' = c P_l' + (l+1) P_l. Its derivative by s needs P'' only; a charge that moves with a rotation δ of
# the magnet moves by δ × (s − p). So the Jacobian is analytic: three columns for the magnet's position, two for its
# axis. The rotation about the axis has no effect and is left out.


class ToolModel(NamedTuple):
    """Tool's magnet, core and sensor positions, in the form that the kernels need."""

    rows: Array  #: (4, n) charges in the mover's frame: x, y, z [m], q [A·m]
    sensors: Array  #: (k, 3) [m]
    core_radius: float  #: [m]
    response: Array  #: (3, L) the core's response by degree, and (2l + 1)/(l + 1), l/(l + 1) of Legendre's recurrence

    @classmethod
    def of(cls, device: SphericalElectromagnet, *, azimuth: int = 4) -> ToolModel:
        """Model of `device`: one node in ρ² and `azimuth` steps per face.

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
    """Hall tracker's model of tool and coils, within compiled code."""

    tool: ToolModel
    per_ampere: Array  #: (3 k, m) field of the coils at the sensors, with the core's response [T/A]
    columns: Array  #: (m,) squares of the columns of the moment map [m⁴]


def pack_model(device: SphericalElectromagnet, model: ToolModel) -> Array:
    """(n,) packed TrackerModel, [m], [A·m] and [T/A], with `model` for the tool; `unpack_model` is the inverse."""
    columns = (np.asarray(device.moment_per_current, dtype=np.float64) ** 2).sum(axis=0)
    per_ampere = coil_field(device).reshape(3 * device.sensors, -1)
    return pack((model.core_radius,), model.rows, model.sensors, model.response, per_ampere, columns)


@kernel
def unpack_model(model: Array) -> TrackerModel:
    """Inverse of `pack_model`, each field in its own unit."""
    tool = ToolModel(part(model, 1), part(model, 2), part(model, 0)[0, 0], part(model, 3))
    return TrackerModel(tool, part(model, 4), part(model, 5)[0])


def coil_field(device: SphericalElectromagnet) -> Array:
    """(k, 3, m) [T/A] field per ampere of each coil at each sensor, with the core's response.

    Measured by the sensors of `device`, if a calibration contains it.
    """
    correction = device.hall.correction
    if correction is not None:
        return np.ascontiguousarray(correction.per_ampere)
    return np.ascontiguousarray(device.coil_fields(device.hall.positions))


def moment_field(device: SphericalElectromagnet) -> Array:
    """(k, 3, 3) [T/(A·m²)] field at each sensor of unit moments along x, y, z at the centre."""
    return np.ascontiguousarray(point_field(device.hall.positions.reshape(-1, 3)))


@kernel
def tool_field(model: ToolModel, p: Array, R: Array, B: Array, J: Array) -> None:
    """Fill B (k, 3) [T] and J (k, 3, 5): ∂B/∂p [T/m], then per rotation about R's x and y axes [T/rad].

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
            q = MU0_OVER_4PI * rows[3, n]
            ax, ay, az = placed[n, 0], placed[n, 1], placed[n, 2]
            sx, sy, sz = placed[n, 3], placed[n, 4], placed[n, 5]
            # Field of the charge: q r/r³, and its derivative by s, q (3 r rᵀ/r⁵ − 1/r³).
            rx, ry, rz = x - sx, y - sy, z - sz
            inverse = 1.0 / (rx * rx + ry * ry + rz * rz)
            w = q * inverse * np.sqrt(inverse)
            bx, by, bz = w * rx, w * ry, w * rz
            v = 3.0 * w * inverse
            dxx, dyy, dzz = v * rx * rx - w, v * ry * ry - w, v * rz * rz - w
            dxy, dxz, dyz = v * rx * ry, v * rx * rz, v * ry * rz
            dyx, dzx, dzy = dxy, dxz, dyz
            # Field of the core's response.
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


_MAX_STEP_M = 15e-3  #: maximum translation of one step [m]: a fifth of the distance to the sensors
_MAX_ROTATION_RAD = 0.35  #: maximum rotation of one step [rad]


@kernel
def _inverse(N: Array) -> bool:
    """Invert the symmetric, positive N (n, n) in place (Gauss–Jordan); False if it is singular."""
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
    """Fill the weight of tracker t; zeros, plain least squares, where the moment is practically exact.

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

    A reading with an age [s] belongs to the pose at that time: r = field − (B − age J rates).
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
    """Improve p (3,) [m] and R (3, 3) in place until a step is below `near` [m] and `turn` [rad].

    Fits the fields of `sensors`, (k,) SENSOR, with the weight of the tracker t (zeros for plain least squares) and
    its rates since those were read; at most `most` evaluations. Its covariance becomes (JᵀWJ)⁻¹, per
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
        if not misfit <= best * (1.0 + 1e-9):  # larger, or NaN: step back and increase the damping
            p[:] = last_p
            R[:] = last_R
            damping = max(8.0 * damping, 1e-3)
            if damping > 1e6 or not best < np.inf:  # failed at the first evaluation: there is no earlier point
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
        shorter = min(1.0, _MAX_STEP_M / max(way, 1e-12), _MAX_ROTATION_RAD / max(wide, 1e-12))
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


# --------------------------------------------------------------------------------------------------
# Accuracy limit of position sensing with field sensors: the Cramér–Rao bound of any unbiased estimate.
#
# Limits, in this order: the field of the tool falls with the cube of the distance, its gradient with the fourth
# power, so that the sensors' distance from the tool matters most; then the sensors' noise; then, under current, the
# uncertainty of the coils' own field, from the noise of the current readings and the errors of the calibration.


def position_accuracy(
    device: SphericalElectromagnet,
    places: ArrayLike,
    axes: ArrayLike | None = None,
    currents: ArrayLike = (0.0, 0.0, 0.0),
    *,
    noise: float | None = None,
    calibration: float = 0.0,
) -> Array:
    """(n, 5) standard deviations of one sample: position [m] along stator x y z, two rotations across the axis [rad].

    places (n, 3) [m]; axes (n, 3), radial where none are given; currents (m,) [A]; noise of one reading [T], the
    device's where none is given; calibration: standard deviation of each entry of the 3 × m moment map, as a share of
    its column.

    Raises InputError for other shapes, and if noise and calibration error are both zero.

    >>> from haptorb.devices.loader import load
    >>> deviation = position_accuracy(load("omni"), [(0.0, 0.0, 0.05)])[0]
    >>> bool(5e-4 < deviation[0] < 2e-3)          # across the axis it is about a millimetre at the assumed places
    True
    """
    at = vectors(places, "places").reshape(-1, 3)
    along = at if axes is None else vectors(axes, "axes").reshape(-1, 3)
    amperes = check_finite(currents, "currents")
    if along.shape != at.shape or amperes.shape != (device.channels,):
        raise InputError(
            f"needs one axis per place and {device.channels} currents; got {at.shape}, {along.shape}, {amperes.shape}"
        )
    hall, supply = device.hall, device.supply
    sigma = hall.noise if noise is None else float(check_finite(noise, "noise"))
    if sigma < 0 or calibration < 0 or sigma + hall.step == 0:
        raise InputError(
            f"noise and calibration must be 0 T or more, and not all of them 0 T; got {sigma} T, {calibration} T"
        )
    per_ampere = coil_field(device).reshape(-1, device.channels)
    ampere2 = supply.current_noise**2 + supply.current_step**2 / 12
    spread = (sigma**2 + hall.step**2 / 12) * np.eye(len(per_ampere)) + ampere2 * per_ampere @ per_ampere.T
    if calibration:
        unit = moment_field(device).reshape(-1, 3)
        errors = calibration * np.linalg.norm(device.moment_per_current, axis=0) * amperes  # A·m² per coil
        spread += float(errors @ errors) * unit @ unit.T
    weight = np.linalg.inv(spread)
    model = ToolModel.of(device)
    k = device.sensors
    B, J = np.empty((k, 3)), np.empty((k, 3, 5))
    out = np.empty((len(at), 5))
    for row, p, axis in zip(out, at, along, strict=True):
        tool_field(model, np.ascontiguousarray(p), rotation_to_axis(axis), B, J)
        j = J.reshape(-1, 5)
        row[:] = np.sqrt(np.diag(np.linalg.inv(j.T @ weight @ j)))
    return out


def with_sensors(device: SphericalElectromagnet, positions: ArrayLike) -> SphericalElectromagnet:
    """Return `device` with its field sensors at `positions` (k, 3) [m], for a parameter study.

    Raises InputError for fewer than two, or one inside the core.
    """
    at = vectors(positions, "positions").reshape(-1, 3)
    if len(at) < 2 or float(np.linalg.norm(at, axis=1).min()) <= device.core_radius:
        raise InputError("field sensors must be at least two, outside the core")
    return replace(device, hall=replace(device.hall, positions=at, correction=None))


def better_sensors(device: SphericalElectromagnet) -> Array:
    """(9, 3) [m] improved placement: two level rings at the dome's equator, clear of the pen.

    Four sensors 4 mm off the dome, five at twice its radius, all 3 mm above the centre: as high as a pen that leans
    outwards at the workspace's edge allows. The near ring is close to the tool, the far one adds another direction;
    the assumed places waste five of nine sensors on the half that is away from the tool. Under the dome's skin it would
    be twice as good again; but there the coils' field is not a dipole's, and exceeds a Hall sensor's range of 40 mT.

    >>> from haptorb.devices.loader import load
    >>> (1e3 * better_sensors(load("omni"))[4]).tolist()
    [60.0, 0.0, 3.0]
    """

    def ring(count: int, radius: float, begin: float) -> Array:
        turn = 2 * np.pi * (np.arange(count) + begin) / count
        return np.column_stack([radius * np.cos(turn), radius * np.sin(turn), np.full(count, 3e-3)])

    return np.vstack([ring(4, device.dome_radius + 4e-3, 0.5), ring(5, 2 * device.dome_radius, 0.0)])
