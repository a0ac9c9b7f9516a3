"""Field sensors on a stator: positions, resolution and errors."""

from __future__ import annotations

from dataclasses import dataclass, fields
from dataclasses import field as dataclass_field

import numpy as np
from numpy.typing import NDArray

from haptorb.arrays import Array
from haptorb.errors import InputError

__all__ = ["FieldSensors", "SensorCorrection", "SensorErrors", "SensorSpecimen", "draw_sensors"]


# --------------------------------------------------------------------------------------------------
# How real field sensors differ from ideal ones: the distribution of each lasting error, as a device file states it.


@dataclass(frozen=True)
class SensorErrors:
    """Standard deviations of the lasting errors of each sensor; noise and step of a reading are the same for all.

    All errors are independent, normal and of mean zero: one draw per axis, per pair of axes for `cross`, and per
    coordinate for `placement` and `angle`. A sensor that reads the true field B at its place gives

        reading = offset + ΔT offset_drift + (1 + gain + ΔT gain_drift + cross) turn(angle) B(place + placement)

    Raises InputError for a deviation that is negative or not finite.

    >>> SensorErrors(gain=0.01, offset=5e-5, cross=0.005).placement
    0.0
    """

    gain: float = 0.0  #: relative
    offset: float = 0.0  #: [T]
    cross: float = 0.0  #: share of another axis that an axis reads as well
    gain_drift: float = 0.0  #: change of gain per kelvin above the temperature of calibration [1/K]
    offset_drift: float = 0.0  #: change of offset per kelvin above the temperature of calibration [T/K]
    placement: float = 0.0  #: distance of a sensor from its place, per coordinate [m]
    angle: float = 0.0  #: rotation of a sensor about each axis [rad]

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not (np.isfinite(value) and value >= 0):
                raise InputError(f"SensorErrors.{field.name} must be a standard deviation from 0 on; got {value!r}")


@dataclass(frozen=True)
class SensorSpecimen:
    """The lasting errors of the k sensors of one device, drawn from `SensorErrors`.

    mixing        (k, 3, 3) reading per field at the temperature of calibration: gain, cross-axis and angle together
    offset        (k, 3) [T]
    gain_drift    (k, 3) [1/K]
    offset_drift  (k, 3) [T/K]
    placement     (k, 3) from the nominal place [m]
    """

    mixing: Array
    offset: Array
    gain_drift: Array
    offset_drift: Array
    placement: Array


def draw_sensors(errors: SensorErrors, count: int, specimen: int = 0) -> SensorSpecimen:
    """The errors of `count` sensors of device number `specimen`: the same number, the same device.

    >>> drawn = draw_sensors(SensorErrors(offset=5e-5), 9)
    >>> drawn.mixing.shape, bool(2e-5 < drawn.offset.std() < 8e-5), bool((drawn.mixing == np.eye(3)).all())
    ((9, 3, 3), True, True)
    """
    draw = np.random.Generator(np.random.PCG64([specimen, 0xB]))
    # always the same number of draws, so that one kind of error does not change another
    scale = draw.standard_normal((count, 3, 3)) * np.where(np.eye(3, dtype=bool), errors.gain, errors.cross)
    offset, gain_drift, offset_drift, placement, turns = draw.standard_normal((5, count, 3))
    x, y, z = (errors.angle * turns).T
    zero = np.zeros(count)
    small = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    # the Cayley transform of a small rotation is a rotation exactly
    turn = np.linalg.solve(np.eye(3) - small / 2, np.eye(3) + small / 2)
    return SensorSpecimen(
        (np.eye(3) + scale) @ turn, errors.offset * offset, errors.gain_drift * gain_drift,
        errors.offset_drift * offset_drift, errors.placement * placement,
    )  # fmt: skip


@dataclass(frozen=True)
class SensorCorrection:
    """Calibration of the k field sensors of one device: field = gain (reading − offset − per_ampere i).

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
    errors: SensorErrors = dataclass_field(default_factory=SensorErrors)  #: how the sensors differ from ideal ones
    warming: float = 0.0  #: their temperature rise as a share of the coils' rise at the boundary
    range: float | None = None  #: greatest field that an axis can read [T]; None: that of 16 bits of `step`
    correction: SensorCorrection | None = None  #: result of a calibration; `positions` are then the calibrated ones

    @property
    def greatest_reading(self) -> float:
        """Maximum reading of an axis [T]: `range`, or that of a 16-bit converter, or inf for an ideal one."""
        if self.range is not None:
            return self.range
        return 32767 * self.step if self.step > 0 else np.inf
