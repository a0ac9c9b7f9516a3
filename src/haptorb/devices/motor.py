"""Spherical motor with a ball joint: magnets and coils around one centre, as in Bai 2012, and variants."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from dataclasses import field as dataclasses_field
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar, final

import numpy as np

from haptorb.arrays import Array
from haptorb.devices.base import Device, DeviceKind, State, WrenchMap
from haptorb.devices.build_checks import BuildCheck, check_wire, format_bound
from haptorb.devices.field_sensors import FieldSensors
from haptorb.devices.geometry import Geometry, Reach, Rod, RoundPart, Spot, list_assumed
from haptorb.devices.magnet_grades import ANY_MAGNET, MagnetUse, charge_field, check_magnet, coil_field
from haptorb.devices.motor_layout import Layout
from haptorb.devices.motor_wrench_map import (
    MotorTables,
    coils_field,
    dipole_field,
    dipole_torque,
    exact_field,
    exact_torque,
    motor_tables,
    multipole_field,
    multipole_torque,
)
from haptorb.devices.schema import list_limit_remarks
from haptorb.devices.tables import Progress
from haptorb.devices.turning_clearance import AxialBody, TiltedAxis, find_clearance, tilted_axes
from haptorb.devices.uncertainty import MotorTolerance, MotorUncertainty
from haptorb.devices.weight_regulator import Regulator, torque_over_sine
from haptorb.errors import GeometryError, InputError
from haptorb.magnetics.coil import Coil
from haptorb.magnetics.magnets import ChargedRing, CylinderMagnet, RingMagnet
from haptorb.magnetics.wire import overall_diameter, wire_diameter
from haptorb.rotations import rotation_from_euler

if TYPE_CHECKING:
    from haptorb.magnetics.multipole import MultipoleSource
from haptorb.devices.motor_wiring import list_not_facing

__all__ = [
    "HANDLE_LOOSE",
    "MOTOR",
    "WORST_CONDITION",
    "EndStop",
    "Grasp",
    "Rotor",
    "SphericalMotor",
    "check_magnets",
    "check_places",
    "check_range",
    "findings",
    "measure_ring_pull",
    "motor_geometry",
    "workspace_sample",
]


# --------------------------------------------------------------------------------------------------
# The record of spherical motors: a rotor with a handle, whose torque moves an object through two modes.


MOTOR = DeviceKind(
    name="spherical-motor",
    title="spherical motor",
    world="outlet",
    modes=("translate", "rotate"),
    contacts=2,
)


# --------------------------------------------------------------------------------------------------
# Surroundings of a motor's rotor: the hand on its handle, and the stop at its edge.


@dataclass(frozen=True)
class Grasp:
    """A hand on the handle as mass, spring and damper where it holds, towards where it wants the handle to be.

    One stiffness for tilt and spin, so that the spring has a potential. From a pen held lightly (0.1 kg, 2 N·s/m,
    100 N/m) to a firm grip (0.8 kg, 10 N·s/m, 500 N/m).
    """

    mass: float  #: that moves with the handle [kg]
    stiffness: float  #: [N/m]
    damping: float  #: [N·s/m]
    radius: float  #: of the fist: its inertia about the handle is ½ m r² [m]

    def __post_init__(self) -> None:
        for name in ("mass", "stiffness", "damping", "radius"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise InputError(f"Grasp.{name} must not be negative; got {value!r}")


HANDLE_LOOSE = Grasp(0.0, 0.0, 0.0, 0.0)  #: no hand at all


@dataclass(frozen=True)
class EndStop:
    """Rubber at the edge of the workspace."""

    stiffness: float  #: [N·m/rad]
    damping: float  #: [N·m·s/rad]


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
    """Magnets on a rotor, air-cored coils and field sensors on a stator, all axes through one centre (Bai 2012).

    Built from a device file of the kind "spherical-motor". The channels are groups of coils that are wired in series.
    Parameters beside those of `haptorb.Device`:

    Parameters
    ----------
    magnets : Layout
        Places and axes of the p magnets, in the rotor's frame.
    polarity : ndarray, shape (p,)
        +1: polarised outward, −1: inward [1]; other values scale the strength.
    magnet : CylinderMagnet
        One magnet, polarised along its +z, which points outward.
    electromagnets : Layout
        Places and axes of the coils, in the stator's frame.
    electromagnet : Coil
        One coil; a positive current is right-handed about the outward axis.
    sensor_layout : Layout
        Places and axes of the field sensors, in the stator's frame.
    hall : FieldSensors
        Errors and noise of the field sensors.
    groups : ndarray, shape (24, m)
        Current of every coil per current of every channel: 0, +1 or −1 [1].
    magnet_model : MultipoleSource or None
        Published model of one magnet.
    coil_model : MultipoleSource or None
        Published model of one coil, per ampere.
    workspace_tilt : float
        Greatest |ψ| and |λ| [rad].
    end_stop : EndStop
        Stop at the edge of the workspace.
    thermometer_step : float
        Resolution of the thermometers [K].
    thermometer_noise : float
        Standard deviation of one temperature reading [K].
    hand : Grasp
        Simulated hand that holds the handle.
    rotor : Rotor
        Inertia and friction of the rotor.
    regulator : Regulator or None
        Pair of ring magnets that turns the rotor upright without current.
    uncertainty : MotorUncertainty
        Standard uncertainties of the values, for the error budget.
    findings : tuple of str
        Objections of the validation that were overridden.
    magnet_use : MagnetUse
        Grade and greatest temperature of the magnets.
    tolerance : MotorTolerance or None
        Standard deviations of what is built, for simulation and error budget; None: exactly the file's values.

    Notes
    -----
    Model "table": "exact" interpolated, at servo speed; "exact": the magnets' closed-form fields integrated over the
    windings; "published": the distributed multipole model of Bai 2012 eqs. (7)–(9), corrected; "dipole": its far field.
    """

    kind: ClassVar[DeviceKind] = MOTOR

    magnets: Layout
    polarity: Array
    magnet: CylinderMagnet
    electromagnets: Layout
    electromagnet: Coil
    sensor_layout: Layout
    hall: FieldSensors
    groups: Array
    magnet_model: MultipoleSource | None
    coil_model: MultipoleSource | None
    workspace_tilt: float
    end_stop: EndStop
    thermometer_step: float
    thermometer_noise: float
    hand: Grasp
    rotor: Rotor
    regulator: Regulator | None
    uncertainty: MotorUncertainty = dataclasses_field(default_factory=lambda: MotorUncertainty.model_validate({}))
    findings: tuple[str, ...] = ()
    magnet_use: MagnetUse = ANY_MAGNET
    tolerance: MotorTolerance | None = dataclasses_field(default_factory=lambda: MotorTolerance.model_validate({}))

    models: tuple[str, ...] = ("table", "exact", "published", "dipole")

    @property
    def sensors(self) -> int:
        """Number of three-axis field sensors."""
        return len(self.sensor_layout)

    @cached_property
    def tables(self) -> MotorTables:
        """Torque and field of one pair of parts; built at first use (seconds), afterwards read from the cache."""
        return motor_tables(self)

    @property
    def is_prepared(self) -> bool:
        """Whether the tables are there."""
        return "tables" in vars(self)

    def prepare(self, report: Progress | None = None) -> None:
        """Compute the tables, or read them from the cache."""
        if not self.is_prepared:
            vars(self)["tables"] = motor_tables(self, report)

    def geometry(self) -> Geometry:
        """The parts of the device, its rotor upright and without spin."""
        return motor_geometry(self)

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
        """(m, 3 sensors) field of one ampere in each channel at every sensor [T/A], stator frame."""
        places = self.sensor_layout.positions
        return np.stack([self.coil_field(places, one).ravel() for one in np.eye(self.channels)])

    def field(self, R: Array, points: Array) -> Array:
        """(n, p, 3) flux density of the rotor's magnets [T] at `points` (p, 3) [m], stator frame, exact model."""
        return exact_field(self, R, points)

    @property
    def build_checks(self) -> tuple[BuildCheck, ...]:
        """Buildability checks of this device: wire in its section, and parts that move without collision."""
        coil, coils = self.electromagnet, self.coils
        in_series = float(np.abs(self.groups).sum(axis=0)[0])
        copper = wire_diameter(coil, float(coils.resistance[0]) / in_series, coils.copper_resistivity)
        origin = ", the wire that gives its resistance"
        wire = check_wire("electromagnets", coil, copper, overall_diameter(copper), origin)[0]
        return (*super().build_checks, wire, *check_places(self), *check_magnets(self), *check_range(self))

    def wrench_map(self, state: State, model: str) -> WrenchMap:
        """(6, m) per channel: torque only, as the bearing carries every force; passive: regulator and gravity."""
        matrix = np.zeros((6, self.channels))
        matrix[3:] = self.torque_characteristic(state.R_SR[None], model)[0] @ self.groups
        return WrenchMap(matrix, self.passive(state.R_SR), self.coils.names)

    @cached_property
    def greatest_torque(self) -> float:
        """Maximum torque about one of the stator's axes, all channels at full current [N·m], by the dipole model.

        Within the workspace; the dipole model is good for a comparison of sizes only.
        """
        tilts = np.array([-1.0, 0.0, 1.0]) * self.workspace_tilt
        psi, lam, phi = np.meshgrid(tilts, tilts, np.radians(np.arange(0, 360, 7.5)), indexing="ij")
        R = rotation_from_euler(psi.ravel(), lam.ravel(), phi.ravel())
        per_channel = self.torque_characteristic(R, "dipole") @ self.groups
        return float((np.abs(per_channel) @ self.driven_current).max())

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks on inconsistent values of this device, which prevent no computation."""
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
        """Torque of the rotor's weight over sin(tilt) [N·m]: (h ẑ_R) × (−m g Ẑ); positive where it tips the rotor."""
        return self.rotor.mass * GRAVITY * self.rotor.centre_of_mass

    @cached_property
    def tilt_torque(self) -> tuple[Array, float]:
        """(n,) coefficients of the torque of weight and regulator [N·m], and the minimum cosine, for
        `weight_regulator.torque_over_sine`: torque over sin(tilt), positive where it turns the rotor upright."""
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


