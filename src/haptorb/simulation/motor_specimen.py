"""Specimen of a motor: parameters drawn from the tolerances of its file, torque and field from turns and charges.

Magnets have deviating strengths, positions and axes; coils deviating radii, positions, axes and turns in each layer;
field sensors deviating positions; regulator and weight deviate slightly from those of the file. Nothing is shared with
the controller's model: a coil is its turns, each a current loop by elliptic integrals (Smythe, Static and Dynamic
Electricity, §7.10), a magnet is charges on its faces, and so are the regulator's rings.

Torque. A magnet and a loop whose axes go through the motor's centre have one co-energy per ampere Λ(s), s = u·c, of the
directions u and c to both. Its derivatives by s, by the magnet's distance from the centre and by the direction of
either axis are the pair's torque, force and torques about the bodies' own centres. So four functions of s describe the
pair and, to first order, a magnet at another distance, and a magnet or a coil that is askew; a place beside the nominal
one is another direction, exactly. They are tabulated for loops at Chebyshev nodes over the region of a coil's turns,
and each coil sums them over its own turns. The torque is the gradient of one Λ, so no turning gains energy.

Field. A magnet off its place or askew has at a sensor the field of an exact one at another place of the sensor: two
functions of s, tabulated with two derivatives by the sensor's distance.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple
from zlib import crc32

import numpy as np

from haptorb.arrays import Array, gauss_legendre
from haptorb.compiled import kernel, pack, part, vector_kernel
from haptorb.devices.base import rotation_to_axis
from haptorb.devices.motor import SphericalMotor
from haptorb.devices.weight_regulator import Regulator
from haptorb.errors import GeometryError
from haptorb.magnetics.coil import Coil
from haptorb.magnetics.current_sheets import loop_field
from haptorb.magnetics.dipole import MU0, MU0_OVER_4PI
from haptorb.magnetics.magnets import ChargedRing, CylinderMagnet
from haptorb.magnetics.wire import overall_diameter, wind, wire_diameter

__all__ = ["MotorSpecimen", "MotorTruth", "draw_motor", "fill_field", "fill_torque", "pack_truth", "unpack_truth"]

_CELLS = 320  #: pieces of a table over the chord |u − c| from 0 to 2
_NODES = 10  #: loops across and along the region of a coil's turns, at Chebyshev nodes
_EDGE_RAD = 3e-4  #: an even function of the angle is taken there instead of at 0 and π, where it is 0/0
_FIELD_STEP_M = 0.4e-3  #: of a sensor's distance, for the two derivatives by it
_MAX_SHARE_OF_GAP = 0.4  #: of the gap between coils and magnets that tolerances may take away
_WINDING_LOOPS = (6, 16)  #: of a winding without tolerances, at Gauss points across and along
_RING_CHARGES = (5, 60)  #: across and around on each face of a regulator's ring
_TILTS = 14  #: at which the regulator's torque is computed
#: greatest number of charges on half a face, across and around
_MAX_CHARGES = (24, 64)


class MotorTruth(NamedTuple):
    """A `MotorSpecimen` in the form that compiled code needs."""

    torque_cells: Array  #: (c (n + 1), 16) cubic pieces over the chord of k, ∂Λ/∂a, hm, hc of each coil in turn
    torque_scale: float  #: pieces per unit of chord
    field_cells: Array  #: (n + 1, 24) of f and g, and their first and half second derivatives by the distance
    field_scale: float
    magnets: Array  #: (p, 3) directions to the magnets' centres, rotor frame
    out: Array  #: (p,) their excess distance from the centre [m]
    lean: Array  #: (p, 3) their axes less these directions, across them, rotor frame
    offset: Array  #: (p, 3) their centres less those of magnets of the same axes through the centre, rotor frame [m]
    axes: Array  #: (p, 3) their axes, rotor frame
    coils: Array  #: (c, 3) directions to the coils' centres
    coil_lean: Array  #: (c, 3) their axes less these directions, across them
    sensors: Array  #: (k, 3) true places of the field sensors [m]
    sensor_distance: float  #: nominal distance of the sensors [m]
    groups: Array  #: (c, m)
    coil_field: Array  #: (m, 3 k) field of the coils at the sensors [T/A]
    tilt_torque: Array  #: (n,) coefficients of weight and regulator [N·m], for `weight_regulator.torque_over_sine`


def pack_truth(m: MotorTruth) -> Array:
    """(n,) `m` packed for compiled code, each number in the unit [..] of its field."""
    return pack((m.torque_scale, m.field_scale, m.sensor_distance), *(x for x in m if isinstance(x, np.ndarray)))


@kernel
def unpack_truth(blob: Array) -> MotorTruth:
    """Inverse of `pack_truth`, each field in its own unit [..]."""
    one = part(blob, 0)
    return MotorTruth(
        part(blob, 1), one[0, 0], part(blob, 2), one[0, 1], part(blob, 3), part(blob, 4)[0], part(blob, 5),
        part(blob, 6), part(blob, 7), part(blob, 8), part(blob, 9), part(blob, 10), one[0, 2], part(blob, 11),
        part(blob, 12), part(blob, 13)[0],
    )  # fmt: skip


@kernel
def _turn(R: Array, vectors: Array, out: Array) -> None:
    """out[:, i] = R vectors[i]."""
    for i in range(vectors.shape[0]):
        x, y, z = vectors[i, 0], vectors[i, 1], vectors[i, 2]
        for a in range(3):
            out[a, i] = R[a, 0] * x + R[a, 1] * y + R[a, 2] * z


@vector_kernel
def fill_torque(m: MotorTruth, strength: Array, R: Array, K: Array) -> None:
    """K (3, m) [N·m/A]: torque on the rotor at R (3, 3) per ampere in each channel; strength (p,) of the magnets."""
    count, rows = m.magnets.shape[0], m.torque_cells.shape[0] // m.coils.shape[0]
    u, lean, cells, scale = np.empty((3, count)), np.empty((3, count)), m.torque_cells, m.torque_scale
    _turn(R, m.magnets, u)
    _turn(R, m.lean, lean)
    K[:] = 0.0
    square = scale * scale
    for j in range(m.coils.shape[0]):
        cx, cy, cz = m.coils[j, 0], m.coils[j, 1], m.coils[j, 2]
        dx, dy, dz = m.coil_lean[j, 0], m.coil_lean[j, 1], m.coil_lean[j, 2]
        first = j * rows
        x, y, z, px, py, pz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(count):
            ux, uy, uz = u[0, i], u[1, i], u[2, i]
            chord = scale * np.sqrt(max(2.0 - 2.0 * (ux * cx + uy * cy + uz * cz), 1e-18))
            piece = min(int(chord), rows - 1)
            t = chord - piece
            q = cells[first + piece]
            pull = q[0] + t * (q[1] + t * (q[2] + t * q[3]))
            near = q[5] + t * (2.0 * q[6] + 3.0 * t * q[7])
            hm, dhm = q[8] + t * (q[9] + t * (q[10] + t * q[11])), q[9] + t * (2.0 * q[10] + 3.0 * t * q[11])
            hc, dhc = q[12] + t * (q[13] + t * (q[14] + t * q[15])), q[13] + t * (2.0 * q[14] + 3.0 * t * q[15])
            ex, ey, ez = lean[0, i], lean[1, i], lean[2, i]
            slope = near * m.out[i] + dhm * (ex * cx + ey * cy + ez * cz) + dhc * (dx * ux + dy * uy + dz * uz)
            along = strength[i] * (pull - slope * square / chord)  # d/ds = −scale²/chord d/dt
            hm *= strength[i]
            hc *= strength[i]
            x += along * ux + hm * ex
            y += along * uy + hm * ey
            z += along * uz + hm * ez
            px += hc * ux
            py += hc * uy
            pz += hc * uz
        a = y * cz - z * cy + py * dz - pz * dy
        b = z * cx - x * cz + pz * dx - px * dz
        c = x * cy - y * cx + px * dy - py * dx
        for channel in range(K.shape[1]):
            K[0, channel] += a * m.groups[j, channel]
            K[1, channel] += b * m.groups[j, channel]
            K[2, channel] += c * m.groups[j, channel]


@vector_kernel
def fill_field(m: MotorTruth, strength: Array, R: Array, out: Array) -> None:
    """out (k, 3) [T]: field of the magnets at the sensors' true places, the rotor at R (3, 3); strength (p,)."""
    count, last, cells, scale = m.axes.shape[0], m.field_cells.shape[0] - 1, m.field_cells, m.field_scale
    u, offset = np.empty((3, count)), np.empty((3, count))
    _turn(R, m.axes, u)
    _turn(R, m.offset, offset)
    for j in range(m.sensors.shape[0]):
        x, y, z = 0.0, 0.0, 0.0
        for i in range(count):
            sx, sy, sz = m.sensors[j, 0] - offset[0, i], m.sensors[j, 1] - offset[1, i], m.sensors[j, 2] - offset[2, i]
            far = np.sqrt(sx * sx + sy * sy + sz * sz)
            per = 1.0 / far
            ux, uy, uz = u[0, i], u[1, i], u[2, i]
            chord = scale * np.sqrt(max(2.0 - 2.0 * per * (ux * sx + uy * sy + uz * sz), 0.0))
            piece = min(int(chord), last)
            t, d, q = chord - piece, far - m.sensor_distance, cells[piece]
            f = (
                q[0]
                + t * (q[1] + t * (q[2] + t * q[3]))
                + d
                * (q[8] + t * (q[9] + t * (q[10] + t * q[11])) + d * (q[16] + t * (q[17] + t * (q[18] + t * q[19]))))
            )
            g = (
                q[4]
                + t * (q[5] + t * (q[6] + t * q[7]))
                + d
                * (q[12] + t * (q[13] + t * (q[14] + t * q[15])) + d * (q[20] + t * (q[21] + t * (q[22] + t * q[23]))))
            )
            f *= strength[i]
            g *= strength[i] * per
            x += f * ux + g * sx
            y += f * uy + g * sy
            z += f * uz + g * sz
        out[j, 0], out[j, 1], out[j, 2] = x, y, z


