"""Standard uncertainties that every kind of device has: of what turns a wanted current into a force.

The classes are the sections of the device file and what a device carries: `ToolUncertainty()` has the defaults. Values
are standard uncertainties in the sense of the GUM (JCGM 100): one standard deviation of the value's distribution.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from haptorb.devices.schema import key as m
from haptorb.devices.schema import quantity as q
from haptorb.devices.schema.sections import Section

__all__ = ["ChainUncertainty", "Share"]

#: A relative standard uncertainty; beyond 0.3 a value is not known, and a normal distribution reaches below zero.
Share = Annotated[q.Number, Field(ge=0, le=0.3)]


class ChainUncertainty(Section):
    """Keys of [uncertainty] for every kind of device."""

    current_gain: Annotated[
        Share, m.Meaning("gain of each current sensor, relative"), Field(default=0.006, validate_default=True)
    ]
    resistance: Annotated[
        Share,
        m.Meaning("resistance of each channel at the reference temperature, relative"),
        Field(default=0.02, validate_default=True),
    ]
    supply: Annotated[
        Share,
        m.Meaning("voltage that reaches the coils under load, relative"),
        Field(default=0.02, validate_default=True),
    ]
    magnet_temperature: Annotated[
        q.TemperatureStep,
        m.Meaning("temperature of the mover's magnets relative to the reference temperature of their remanence"),
        Field(default="3 delta_degC", validate_default=True, ge=0, le=100),
    ]
    remanence_drift: Annotated[
        q.InverseKelvin,
        m.Meaning("relative change of the remanence per kelvin, which turns magnet_temperature into a force"),
        Field(default="-1.2e-3 / K", validate_default=True, ge=-0.02, le=0.02),
    ]

    def is_stated(self, key: str) -> bool:
        """Whether the device file has `key`; else its value is the default."""
        return key in self.model_fields_set
