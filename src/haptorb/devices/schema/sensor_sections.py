"""Keys that every table of field sensors has: how finely they read, and how they differ from ideal ones."""

from __future__ import annotations

from typing import Annotated

from annotated_types import Ge, Len

from haptorb.devices.schema import key as m
from haptorb.devices.schema import quantity as q
from haptorb.devices.schema.sections import Point, Section
from haptorb.devices.sensor_errors import SensorErrors

__all__ = ["FieldSensorsSection", "SensorQualitySection"]


class SensorQualitySection(Section):
    """What [hall] and [sensors] have in common; a device file without an error's key has sensors without that error."""

    noise: Annotated[q.Polarization, Ge(0), m.Meaning("standard deviation of one reading, each axis")]
    step: Annotated[q.Polarization, Ge(0), m.Meaning("resolution of a reading")]
    gain: Annotated[
        q.Number, Ge(0), m.Meaning("standard deviation of the relative gain error from sensor to sensor")
    ] = 0.0
    offset: Annotated[q.Polarization, Ge(0), m.Meaning("standard deviation of the offset from sensor to sensor")] = 0.0
    cross: Annotated[q.Number, Ge(0), m.Meaning("standard deviation of the cross-axis sensitivity")] = 0.0
    gain_drift: Annotated[
        q.InverseKelvin, Ge(0), m.Meaning("standard deviation of the relative change of gain per kelvin")
    ] = 0.0
    offset_drift: Annotated[q.FieldDrift, Ge(0), m.Meaning("standard deviation of the change of offset per kelvin")] = (
        0.0
    )
    placement: Annotated[q.Length, Ge(0), m.Meaning("standard deviation of a sensor's position, each coordinate")] = 0.0
    angle: Annotated[q.Angle, Ge(0), m.Meaning("standard deviation of a sensor's rotation about each axis")] = 0.0
    warming: Annotated[
        q.Number, Ge(0), m.Meaning("temperature rise of the sensors as a share of the coils' rise at their boundary")
    ] = 0.0

    def errors(self) -> SensorErrors:
        """As the device has them."""
        return SensorErrors(
            self.gain, self.offset, self.cross, self.gain_drift, self.offset_drift, self.placement, self.angle
        )


class FieldSensorsSection(SensorQualitySection):
    """[hall]"""

    positions: Annotated[
        tuple[Point, ...],
        Len(0, 100),
        m.Meaning("position of each three-axis field sensor, stator frame, in the order of their numbers"),
        m.Form("0 to 100 positions x, y, z outside the core"),
    ]