# --------------------------------------------------------------------------------------------------
# Tables of one magnet with loops of a coil, and with a field sensor.


class _Region(NamedTuple):
    """Region of the turns of all coils that may be drawn: radii, and heights over the motor's centre."""

    inner: float  #: [m]
    outer: float  #: [m]
    low: float  #: [m]
    high: float  #: [m]

    def nodes(self) -> tuple[Array, Array]:
        """(n,) radii and (n,) heights of the tabulated loops [m]."""
        x = np.cos(np.pi * (np.arange(_NODES) + 0.5) / _NODES)
        return (
            0.5 * (self.inner + self.outer) + 0.5 * (self.outer - self.inner) * x,
            0.5 * (self.low + self.high) + 0.5 * (self.high - self.low) * x,
        )

    def weigh(self, radii: Array, heights: Array, turns: Array) -> Array:
        """(n²,) turns of the tabulated loops equivalent to loops at `radii` and `heights` (f,) with `turns`.

        Lagrange interpolation over the Chebyshev nodes.
        """
        degrees, node = np.arange(_NODES), np.cos(np.pi * (np.arange(_NODES) + 0.5) / _NODES)
        polynomials = np.cos(np.outer(np.arccos(node), degrees)) * np.where(degrees == 0, 1.0, 2.0) / _NODES

        def lagrange(place: Array, low: float, high: float) -> Array:
            x = np.clip((2 * place - low - high) / (high - low), -1.0, 1.0)
            at: Array = np.cos(np.outer(np.arccos(x), degrees)) @ polynomials.T
            return at

        across, along = lagrange(radii, self.inner, self.outer), lagrange(heights, self.low, self.high)
        weights: Array = np.einsum("f,fi,fj->ij", turns, across, along).ravel()
        return weights


