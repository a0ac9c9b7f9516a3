"""Schema of the file of a spherical motor, and construction of the device from it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Len
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from haptorb.arrays import Array
from haptorb.devices import quantity as q
from haptorb.devices import schema as m
from haptorb.devices.base import Coils
from haptorb.devices.build_checks import refuse_unbuildable
from haptorb.devices.field_sensors import FieldSensors
from haptorb.devices.magnet_grades import Letters, MagnetUse, Temperature
from haptorb.devices.motor import EndStop, Grasp, Rotor, SphericalMotor, findings, workspace_sample
from haptorb.devices.motor_layout import Layout, PartRing, alternate_signs
from haptorb.devices.motor_wiring import grouping, match_winding, pair_opposite
from haptorb.devices.schema import (
    RIGHT_ANGLE,
    BasedOn,
    Count,
    DeviceSchema,
    Drop,
    HeatSection,
    LimitsSection,
    Name,
    Positive,
    Section,
    SensorQualitySection,
    SupplySection,
    Text,
    ThermometerSection,
    check_wall,
    limit_currents,
    list_limit_mistakes,
)
from haptorb.devices.uncertainty import MotorTolerance, MotorUncertainty
from haptorb.devices.weight_regulator import Regulator
from haptorb.errors import DeviceError, quote
from haptorb.magnetics.coil import Coil as CoilCoil
from haptorb.magnetics.magnets import CylinderMagnet, RingMagnet
from haptorb.magnetics.multipole import MultipoleSource

__all__ = [
    "ElectromagnetsSection",
    "EndStopSection",
    "GripSection",
    "GroupsSection",
    "MagnetsSection",
    "MotorFile",
    "MultipoleSection",
    "RegulatorRingSection",
    "RegulatorSection",
    "RingSection",
    "RotorSection",
    "SensorsSection",
    "WorkspaceSection",
    "layout",
]


# --------------------------------------------------------------------------------------------------
# Magnets, coils and field sensors in a spherical motor's file: parts on rings around one centre.


Share = Annotated[q.Number, Field(gt=0, le=1)]
Coil = Annotated[int, Field(ge=-1000, le=1000, strict=True)]
_MOST_PARTS = 48  #: on all rings together: what is computed of them grows with their squares


def _sign(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and -1 <= value <= 1


def _polarity(value: Any) -> Any:
    if value in ("checkerboard", "in-phase"):
        return value
    signs = isinstance(value, list) and all(_sign(sign) for sign in value)
    if not signs:
        raise ValueError(
            f"must be 'checkerboard', 'in-phase' or a list of +1 (outward) and -1, one per magnet; got {quote(value)}"
        )
    return tuple(float(sign) for sign in value)


Polarity = Annotated[str | tuple[float, ...], BeforeValidator(_polarity)]


class RingSection(Section):
    """One of [[….rings]]: parts at one latitude."""

    latitude: Annotated[
        q.Angle, Field(ge=-RIGHT_ANGLE, le=RIGHT_ANGLE), m.Meaning("latitude of the ring, seen from the motor's centre")
    ]
    count: Annotated[Count, m.Meaning("number of parts on the ring"), m.Form("≥ 1, on all rings together at most 48")]
    first: Annotated[q.Angle, m.Meaning("longitude of the first part")]
    step: Annotated[
        q.Angle | None,
        BeforeValidator(lambda value: None if value == "even" else value),
        m.Meaning("longitude from one part to the next"),
        m.Form('an angle, or "even": 360° divided by count'),
        m.Without("even"),
    ] = None

    def build(self) -> PartRing:
        """As the layout has it."""
        step = 2 * np.pi / self.count if self.step is None else self.step
        return PartRing(self.latitude, self.count, self.first, step)


def _check_count(rings: tuple[RingSection, ...]) -> tuple[RingSection, ...]:
    total = sum(ring.count for ring in rings)
    if total > _MOST_PARTS:
        raise ValueError(f"must have at most {_MOST_PARTS} parts on all rings together; got {total}")
    return rings


Rings = Annotated[tuple[RingSection, ...], Len(1, _MOST_PARTS), AfterValidator(_check_count)]


class MultipoleSection(Section):
    """[….multipole]: a distributed multipole model, Bai 2012 eq. (7) and Table 1."""

    dipoles_per_loop: Annotated[Count, m.Meaning("dipoles on each loop, n")]
    length_ratio: Annotated[Share, m.Meaning("length of the dipoles over that of the part, l̄/l")]
    strengths: Annotated[
        tuple[q.Number, ...],
        Len(1, 20),
        m.Meaning("pole strengths m_0 to m_k; of coils per ampere"),
        m.Unit("A·m"),
        m.Form("any"),
    ]

    def build(self, radius: float, length: float) -> MultipoleSource:
        """The model of a body of this radius and length [m]."""
        return MultipoleSource(radius, self.length_ratio * length, self.strengths, self.dipoles_per_loop)


class MagnetsSection(Section):
    """[magnets]: the rotor's."""

    distance: Annotated[q.Length, Positive, m.Meaning("distance of the magnets' centres from the motor's centre")]
    radius: Annotated[q.Length, Positive, m.Meaning("radius of one cylinder magnet")]
    length: Annotated[q.Length, Positive, m.Meaning("length of one cylinder magnet")]
    polarization: Annotated[q.Polarization, Positive, m.Meaning("polarization of one magnet")]
    polarity: Annotated[
        Polarity,
        m.Meaning("polarity of the magnets"),
        m.Form('"checkerboard", "in-phase" or a number from −1 to 1 per magnet, +1 outward'),
    ]
    rings: Annotated[Rings, m.Meaning("rings of magnets on the rotor")]
    grade: Letters = None
    greatest_temperature: Temperature = None
    multipole: Annotated[
        MultipoleSection | None,
        m.Meaning("distributed multipole model of one magnet, Bai 2012 eq. (7)"),
        m.Without("none: no model published"),
    ] = None

    @model_validator(mode="after")
    def _check_polarity(self) -> MagnetsSection:
        total = sum(ring.count for ring in self.rings)
        if not isinstance(self.polarity, str) and len(self.polarity) != total:
            raise ValueError(f"has {total} magnets but {len(self.polarity)} values of polarity")
        return self

    def signs(self) -> Array:
        """(p,) polarity of every magnet."""
        if isinstance(self.polarity, str):
            return alternate_signs([ring.count for ring in self.rings], self.polarity)
        return np.array(self.polarity)


