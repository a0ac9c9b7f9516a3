"""What a device file may say, section by section; each kind of device adds its own sections to these."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Gt, Len
from pydantic import BaseModel, ConfigDict, Field, model_validator

from haptorb.devices import quantity as q
from haptorb.devices.device import Coils, Heat, Limits, Supply
from haptorb.devices.electromagnet import Contact, FieldSensors, Hand, SphericalElectromagnet, Tool
from haptorb.devices.marks import Marks
from haptorb.devices.windings import Windings

__all__ = ["ElectromagnetFile", "Section"]

Positive = Gt(0)
_SPREAD = 1e-3  #: marks nearer to a common line than this cannot hold a frame [m]
Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9-]*$")]
Row3 = Annotated[tuple[q.MomentPerCurrent, ...], Len(3, 3)]
Point = Annotated[tuple[q.Length, ...], Len(3, 3)]


class Section(BaseModel):
    """A table of the file: no unknown keys, nothing changed after reading."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class HeatSection(Section):
    """[coils.heat]"""

    winding_capacity: Annotated[q.HeatCapacity, Positive]
    body_capacity: Annotated[q.HeatCapacity, Positive]
    winding_to_body: Annotated[q.Conductance, Positive]
    body_to_air: Annotated[q.Conductance, Positive]
    ambient: Annotated[q.Temperature, Positive]
    warn: Annotated[q.Temperature, Positive]
    derate: Annotated[q.Temperature, Positive]
    stop: Annotated[q.Temperature, Positive]

    @model_validator(mode="after")
    def _in_order(self) -> HeatSection:
        if not self.ambient < self.warn < self.derate < self.stop:
            raise ValueError("must have ambient < warn < derate < stop")
        return self

    def built(self) -> Heat:
        """As the device has it."""
        return Heat(**self.model_dump())


class CoilsSection(Section):
    """[coils]"""

    names: Annotated[tuple[str, ...], Len(1)]
    resistance: tuple[Annotated[q.Resistance, Positive], ...]
    inductance: tuple[Annotated[q.Inductance, Positive], ...]
    current_limit: tuple[Annotated[q.Current, Positive], ...]
    temperature_coefficient: q.InverseKelvin
    reference_temperature: Annotated[q.Temperature, Positive]
    heat: HeatSection

    @model_validator(mode="after")
    def _one_each(self) -> CoilsSection:
        for key in ("resistance", "inductance", "current_limit"):
            count = len(getattr(self, key))
            if count != len(self.names):
                raise ValueError(f"has {len(self.names)} names but {count} values of {key}")
        if len(set(self.names)) != len(self.names):
            raise ValueError("has a name twice")
        return self

    def built(self) -> Coils:
        """As the device has it."""
        return Coils(
            names=self.names,
            resistance=np.array(self.resistance),
            inductance=np.array(self.inductance),
            current_limit=np.array(self.current_limit),
            temperature_coefficient=self.temperature_coefficient,
            reference_temperature=self.reference_temperature,
            heat=self.heat.built(),
        )


class SupplySection(Section):
    """[supply]"""

    voltage: Annotated[q.Voltage, Positive]
    duty_bits: Annotated[int, Field(ge=1, le=24)]
    current_noise: Annotated[q.Current, Field(ge=0)]
    current_step: Annotated[q.Current, Field(ge=0)]

    def built(self) -> Supply:
        """As the device has it."""
        return Supply(**self.model_dump())


class LimitsSection(Section):
    """[limits]"""

    force: Annotated[q.Force, Positive]
    torque: Annotated[q.Torque, Positive]
    slew: Annotated[q.Slew, Positive]
    expiry: Annotated[q.Duration, Positive]

    def built(self) -> Limits:
        """As the device has it."""
        return Limits(**self.model_dump())


class FieldSensorsSection(Section):
    """[hall]"""

    positions: tuple[Point, ...]
    noise: Annotated[q.Polarization, Field(ge=0)]
    step: Annotated[q.Polarization, Field(ge=0)]


class CommonFile(Section):
    """What every device file has."""

    name: Name
    title: str
    source: str
    coils: CoilsSection
    supply: SupplySection
    limits: LimitsSection

    def common(self) -> dict[str, Any]:
        """The parts that every Device takes."""
        return {
            "name": self.name,
            "title": self.title,
            "source": self.source,
            "coils": self.coils.built(),
            "supply": self.supply.built(),
            "limits": self.limits.built(),
        }


class ElectromagnetSection(Section):
    """[electromagnet]"""

    moment_per_current: Annotated[tuple[Row3, ...], Len(3, 3)]
    core_radius: Annotated[q.Length, Positive]
    core_permeability: Annotated[q.Number, Gt(1)]


class DomeSection(Section):
    """[dome]"""

    radius: Annotated[q.Length, Positive]
    shell_thickness: Annotated[q.Length, Positive]
    workspace_half_angle: Annotated[q.Angle, Positive]
    stiffness: Annotated[q.Stiffness, Positive]
    damping: Annotated[q.Damping, Field(ge=0)]
    friction: Annotated[q.Number, Field(ge=0)]