# --------------------------------------------------------------------------------------------------
# The bodies of a spherical motor: coils and field sensors of the stator, magnets and handle of the upright rotor.


_SIZES = (
    *("magnets.distance", "magnets.radius", "magnets.length", "magnets.rings", "electromagnets.distance"),
    *("electromagnets.outer_radius", "electromagnets.inner_radius", "electromagnets.length", "electromagnets.rings"),
    *("sensors.distance", "sensors.rings", "rotor.handle_length", "workspace.tilt"),
    *(f"regulator.{side}.{key}" for side in ("stator", "rotor")
      for key in ("outer_radius", "inner_radius", "length", "height")),
)  # fmt: skip


def motor_geometry(device: SphericalMotor) -> Geometry:
    """The parts of `device`, its rotor upright and without spin."""
    handle = device.rotor.handle_length
    return Geometry(
        round_parts=(*_coils(device), *_magnets(device), *_regulator(device)),
        spots=tuple(Spot(f"sensor {n}", "sensor", at) for n, at in enumerate(device.sensor_layout.positions, 1)),
        rods=(Rod("handle", np.zeros(3), np.array([0.0, 0.0, handle])),),
        reach=Reach("end of the handle", device.workspace_tilt, handle, handle),
        notes=(
            "not stated in the device file: the rotor's shell, the bearing, the stator's body, the handle's thickness",
            *list_assumed(device.assumed, _SIZES),
        ),
    )


