"""What the file of a spherical motor may say, and the device that it builds."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Len
from pydantic import BeforeValidator, Field, model_validator

from haptorb.devices import quantity as q
from haptorb.devices.device import Coils
from haptorb.devices.electromagnet import FieldSensors
from haptorb.devices.handle import EndStop, Grasp, HallQuality
from haptorb.devices.layouts import Layout, Ring, alternating
from haptorb.devices.motor_validation import findings, grouping
from haptorb.devices.regulator import Regulator
from haptorb.devices.schema import (
    HeatSection,
    LimitsSection,
    Name,
    Positive,
    Section,
    SupplySection,
    ThermometerSection,
)
from haptorb.devices.spherical_motor import Rotor, SphericalMotor
from haptorb.errors import DeviceError
from haptorb.physics.arrays import Array
from haptorb.physics.coil import Coil
from haptorb.physics.cylinder import CylinderMagnet
from haptorb.physics.multipole import MultipoleSource
from haptorb.physics.ring import RingMagnet

__all__ = ["MotorFile"]

Share = Annotated[q.Number, Field(gt=0, le=1)]
Count = Annotated[int, Field(ge=1, le=1000)]


def _polarity(value: Any) -> Any:
    if value in ("checkerboard", "in-phase"):
        return value
    signs = isinstance(value, list) and all(isinstance(sign, int | float) and abs(sign) <= 1 for sign in value)
    if not signs:
        raise ValueError(
            f"must be 'checkerboard', 'in-phase' or a list of +1 (outward) and -1, one per magnet; got {value!r}"
        )
    return tuple(float(sign) for sign in value)


Polarity = Annotated[str | tuple[float, ...], BeforeValidator(_polarity)]


class RingSection(Section):
    """One of [[….rings]]: parts at one latitude."""

    latitude: Annotated[q.Angle, Field(ge=-np.pi / 2, le=np.pi / 2)]
    count: Count
    first: q.Angle
    step: q.Angle

    def built(self) -> Ring:
        """As the layout has it."""
        return Ring(self.latitude, self.count, self.first, self.step)


Rings = Annotated[tuple[RingSection, ...], Len(1)]


class MultipoleSection(Section):
    """[….multipole]: a distributed multipole model, Bai 2012 eq. (7) and Table 1."""

    dipoles_per_loop: Count
    length_ratio: Share  #: l̄/l
    strengths: Annotated[tuple[q.Number, ...], Len(1)]  #: m_0 … m_k [A·m], coils: per ampere [m]

    def built(self, radius: float, length: float) -> MultipoleSource:
        """The model of a body of this radius and length [m]."""
        return MultipoleSource(radius, self.length_ratio * length, self.strengths, self.dipoles_per_loop)


class MagnetsSection(Section):
    """[magnets]: the rotor's."""

    distance: Annotated[q.Length, Positive]
    radius: Annotated[q.Length, Positive]
    length: Annotated[q.Length, Positive]
    polarization: Annotated[q.Polarization, Positive]
    polarity: Polarity
    rings: Rings
    multipole: MultipoleSection | None = None

    @model_validator(mode="after")
    def _one_sign_each(self) -> MagnetsSection:
        total = sum(ring.count for ring in self.rings)
        if not isinstance(self.polarity, str) and len(self.polarity) != total:
            raise ValueError(f"has {total} magnets but {len(self.polarity)} values of polarity")
        return self

    def signs(self) -> Array:
        """(p,) polarity of every magnet."""
        if isinstance(self.polarity, str):
            return alternating([ring.count for ring in self.rings], self.polarity)
        return np.array(self.polarity)


class ElectromagnetsSection(Section):
    """[electromagnets]: the stator's coils."""

    distance: Annotated[q.Length, Positive]
    turns: Annotated[q.Number, Positive]
    outer_radius: Annotated[q.Length, Positive]
    inner_radius: Annotated[q.Length, Positive]
    length: Annotated[q.Length, Positive]
    fill: Share
    rings: Rings
    multipole: MultipoleSection | None = None

    @model_validator(mode="after")
    def _has_a_winding(self) -> ElectromagnetsSection:
        if self.inner_radius >= self.outer_radius:
            raise ValueError(
                f"inner_radius ({self.inner_radius * 1e3:g} mm) must be smaller than outer_radius "
                f"({self.outer_radius * 1e3:g} mm)"
            )
        return self


