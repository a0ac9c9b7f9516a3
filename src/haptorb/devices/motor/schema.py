"""What the file of a spherical motor may say, and the device that it builds."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Literal

import numpy as np

from haptorb.devices.device import Coils
from haptorb.devices.field_sensors import FieldSensors
from haptorb.devices.motor.handle import EndStop, Grasp, HallQuality
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
from haptorb.devices.schema import quantity as q
from haptorb.devices.schema.sections import (
    HeatSection,
    LimitsSection,
    Name,
    Positive,
    Section,
    SupplySection,
    Text,
    ThermometerSection,
)
from haptorb.errors import DeviceError
from haptorb.numerics.arrays import Array
from haptorb.physics.sources.coil import Coil
from haptorb.physics.sources.cylinder import CylinderMagnet

__all__ = ["MotorFile"]


class ChannelsSection(Section):
    """[coils]: what an electrician sees of a channel, all alike."""

    current_limit: Annotated[q.Current, Positive]
    temperature_coefficient: q.InverseKelvin
    reference_temperature: Annotated[q.Temperature, Positive]
    heat: HeatSection


class MotorFile(Section):
    """A file of kind "spherical-motor"."""

    kind: Literal["spherical-motor"]
    name: Name
    title: Text
    source: Text
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
            raise DeviceError(f"{lines}\ncorrect the file, or load it with override=True to study it as it is")
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
            hall=FieldSensors(sensors.positions, s.noise, s.step),
            hall_spread=HallQuality(s.gain, s.offset, s.cross),
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