def _coils(device: SphericalMotor) -> tuple[RoundPart, ...]:
    coil, layout, names = device.electromagnet, device.electromagnets, device.coils.names
    channels = [next((names[m] for m in np.flatnonzero(row)), "") for row in device.groups]
    return tuple(
        RoundPart(
            f"EM{k + 1}", "coil", layout.positions[k], layout.directions[k], float(coil.inner_radius),
            float(coil.outer_radius), float(coil.length), channel=channels[k],
        )
        for k in range(len(layout))
    )  # fmt: skip


def _magnets(device: SphericalMotor) -> tuple[RoundPart, ...]:
    magnet, layout = device.magnet, device.magnets
    return tuple(
        RoundPart(
            f"PM{k + 1}", "magnet", layout.positions[k], layout.directions[k], 0.0, float(magnet.radius),
            float(magnet.length), polarity=float(device.polarity[k]), moves=True,
        )
        for k in range(len(layout))
    )  # fmt: skip


def _regulator(device: SphericalMotor) -> tuple[RoundPart, ...]:
    """The two rings that hold the rotor up: polarized against each other."""
    both = device.regulator
    if both is None:
        return ()
    up = np.array([0.0, 0.0, 1.0])
    rings = (
        ("regulator ring of the stator", both.stator_ring, both.stator_height, 1.0, False),
        ("regulator ring of the rotor", both.rotor_ring, both.rotor_height, -1.0, True),
    )
    return tuple(
        RoundPart(
            name, "ring", height * up, up, float(ring.inner_radius), float(ring.outer_radius), float(ring.length),
            polarity=sign, moves=moves,
        )
        for name, ring, height, sign, moves in rings
    )  # fmt: skip


# --------------------------------------------------------------------------------------------------
# Wiring errors of a spherical motor that no single value of its file reveals.
#
# Findings are sentences: groups that name coils wrongly, pairs that do not face each other, and groups wired so that
# the motor cannot turn about every axis.


WORST_CONDITION = 100.0  #: a motor that is a hundred times weaker about some axis cannot be used there
_CHORDS = 2048  #: steps of a table of the pair's torque between no chord and a diameter


def findings(motor: SphericalMotor, groups: Sequence[Sequence[int]], *, antipodal: bool) -> list[str]:
    """Everything that its wiring has against `motor`, as sentences; an empty list is a pass."""
    found = list_not_facing(motor.electromagnets, groups) if antipodal else []
    return found + _list_weaknesses(motor, groups)


# --------------------------------------------------------------------------------------------------
# Room for a motor's parts: beside each other, and past each other at every tilt of the workspace and any spin.
#
# All parts are round about axes through the centre, so that a distance depends on one angle only (`turning_clearance`).
# What the file does not state is taken as thin as it can be: a handle and a column of 5 mm radius, and chips of 1 mm.


_MIN_GAP_M = 0.5e-3  #: between parts that move past each other [m]
_COLUMN_RADIUS_M = 5e-3  #: radius of a column that carries the stator and its leads [m]
_HANDLE_RADIUS_M = 5e-3  #: radius of the handle, from the bearing at the centre on [m]
_CHIP_HEIGHT_M = 1e-3  #: from a field sensor's centre to the face of its chip, with air [m]


@dataclass(frozen=True)
class _Ring:
    """Parts at one latitude: their body, the angle to the z axis of their side, and those to the other side's z."""

    name: str
    body: AxialBody
    angle: float  #: [rad]
    tilted: TiltedAxis

    @property
    def level(self) -> TiltedAxis:
        """Of their own side's z axis."""
        return TiltedAxis(self.angle, self.angle)