class SensorsSection(Section):
    """[sensors]: three-axis field sensors on the stator."""

    distance: Annotated[q.Length, Positive]
    rings: Rings
    noise: Annotated[q.Polarization, Ge(0)]
    step: Annotated[q.Polarization, Ge(0)]
    gain: Annotated[q.Number, Ge(0)]
    offset: Annotated[q.Polarization, Ge(0)]
    cross: Annotated[q.Number, Ge(0)]


class GroupsSection(Section):
    """[groups]: which coils are wired in series; each group is one channel."""

    coils: Annotated[tuple[Annotated[tuple[int, ...], Len(1)], ...], Len(1)]  #: numbered from 1
    winding: Literal["series-aiding", "series-opposed"]
    antipodal: bool = False  #: the maker states that the coils of a group face each other across the centre


class ChannelsSection(Section):
    """[coils]: what an electrician sees of a channel, all alike."""

    current_limit: Annotated[q.Current, Positive]
    temperature_coefficient: q.InverseKelvin
    reference_temperature: Annotated[q.Temperature, Positive]
    heat: HeatSection


class WorkspaceSection(Section):
    """[workspace]: |ψ| and |λ| up to `tilt`, any φ."""

    tilt: Annotated[q.Angle, Field(gt=0, lt=np.pi / 2)]


class EndStopSection(Section):
    """[end_stop]: what the rotor meets at the edge of the workspace."""

    stiffness: Annotated[q.TurnStiffness, Positive]
    damping: Annotated[q.TurnDamping, Ge(0)]


class GripSection(Section):
    """[hand]: who holds the handle's end."""

    mass: Annotated[q.Mass, Ge(0)]
    stiffness: Annotated[q.Stiffness, Ge(0)]
    damping: Annotated[q.Damping, Ge(0)]
    radius: Annotated[q.Length, Ge(0)]


class RotorSection(Section):
    """[rotor]"""

    mass: Annotated[q.Mass, Positive]
    inertia: Annotated[tuple[Annotated[q.Inertia, Positive], ...], Len(3, 3)]
    centre_of_mass: q.Length
    viscous_friction: Annotated[q.TurnDamping, Ge(0)]
    dry_friction: Annotated[q.Torque, Ge(0)]
    handle_length: Annotated[q.Length, Positive]

    @model_validator(mode="after")
    def _is_a_body(self) -> RotorSection:
        if 2 * max(self.inertia) > sum(self.inertia):
            raise ValueError("inertia must obey I1 ≤ I2 + I3, as every body's does")
        return self


class RegulatorRingSection(Section):
    """[regulator.stator] or [regulator.rotor]"""

    outer_radius: Annotated[q.Length, Positive]
    inner_radius: Annotated[q.Length, Positive]
    length: Annotated[q.Length, Positive]
    polarization: Annotated[q.Polarization, Positive]
    height: q.Length

    @model_validator(mode="after")
    def _is_a_ring(self) -> RegulatorRingSection:
        if self.inner_radius >= self.outer_radius:
            raise ValueError("inner_radius must be smaller than outer_radius")
        return self

    def built(self) -> RingMagnet:
        """The ring's magnet."""
        return RingMagnet(self.outer_radius, self.inner_radius, self.length, self.polarization)


class RegulatorSection(Section):
    """[regulator]: two opposed rings that hold the rotor up."""

    stator: RegulatorRingSection
    rotor: RegulatorRingSection