class ToolSection(Section):
    """[tool]"""

    outer_radius: Annotated[q.Length, Positive]
    inner_radius: Annotated[q.Length, Field(ge=0)]
    length: Annotated[q.Length, Positive]
    remanence: Annotated[q.Polarization, Positive]
    tip_distance: Annotated[q.Length, Positive]
    mass: Annotated[q.Mass, Positive]
    inertia: Annotated[tuple[Annotated[q.Inertia, Positive], ...], Len(3, 3)]

    @model_validator(mode="after")
    def _ring(self) -> ToolSection:
        if self.inner_radius >= self.outer_radius:
            raise ValueError(
                f"inner_radius ({self.inner_radius * 1e3:g} mm) must be smaller than outer_radius "
                f"({self.outer_radius * 1e3:g} mm)"
            )
        if self.tip_distance < self.length / 2:
            raise ValueError(f"tip_distance must be at least half the magnet's length ({self.length * 500:g} mm)")
        return self


class HandSection(Section):
    """[hand]"""

    mass: Annotated[q.Mass, Field(ge=0)]
    damping: Annotated[q.Damping, Positive]
    stiffness: Annotated[q.Stiffness, Positive]
    turn_damping: Annotated[q.TurnDamping, Positive]
    turn_stiffness: Annotated[q.TurnStiffness, Positive]


class WindingsSection(Section):
    """[windings]"""

    turns: Annotated[tuple[Annotated[q.Number, Positive], ...], Len(3, 3)]
    inner_radius: Annotated[tuple[Annotated[q.Length, Positive], ...], Len(3, 3)]
    outer_radius: Annotated[tuple[Annotated[q.Length, Positive], ...], Len(3, 3)]
    length: Annotated[tuple[Annotated[q.Length, Positive], ...], Len(3, 3)]

    def built(self) -> Windings:
        """As the device has it."""
        return Windings(*(np.array(part) for part in (self.turns, self.inner_radius, self.outer_radius, self.length)))


class MarksSection(Section):
    """[marks]"""

    names: Annotated[tuple[Name, ...], Len(3)]
    positions: Annotated[tuple[Point, ...], Len(3)]

    @model_validator(mode="after")
    def _apart(self) -> MarksSection:
        if len(self.names) != len(self.positions):
            raise ValueError(f"has {len(self.names)} names but {len(self.positions)} positions")
        if len(set(self.names)) != len(self.names):
            raise ValueError("has a name twice")
        places = np.array(self.positions)
        spread = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
        if spread[1] < _SPREAD:
            raise ValueError("must not lie on one line: a frame could turn about it")
        return self

    def built(self) -> Marks:
        """As the device has it."""
        return Marks(self.names, np.array(self.positions))


class ThermometerSection(Section):
    """[thermometer]"""

    step: Annotated[q.TemperatureStep, Field(ge=0)]
    noise: Annotated[q.TemperatureStep, Field(ge=0)]


class ElectromagnetFile(CommonFile):
    """A file of kind "spherical-electromagnet"."""

    kind: Literal["spherical-electromagnet"]
    based_on: str | None = None
    electromagnet: ElectromagnetSection
    dome: DomeSection
    tool: ToolSection
    hand: HandSection
    hall: FieldSensorsSection
    thermometer: ThermometerSection
    windings: WindingsSection | None = None
    marks: MarksSection | None = None

    @model_validator(mode="after")
    def _clear(self) -> ElectromagnetFile:
        if self.windings is None:
            return self
        core, dome = self.electromagnet.core_radius, self.dome.radius
        sizes = zip(self.coils.names, self.windings.inner_radius, self.windings.outer_radius, strict=True)
        for name, inner, outer in sizes:
            if not core < inner < outer < dome:
                raise ValueError(
                    f"windings of coil '{name}' reach from {inner * 1e3:g} to {outer * 1e3:g} mm; they must lie "
                    f"between the core ({core * 1e3:g} mm) and the dome ({dome * 1e3:g} mm), the inner radius first"
                )
        return self

    @model_validator(mode="after")
    def _fits(self) -> ElectromagnetFile:
        if len(self.coils.names) != 3:
            raise ValueError(f"coils.names must be three for a spherical electromagnet; got {len(self.coils.names)}")
        if self.dome.radius <= self.electromagnet.core_radius:
            raise ValueError(
                f"dome.radius ({self.dome.radius * 1e3:g} mm) must be greater than electromagnet.core_radius "
                f"({self.electromagnet.core_radius * 1e3:g} mm)"
            )
        moments = np.array(self.electromagnet.moment_per_current)
        if np.linalg.cond(moments) > 100:
            raise ValueError("electromagnet.moment_per_current is (nearly) singular: two coils do the same")
        return self

    def built(self, assumed: dict[str, str], digest: str, *, override: bool = False) -> SphericalElectromagnet:
        """The device that this file describes; there are no findings to override beyond wrong values."""
        dome, hall = self.dome, self.hall
        tool = self.tool.model_dump()
        tool["inertia"] = np.array(tool["inertia"])
        return SphericalElectromagnet(
            **self.common(),
            assumed=assumed,
            digest=digest,
            moment_per_current=np.array(self.electromagnet.moment_per_current),
            core_radius=self.electromagnet.core_radius,
            core_permeability=self.electromagnet.core_permeability,
            dome_radius=dome.radius,
            shell_thickness=dome.shell_thickness,
            workspace_half_angle=dome.workspace_half_angle,
            tool=Tool(**tool),
            hand=Hand(**self.hand.model_dump()),
            contact=Contact(dome.stiffness, dome.damping, dome.friction),
            hall=FieldSensors(np.array(hall.positions).reshape(-1, 3), hall.noise, hall.step),
            thermometer_step=self.thermometer.step,
            thermometer_noise=self.thermometer.noise,
            windings=None if self.windings is None else self.windings.built(),
            marks=None if self.marks is None else self.marks.built(),
        )
