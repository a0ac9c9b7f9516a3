"""A ball-joint-like spherical motor: magnets around coils around one centre, as in Bai 2012, and its relatives."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar, final

import numpy as np

from haptorb.devices.device import Device
from haptorb.devices.field_sensors import FieldSensors
from haptorb.devices.kind import DeviceKind
from haptorb.devices.motor.handle import EndStop, Grasp
from haptorb.devices.motor.kind import MOTOR
from haptorb.devices.motor.layouts import Layout
from haptorb.devices.motor.models import (
    coils_field,
    dipole_field,
    dipole_torque,
    exact_field,
    exact_torque,
    multipole_field,
    multipole_torque,
)
from haptorb.devices.motor.regulator import Regulator, torque_over_sine
from haptorb.devices.motor.tables import MotorTables, motor_tables
from haptorb.devices.schema.limit_checks import list_limit_remarks
from haptorb.devices.state import State
from haptorb.devices.uncertainty.motor import MotorUncertainty
from haptorb.devices.wrench_map import WrenchMap
from haptorb.numerics.arrays import Array
from haptorb.numerics.rotations import rotation_from_euler
from haptorb.physics.sources.coil import Coil
from haptorb.physics.sources.cylinder import CylinderMagnet

if TYPE_CHECKING:
    from haptorb.physics.sources.multipole import MultipoleSource


__all__ = ["Rotor", "SphericalMotor"]

GRAVITY = 9.80665  #: standard gravity, along −Z of the stator [m/s²]


@dataclass(frozen=True)
class Rotor:
    """The moving part on its ball bearing: an inverted pendulum with a handle along +z."""

    mass: float  #: [kg]
    inertia: Array  #: (3,) principal moments about the motor's centre, rotor frame [kg·m²]
    centre_of_mass: float  #: height above the motor's centre along the rotor's z [m]
    viscous_friction: float  #: of the bearing [N·m·s/rad]
    dry_friction: float  #: of the bearing, opposed to the turning [N·m]
    handle_length: float  #: from the motor's centre to where the hand holds it [m]


@final
@dataclass(frozen=True, kw_only=True)
class SphericalMotor(Device):
    """Round magnets on a rotor, round air-cored coils and field sensors on a stator, all axes through one centre.

    The channels are the groups of coils that are wired in series; `groups` says how. Models: "table" looks the exact
    one up (servo speed), "exact" integrates the magnets' closed-form fields over the windings, "published" is the
    distributed multipole model of Bai 2012 eqs. 7–9, corrected, "dipole" its far field.
    """

    kind: ClassVar[DeviceKind] = MOTOR

    magnets: Layout  #: in the rotor's frame
    polarity: Array  #: (p,) +1 where a magnet is polarized outward, −1 inward (other values scale its strength)
    magnet: CylinderMagnet  #: one of them, polarized along its +z, which points outward
    electromagnets: Layout  #: in the stator's frame
    electromagnet: Coil  #: one of them; positive current is right-handed about the outward axis
    sensor_layout: Layout  #: in the stator's frame
    hall: FieldSensors
    groups: Array  #: (24, m) current of every coil per current of every channel: 0, +1 or −1
    magnet_model: MultipoleSource | None  #: the published model of one magnet
    coil_model: MultipoleSource | None  #: the published model of one coil, per ampere
    workspace_tilt: float  #: greatest |ψ| and |λ| [rad]
    end_stop: EndStop  #: at its edge
    thermometer_step: float  #: [K]
    thermometer_noise: float  #: [K]
    hand: Grasp  #: who holds the handle
    rotor: Rotor
    regulator: Regulator | None
    uncertainty: MotorUncertainty = field(default_factory=MotorUncertainty)  #: how well the values are known
    findings: tuple[str, ...] = ()  #: what validation objected to, where it was overridden

    models: tuple[str, ...] = ("table", "exact", "published", "dipole")

    @property
    def sensors(self) -> int:
        """Number of three-axis field sensors."""
        return len(self.sensor_layout)

    @cached_property
    def tables(self) -> MotorTables:
        """Torque and field of one pair of parts; built at first use (seconds), afterwards read from the cache."""
        return motor_tables(self)

    def torque_characteristic(self, R: Array, model: str) -> Array:
        """(n, 3, coils) torque on the rotor per ampere in every single coil [N·m/A], for R (n, 3, 3)."""
        match self.check_model(model):
            case "table":
                return self.tables.torque(self, R)
            case "exact":
                return exact_torque(self, R)
            case "published":
                return multipole_torque(self, R)
            case _:
                return dipole_torque(self, R)

    def sensor_field(self, R: Array, model: str) -> Array:
        """(n, sensors, 3) flux density of the magnets at the sensors [T], stator frame, for R (n, 3, 3)."""
        match self.check_model(model):
            case "table":
                return self.tables.field(self, R)
            case "exact":
                return exact_field(self, R, self.sensor_layout.positions)
            case "published":
                return multipole_field(self, R, self.sensor_layout.positions)
            case _:
                return dipole_field(self, R, self.sensor_layout.positions)

    def coil_field(self, points: Array, currents: Array) -> Array:
        """(p, 3) flux density of the coils [T] at `points` (p, 3) [m] with `currents` (m,) [A] in the channels."""
        return coils_field(self, points, self.groups @ currents)

    @cached_property
    def sensor_field_per_ampere(self) -> Array:
        """(m, 3 sensors) what one ampere in each channel adds to every sensor's reading [T/A], stator frame."""
        places = self.sensor_layout.positions
        return np.stack([self.coil_field(places, one).ravel() for one in np.eye(self.channels)])

    def field(self, R: Array, points: Array) -> Array:
        """(n, p, 3) flux density of the rotor's magnets [T] at `points` (p, 3) [m], stator frame, exact model."""
        return exact_field(self, R, points)

    def wrench_map(self, state: State, model: str) -> WrenchMap:
        """(6, m) per channel: torque only, as the bearing carries every force; passive: regulator and gravity."""
        matrix = np.zeros((6, self.channels))
        matrix[3:] = self.torque_characteristic(state.R_SR[None], model)[0] @ self.groups
        return WrenchMap(matrix, self.passive(state.R_SR))

    @cached_property
    def greatest_torque(self) -> float:
        """Greatest torque about one of the stator's axes, all channels at full current [N·m], by the dipole model.

        Within the workspace; the dipole model is good for a comparison of sizes only.
        """
        tilts = np.array([-1.0, 0.0, 1.0]) * self.workspace_tilt
        psi, lam, phi = np.meshgrid(tilts, tilts, np.radians(np.arange(0, 360, 7.5)), indexing="ij")
        R = rotation_from_euler(psi.ravel(), lam.ravel(), phi.ravel())
        per_channel = self.torque_characteristic(R, "dipole") @ self.groups
        return float((np.abs(per_channel) @ self.driven_current).max())

    @property
    def remarks(self) -> tuple[str, ...]:
        """What should be known of this device though it can be computed with; the bearing carries every force."""
        if self.findings:
            return ()  # a motor whose coils cancel has no torque to compare with
        return tuple(list_limit_remarks(self.coils, self.supply, self.limits, 0.0, self.greatest_torque))

    def _list_facts(self) -> list[tuple[str, str]]:
        head, tail = Device._list_facts(self)[:2], Device._list_facts(self)[2:]
        coils = f"{len(self.electromagnets)} coils in {self.channels} channels"
        return [
            *head,
            ("workspace", f"tilts up to {np.degrees(self.workspace_tilt):.0f}°, any spin"),
            ("magnetics", f"{len(self.magnets)} magnets on the rotor, {coils}"),
            ("rotor", f"{self.rotor.mass:.3g} kg, handle of {1e3 * self.rotor.handle_length:.0f} mm"),
            *(("remark", remark) for remark in self.remarks),
            *((f"finding {n}", text) for n, text in enumerate(self.findings, 1)),
            *tail,
        ]

    @property
    def weight_torque(self) -> float:
        """What the rotor's weight does over sin(tilt) [N·m]: (h ẑ_R) × (−m g Ẑ); positive where it tips the rotor."""
        return self.rotor.mass * GRAVITY * self.rotor.centre_of_mass

    @cached_property
    def tilt_torque(self) -> tuple[Array, float]:
        """(n,) coefficients of what weight and regulator do [N·m], and the least cosine, as
        `regulator.torque_over_sine` takes them: torque over sin(tilt), positive where it turns the rotor upright."""
        weight = self.weight_torque
        if self.regulator is None:
            return np.array([-weight]), 0.0
        series, least = self.regulator.series
        return series - weight * np.eye(1, len(series))[0], least

    def passive(self, R_SR: Array) -> Array:
        """(6,) torque on the rotor at zero current: its weight, and the regulator that holds it up [N·m]."""
        wrench = np.zeros(6)
        axis = R_SR[:, 2]
        back = torque_over_sine(float(axis[2]), *self.tilt_torque)
        wrench[3] = back * axis[1]  # back · ẑ_R × Ẑ
        wrench[4] = -back * axis[0]
        return wrench
