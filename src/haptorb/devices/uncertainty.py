"""Standard uncertainties common to all kinds of device, from commanded current to force.

The classes are the sections of the device file and what a device carries: `ToolUncertainty()` has the defaults. Values
are standard uncertainties in the sense of the GUM (JCGM 100): one standard deviation of the value's distribution.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from haptorb.devices import quantity as q
from haptorb.devices import schema as m
from haptorb.devices.schema import Section

__all__ = [
    "ArrayUncertainty",
    "ChainUncertainty",
    "ElectromagnetTolerance",
    "MotorTolerance",
    "MotorUncertainty",
    "Share",
    "ToolUncertainty",
]


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


# --------------------------------------------------------------------------------------------------
# Standard uncertainties of a spherical electromagnet: [uncertainty] of its file.


class ToolUncertainty(ChainUncertainty):
    """[uncertainty] of a spherical electromagnet; `ToolUncertainty()` has the defaults.

    >>> ToolUncertainty().place, ToolUncertainty(place="0.1 mm").place
    (0.0003, 0.0001)
    """

    current_offset: Annotated[
        q.Current,
        m.Meaning("offset of each current sensor"),
        Field(default="5 mA", validate_default=True, ge=0, le=10),
    ]
    remanence: Annotated[
        Share, m.Meaning("remanence of the tool's magnet, relative"), Field(default=0.012, validate_default=True)
    ]
    moments: Annotated[
        Share,
        m.Meaning("each component of a coil's moment per ampere, as a share of that moment; a calibration replaces it"),
        Field(default=0.01, validate_default=True),
    ]
    place: Annotated[
        q.Length,
        m.Meaning("tracked position of the tool's magnet, along each axis, including the tracker's frame"),
        Field(default="0.3 mm", validate_default=True, ge=0, le=0.005),
    ]
    axis: Annotated[
        q.Angle,
        m.Meaning("tracked direction of the tool, about each axis across it"),
        Field(default="0.3 deg", validate_default=True, ge=0, le=0.2),
    ]
    core_place: Annotated[
        q.Length,
        m.Meaning("position of core and coils in the stator's frame, along each axis"),
        Field(default="0.1 mm", validate_default=True, ge=0, le=0.005),
    ]
    core_radius: Annotated[
        q.Length,
        m.Meaning("radius of the core"),
        Field(default="0.05 mm", validate_default=True, ge=0, le=0.002),
    ]


# --------------------------------------------------------------------------------------------------
# Manufacturing tolerances of a spherical electromagnet: [tolerance] of its file.


class ElectromagnetTolerance(Section):
    """[tolerance] of a spherical electromagnet; `ElectromagnetTolerance()` has the defaults.

    Standard deviations; the built device is uniformly distributed within √3 of them.

    >>> ElectromagnetTolerance().position
    0.00017
    """

    winding: Annotated[
        q.Length,
        m.Meaning("inner radius, outer radius and length of each winding"),
        Field(default="0.17 mm", validate_default=True, ge=0, le=0.003),
    ]
    position: Annotated[
        q.Length,
        m.Meaning("centre of each winding, along each axis"),
        Field(default="0.17 mm", validate_default=True, ge=0, le=0.003),
    ]
    tilt: Annotated[
        q.Angle,
        m.Meaning("axis of each winding, about each axis across it, where the moments per ampere were not measured"),
        Field(default="0.58 deg", validate_default=True, ge=0, le=0.2),
    ]
    turns: Annotated[
        Share,
        m.Meaning("turns of each winding, relative, where the moments per ampere were not measured"),
        Field(default=0.006, validate_default=True),
    ]
    turns_per_layer: Annotated[
        q.Number,
        m.Meaning("turns of each layer of a winding"),
        Field(default=0.58, validate_default=True, ge=0, le=10),
    ]
    core_position: Annotated[
        q.Length,
        m.Meaning("centre of the core, along each axis"),
        Field(default="0.115 mm", validate_default=True, ge=0, le=0.003),
    ]
    core_shape: Annotated[
        q.Number,
        m.Meaning("each semi-axis of the core, relative"),
        Field(default=0.003, validate_default=True, ge=0, le=0.05),
    ]
    core_permeability: Annotated[
        tuple[q.Number, q.Number],
        m.Meaning("minimum and maximum relative permeability of the core, uniformly distributed in their logarithm"),
        m.Form("above 1, least first"),
        m.Without("200 and 5000"),
        Field(default=(200.0, 5000.0)),
    ]
    earth_field: Annotated[
        q.Polarization,
        m.Meaning("size of the uniform field in which the device stands, in any direction"),
        Field(default="50 µT", validate_default=True, ge=0, le=1e-3),
    ]

    @model_validator(mode="after")
    def _order(self) -> ElectromagnetTolerance:
        low, high = self.core_permeability
        if not 1.0 < low <= high < float("inf"):
            raise ValueError(f"core_permeability must be two finite numbers above 1, least first; got {low}, {high}")
        return self


# --------------------------------------------------------------------------------------------------
# Manufacturing tolerances of a spherical motor: [tolerance] of its file.


class MotorTolerance(Section):
    """[tolerance] of a spherical motor; `MotorTolerance()` has the defaults.

    Standard deviations; the built device is uniformly distributed within √3 of them.

    >>> MotorTolerance().position
    0.00017
    """

    winding: Annotated[
        q.Length,
        m.Meaning("inner radius, outer radius and length of each coil"),
        Field(default="0.17 mm", validate_default=True, ge=0, le=0.003),
    ]
    position: Annotated[
        q.Length,
        m.Meaning("centre of each coil, along each axis"),
        Field(default="0.17 mm", validate_default=True, ge=0, le=0.003),
    ]
    tilt: Annotated[
        q.Angle,
        m.Meaning("axis of each coil, about each axis across it"),
        Field(default="0.58 deg", validate_default=True, ge=0, le=0.2),
    ]
    turns_per_layer: Annotated[
        q.Number,
        m.Meaning("turns of each layer of a coil"),
        Field(default=0.58, validate_default=True, ge=0, le=10),
    ]
    magnet_position: Annotated[
        q.Length,
        m.Meaning("centre of each magnet in the rotor, along each axis"),
        Field(default="0.058 mm", validate_default=True, ge=0, le=0.003),
    ]
    magnet_tilt: Annotated[
        q.Angle,
        m.Meaning("axis of each magnet, about each axis across it"),
        Field(default="0.29 deg", validate_default=True, ge=0, le=0.2),
    ]


# --------------------------------------------------------------------------------------------------
# Standard uncertainties of a spherical motor: [uncertainty] of its file.


class MotorUncertainty(ChainUncertainty):
    """[uncertainty] of a spherical motor; `MotorUncertainty()` has the defaults.

    >>> MotorUncertainty().coil
    0.0
    """

    current_offset: Annotated[
        q.Current,
        m.Meaning("offset of each current sensor"),
        Field(default="0.5 mA", validate_default=True, ge=0, le=1),
    ]
    polarization: Annotated[
        Share, m.Meaning("polarization, common to all magnets, relative"), Field(default=0.012, validate_default=True)
    ]
    polarization_spread: Annotated[
        Share, m.Meaning("polarization from magnet to magnet, relative"), Field(default=0.01, validate_default=True)
    ]
    coil: Annotated[
        Share,
        m.Meaning("torque per ampere of each coil, relative, beside what follows from [tolerance]"),
        Field(default=0.0, validate_default=True),
    ]
    regulator: Annotated[
        Share, m.Meaning("torque of the regulator, relative"), Field(default=0.03, validate_default=True)
    ]
    weight: Annotated[
        Share,
        m.Meaning("torque of the rotor's weight, relative: its mass times the height of its centre"),
        Field(default=0.02, validate_default=True),
    ]
    axis: Annotated[
        q.Angle,
        m.Meaning("orientation about each axis if measured by a tracker; field sensors have their own errors"),
        Field(default="0.3 deg", validate_default=True, ge=0, le=0.2),
    ]


# --------------------------------------------------------------------------------------------------
# Standard uncertainties of a coil array: [uncertainty] of its file. Tolerances of its coils are in [tolerance].


class ArrayUncertainty(ChainUncertainty):
    """[uncertainty] of a coil array; `ArrayUncertainty()` has the defaults.

    >>> ArrayUncertainty().place
    0.0003
    """

    current_offset: Annotated[
        q.Current,
        m.Meaning("offset of each current sensor"),
        Field(default="5 mA", validate_default=True, ge=0, le=10),
    ]
    remanence: Annotated[
        Share, m.Meaning("remanence, common to all magnets, relative"), Field(default=0.012, validate_default=True)
    ]
    place: Annotated[
        q.Length,
        m.Meaning("tracked position of the tool, along each axis, including the tracker's frame"),
        Field(default="0.3 mm", validate_default=True, ge=0, le=0.005),
    ]
    axis: Annotated[
        q.Angle,
        m.Meaning("tracked orientation of the tool, about each axis"),
        Field(default="0.3 deg", validate_default=True, ge=0, le=0.2),
    ]