def _list_angles() -> Array:
    chord = np.linspace(0.0, 2.0, _CELLS + 1)
    angles: Array = np.clip(2 * np.arcsin(0.5 * chord), _EDGE_RAD, np.pi - _EDGE_RAD)
    return angles


def _charge_half_faces(magnet: CylinderMagnet, across: int, around: int) -> Array:
    """(4, n) charges on the half of both faces at y > 0, twice as strong, in the magnet's own frame [m, A·m]."""
    node, weight = gauss_legendre(across)
    radius = 0.5 * magnet.radius * (1 + node)
    charge = magnet.polarization / MU0 * radius * 0.5 * magnet.radius * weight * 2 * np.pi / around
    angle = np.pi * (np.arange(around) + 0.5) / around
    x, y = np.outer(radius, np.cos(angle)).ravel(), np.outer(radius, np.sin(angle)).ravel()
    one = np.stack([x, y, np.full_like(x, 0.5 * magnet.length), np.repeat(charge, around)])
    return np.hstack([one, one * np.array([[1.0], [1.0], [-1.0], [-1.0]])])


@kernel
def _fill_pairs(charges: Array, distance: float, angles: Array, radii: Array, heights: Array, out: Array) -> None:
    """out (loops, n, 4): k, ∂Λ/∂a, hm and F_x/sinθ per ampere in loops at `radii` and `heights` (loops,).

    charges (4, c) of half a magnet, whose centre is `distance` from the motor's in a direction `angles` (n,) from the
    loops' axis z.
    """
    for n in range(angles.shape[0]):
        c, s = np.cos(angles[n]), np.sin(angles[n])
        for f in range(radii.shape[0]):
            fx, fz, about, own = 0.0, 0.0, 0.0, 0.0
            for i in range(charges.shape[1]):
                ax, az = c * charges[0, i] + s * charges[2, i], c * charges[2, i] - s * charges[0, i]
                x, y, z = distance * s + ax, charges[1, i], distance * c + az
                over, axial = loop_field(radii[f], np.sqrt(x * x + y * y), z - heights[f])
                bx, bz = MU0 * charges[3, i] * over * x, MU0 * charges[3, i] * axial
                fx += bx
                fz += bz
                about += z * bx - x * bz
                own += az * bx - ax * bz
            out[f, n, 0], out[f, n, 1], out[f, n, 2], out[f, n, 3] = -about / s, s * fx + c * fz, -own / s, fx / s