def _list_rings(name: str, layout: Layout, body: AxialBody, tilt: float) -> list[_Ring]:
    axes = tilted_axes(tilt, layout.directions)
    height = np.round(layout.directions[:, 2], 9)
    found = []
    for level in np.unique(height):
        members = [axes[k] for k in np.flatnonzero(height == level)]
        both = TiltedAxis(min(one.low for one in members), max(one.high for one in members))
        angle = float(np.arccos(np.clip(level, -1.0, 1.0)))
        found.append(_Ring(f"{name} at a latitude of {90 - np.degrees(angle):.3g}°", body, angle, both))
    return found


def check_places(motor: SphericalMotor) -> list[BuildCheck]:
    """Check that the parts of `motor` do not overlap, and that the rotor moves without collision at every tilt."""
    coil, magnet, tilt = motor.electromagnet, motor.magnet, motor.workspace_tilt
    coil_body = AxialBody.of_length(motor.electromagnets.distance, float(coil.length), 0.0, float(coil.outer_radius))
    magnet_body = AxialBody.of_length(motor.magnets.distance, magnet.length, 0.0, magnet.radius)
    chip = AxialBody.of_length(motor.sensor_layout.distance, 0.0, 0.0, 0.0)
    coils = _list_rings("the coils", motor.electromagnets, coil_body, tilt)
    sensors = _list_rings("the sensors", motor.sensor_layout, chip, tilt)
    # the magnets' tilted angles are those to the stator's z axis, which the rotor sees tilt likewise
    upright = TiltedAxis(0.0, float(np.arccos(np.cos(tilt) ** 2)))
    magnets = [
        replace(one, tilted=upright.of_part(one.angle))
        for one in _list_rings("the magnets", motor.magnets, magnet_body, tilt)
    ]
    found = [
        _check_neighbours("electromagnets", "outer_radius", "EM", motor.electromagnets, coil_body),
        _check_neighbours("magnets", "radius", "PM", motor.magnets, magnet_body),
        _check_gap(coil_body, magnet_body),
        _check_sensors(motor, sensors, magnets),
    ]
    handle = AxialBody(0.0, motor.rotor.handle_length, 0.0, _HANDLE_RADIUS_M)
    met = [(find_clearance(handle, one.body, one.tilted), one.name) for one in (*coils, *sensors)]
    ring = base = None
    if motor.regulator is not None:
        ring, base = _regulator_bodies(motor.regulator, magnet_body)
        met.append((find_clearance(handle, base, upright), "the regulator's ring on the base"))
    found.append(
        _nearest("handle free to move", "its distance from what stands", met, _MIN_GAP_M,
                 "reduce workspace.tilt, or move the upper rings of parts down")
    )  # fmt: skip
    downward = TiltedAxis(np.pi - upright.high, np.pi)
    column = AxialBody(0.0, 4 * magnet_body.high, 0.0, 0.0)
    room = [
        (find_clearance(column, one.body, TiltedAxis(np.pi - one.angle, np.pi - one.angle)), one.name) for one in coils
    ]
    room += [(find_clearance(column, one.body, downward.of_part(one.angle)), one.name) for one in magnets]
    if ring is not None and base is not None and motor.regulator is not None:
        room.append((find_clearance(column, ring, downward), "the regulator's ring on the rotor"))
        met = [(find_clearance(ring, one.body, one.tilted), one.name) for one in (*coils, *sensors)]
        met.append((find_clearance(ring, base, upright), "the ring on the base, or what carries it"))
        found.append(
            _nearest("regulator's ring on the rotor free to move",
                     "its distance from coils, sensors and the other ring", met, _MIN_GAP_M,
                     "move regulator.rotor away from them, or reduce workspace.tilt")
        )  # fmt: skip
        met = [(find_clearance(base, one.body, one.tilted), one.name) for one in magnets]
        found.append(
            _nearest("magnets free to move", "their distance from the regulator's ring on the base, or what carries it",
                     met, _MIN_GAP_M, "increase regulator.stator.inner_radius, or reduce workspace.tilt")
        )  # fmt: skip
        met = [(find_clearance(ring, one.body, one.level), f"the rotor's ring and {one.name}") for one in magnets]
        met += [
            (find_clearance(base, one.body, one.level), f"the base's ring and {one.name}") for one in (*coils, *sensors)
        ]
        found.append(
            _nearest("regulator's rings beside the parts of their own side", "the least distance", met, 0.0,
                     "move regulator.rotor or regulator.stator away")
        )  # fmt: skip
    if motor.magnets.distance > motor.electromagnets.distance:  # a stator within the rotor stands on a column
        found.append(
            _nearest("room for the column that carries the stator", "its greatest radius", room, _COLUMN_RADIUS_M,
                     "increase regulator.rotor.inner_radius, reduce workspace.tilt, or move the lower rings up")
        )  # fmt: skip
    return found


def _nearest(condition: str, name: str, met: Sequence[tuple[float, str]], limit: float, remedy: str) -> BuildCheck:
    distance, what = min(met)
    return BuildCheck(condition, name, distance, limit, "m", remedy, at_least=True, note=f"{what}; negative: inside")


