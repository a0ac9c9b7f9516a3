"""What the file of a spherical motor may say, and the device that it builds."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from haptorb.devices.device import Coils
from haptorb.devices.field_sensors import FieldSensors
from haptorb.devices.motor.handle import EndStop, Grasp
from haptorb.devices.motor.magnetics_schema import (
    ElectromagnetsSection,
    GroupsSection,
    MagnetsSection,
    SensorsSection,
    layout,
)
from haptorb.devices.motor.regulator import Regulator
from haptorb.devices.motor.rotor_schema import (
    EndStopSection,
    GripSection,
    RegulatorSection,
    RotorSection,
    WorkspaceSection,
)
from haptorb.devices.motor.spherical_motor import Rotor, SphericalMotor
from haptorb.devices.motor.validation import findings, grouping
from haptorb.devices.schema import key as m
from haptorb.devices.schema import quantity as q
from haptorb.devices.schema.limit_checks import list_limit_mistakes
from haptorb.devices.schema.sections import (
    BasedOn,
    HeatSection,
    LimitsSection,
    Name,
    Positive,
    Section,
    SupplySection,
    Text,
    ThermometerSection,
)
from haptorb.devices.uncertainty.motor import MotorUncertainty
from haptorb.errors import DeviceError
from haptorb.numerics.arrays import Array
from haptorb.physics.sources.coil import Coil
from haptorb.physics.sources.cylinder import CylinderMagnet

__all__ = ["MotorFile"]


class ChannelsSection(Section):
    """[coils]: what an electrician sees of a channel, all alike."""

    current_limit: Annotated[
        q.Current,
        Positive,
        m.Meaning("maximum commanded current in a channel"),
        m.Form("> 0, at most 10 times what the supply drives"),
    ]
    temperature_coefficient: Annotated[
        q.InverseKelvin, m.Meaning("relative change of resistance per kelvin; copper: 3.93e-3 / K")
    ]
    reference_temperature: Annotated[
        q.Temperature, Positive, m.Meaning("reference temperature of the resistances"), m.Form("> 0 K")
    ]
    heat: Annotated[HeatSection, m.Meaning("thermal model of one channel, equal for all: winding, body, air")]


class MotorFile(Section):
    """A file of kind "spherical-motor"."""

    kind: Annotated[Literal["spherical-motor"], m.Meaning("kind of device")]
    name: Annotated[Name, m.Meaning("short name of the device; recordings and calibrations refer to it")]
    title: Annotated[Text, m.Meaning("title of the device")]
    source: Annotated[Text, m.Meaning("where the values come from")]
    based_on: BasedOn = None
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
    uncertainty: Annotated[
        MotorUncertainty,
        m.Meaning("standard uncertainties of assumed or measured values, for `haptorb inspect --errors`"),
        m.Without("the defaults below"),
        Field(default_factory=MotorUncertainty),
    ]

    def build(self, assumed: dict[str, str], digest: str, *, override: bool = False) -> SphericalMotor:
        """The device that this file describes; DeviceError with all findings unless they are overridden."""
        count = sum(ring.count for ring in self.electromagnets.rings)
        groups, wrong = grouping(self.groups.coils, count, self.groups.winding)
        if wrong:
            raise DeviceError("\n".join(f"device '{self.name}': {line}" for line in wrong))
        motor = self._motor(assumed, digest, groups)
        found = findings(motor, self.groups.coils, antipodal=self.groups.antipodal)
        if found and not override:
            lines = "\n".join(f"device '{self.name}': {line}" for line in found)
            text = f"{lines}\ncorrect the file, or study it as it is"
            raise DeviceError(f"{text}: override=True", command=f"{text}: `haptorb inspect DEVICE --override`")
        if not found:  # a motor whose coils cancel has no torque to compare with
            wrong = list_limit_mistakes(motor.coils, motor.supply, motor.limits, 0.0, motor.greatest_torque)
        if wrong:
            raise DeviceError("\n".join(f"device '{self.name}': {line}" for line in wrong))
        return replace(motor, findings=tuple(found))

    def _motor(self, assumed: dict[str, str], digest: str, groups: Array) -> SphericalMotor:
        m, e, s = self.magnets, self.electromagnets, self.sensors
        coil = Coil(e.turns, e.inner_radius, e.outer_radius, e.length)
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
            hall=FieldSensors(sensors.positions, s.noise, s.step, s.errors(), s.warming),
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
            heat=self.coils.heat.build(),
        )

    def _regulator(self) -> Regulator | None:
        if self.regulator is None:
            return None
        stator, rotor = self.regulator.stator, self.regulator.rotor
        # tilts of |ψ| and |λ| add up at the corners of the workspace
        corner = float(np.arccos(np.cos(self.workspace.tilt) ** 2))
        return Regulator(stator.build(), stator.height, rotor.build(), rotor.height, 1.05 * corner)
