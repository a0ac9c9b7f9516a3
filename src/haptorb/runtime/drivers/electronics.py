"""What the electronics of both real drivers serve: three coils, nine Hall sensors, duties in steps, and no tracker."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from haptorb.devices.device import Device
from haptorb.errors import DriverError, InputError
from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel
from haptorb.sensing.sample import Pose

__all__ = [
    "CHANNELS",
    "DUTY_FULL",
    "DUTY_STEPS",
    "HALL_SENSORS",
    "THERMOMETERS",
    "check_electronics",
    "counts",
    "invalid_pose",
    "quantise_duties",
]

CHANNELS = 3
HALL_SENSORS = 9  #: places
THERMOMETERS = 3
DUTY_FULL = 4095  #: greatest duty, in steps
DUTY_STEPS = 4096  #: steps in one PWM period: a duty of n steps is n / 4096 of the supply

_UPRIGHT, _STILL = np.eye(3), np.zeros(3)
_UPRIGHT.flags.writeable = _STILL.flags.writeable = False


def invalid_pose(now: float) -> Pose:
    """The word of a tracker that is not there: not valid."""
    return Pose(now, _UPRIGHT, _STILL, _STILL, _STILL, valid=False)


def check_electronics(device: Device, driver: str, reader: str) -> Array:
    """(9, 3) where the device's Hall sensors are [m].

    Raises DriverError, which says what `driver` serves and `reader` reads, unless the device has as many.
    """
    if device.channels != CHANNELS:
        raise DriverError(f"{driver} serves {CHANNELS} coils; device '{device.name}' has {device.channels}")
    positions: Array | None = getattr(getattr(device, "hall", None), "positions", None)
    if positions is None or len(positions) != HALL_SENSORS:
        raise DriverError(f"{reader} reads {HALL_SENSORS} Hall sensors; device '{device.name}' has another number")
    return positions


@kernel
def quantise_duties(duties: Array, steps: NDArray[np.int64]) -> bool:
    """Fill `steps` (3,), signed PWM steps, with duties (3,) in −1…1 [1], clipped, zero for what is no number; any?"""
    some = False
    for i in range(CHANNELS):
        whole = min(max(duties[i] * DUTY_STEPS, -DUTY_FULL), DUTY_FULL)
        steps[i] = 0 if duties[i] != duties[i] else round(whole)
        some = some or steps[i] != 0
    return some


def counts(duties: ArrayLike) -> list[int]:
    """Duties (3,) in −1…1 [1] as signed PWM steps, clipped; what is not a number is zero.

    Raises InputError for another shape.

    >>> counts([0.5, -2.0, float("nan")])
    [2048, -4095, 0]
    """
    asked = np.ascontiguousarray(duties, dtype=np.float64)
    if asked.shape != (CHANNELS,):
        raise InputError(f"duties must have one entry per coil, shape ({CHANNELS},); got shape {asked.shape}")
    steps = np.empty(CHANNELS, np.int64)
    quantise_duties(asked, steps)
    return [int(one) for one in steps]