def _regulator_bodies(regulator: Regulator, magnet: AxialBody) -> tuple[AxialBody, AxialBody]:
    """The ring on the rotor, and that on the base with what carries it: down to below the rotor's reach."""
    own, base = regulator.rotor_ring, regulator.stator_ring
    ring = AxialBody.of_length(regulator.rotor_height, own.length, own.inner_radius, own.outer_radius)
    stands = AxialBody.of_length(regulator.stator_height, base.length, base.inner_radius, base.outer_radius)
    if regulator.stator_height < 0.0:
        reach = max(float(np.hypot(*body.border).max()) for body in (ring, magnet))
        stands = replace(stands, low=min(stands.low, -reach))
    return ring, stands


def _check_neighbours(section: str, key: str, letters: str, layout: Layout, body: AxialBody) -> BuildCheck:
    """Two equal radial cylinders touch where their inner rims meet: on the plane that halves the angle between them."""
    between = np.arccos(np.clip(layout.directions @ layout.directions.T, -1.0, 1.0))
    np.fill_diagonal(between, np.pi)
    near = float(between.min())
    room = max(body.low, 0.0) * float(np.tan(near / 2)) if near < np.pi else np.inf
    span = 2 * np.arctan2(body.outer_radius, body.low) if body.low > 0.0 else 2 * np.pi
    first, second = np.nonzero(np.triu(between < max(span, near + 1e-9), k=1))
    pairs = ", ".join(
        f"{letters}{i + 1} and {letters}{j + 1} at {np.degrees(between[i, j]):.1f}°"
        for i, j in zip(first, second, strict=True)
    )
    through = "the parts reach through the centre; " if body.low <= 0.0 else ""
    return BuildCheck(
        f"{section} beside each other", f"{section}.{key}", body.outer_radius, room, "m",
        f"reduce {section}.{key}, increase {section}.distance, or move the rings apart",
        note=f"{through}each spans {np.degrees(span):.1f}° as seen from the centre; {pairs}",
    )  # fmt: skip


def _check_gap(coil: AxialBody, magnet: AxialBody) -> BuildCheck:
    inner, outer = (coil, magnet) if magnet.low + magnet.high > coil.low + coil.high else (magnet, coil)
    reach = float(np.hypot(inner.high, inner.outer_radius))
    return BuildCheck(
        "gap between rotor and stator", "magnets.distance, electromagnets.distance", outer.low - reach, _MIN_GAP_M, "m",
        "move magnets and coils apart, or make them thinner", at_least=True,
        note=f"the inner parts reach {reach * 1e3:.2f} mm from the centre, the outer ones begin at "
        f"{outer.low * 1e3:.2f} mm",
    )  # fmt: skip


def _check_sensors(motor: SphericalMotor, sensors: Sequence[_Ring], magnets: Sequence[_Ring]) -> BuildCheck:
    """The sensors' chips clear of the coils, and of magnets that pass; a chip may be in a coil's hole."""
    coil, coils, places = motor.electromagnet, motor.electromagnets, motor.sensor_layout
    body = AxialBody.of_length(coils.distance, float(coil.length), float(coil.inner_radius), float(coil.outer_radius))
    angle = np.arccos(np.clip(places.directions @ coils.directions.T, -1.0, 1.0))
    apart = body.measure_distance(places.distance * np.sin(angle), places.distance * np.cos(angle))
    number, near = np.unravel_index(int(np.argmin(apart)), apart.shape)
    met = [(float(apart[number, near]), f"sensor {number + 1} and EM{near + 1}")]
    for sensor in sensors:
        for magnet in magnets:
            axis = sensor.tilted.of_part(magnet.angle)
            met.append((find_clearance(sensor.body, magnet.body, axis), f"{sensor.name} and {magnet.name}"))
    return _nearest(
        "sensors clear of coils and magnets", "sensors.distance, from a chip's centre to the nearest part", met,
        _CHIP_HEIGHT_M, "move the sensors, by sensors.distance or their rings",
    )  # fmt: skip


# --------------------------------------------------------------------------------------------------
# Fields against a motor's magnets: of the other magnets, of the regulator's other ring, and of the coils at their peak.


_CHORD_STEPS = 60  #: angles between a magnet's and a coil's axis, from none to half a turn


def check_magnets(motor: SphericalMotor) -> list[BuildCheck]:
    """Whether the motor's magnets, and the rings of its regulator, keep their polarization."""
    stop, use = motor.coils.heat.stop, motor.magnet_use
    found = check_magnet(
        "magnets", "magnets.polarization", motor.magnet, use, stop, _oppose_magnets(motor), _oppose_coils(motor)
    )
    if motor.regulator is not None:
        plain = MagnetUse(None, use.greatest_temperature)
        for part, ring, other in _oppose_rings(motor, motor.regulator):
            found += check_magnet(f"regulator.{part}", f"regulator.{part}.polarization", ring, plain, stop, *other)
    return found