@kernel
def _fill_sensed(charges: Array, distance: float, sensor: float, angles: Array, out: Array) -> None:
    """out (n, 2) [T]: f and g of a magnet of `charges` (4, c) on half its faces at a sensor that is `sensor` away."""
    for n in range(angles.shape[0]):
        c, s = np.cos(angles[n]), np.sin(angles[n])
        x, z, bx, bz = sensor * s, sensor * c - distance, 0.0, 0.0
        for i in range(charges.shape[1]):
            dx, dy, dz = x - charges[0, i], charges[1, i], z - charges[2, i]
            square = dx * dx + dy * dy + dz * dz
            q = MU0_OVER_4PI * charges[3, i] / (square * np.sqrt(square))
            bx += q * dx
            bz += q * dz
        out[n, 1] = bx / s
        out[n, 0] = bz - out[n, 1] * c


def _choose_charges(magnet: CylinderMagnet, gap: float, finer: float = 1.0) -> tuple[int, int]:
    """Numbers of charges across and around on half a face of `magnet` for distances of at least `gap` [m]."""
    ratio = finer * magnet.radius / gap
    return min(int(3 + 1.6 * ratio), _MAX_CHARGES[0]), min(int(6 + 4.5 * ratio), _MAX_CHARGES[1])


@lru_cache(maxsize=8)
def _tabulate_pairs(radius: float, length: float, polarization: float, distance: float, region: _Region) -> Array:
    """(n², cells + 1, 4) functions of the pair of a magnet and each loop of `region`, at the pieces' ends."""
    magnet = CylinderMagnet(radius, length, polarization)
    gap = _find_gap(magnet, distance, region)
    across, along = region.nodes()
    radii, heights = np.repeat(across, _NODES), np.tile(along, _NODES)
    angles = _list_angles()
    wide = np.arctan(radius / (distance - 0.5 * length)) + np.arctan(region.outer / region.low)
    out = np.empty((len(radii), len(angles), 4))
    begin = 0
    for limit, near in ((wide + 0.1, gap), (wide + 0.6, 0.1 * distance), (np.inf, 0.6 * distance)):
        end = int(np.searchsorted(angles, limit))
        part_of = np.empty((len(radii), end - begin, 4))
        charges = _charge_half_faces(magnet, *_choose_charges(magnet, max(near, gap)))
        _fill_pairs(charges, distance, angles[begin:end], radii, heights, part_of)
        out[:, begin:end] = part_of
        begin = end
    return out