class ElectromagnetsSection(Section):
    """[electromagnets]: the stator's coils."""

    distance: Annotated[q.Length, Positive, m.Meaning("distance of the coils' centres from the motor's centre")]
    turns: Annotated[q.Number, Positive, m.Meaning("turns of one coil")]
    outer_radius: Annotated[q.Length, Positive, m.Meaning("outer radius of one winding")]
    inner_radius: Annotated[
        q.Length, Positive, m.Meaning("inner radius of one winding"), m.Form("> 0, below outer_radius")
    ]
    length: Annotated[q.Length, Positive, m.Meaning("length of one winding along its axis")]
    fill: Annotated[Share, m.Meaning("fill factor of copper in the winding's cross-section; determines the resistance")]
    rings: Annotated[Rings, m.Meaning("rings of coils on the stator")]
    multipole: Annotated[
        MultipoleSection | None,
        m.Meaning("distributed multipole model of one coil, Bai 2012 eq. (7)"),
        m.Without("none: no model published"),
    ] = None

    @model_validator(mode="after")
    def _check_winding(self) -> ElectromagnetsSection:
        check_wall(self.inner_radius, self.outer_radius)
        return self


class SensorsSection(SensorQualitySection):
    """[sensors]: three-axis field sensors on the stator."""

    distance: Annotated[q.Length, Positive, m.Meaning("distance of the field sensors from the motor's centre")]
    rings: Annotated[Rings, m.Meaning("rings of three-axis field sensors on the stator")]