def _oppose_magnets(motor: SphericalMotor) -> float:
    """Greatest field [T] of the other magnets against one, on its axis and near its rim."""
    magnet, layout = motor.magnet, motor.magnets
    aside, places, frames = 0.8 * magnet.radius, layout.positions, layout.frames
    own = np.array([[0.0, 0.0, 0.0], [aside, 0.0, 0.0], [-aside, 0.0, 0.0], [0.0, aside, 0.0], [0.0, -aside, 0.0]])
    at = np.einsum("iab,pb->ipa", frames, own) + places[:, None]  # (i, 5, 3)
    faces = ChargedRing(magnet.radius, 0.0, magnet.length, magnet.polarization, radial=2, azimuth=12).rows
    charged = np.einsum("iab,bk->iak", frames, faces[:3]) + places[:, :, None]
    signed = motor.polarity[:, None] * faces[3]
    most = 0.0
    for i, sign in enumerate(motor.polarity):
        others = np.arange(len(layout)) != i
        rows = np.vstack([np.hstack(list(charged[others])), signed[others].ravel()])
        along = charge_field(rows, at[i]) @ layout.directions[i]
        most = max(most, float((-np.sign(sign) * along).max()))
    return most


def _oppose_coils(motor: SphericalMotor) -> float:
    """Greatest field [T] of all coils at their peak, each in its worse sense, at a magnet's face that is nearest.

    Over orientations of the whole workspace.
    """
    coils, magnets = motor.electromagnets, motor.magnets
    near = np.sign(coils.distance - magnets.distance) * motor.magnet.length / 2
    angle = np.pi * np.arange(_CHORD_STEPS + 1) / _CHORD_STEPS
    axis = np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], axis=1)
    places = (magnets.distance + near) * axis - np.array([0.0, 0.0, coils.distance])
    along = np.abs((coil_field(motor.electromagnet, places) * axis).sum(axis=1))
    current = np.abs(motor.groups) @ motor.driven_current
    most = 0.0
    for part in np.array_split(workspace_sample(motor.workspace_tilt, 3, 24), 6):
        u = np.einsum("nab,ib->nia", part, magnets.directions)
        between = np.arccos(np.clip(u @ coils.directions.T, -1.0, 1.0))
        most = max(most, float((np.interp(between, angle, along) @ current).max()))
    return most


def _oppose_rings(motor: SphericalMotor, regulator: Regulator) -> list[tuple[str, RingMagnet, tuple[float, float]]]:
    """Of each of the regulator's rings: its part of the file, and the fields [T] of the other ring and of the coils."""
    phi, tilt = 2 * np.pi * np.arange(12) / 12, motor.workspace_tilt
    around = np.stack([np.cos(phi), np.sin(phi), np.zeros_like(phi)], axis=1)
    up, current = np.array([0.0, 0.0, 1.0]), np.abs(motor.groups) @ motor.driven_current
    rings = (regulator.stator_ring, regulator.stator_height), (regulator.rotor_ring, regulator.rotor_height)
    points, faces, tables = [], [], dict[float, Array]()
    for ring, height in rings:
        points.append(
            np.concatenate([radius * around + height * up for radius in (ring.inner_radius, ring.outer_radius)])
        )
        rows = ChargedRing(
            ring.outer_radius, ring.inner_radius, ring.length, ring.polarization, radial=2, azimuth=30
        ).rows.copy()  # fmt: skip
        rows[2] += height
        faces.append(rows)
    other, driven = [0.0, 0.0], [0.0, 0.0]
    for R in rotation_from_euler(np.array([0.0, tilt, tilt]), np.array([0.0, 0.0, tilt]), np.zeros(3)):
        # polarized along +Z of the stator, and along −z of the rotor: what points along z opposes the rotor's
        seen = points[1] @ R.T
        other[1] = max(other[1], float((charge_field(faces[0], seen) @ R[:, 2]).max()))
        other[0] = max(other[0], float((charge_field(faces[1], points[0] @ R) @ R[2]).max()))
        for k, places in enumerate((points[0], seen)):
            driven[k] = max(driven[k], float((_bound_coils(motor, places, tables) @ current).max()))
    return [
        ("stator", regulator.stator_ring, (other[0], driven[0])),
        ("rotor", regulator.rotor_ring, (other[1], driven[1])),
    ]


def _bound_coils(motor: SphericalMotor, places: Array, tables: dict[float, Array]) -> Array:
    """(n, coils) size of each coil's field per ampere [T/A] at `places` (n, 3) [m].

    By tables over the angle from the coil's axis, one for each distance from the centre, which are kept in `tables`.
    """
    out = np.empty((len(places), len(motor.electromagnets)))
    angle = np.pi * np.arange(_CHORD_STEPS + 1) / _CHORD_STEPS
    axis = np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], axis=1)
    distances = np.round(np.linalg.norm(places, axis=1), 9)
    for distance in np.unique(distances).tolist():
        if distance not in tables:
            seen = distance * axis - np.array([0.0, 0.0, motor.electromagnets.distance])
            tables[distance] = np.linalg.norm(coil_field(motor.electromagnet, seen), axis=1)
        at = distances == distance
        between = np.arccos(np.clip(places[at] @ motor.electromagnets.directions.T / distance, -1.0, 1.0))
        out[at] = np.interp(between, angle, tables[distance])
    return out


