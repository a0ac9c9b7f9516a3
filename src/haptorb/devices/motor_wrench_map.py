"""Torque per ampere and field of a spherical motor: exact, by multipoles, by dipoles, and from tables.

All take orientations R (n, 3, 3) and give torque on the rotor about the centre, per ampere in every single coil,
(n, 3, m) [N·m/A], stator frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from haptorb.arrays import Array
from haptorb.compiled import kernel
from haptorb.devices import tables
from haptorb.devices.motor_layout import Layout
from haptorb.devices.table_cache import load_field_table, load_torque_table
from haptorb.devices.tables import PairTable, Progress
from haptorb.errors import DeviceError, PrecisionError
from haptorb.magnetics import dipole
from haptorb.magnetics.coil import Coil
from haptorb.magnetics.dipole import MU0_OVER_4PI
from haptorb.magnetics.magnets import CylinderMagnet
from haptorb.magnetics.multipole import MultipoleSource
from haptorb.magnetics.source import Source

__all__ = [
    "MotorParts",
    "MotorTables",
    "coils_field",
    "dipole_field",
    "dipole_torque",
    "exact_field",
    "exact_torque",
    "motor_tables",
    "multipole_field",
    "multipole_torque",
]


#: Gauss points across and along the winding, and steps around it
_REFINEMENTS = ((4, 3, 54), (6, 4, 72), (8, 5, 90), (10, 6, 108), (13, 8, 140), (17, 10, 180), (24, 14, 250))
_TOGETHER = 60  #: orientations whose pairs of parts fit into a processor's cache
PRECISION = 1e-7  #: of the exact model, relative to the greatest torque of any coil


def exact_field(motor: MotorParts, R: Array, points: Array) -> Array:
    """(n, p, 3) flux density of all magnets [T] at `points` (p, 3) [m], stator frame: closed form, summed."""
    return _sum_field(motor, motor.magnet, R, points)


def multipole_field(motor: MotorParts, R: Array, points: Array) -> Array:
    """The same by the published model, Bai 2012 eq. (8). (n, p, 3) [T]."""
    return _sum_field(motor, _models(motor)[0], R, points)


def _sum_field(motor: MotorParts, magnet: Source, R: Array, points: Array) -> Array:
    out = np.empty((len(R), len(points), 3))
    frames, places = motor.magnets.frames, motor.magnets.positions
    for number, turn in enumerate(R):
        in_rotor = points @ turn
        own = (in_rotor[None] - places[:, None]) @ frames  # every magnet's own frame
        field = magnet.field(own) @ np.swapaxes(frames, 1, 2)
        out[number] = np.tensordot(motor.polarity, field, 1) @ turn.T
    return out


def dipole_field(motor: MotorParts, R: Array, points: Array) -> Array:
    """The same with every magnet as a point moment. (n, p, 3) [T]."""
    u = np.einsum("nab,ib->nia", R, motor.magnets.directions)[:, :, None]
    moment = u * (motor.polarity[:, None, None] * motor.magnet.moment[2])
    out: Array = dipole.field(moment, points - motor.magnets.distance * u).sum(axis=1)
    return out


def coils_field(motor: MotorParts, points: Array, currents: Array) -> Array:
    """(p, 3) flux density of all coils [T] at `points` (p, 3) [m] with `currents` (coils,) [A]."""
    frames = motor.electromagnets.frames
    own = (points[None] - motor.electromagnets.positions[:, None]) @ frames
    field = motor.electromagnet.field(own) @ np.swapaxes(frames, 1, 2)
    out: Array = np.tensordot(currents, field, 1)
    return out


def exact_torque(motor: MotorParts, R: Array, precision: float = PRECISION) -> Array:
    """(n, 3, coils) [N·m/A]: the magnets' field integrated over every coil's filaments, refined until two levels agree
    to `precision`.

    Raises PrecisionError, which states the best precision reached.
    """
    last = _integrate(motor, R, _REFINEMENTS[0])
    best = np.inf
    for level in _REFINEMENTS[1:]:
        value = _integrate(motor, R, level)
        best = float(np.abs(value - last).max() / max(np.abs(value).max(), 1e-300))
        if best <= precision:
            return value
        last = value
    raise PrecisionError(f"the torque converged to {best:.1e} relative, not to {precision:.1e}; request less")


def _integrate(motor: MotorParts, R: Array, level: tuple[int, int, int]) -> Array:
    radii, heights, turns = motor.electromagnet.filaments(level[0], level[1])
    angle = 2 * np.pi * (np.arange(level[2]) + 0.5) / level[2]
    cosine, sine = np.cos(angle), np.sin(angle)
    rim = np.stack(
        [np.outer(radii, cosine), np.outer(radii, sine), np.repeat(heights[:, None], level[2], 1)], axis=-1
    ).reshape(-1, 3)
    step = (2 * np.pi / level[2]) * radii * turns
    element = np.stack([-np.outer(step, sine), np.outer(step, cosine), np.zeros((len(radii), level[2]))], axis=-1)
    frames = motor.electromagnets.frames
    points = np.einsum("jab,pb->jpa", frames, rim) + motor.electromagnets.positions[:, None]
    elements = np.einsum("jab,pb->jpa", frames, element.reshape(-1, 3))
    field = exact_field(motor, R, points.reshape(-1, 3)).reshape(len(R), *points.shape)
    on_coils: Array = np.cross(points, np.cross(elements, field)).sum(axis=2)
    return -np.swapaxes(on_coils, 1, 2)  # third law: the rotor feels the opposite


def dipole_torque(motor: MotorParts, R: Array) -> Array:
    """Every magnet and every coil as one point moment at its centre. (n, 3, coils) [N·m/A].

    All moments point along the radius, so the energy W of a magnet at a û and a coil at b ĉ depends on s = û·ĉ only
    (Jackson, Classical Electrodynamics, section 5.7), and the torque on the rotor is −W′(s) û × ĉ. The sum over the
    magnets is taken before the product. Needs no compiled code: a device file is checked by it.
    """
    c = motor.electromagnets.directions
    a, b = motor.magnets.distance, motor.electromagnets.distance
    strength = MU0_OVER_4PI * motor.magnet.moment[2] * motor.electromagnet.moment[2] * motor.polarity
    out = np.empty((len(R), 3, len(c)))
    for first in range(0, len(R), _TOGETHER):
        part = slice(first, first + _TOGETHER)
        u = np.einsum("nab,ib->nia", R[part], motor.magnets.directions)
        s = u @ c.T
        per_square = 1.0 / (a * a + b * b - 2 * a * b * s)
        steep = -2 + 3 * a * b * per_square * (s - 5 * (b * s - a) * (b - a * s) * per_square)
        steep *= per_square * np.sqrt(per_square) * strength[:, None]
        pull = np.swapaxes(steep, 1, 2) @ u  # (n, coils, 3): Σ W′ û
        out[part] = np.swapaxes(np.cross(c, pull), 1, 2)
    return out


def multipole_torque(motor: MotorParts, R: Array) -> Array:
    """The published model, Bai 2012 eq. (9) with signs and arms put right (erratum E5)."""
    magnet_model, coil_model = _models(motor)
    poles, strength = magnet_model.poles, magnet_model.strengths
    rotor = np.einsum("iab,pb->ipa", motor.magnets.frames, poles) + motor.magnets.positions[:, None]
    charge = np.outer(motor.polarity, strength).ravel()
    coil = coil_model.poles
    stator = np.einsum("jab,pb->jpa", motor.electromagnets.frames, coil) + motor.electromagnets.positions[:, None]
    out = np.empty((len(R), 3, len(stator)))
    for number, turn in enumerate(R):
        turned = np.ascontiguousarray(rotor.reshape(-1, 3) @ turn.T)
        _pole_torque(turned, charge, np.ascontiguousarray(stator), coil_model.strengths, out[number])
    return out


def _models(motor: MotorParts) -> tuple[MultipoleSource, MultipoleSource]:
    if motor.magnet_model is None or motor.coil_model is None:
        raise DeviceError(
            f"device '{motor.name}': model 'published' needs [magnets.multipole] and [electromagnets.multipole]"
        )
    return motor.magnet_model, motor.coil_model


@kernel
def _pole_torque(rotor: Array, charge: Array, stator: Array, strength: Array, out: Array) -> None:
    """out (3, m) = μ0/4π Σ_r Σ_s q_r q_s R_r × (R_r − R_s)/|R_r − R_s|³: eq. (9) with sources +, sinks − as charges."""
    for j in range(stator.shape[0]):
        tx, ty, tz = 0.0, 0.0, 0.0
        for r in range(rotor.shape[0]):
            x, y, z = rotor[r, 0], rotor[r, 1], rotor[r, 2]
            fx, fy, fz = 0.0, 0.0, 0.0
            for s in range(stator.shape[1]):
                dx, dy, dz = x - stator[j, s, 0], y - stator[j, s, 1], z - stator[j, s, 2]
                d2 = dx * dx + dy * dy + dz * dz
                q = strength[s] / (d2 * np.sqrt(d2))
                fx += q * dx
                fy += q * dy
                fz += q * dz
            q = charge[r]
            tx += q * (y * fz - z * fy)
            ty += q * (z * fx - x * fz)
            tz += q * (x * fy - y * fx)
        out[0, j] = MU0_OVER_4PI * tx
        out[1, j] = MU0_OVER_4PI * ty
        out[2, j] = MU0_OVER_4PI * tz


# --------------------------------------------------------------------------------------------------
# The parts of a spherical motor that make field and torque, as every model takes them.


class MotorParts(Protocol):
    """Round magnets on a rotor, round coils and field sensors on a stator, all axes through one centre."""

    @property
    def name(self) -> str:
        """Of the device."""

    @property
    def magnets(self) -> Layout:
        """Positions of the magnets, rotor frame."""

    @property
    def polarity(self) -> Array:
        """(p,) [1]: +1 where a magnet is polarized outward, −1 inward (other values scale its strength)."""

    @property
    def magnet(self) -> CylinderMagnet:
        """One of them, polarized along its +z, which points outward."""

    @property
    def electromagnets(self) -> Layout:
        """Positions of the coils, stator frame."""

    @property
    def electromagnet(self) -> Coil:
        """One of them; positive current is right-handed about the outward axis."""

    @property
    def sensor_layout(self) -> Layout:
        """Positions of the field sensors, stator frame."""

    @property
    def magnet_model(self) -> MultipoleSource | None:
        """The published model of one magnet."""

    @property
    def coil_model(self) -> MultipoleSource | None:
        """The published model of one coil, per ampere."""


# --------------------------------------------------------------------------------------------------
# The pair tables of one spherical motor, and the device's torque and field looked up in them.


@dataclass(frozen=True)
class MotorTables:
    """k(u·c) of one magnet and one coil, and f(u·s), g(u·s) of one magnet and one sensor."""

    torque_pair: PairTable
    field_pair: PairTable

    def torque(self, motor: MotorParts, R: Array) -> Array:
        """(n, 3, coils) torque on the rotor per ampere in every coil [N·m/A], for R (n, 3, 3)."""
        coils = motor.electromagnets.directions
        out = np.empty((len(R), 3, len(coils)))
        table = self.torque_pair
        tables.torque_characteristic(
            table.cells, table.scale, motor.magnets.directions, motor.polarity, coils, np.ascontiguousarray(R), out
        )
        return out

    def field(self, motor: MotorParts, R: Array) -> Array:
        """(n, sensors, 3) flux density at the sensors [T], stator frame, for R (n, 3, 3)."""
        sensors = motor.sensor_layout.directions
        out = np.empty((len(R), len(sensors), 3))
        table = self.field_pair
        tables.sensor_field(
            table.cells, table.scale, motor.magnets.directions, motor.polarity, sensors, np.ascontiguousarray(R), out
        )
        return out


def motor_tables(motor: MotorParts, progress: Progress | None = None) -> MotorTables:
    """Built from the exact model, or read from the cache; PrecisionError if the parts are too close for a table."""
    magnet, out = motor.magnet, motor.magnets.distance
    return MotorTables(
        load_torque_table(magnet, out, motor.electromagnet, motor.electromagnets.distance, progress=progress),
        load_field_table(magnet, out, motor.sensor_layout.distance, progress=progress),
    )