class GroupsSection(Section):
    """[groups]: coils wired in series; each group is one channel."""

    coils: Annotated[
        Annotated[tuple[Annotated[tuple[Coil, ...], Len(1, _MOST_PARTS)], ...], Len(1, _MOST_PARTS)] | None,
        BeforeValidator(lambda value: None if value == "antipodal" else value),
        m.Meaning("coils of each channel, by number, wired in series"),
        m.Form('lists of coil numbers from 1, each coil once; or "antipodal": pairs of opposite coils'),
    ]
    winding: Annotated[
        Literal["series-aiding", "series-opposed", "matched"],
        m.Meaning(
            "winding sense of the second coil of a group relative to the first; matched: such that each adds to the "
            "torque of the first"
        ),
    ]
    antipodal: Annotated[
        bool,
        Field(strict=True),
        m.Meaning("whether the coils of every pair face each other across the centre, which is then checked"),
    ] = False


def layout(distance: float, rings: Rings) -> Layout:
    """The places of all parts of `rings`, `distance` [m] from the centre."""
    return Layout.of_rings(distance, [ring.build() for ring in rings])


# --------------------------------------------------------------------------------------------------
# The rotor in a spherical motor's file: body, support, hand and stop.


class WorkspaceSection(Section):
    """[workspace]: |ψ| and |λ| up to `tilt`, any φ."""

    tilt: Annotated[
        q.Angle, Field(gt=0, lt=RIGHT_ANGLE), m.Meaning("maximum tilt |ψ| and |λ| of the rotor; spin is free")
    ]


class EndStopSection(Section):
    """[end_stop]: mechanical stop at the edge of the workspace."""

    stiffness: Annotated[q.TurnStiffness, Positive, m.Meaning("rotational stiffness of the stop")]
    damping: Annotated[q.TurnDamping, Ge(0), m.Meaning("rotational damping of the stop")]


class GripSection(Section):
    """[hand]: who holds the handle's end."""

    mass: Annotated[q.Mass, Ge(0), m.Meaning("mass that the hand adds at the handle's end")]
    stiffness: Annotated[q.Stiffness, Ge(0), m.Meaning("stiffness of the grip along each axis")]
    damping: Annotated[q.Damping, Ge(0), m.Meaning("damping of the grip along each axis")]
    radius: Annotated[q.Length, Ge(0), m.Meaning("radius of the fist, for its inertia and grip about the handle")]


class RotorSection(Section):
    """[rotor]"""

    mass: Annotated[q.Mass, Positive, m.Meaning("mass of the rotor with its magnets and handle")]
    inertia: Annotated[
        tuple[Annotated[q.Inertia, Positive], ...],
        Len(3, 3),
        m.Meaning("principal moments of inertia about the motor's centre: x, y, and z along the handle"),
        m.Form("> 0, none above the sum of the others"),
    ]
    centre_of_mass: Annotated[
        q.Length, m.Meaning("height of the centre of mass over the motor's centre, along the handle")
    ]
    viscous_friction: Annotated[q.TurnDamping, Ge(0), m.Meaning("viscous friction of the bearing")]
    dry_friction: Annotated[q.Torque, Ge(0), m.Meaning("dry friction of the bearing")]
    handle_length: Annotated[q.Length, Positive, m.Meaning("distance from the motor's centre to the handle's end")]

    @model_validator(mode="after")
    def _check_inertia(self) -> RotorSection:
        if 2 * max(self.inertia) > sum(self.inertia):
            raise ValueError("inertia must obey I1 ≤ I2 + I3, like every rigid body")
        return self


class RegulatorRingSection(Section):
    """[regulator.stator] or [regulator.rotor]"""

    outer_radius: Annotated[q.Length, Positive, m.Meaning("outer radius of the ring magnet")]
    inner_radius: Annotated[
        q.Length, Positive, m.Meaning("inner radius of the ring magnet"), m.Form("> 0, below outer_radius")
    ]
    length: Annotated[q.Length, Positive, m.Meaning("length of the ring along its axis")]
    polarization: Annotated[q.Polarization, Positive, m.Meaning("polarization of the ring")]
    height: Annotated[q.Length, m.Meaning("height of the ring's centre over the motor's centre")]

    @model_validator(mode="after")
    def _check_ring(self) -> RegulatorRingSection:
        if self.inner_radius >= self.outer_radius:
            raise ValueError("inner_radius must be smaller than outer_radius")
        return self

    def build(self) -> RingMagnet:
        """The ring's magnet."""
        return RingMagnet(self.outer_radius, self.inner_radius, self.length, self.polarization)