@lru_cache(maxsize=8)
def _tabulate_field(radius: float, length: float, polarization: float, distance: float, sensor: float) -> Array:
    """(cells + 1, 24) pieces of f and g, as `MotorTruth.field_cells`."""
    magnet, angles = CylinderMagnet(radius, length, polarization), _list_angles()
    gap = abs(distance - sensor) - 0.5 * length - _FIELD_STEP_M
    if gap <= 0.0:
        raise GeometryError(
            f"sensors {1e3 * sensor:g} mm from the centre pass within {1e3 * _FIELD_STEP_M:g} mm of the magnets' "
            "faces: move them apart"
        )
    charges = _charge_half_faces(magnet, *_choose_charges(magnet, gap, 1.5))
    values = np.empty((3, len(angles), 2))
    for number, step in enumerate((-_FIELD_STEP_M, 0.0, _FIELD_STEP_M)):
        _fill_sensed(charges, distance, sensor + step, angles, values[number])
    first = (values[2] - values[0]) / (2 * _FIELD_STEP_M)
    second = (values[2] + values[0] - 2 * values[1]) / (2 * _FIELD_STEP_M**2)
    cells: Array = _lay_out(np.concatenate([values[1], first, second], axis=1)[None])[0]
    return cells


def _lay_out(values: Array) -> Array:
    """(m, cells + 1, 4 q) cubic pieces of `values` (m, cells + 1, q) at the pieces' ends, twice differentiable.

    The slope is zero at chord 0, because the functions are even; the last row continues the previous piece.
    """
    count = values.shape[1]
    system = 4.0 * np.eye(count) + np.eye(count, k=1) + np.eye(count, k=-1)
    system[0], system[-1] = np.eye(count)[0], np.eye(count)[-1]
    right = np.zeros_like(values)
    right[:, 1:-1] = 3 * (values[:, 2:] - values[:, :-2])
    right[:, -1] = np.tensordot(values[:, -5:], np.array([3, -16, 36, -48, 25]) / 12, axes=(1, 0))
    flat = np.moveaxis(right, 1, 0).reshape(count, -1)
    slopes = np.moveaxis(np.linalg.solve(system, flat).reshape(count, len(values), -1), 0, 1)
    rise, d0, d1 = np.diff(values, axis=1), slopes[:, :-1], slopes[:, 1:]
    pieces = np.zeros((*values.shape, 4))
    pieces[:, :-1] = np.stack([values[:, :-1], d0, 3 * rise - 2 * d0 - d1, d0 + d1 - 2 * rise], axis=-1)
    pieces[:, -1, :, 0], pieces[:, -1, :, 1] = values[:, -1], slopes[:, -1]
    return np.ascontiguousarray(pieces.reshape(len(values), count, -1))


def _find_gap(magnet: CylinderMagnet, distance: float, region: _Region) -> float:
    """Minimum distance between a magnet's sphere and the turns of any coil [m]; GeometryError without a gap."""
    face, rim = distance - 0.5 * magnet.length, float(np.hypot(distance + 0.5 * magnet.length, magnet.radius))
    gap = max(face - float(np.hypot(region.high, region.outer)), region.low - rim)
    if gap <= 0.0:
        raise GeometryError(
            f"no gap between coils and magnets: magnets begin at {1e3 * face:.2f} mm, coils reach "
            f"{1e3 * float(np.hypot(region.high, region.outer)):.2f} mm; a rotor that cannot turn is not simulated"
        )
    return gap


# --------------------------------------------------------------------------------------------------
# The regulator's rings as charges.