_RANGE_SPINS = 12  #: of the rotor, at each of its tilts, at which the sensors' fields are computed …
_RANGE_SENSORS, _RANGE_ROUNDS = (
    6,
    5,
)  #: … and sensors with the greatest for which the orientation is refined, and how often


def check_range(motor: SphericalMotor) -> list[BuildCheck]:
    """Whether magnets and coils together stay within the sensors' range, in every orientation of the workspace.

    The magnets' fields along each sensor's axes are those of charges, their greatest is searched from sampled
    orientations. All coils are at their peak, each in its worse sense. Nothing where the sensors are ideal.
    """
    places, magnet, reach = motor.sensor_layout, motor.magnet, motor.hall.greatest_reading
    if not np.isfinite(reach):
        return []
    beside = np.arctan2(magnet.radius, motor.magnets.distance)
    angle = np.concatenate([
        np.linspace(1e-3, 2 * beside, _CHORD_STEPS, endpoint=False), np.linspace(2 * beside, np.pi - 1e-3, _CHORD_STEPS)
    ])  # fmt: skip
    sine, cosine = np.sin(angle), np.cos(angle)
    ratio = magnet.radius / max(
        abs(motor.magnets.distance - places.distance) - 0.5 * magnet.length, 0.1 * magnet.radius
    )
    finer = {"radial": int(3 + 1.7 * ratio), "azimuth": int(8 + 5 * ratio)}
    rows = ChargedRing(magnet.radius, 0.0, magnet.length, magnet.polarization, **finer).rows
    points = np.stack([places.distance * sine, 0 * sine, places.distance * cosine - motor.magnets.distance], axis=1)
    field = charge_field(rows, points)
    across = field[:, 0] / sine  # the field is (B_z − B_x cos/sin) u + B_x/sin s, for a magnet at u and a sensor at s
    along = field[:, 2] - across * cosine

    def read(angles: Array, directions: Array, frames: Array) -> Array:
        """(n, k) greatest field along an axis of sensors, k or one, at n orientations by their Euler angles."""
        u = np.einsum("nab,ib->nia", rotation_from_euler(*angles.T), motor.magnets.directions)
        between = np.arccos(np.clip(np.einsum("nia,nka->nik", u, directions), -1.0, 1.0))
        pull = np.einsum("nik,nia,i->nka", np.interp(between, angle, along), u, motor.polarity)
        toward = np.einsum("nik,i->nk", np.interp(between, angle, across), motor.polarity)
        total = pull + toward[..., None] * directions
        greatest: Array = np.abs(np.einsum("nka,nkab->nkb", total, frames)).max(axis=2)
        return greatest

    tilt, spin = motor.workspace_tilt, 2 * np.pi / _RANGE_SPINS
    grid = np.meshgrid(*(np.linspace(-tilt, tilt, 3),) * 2, spin * np.arange(_RANGE_SPINS), indexing="ij")
    angles = np.stack([one.ravel() for one in grid], axis=1)
    count = len(places)
    fields = np.concatenate([
        read(part, np.broadcast_to(places.directions, (len(part), count, 3)),
             np.broadcast_to(places.frames, (len(part), count, 3, 3)))
        for part in np.array_split(angles, 4)
    ])  # fmt: skip
    # from the best of these orientations of each sensor to the greatest nearby, in ever smaller steps
    best, most = angles[np.argmax(fields, axis=0)], fields.max(axis=0)
    step = np.stack(np.meshgrid(*(np.array([-1.0, 0.0, 1.0]),) * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    leading = np.argsort(most)[-_RANGE_SENSORS:]
    for share in 0.5 ** np.arange(1, _RANGE_ROUNDS + 1):
        near = best[leading][:, None] + share * step * np.array([tilt, tilt, spin])
        near[..., :2] = np.clip(near[..., :2], -tilt, tilt)
        chosen = np.repeat(leading, len(step))
        found = read(near.reshape(-1, 3), places.directions[chosen][:, None], places.frames[chosen][:, None])
        found = found.reshape(len(leading), -1)
        highest = np.argmax(found, axis=1)
        best[leading], most[leading] = near[np.arange(len(leading)), highest], found.max(axis=1)
    driven = _bound_coils(motor, places.positions, {}) @ (np.abs(motor.groups) @ motor.driven_current)
    worst = int(np.argmax(most + driven))
    share, coils = format_bound(float(most[worst]), "T"), format_bound(float(driven[worst]), "T")
    return [
        BuildCheck(
            "fields within the sensors' range", f"sensor {worst + 1}, magnets and coils together",
            float(most[worst] + driven[worst]), reach, "T",
            "move the sensors away from magnets and coils, or take chips with a greater range (sensors.range)",
            note=f"magnets {share}, all coils at their peak {coils}",
        )
    ]  # fmt: skip


def measure_ring_pull(motor: SphericalMotor) -> float:
    """Greatest torque per ampere of a coil on the regulator's ring, over a coil's greatest on the magnets [1].

    No model counts it. Upright, and at one and both full tilts, by the coils' fields on charges on the ring's faces; 0
    without a regulator.
    """
    if motor.regulator is None:
        return 0.0
    ring, tilt, most = motor.regulator.rotor_ring, motor.workspace_tilt, 0.0
    rows = ChargedRing(ring.outer_radius, ring.inner_radius, ring.length, ring.polarization, radial=4, azimuth=48).rows
    faces = rows[:3].T + np.array([0.0, 0.0, motor.regulator.rotor_height])
    turns = rotation_from_euler(np.array([0.0, tilt, tilt]), np.array([0.0, 0.0, tilt]), np.zeros(3))
    for R in turns:
        at = faces @ R.T
        for frame, place in zip(motor.electromagnets.frames, motor.electromagnets.positions, strict=True):
            field = motor.electromagnet.field((at - place) @ frame) @ frame.T
            most = max(most, float(np.linalg.norm((rows[3][:, None] * np.cross(at, field)).sum(axis=0))))
    return most / float(np.linalg.norm(motor.torque_characteristic(turns, "table"), axis=1).max())


def workspace_sample(tilt: float, tilts: int, spins: int) -> Array:
    """(n, 3, 3) orientations over |ψ|, |λ| ≤ `tilt` (a square grid) and 0 ≤ φ < 360°.

    `tilt` in [rad].

    >>> workspace_sample(0.4, 3, 8).shape
    (72, 3, 3)
    """
    edge = np.linspace(-tilt, tilt, tilts)
    psi, lam, phi = np.meshgrid(edge, edge, 2 * np.pi * np.arange(spins) / spins, indexing="ij")
    return rotation_from_euler(psi.ravel(), lam.ravel(), phi.ravel())


def _list_weaknesses(motor: SphericalMotor, groups: Sequence[Sequence[int]]) -> list[str]:
    """Rank and condition of the grouped torque characteristic, at the dipole model: symmetry shows there as well."""
    R = workspace_sample(motor.workspace_tilt, 5, 48)
    single = motor.torque_characteristic(R, "dipole")
    grouped = single @ motor.groups
    scale = float(np.abs(single).max())
    reach = np.abs(grouped).max(axis=(0, 1))
    dead = np.flatnonzero(reach < 1e-6 * scale).tolist()
    if len(dead) == len(groups):
        return [
            "groups.winding: no group produces any torque at any orientation: the coils of every group cancel each "
            "other. "
            "Magnets polarized alike at opposite positions need 'series-aiding', unlike ones 'series-opposed', or the "
            "other polarity"
        ]
    found = [
        f"groups.coils: group {number + 1} (EM{' + EM'.join(str(coil) for coil in groups[number])}) produces no "
        "torque at any orientation: its coils cancel each other"
        for number in dead
    ]
    values = np.linalg.svd(grouped, compute_uv=False)
    weakest, strongest = values[:, 2], values[:, 0]
    worst = int(np.argmin(weakest / strongest))
    rank = int((values[worst] > 1e-6 * strongest[worst]).sum())
    if rank < 3:
        found.append(
            f"groups: the channels produce torque about {rank} of three axes (rank {rank}) somewhere in the workspace"
        )
    elif strongest[worst] > WORST_CONDITION * weakest[worst] and (times := _condition(motor, R)) > WORST_CONDITION:
        found.append(
            f"groups: {times:.0f} times weaker about one axis than about another within "
            f"the workspace; at most {WORST_CONDITION:.0f} times is allowed"
        )
    return found


def _condition(motor: SphericalMotor, R: Array) -> float:
    """Greatest over smallest torque per ampere by direction, in the worst of R (n, 3, 3), at the exact level.

    Dipoles tell which axes a motor has, but not how weak one is where wide parts pass each other closely. Slower, so
    it is asked only where dipoles object. Infinite where parts overlap, which is a finding of its own.
    """
    from haptorb.devices.tables import series_torque

    coils, chords = motor.electromagnets, np.linspace(0.0, 2.0, _CHORDS + 1)
    try:
        k = series_torque(
            motor.magnet, motor.magnets.distance, motor.electromagnet, coils.distance, 1 - 0.5 * chords**2
        )
    except GeometryError:
        return float("inf")
    greatest, slope = 0.0, np.diff(k)
    for part in np.array_split(R, max(len(R) // 100, 1)):
        u = np.einsum("nab,ib->nia", part, motor.magnets.directions)
        place = 0.5 * _CHORDS * np.sqrt(np.clip(2 - 2 * u @ coils.directions.T, 0.0, 4.0))
        below = np.minimum(place.astype(np.intp), _CHORDS - 1)
        strength = (k[below] + (place - below) * slope[below]) * motor.polarity[:, None]
        pull = np.swapaxes(strength, 1, 2) @ u  # (n, coils, 3): Σ k û
        single = np.swapaxes(np.cross(pull, coils.directions), 1, 2)
        values = np.linalg.svd(single @ motor.groups, compute_uv=False)
        greatest = max(greatest, float((values[:, 0] / np.maximum(values[:, 2], 1e-300)).max()))
    return greatest