class RegulatorSection(Section):
    """[regulator]: two opposed rings that hold the rotor up."""

    stator: Annotated[RegulatorRingSection, m.Meaning("ring on the base")]
    rotor: Annotated[RegulatorRingSection, m.Meaning("ring on the rotor")]


class ChannelsSection(Section):
    """[coils]: electrical data of a channel, the same for all."""

    current_limit: Annotated[
        q.Current | None,
        Positive,
        m.Meaning("maximum commanded current in a channel"),
        m.Form("> 0, at most 1.25 times what the supply drives at 20 °C"),
        m.Without("what the supply drives at 20 °C"),
    ] = None
    temperature_coefficient: Annotated[
        q.InverseKelvin, m.Meaning("relative change of resistance per kelvin; copper: 3.93e-3 / K")
    ]
    reference_temperature: Annotated[
        q.Temperature, Positive, m.Meaning("reference temperature of the resistances"), m.Form("> 0 K")
    ]
    heat: Annotated[HeatSection, m.Meaning("thermal model of one channel, equal for all: winding, body, air")]


class MotorFile(DeviceSchema):
    """A file of kind "spherical-motor"."""

    kind: Annotated[Literal["spherical-motor"], m.Meaning("kind of device")]
    name: Annotated[Name, m.Meaning("short name of the device; recordings and calibrations refer to it")]
    title: Annotated[Text, m.Meaning("title of the device")]
    source: Annotated[Text, m.Meaning("source of the values")]
    based_on: BasedOn = None
    drop: Drop = ()
    magnets: Annotated[MagnetsSection, m.Meaning("the rotor's magnets")]
    electromagnets: Annotated[ElectromagnetsSection, m.Meaning("the stator's coils")]
    sensors: Annotated[SensorsSection, m.Meaning("field sensors of the stator")]
    groups: Annotated[GroupsSection, m.Meaning("coils wired in series; each group is one channel")]
    coils: Annotated[ChannelsSection, m.Meaning("electrical data of the channels, all equal")]
    supply: Annotated[SupplySection, m.Meaning("supply of the channels")]
    limits: Annotated[LimitsSection, m.Meaning("limits that the guard enforces")]
    workspace: Annotated[WorkspaceSection, m.Meaning("workspace: orientations of the rotor")]
    end_stop: Annotated[EndStopSection, m.Meaning("mechanical stop at the edge of the workspace")]
    thermometer: Annotated[ThermometerSection, m.Meaning("thermometers of the channels")]
    hand: Annotated[GripSection, m.Meaning("the hand that holds the handle, for simulation and stability")]
    rotor: Annotated[RotorSection, m.Meaning("mass properties of the rotor")]
    regulator: Annotated[
        RegulatorSection | None,
        m.Meaning("two opposed ring magnets that hold the rotor up"),
        m.Without("none: only the currents hold it up"),
    ] = None
    tolerance: Annotated[
        MotorTolerance,
        m.Meaning("standard deviations of what is built from the file, for simulation and error budget"),
        m.Without("the defaults below"),
        Field(default_factory=MotorTolerance),
    ]
    uncertainty: Annotated[
        MotorUncertainty,
        m.Meaning("standard uncertainties of assumed or measured values, for `haptorb inspect --errors`"),
        m.Without("the defaults below"),
        Field(default_factory=MotorUncertainty),
    ]

    def list_idle(self) -> Iterator[tuple[str, str]]:
        """Keys that change nothing, beside what else the file says, and why."""
        if self.regulator is None:
            yield "uncertainty.regulator", "there is no [regulator]"
        for one, other in (("magnets", "electromagnets"), ("electromagnets", "magnets")):
            if getattr(self, one).multipole is not None and getattr(self, other).multipole is None:
                yield f"{one}.multipole", f"the published model needs [{other}.multipole] too"

    def build(self, assumed: dict[str, str], digest: str, *, override: bool = False) -> SphericalMotor:
        """The device that this file describes; DeviceError with all findings unless they are overridden."""
        coils = layout(self.electromagnets.distance, self.electromagnets.rings)
        members = pair_opposite(coils) if self.groups.coils is None else self.groups.coils
        groups, wrong = grouping(members, len(coils), self.groups.winding)
        if wrong:
            raise DeviceError("\n".join(f"device '{self.name}': {line}" for line in wrong))
        motor = self._motor(assumed, digest, groups)
        if self.groups.winding == "matched":
            single = motor.torque_characteristic(workspace_sample(motor.workspace_tilt, 3, 24), "dipole")
            motor = replace(motor, groups=match_winding(groups, single))
        found = findings(motor, members, antipodal=self.groups.antipodal)
        if not override:
            refuse_unbuildable(self.name, motor.build_checks, found)
        if not found:  # a motor whose coils cancel has no torque to compare with
            wrong = list_limit_mistakes(motor.coils, motor.supply, motor.limits, 0.0, motor.greatest_torque)
        if wrong:
            raise DeviceError("\n".join(f"device '{self.name}': {line}" for line in wrong))
        return replace(motor, findings=tuple(found))

    def _motor(self, assumed: dict[str, str], digest: str, groups: Array) -> SphericalMotor:
        m, e, s = self.magnets, self.electromagnets, self.sensors
        coil = CoilCoil(e.turns, e.inner_radius, e.outer_radius, e.length)
        sensors = layout(s.distance, s.rings)
        return SphericalMotor(
            name=self.name,
            title=self.title,
            source=self.source,
            coils=self._channels(coil, groups),
            supply=self.supply.build(),
            limits=self.limits.build(),
            assumed=assumed,
            digest=digest,
            magnets=layout(m.distance, m.rings),
            polarity=m.signs(),
            magnet=CylinderMagnet(m.radius, m.length, m.polarization),
            electromagnets=layout(e.distance, e.rings),
            electromagnet=coil,
            sensor_layout=sensors,
            hall=FieldSensors(sensors.positions, s.noise, s.step, s.errors(), s.warming, s.range),
            groups=groups,
            magnet_model=None if m.multipole is None else m.multipole.build(m.radius, m.length),
            coil_model=None if e.multipole is None else e.multipole.build(e.outer_radius, e.length),
            workspace_tilt=self.workspace.tilt,
            end_stop=EndStop(self.end_stop.stiffness, self.end_stop.damping),
            thermometer_step=self.thermometer.step,
            thermometer_noise=self.thermometer.noise,
            hand=Grasp(self.hand.mass, self.hand.stiffness, self.hand.damping, self.hand.radius),
            rotor=Rotor(**{**self.rotor.model_dump(), "inertia": np.array(self.rotor.inertia)}),
            regulator=self._regulator(),
            uncertainty=self.uncertainty,
            tolerance=self.tolerance,
            magnet_use=MagnetUse(m.grade, m.greatest_temperature),
        )

    def _channels(self, coil: CoilCoil, groups: Array) -> Coils:
        """Series resistance and inductance; the coils of a group are too far apart to share flux worth counting."""
        in_series = np.abs(groups).sum(axis=0)
        many = len(in_series)
        channels = Coils(
            names=tuple(f"u{number}" for number in range(1, many + 1)),
            resistance=in_series * coil.resistance(self.electromagnets.fill),
            inductance=in_series * coil.inductance,
            current_limit=np.full(many, self.coils.current_limit or np.nan),
            temperature_coefficient=self.coils.temperature_coefficient,
            reference_temperature=self.coils.reference_temperature,
            heat=self.coils.heat.build(),
        )
        return limit_currents(channels, self.supply.build())

    def _regulator(self) -> Regulator | None:
        if self.regulator is None:
            return None
        stator, rotor = self.regulator.stator, self.regulator.rotor
        # tilts of |ψ| and |λ| add up at the corners of the workspace
        corner = float(np.arccos(np.cos(self.workspace.tilt) ** 2))
        return Regulator(stator.build(), stator.height, rotor.build(), rotor.height, 1.05 * corner)