@kernel
def _torque_of_charges(still: Array, turned: Array) -> float:
    """Torque about y [N·m] on charges `turned` (4, n) in the field of charges `still` (4, n)."""
    total = 0.0
    for i in range(turned.shape[1]):
        x, y, z, fx, fz = turned[0, i], turned[1, i], turned[2, i], 0.0, 0.0
        for j in range(still.shape[1]):
            dx, dy, dz = x - still[0, j], y - still[1, j], z - still[2, j]
            square = dx * dx + dy * dy + dz * dz
            q = still[3, j] / (square * np.sqrt(square))
            fx += q * dx
            fz += q * dz
        total += MU0_OVER_4PI * turned[3, i] * (z * fx - x * fz)
    return total


def _expand_regulator(regulator: Regulator) -> tuple[Array, float]:
    """(14,) coefficients of torque over sin(tilt) [N·m], and the least cosine, for `torque_over_sine`."""
    sizes = [
        (ring.outer_radius, ring.inner_radius, ring.length, ring.polarization)
        for ring in (regulator.stator_ring, regulator.rotor_ring)
    ]
    return _expand_rings(*map(tuple, sizes), regulator.stator_height, regulator.rotor_height, regulator.greatest_tilt)


@lru_cache(maxsize=8)
def _expand_rings(
    stator: tuple[float, ...], rotor: tuple[float, ...], stator_height: float, rotor_height: float, most: float
) -> tuple[Array, float]:
    radial, azimuth = _RING_CHARGES
    still, turning = (ChargedRing(*size, radial=radial, azimuth=azimuth).rows.copy() for size in (stator, rotor))
    still[2] += stator_height
    turning[2] += rotor_height
    turning[3] *= -1.0  # polarized along the rotor's −z
    low = float(np.cos(most))
    node = np.cos(np.pi * (np.arange(_TILTS) + 0.5) / _TILTS)
    tilts = np.arccos(0.5 * (1 + low) + 0.5 * (1 - low) * node)
    values = np.empty(_TILTS)
    for number, (c, s) in enumerate(zip(np.cos(tilts), np.sin(tilts), strict=True)):
        placed = np.ascontiguousarray(
            np.vstack([np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ turning[:3], turning[3]])
        )
        values[number] = -_torque_of_charges(still, placed) / s
    return np.asarray(np.polynomial.chebyshev.chebfit(node, values, _TILTS - 1)), low


# --------------------------------------------------------------------------------------------------
# Drawing a specimen.


@dataclass(frozen=True)
class MotorSpecimen:
    """True magnets, coils and sensors of one specimen, with their torques and fields."""

    device: SphericalMotor
    magnet_places: Array  #: (p, 3) centres, rotor frame [m]
    magnet_axes: Array  #: (p, 3) rotor frame
    strength: Array  #: (p,) polarization over the file's, with its sign
    coil_places: Array  #: (c, 3) centres [m]
    coil_axes: Array  #: (c, 3)
    turns: tuple[Array, ...]  #: (3, f) of each coil: radii [m], heights over its centre [m], turns
    sensor_places: Array  #: (k, 3) [m]
    tilt_torque: Array  #: (n,) as `MotorTruth`
    least: float  #: minimum cosine of its validity
    region: _Region

    def compile(self) -> MotorTruth:
        """Compute tables and geometry for compiled code."""
        device, magnet = self.device, self.device.magnet
        out = np.linalg.norm(self.magnet_places, axis=1)
        coil_out = np.linalg.norm(self.coil_places, axis=1)
        toward, coil_toward = self.magnet_places / out[:, None], self.coil_places / coil_out[:, None]
        pairs = _tabulate_pairs(
            float(magnet.radius), float(magnet.length), float(magnet.polarization), float(device.magnets.distance),
            self.region,
        )  # fmt: skip
        weights = np.stack(
            [self.region.weigh(one[0], away + one[1], one[2]) for one, away in zip(self.turns, coil_out, strict=True)]
        )
        values = np.tensordot(weights, pairs, 1)  # (c, cells + 1, 4)
        values[..., 3] = values[..., 0] + coil_out[:, None] * values[..., 3]  # hc = k + b F_x/sinθ
        field = _tabulate_field(
            float(magnet.radius), float(magnet.length), float(magnet.polarization), float(device.magnets.distance),
            float(device.sensor_layout.distance),
        )  # fmt: skip
        return MotorTruth(
            _lay_out(values).reshape(-1, 16), 0.5 * _CELLS, field, 0.5 * _CELLS, toward,
            out - device.magnets.distance, _across(self.magnet_axes, toward),
            self.magnet_places - device.magnets.distance * self.magnet_axes, self.magnet_axes, coil_toward,
            _across(self.coil_axes, coil_toward), self.sensor_places, float(device.sensor_layout.distance),
            device.groups, self.compute_coil_field(), self.tilt_torque,
        )  # fmt: skip

    def compute_coil_field(self) -> Array:
        """(m, 3 k) [T/A] field of the turns at the sensors, per ampere in each channel."""
        out = np.zeros((self.device.groups.shape[1], 3 * len(self.sensor_places)))
        field = np.empty((len(self.sensor_places), 3))
        for number, loops in enumerate(self.turns):
            frame = rotation_to_axis(self.coil_axes[number])
            _fill_loops(loops, np.ascontiguousarray((self.sensor_places - self.coil_places[number]) @ frame), field)
            out += np.outer(self.device.groups[number], (field @ frame.T).ravel())
        return out


