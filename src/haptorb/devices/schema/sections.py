"""What every device file may say, section by section; each kind of device adds its own sections to these."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from annotated_types import Gt, Len
from pydantic import BaseModel, ConfigDict, Field, model_validator

from haptorb.devices.device import CONTACT_RATE, HANDOVER, Coils, Heat, Limits, Supply
from haptorb.devices.schema import key as m
from haptorb.devices.schema import quantity as q

__all__ = [
    "RIGHT_ANGLE",
    "BasedOn",
    "CommonFile",
    "Count",
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
RIGHT_ANGLE = q.si("90 deg", "rad", "an angle")  #: rounded as every value is, so that "90 deg" is not beyond it [rad]
Name = Annotated[
    str,
    Field(pattern=r"^[a-z][a-z0-9-]*$", max_length=64),
    m.Form("a lower-case letter, then at most 63 of them, digits and hyphens"),
]  #: it becomes part of files' names
Count = Annotated[int, Field(ge=1, le=1000, strict=True)]
Text = Annotated[
    str, Field(pattern=r"^[^\x00-\x1f\x7f-\x9f]*$", max_length=400), m.Form("one line, at most 400 characters")
]  #: one line
Point = Annotated[tuple[q.Length, ...], Len(3, 3)]
BasedOn = Annotated[
    str | None,
    m.Meaning("base device, whose values are used for missing keys"),
    m.Form("name in the catalogue, or path of a device file"),
    m.Without("none"),
]


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

    winding_capacity: Annotated[q.HeatCapacity, Positive, m.Meaning("heat capacity of one channel's winding")]
    body_capacity: Annotated[
        q.HeatCapacity, Positive, m.Meaning("heat capacity of the parts around the winding: former, core, housing")
    ]
    winding_to_body: Annotated[q.Conductance, Positive, m.Meaning("heat conductance from winding to body")]
    body_to_air: Annotated[q.Conductance, Positive, m.Meaning("heat conductance from body to the air")]
    ambient: Annotated[q.Temperature, Positive, m.Meaning("temperature of the room"), m.Form("> 0 K, below warn")]
    warn: Annotated[
        q.Temperature,
        Positive,
        m.Meaning("winding temperature for the warning"),
        m.Form("between ambient and derate"),
    ]
    derate: Annotated[
        q.Temperature,
        Positive,
        m.Meaning("winding temperature from which the currents are reduced"),
        m.Form("between warn and stop"),
    ]
    stop: Annotated[
        q.Temperature,
        Positive,
        m.Meaning("winding temperature at which the coils are switched off"),
        m.Form("above derate"),
    ]

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

    names: Annotated[
        tuple[Annotated[Text, Len(1, 40)], ...],
        Len(1, 100),
        m.Meaning("name of each coil; their number is the number of channels"),
        m.Form("1 to 40 characters each, all different"),
    ]
    resistance: Annotated[
        tuple[Annotated[q.Resistance, Positive], ...],
        m.Meaning("resistance of each coil at the reference temperature, one per name"),
    ]
    inductance: Annotated[
        tuple[Annotated[q.Inductance, Positive], ...], m.Meaning("inductance of each coil, one per name")
    ]
    current_limit: Annotated[
        tuple[Annotated[q.Current, Positive], ...],
        m.Meaning("maximum commanded current in each coil, one per name"),
        m.Form("> 0, at most 10 times what the supply drives"),
    ]
    temperature_coefficient: Annotated[
        q.InverseKelvin, m.Meaning("relative change of resistance per kelvin; copper: 3.93e-3 / K")
    ]
    reference_temperature: Annotated[
        q.Temperature, Positive, m.Meaning("reference temperature of the resistances"), m.Form("> 0 K")
    ]
    heat: Annotated[HeatSection, m.Meaning("thermal model of one channel, equal for all: winding, body, air")]

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

    voltage: Annotated[q.Voltage, Positive, m.Meaning("voltage of the supply that drives the coils")]
    duty_bits: Annotated[
        int, Field(ge=1, le=24, strict=True), m.Meaning("resolution of the duty cycle's magnitude in bits")
    ]
    current_noise: Annotated[q.Current, Field(ge=0), m.Meaning("standard deviation of one current reading")]
    current_step: Annotated[q.Current, Field(ge=0), m.Meaning("resolution of a current reading")]
    power: Annotated[
        q.Power | None,
        Positive,
        m.Meaning("maximum power of the supply for all coils together, with windings at the stop temperature"),
        m.Without("no limit"),
    ] = None

    def build(self) -> Supply:
        """As the device has it."""
        values = self.model_dump()
        return Supply(**{**values, "power": np.inf if self.power is None else self.power})


class LimitsSection(Section):
    """[limits]"""

    force: Annotated[
        q.Force,
        Positive,
        m.Meaning("maximum force that the guard allows"),
        m.Form("> 0, at most 100 times what the coils of an electromagnet give"),
    ]
    torque: Annotated[
        q.Torque,
        Positive,
        m.Meaning("maximum torque that the guard allows"),
        m.Form("> 0, at most 100 times what the coils give"),
    ]
    slew: Annotated[q.Slew, Positive, m.Meaning("maximum slew rate of a channel's current")]
    expiry: Annotated[q.Duration, Positive, m.Meaning("maximum age of a pose at which force is allowed")]
    force_rate: Annotated[
        q.ForceRate | None,
        Positive,
        m.Meaning("maximum rate of a client's force, and of the force while another world takes over"),
        m.Without("150 N/s, a contact of 500 N/m at 0.3 m/s; more where `force` / 20 ms is more"),
    ] = None
    torque_rate: Annotated[
        q.TorqueRate | None,
        Positive,
        m.Meaning("maximum rate of the torque that a client's force causes, and while another world takes over"),
        m.Without("`torque` / 20 ms, the time in which the force of a lost client fades"),
    ] = None

    def build(self) -> Limits:
        """As the device has it."""
        values = self.model_dump()
        force_rate = self.force_rate or max(CONTACT_RATE, self.force / HANDOVER)
        return Limits(**{**values, "force_rate": force_rate, "torque_rate": self.torque_rate or self.torque / HANDOVER})


class ThermometerSection(Section):
    """[thermometer]"""

    step: Annotated[q.TemperatureStep, Field(ge=0), m.Meaning("resolution of a coil thermometer")]
    noise: Annotated[q.TemperatureStep, Field(ge=0), m.Meaning("standard deviation of one reading")]


class CommonFile(Section):
    """What every device file has."""

    name: Annotated[Name, m.Meaning("short name of the device; recordings and calibrations refer to it")]
    title: Annotated[Text, m.Meaning("title of the device")]
    source: Annotated[Text, m.Meaning("where the values come from")]
    coils: Annotated[CoilsSection, m.Meaning("electrical data of the coils")]
    supply: Annotated[SupplySection, m.Meaning("supply of the coils")]
    limits: Annotated[LimitsSection, m.Meaning("limits that the guard enforces")]

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
