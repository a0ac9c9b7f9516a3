"""What every device file may say, section by section; each kind of device adds its own sections to these."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from annotated_types import Gt, Len
from pydantic import BaseModel, ConfigDict, Field, model_validator

from haptorb.devices.device import Coils, Heat, Limits, Supply
from haptorb.devices.schema import quantity as q

__all__ = [
    "CommonFile",
    "Count",
    "FieldSensorsSection",
    "HeatSection",
    "LimitsSection",
    "Name",
    "Point",
    "Positive",
    "Section",
    "SupplySection",
    "Text",
    "ThermometerSection",
    "check_wall",
]

Positive = Gt(0)
Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9-]*$", max_length=64)]  #: it becomes part of files' names
Count = Annotated[int, Field(ge=1, le=1000, strict=True)]
Text = Annotated[str, Field(pattern=r"^[^\x00-\x1f\x7f-\x9f]*$", max_length=400)]  #: one line
Point = Annotated[tuple[q.Length, ...], Len(3, 3)]


def check_wall(inner_radius: float, outer_radius: float) -> None:
    """ValueError unless a ring of these radii [m] has a wall."""
    if inner_radius >= outer_radius:
        raise ValueError(
            f"inner_radius ({inner_radius * 1e3:g} mm) must be smaller than outer_radius ({outer_radius * 1e3:g} mm)"
        )


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
    def _check_order(self) -> HeatSection:
        if not self.ambient < self.warn < self.derate < self.stop:
            raise ValueError("must have ambient < warn < derate < stop")
        return self

    def build(self) -> Heat:
        """As the device has it."""
        return Heat(**self.model_dump())


class CoilsSection(Section):
    """[coils]"""

    names: Annotated[tuple[Annotated[Text, Len(1, 40)], ...], Len(1, 100)]
    resistance: tuple[Annotated[q.Resistance, Positive], ...]
    inductance: tuple[Annotated[q.Inductance, Positive], ...]
    current_limit: tuple[Annotated[q.Current, Positive], ...]
    temperature_coefficient: q.InverseKelvin
    reference_temperature: Annotated[q.Temperature, Positive]
    heat: HeatSection

    @model_validator(mode="after")
    def _check_lengths(self) -> CoilsSection:
        for key in ("resistance", "inductance", "current_limit"):
            count = len(getattr(self, key))
            if count != len(self.names):
                raise ValueError(f"has {len(self.names)} names but {count} values of {key}")
        if len(set(self.names)) != len(self.names):
            raise ValueError("has a duplicate name")
        return self

    def build(self) -> Coils:
        """As the device has it."""
        return Coils(
            names=self.names,
            resistance=np.array(self.resistance),
            inductance=np.array(self.inductance),
            current_limit=np.array(self.current_limit),
            temperature_coefficient=self.temperature_coefficient,
            reference_temperature=self.reference_temperature,
            heat=self.heat.build(),
        )


class SupplySection(Section):
    """[supply]"""

    voltage: Annotated[q.Voltage, Positive]
    duty_bits: Annotated[int, Field(ge=1, le=24, strict=True)]
    current_noise: Annotated[q.Current, Field(ge=0)]
    current_step: Annotated[q.Current, Field(ge=0)]

    def build(self) -> Supply:
        """As the device has it."""
        return Supply(**self.model_dump())


class LimitsSection(Section):
    """[limits]"""

    force: Annotated[q.Force, Positive]
    torque: Annotated[q.Torque, Positive]
    slew: Annotated[q.Slew, Positive]
    expiry: Annotated[q.Duration, Positive]

    def build(self) -> Limits:
        """As the device has it."""
        return Limits(**self.model_dump())


class FieldSensorsSection(Section):
    """[hall]"""

    positions: Annotated[tuple[Point, ...], Len(0, 100)]
    noise: Annotated[q.Polarization, Field(ge=0)]
    step: Annotated[q.Polarization, Field(ge=0)]


class ThermometerSection(Section):
    """[thermometer]"""

    step: Annotated[q.TemperatureStep, Field(ge=0)]
    noise: Annotated[q.TemperatureStep, Field(ge=0)]


class CommonFile(Section):
    """What every device file has."""

    name: Name
    title: Text
    source: Text
    coils: CoilsSection
    supply: SupplySection
    limits: LimitsSection

    def common(self) -> dict[str, Any]:
        """The parts that every Device takes."""
        return {
            "name": self.name,
            "title": self.title,
            "source": self.source,
            "coils": self.coils.build(),
            "supply": self.supply.build(),
            "limits": self.limits.build(),
        }