@kernel
def _fill_loops(loops: Array, points: Array, out: Array) -> None:
    """out (k, 3) [T/A] of loops (3, f) of one coil at `points` (k, 3), in the coil's frame."""
    for k in range(points.shape[0]):
        rho, over, axial = np.sqrt(points[k, 0] ** 2 + points[k, 1] ** 2), 0.0, 0.0
        for f in range(loops.shape[1]):
            a, b = loop_field(loops[0, f], rho, points[k, 2] - loops[1, f])
            over += MU0 * loops[2, f] * a
            axial += MU0 * loops[2, f] * b
        out[k, 0], out[k, 1], out[k, 2] = over * points[k, 0], over * points[k, 1], axial


def _across(axes: Array, toward: Array) -> Array:
    """(n, 3) component of `axes` perpendicular to the unit vectors `toward`, relative to that along them."""
    lean: Array = axes / (axes * toward).sum(axis=1, keepdims=True) - toward
    return lean


def draw_motor(device: SphericalMotor, specimen: int = 0, placement: Array | None = None) -> MotorSpecimen:
    """Draw specimen number `specimen` of the motors within the tolerances of `device`; reproducible.

    placement (k, 3) [m]: displacement of the field sensors, from `draw_sensors`.

    Every value is uniform within √3 times its standard deviation of [tolerance] or [uncertainty]. If these reduce the
    gap between coils and magnets below six tenths, all positions and edges are scaled towards the file's, because a
    builder would not leave parts that touch. Without tolerances (`device.tolerance` is None) it is exactly the file's.
    GeometryError for a motor without a gap.
    """
    known, tolerance = device.uncertainty, device.tolerance
    magnets, coils, coil = device.magnets, device.electromagnets, device.electromagnet
    places = device.sensor_layout.positions + (0.0 if placement is None else placement)
    nominal = _Region(
        coil.inner_radius, coil.outer_radius, coils.distance - 0.5 * coil.length, coils.distance + 0.5 * coil.length
    )
    gap = _find_gap(device.magnet, magnets.distance, nominal)
    tilt_torque, least = np.zeros(1), 0.0
    if device.regulator is not None:
        tilt_torque, least = _expand_regulator(device.regulator)
    if tolerance is None:
        return MotorSpecimen(
            device, magnets.positions, magnets.directions, np.array(device.polarity, dtype=np.float64),
            coils.positions, coils.directions, (np.stack(coil.filaments(*_WINDING_LOOPS)),) * len(coils),
            places, _add_weight(tilt_torque, device.weight_torque), least, nominal,
        )  # fmt: skip
    draw = np.random.Generator(np.random.PCG64([crc32(device.digest.encode()), specimen, 0x5]))

    def spread(standard: float, *shape: int) -> Array:
        drawn: Array = standard * np.sqrt(3.0) * draw.uniform(-1.0, 1.0, shape)
        return drawn

    count, windings = len(magnets), len(coils)
    axial = np.sqrt(3.0) * (tolerance.position + 0.5 * tolerance.winding)
    radial = np.sqrt(3.0) * tolerance.winding
    taken = float(np.hypot(axial, radial)) + np.sqrt(3.0) * tolerance.magnet_position
    closer = min(1.0, _MAX_SHARE_OF_GAP * gap / max(taken, 1e-12))
    region = _Region(
        nominal.inner - closer * radial, nominal.outer + closer * radial, nominal.low - closer * axial,
        nominal.high + closer * axial,
    )  # fmt: skip
    strength = (1.0 + float(spread(known.polarization))) * (1.0 + spread(known.polarization_spread, count))
    magnet_shift = closer * spread(tolerance.magnet_position, count, 3)
    magnet_lean = spread(tolerance.magnet_tilt, count, 3)
    shift, lean = closer * spread(tolerance.position, windings, 3), spread(tolerance.tilt, windings, 3)
    edges = closer * spread(tolerance.winding, windings, 3)
    regulator, weight = 1.0 + float(spread(known.regulator)), 1.0 + float(spread(known.weight))
    layers = [_wind_layers(device, coil, edge, tolerance.turns_per_layer, draw) for edge in edges]
    return MotorSpecimen(
        device, magnets.positions + magnet_shift, _tilt(magnets.directions, magnet_lean), device.polarity * strength,
        _keep_radial(coils.positions + shift, coils.distance, closer * np.sqrt(3.0) * tolerance.position),
        _tilt(coils.directions, lean), tuple(layers), places,
        _add_weight(regulator * tilt_torque, weight * device.weight_torque), least, region,
    )  # fmt: skip


