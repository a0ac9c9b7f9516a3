"""Field sensors on a stator: where they are, and how finely they read."""

from __future__ import annotations

from dataclasses import dataclass, field

from haptorb.devices.sensor_errors import SensorErrors
from haptorb.numerics.arrays import Array

__all__ = ["FieldSensors"]


@dataclass(frozen=True)
class FieldSensors:
    """Three-axis field sensors fixed to the stator."""

    positions: Array  #: (k, 3) [m]
    noise: float  #: standard deviation of one reading [T]
    step: float  #: quantum of one reading [T]
    errors: SensorErrors = field(default_factory=SensorErrors)  #: how the sensors differ from ideal ones
    warming: float = 0.0  #: their temperature rise as a share of the coils' rise at the boundary
