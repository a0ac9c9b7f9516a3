"""Field sensors on a stator: where they are, and how finely they read."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from haptorb.devices.sensor_errors import SensorErrors
from haptorb.numerics.arrays import Array

__all__ = ["FieldSensors", "SensorCorrection"]


@dataclass(frozen=True)
class SensorCorrection:
    """What a calibration found of the k field sensors of one device: field = gain (reading − offset − per_ampere i).

    gain         (k, 3, 3) field per reading: gain, cross-axis and rotation together
    offset       (k, 3) reading without currents and without a tool [T]
    per_ampere   (k, 3, m) reading per ampere in each coil [T/A]
    used         (k,) False: the sensor has failed; it is left out
    uncertainty  standard deviation of the lasting error that is left in one reading of the tool [T]
    """

    gain: Array
    offset: Array
    per_ampere: Array
    used: NDArray[np.bool_]
    uncertainty: float


@dataclass(frozen=True)
class FieldSensors:
    """Three-axis field sensors fixed to the stator."""

    positions: Array  #: (k, 3) [m]
    noise: float  #: standard deviation of one reading [T]
    step: float  #: quantum of one reading [T]
    errors: SensorErrors = field(default_factory=SensorErrors)  #: how the sensors differ from ideal ones
    warming: float = 0.0  #: their temperature rise as a share of the coils' rise at the boundary
    correction: SensorCorrection | None = None  #: what a calibration found; `positions` are then the calibrated ones