def _add_weight(regulator: Array, weight: float) -> Array:
    total = regulator.copy()
    total[0] -= weight
    return total


def _keep_radial(places: Array, distance: float, most: float) -> Array:
    """Clip the distance of `places` (n, 3) from the centre to `distance` ± `most` [m]."""
    out = np.linalg.norm(places, axis=1, keepdims=True)
    kept: Array = places * np.clip(out, distance - most, distance + most) / out
    return kept


def _tilt(axes: Array, lean: Array) -> Array:
    """Rotate `axes` (n, 3) by `lean` (n, 3) [rad]; a rotation about the axis itself has no effect."""
    turned = axes + np.cross(lean, axes)
    tilted: Array = turned / np.linalg.norm(turned, axis=1, keepdims=True)
    return tilted


def _wind_layers(
    device: SphericalMotor, coil: Coil, edges: Array, per_layer: float, draw: np.random.Generator
) -> Array:
    """Loops (3, f) of one coil: radii and heights over its middle [m], turns of each loop.

    edges (3,): excess of inner radius, outer radius and length [m]. A layer has up to √3 `per_layer` turns more or less
    than nominal, because its ends are arbitrary. The turns of a layer are spread over the length.
    """
    in_series = float(np.abs(device.groups).sum(axis=0)[0])
    copper = wire_diameter(coil, float(device.coils.resistance[0]) / in_series, device.coils.copper_resistivity)
    made = wind(coil.turns, coil.inner_radius, coil.length, overall_diameter(copper))
    full, layers = (coil.turns, 1) if made is None else (float(made.per_layer), made.layers)
    counts = np.full(layers, full)
    counts[-1] = coil.turns - full * (layers - 1)
    counts = np.maximum(counts + np.sqrt(3.0) * per_layer * draw.uniform(-1.0, 1.0, layers), 0.0)
    inner, outer = coil.inner_radius + edges[0], coil.outer_radius + edges[1]
    length = coil.length + edges[2]
    radii = inner + (outer - inner) * (np.arange(layers) + 0.5) / layers
    many = max(int(np.ceil(full)), 1)
    heights = length * ((np.arange(many) + 0.5) / many - 0.5)
    return np.stack([np.repeat(radii, many), np.tile(heights, layers), np.repeat(counts / many, many)])
