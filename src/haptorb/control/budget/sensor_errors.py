"""What field sensors make of the field: gain, cross-axis, offset, noise and place, each sensor its own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from haptorb.control.budget.current_errors import ChainTrial, describe_share
from haptorb.control.budget.error_model import ErrorSource
from haptorb.devices.device import Device
from haptorb.devices.field_sensors import FieldSensors
from haptorb.display.quantity_text import format_quantity
from haptorb.numerics.arrays import Array

__all__ = ["SensorPlacement", "SensorTrial", "sensor_sources"]


@dataclass
class SensorTrial(ChainTrial):
    """How the field sensors of one device differ from ideal ones, and the electronics; zeros: not at all."""

    mixing: Array  #: (k, 3, 3) what they read of a field beyond the field itself, along their own axes
    reading: Array  #: (k, 3) what they read without a field [T]
    placement: Array  #: (k, 3) from the nominal places [m]

    def read_field(self, field: Array, frames: Array | None = None) -> Array:
        """(k, 3) readings [T] of a true `field` (k, 3) [T]; columns of frames (k, 3, 3) are the sensors' own axes."""
        own = field if frames is None else np.einsum("kji,kj->ki", frames, field)
        own = own + np.einsum("kij,kj->ki", self.mixing, own) + self.reading
        read: Array = own if frames is None else np.einsum("kij,kj->ki", frames, own)
        return read


S = TypeVar("S", bound=SensorTrial)


class SensorMixing(ErrorSource[S]):
    """Gain of each field sensor's axes, or what they read of each other."""

    def __init__(self, name: str, standard: float, origin: str, sensors: int, *, across: bool) -> None:
        super().__init__(name, describe_share(standard), origin, sensors * (6 if across else 3))
        self._standard, self._where = standard, np.nonzero(np.eye(3) != across)

    def perturb(self, deviates: Array, trial: S) -> None:
        """Change what the sensors read of a field."""
        rows, columns = self._where
        trial.mixing[:, rows, columns] += self._standard * deviates.reshape(len(trial.mixing), -1)


class SensorReading(ErrorSource[S]):
    """What each axis of the field sensors reads without a field: its offset, or its noise."""

    def __init__(self, name: str, standard: float, origin: str, sensors: int) -> None:
        super().__init__(name, format_quantity(standard, "T"), origin, 3 * sensors)
        self._standard = standard

    def perturb(self, deviates: Array, trial: S) -> None:
        """Add to the readings."""
        trial.reading += self._standard * deviates.reshape(-1, 3)


class SensorAngle(ErrorSource[S]):
    """How each field sensor is turned about its axes."""

    def __init__(self, standard: float, origin: str, sensors: int) -> None:
        super().__init__("field sensors, angle", f"{np.degrees(standard):.2g}°", origin, 3 * sensors)
        self._standard = standard

    def perturb(self, deviates: Array, trial: S) -> None:
        """Turn the sensors, by small angles."""
        x, y, z = self._standard * deviates.reshape(-1, 3).T
        for row, column, angle in ((0, 1, -z), (0, 2, y), (1, 2, -x)):
            trial.mixing[:, row, column] += angle
            trial.mixing[:, column, row] -= angle


class SensorPlacement(ErrorSource[S]):
    """Where each field sensor is."""

    def __init__(self, standard: float, origin: str, sensors: int) -> None:
        super().__init__("field sensors, position", format_quantity(standard, "m"), origin, 3 * sensors)
        self._standard = standard

    def perturb(self, deviates: Array, trial: S) -> None:
        """Move the sensors of `trial`, by `deviates` (3 k,) [1] times the standard uncertainty."""
        trial.placement += self._standard * deviates.reshape(-1, 3)


def sensor_sources(device: Device, hall: FieldSensors, section: str, averaged: float) -> tuple[ErrorSource[S], ...]:
    """Those of the field sensors `hall` of `device` but their places; the device file has them in `section`.

    The estimator averages their noise over so many readings. All are at the temperature of their calibration.
    """
    errors, count = hall.errors, len(hall.positions)

    def origin(key: str) -> str:
        return "assumed" if f"{section}.{key}" in device.assumed else "device file"

    noise = float(np.hypot(hall.noise, hall.step / np.sqrt(12)) / np.sqrt(averaged))
    return (
        SensorMixing("field sensors, gain", errors.gain, origin("gain"), count, across=False),
        SensorMixing("field sensors, cross-axis", errors.cross, origin("cross"), count, across=True),
        SensorReading("field sensors, offset", errors.offset, origin("offset"), count),
        SensorReading("field sensors, noise", noise, origin("noise"), count),
        SensorAngle(errors.angle, origin("angle"), count),
    )