class MotorFile(Section):
    """A file of kind "spherical-motor"."""

    kind: Literal["spherical-motor"]
    name: Name
    title: str
    source: str
    based_on: str | None = None
    magnets: MagnetsSection
    electromagnets: ElectromagnetsSection
    sensors: SensorsSection
    groups: GroupsSection
    coils: ChannelsSection
    supply: SupplySection
    limits: LimitsSection
    workspace: WorkspaceSection
    end_stop: EndStopSection
    thermometer: ThermometerSection
    hand: GripSection
    rotor: RotorSection
    regulator: RegulatorSection | None = None

    def built(self, assumed: dict[str, str], digest: str, *, override: bool = False) -> SphericalMotor:
        """The device that this file describes; DeviceError with all findings unless they are overridden."""
        count = sum(ring.count for ring in self.electromagnets.rings)
        groups, wrong = grouping(self.groups.coils, count, self.groups.winding)
        if wrong:
            raise DeviceError("\n".join(f"device '{self.name}': {line}" for line in wrong))
        motor = self._motor(assumed, digest, groups)
        found = findings(motor, self.groups.coils, antipodal=self.groups.antipodal)
        if found and not override:
            lines = "\n".join(f"device '{self.name}': {line}" for line in found)
            raise DeviceError(f"{lines}\ncorrect the file, or load it with override=True to study it as it is")
        return replace(motor, findings=tuple(found))

    def _motor(self, assumed: dict[str, str], digest: str, groups: Array) -> SphericalMotor:
        m, e, s = self.magnets, self.electromagnets, self.sensors
        coil = Coil(e.turns, e.inner_radius, e.outer_radius, e.length)
        sensors = _layout(s.distance, s.rings)
        return SphericalMotor(
            name=self.name,
            title=self.title,
            source=self.source,
            coils=self._channels(coil, groups),
            supply=self.supply.built(),
            limits=self.limits.built(),
            assumed=assumed,
            digest=digest,
            magnets=_layout(m.distance, m.rings),
            polarity=m.signs(),
            magnet=CylinderMagnet(m.radius, m.length, m.polarization),
            electromagnets=_layout(e.distance, e.rings),
            electromagnet=coil,
            sensor_layout=sensors,
            hall=FieldSensors(sensors.positions, s.noise, s.step),
            hall_spread=HallQuality(s.gain, s.offset, s.cross),
            groups=groups,
            magnet_model=None if m.multipole is None else m.multipole.built(m.radius, m.length),
            coil_model=None if e.multipole is None else e.multipole.built(e.outer_radius, e.length),
            workspace_tilt=self.workspace.tilt,
            end_stop=EndStop(self.end_stop.stiffness, self.end_stop.damping),
            thermometer_step=self.thermometer.step,
            thermometer_noise=self.thermometer.noise,
            hand=Grasp(self.hand.mass, self.hand.stiffness, self.hand.damping, self.hand.radius),
            rotor=Rotor(**{**self.rotor.model_dump(), "inertia": np.array(self.rotor.inertia)}),
            regulator=self._regulator(),
        )

    def _channels(self, coil: Coil, groups: Array) -> Coils:
        """Series resistance and inductance; the coils of a group are too far apart to share flux worth counting."""
        in_series = np.abs(groups).sum(axis=0)
        many = len(in_series)
        return Coils(
            names=tuple(f"u{number}" for number in range(1, many + 1)),
            resistance=in_series * coil.resistance(self.electromagnets.fill),
            inductance=in_series * coil.inductance,
            current_limit=np.full(many, self.coils.current_limit),
            temperature_coefficient=self.coils.temperature_coefficient,
            reference_temperature=self.coils.reference_temperature,
            heat=self.coils.heat.built(),
        )

    def _regulator(self) -> Regulator | None:
        if self.regulator is None:
            return None
        stator, rotor = self.regulator.stator, self.regulator.rotor
        # tilts of |ψ| and |λ| add up at the corners of the workspace
        corner = float(np.arccos(np.cos(self.workspace.tilt) ** 2))
        return Regulator(stator.built(), stator.height, rotor.built(), rotor.height, 1.05 * corner)


def _layout(distance: float, rings: Any) -> Layout:
    return Layout.of_rings(distance, [ring.built() for ring in rings])
