"""What the electronics of both real drivers serve: three coils, nine Hall sensors, and no tracker of their own."""

from __future__ import annotations

import numpy as np

from haptorb.devices.device import Device
from haptorb.errors import DriverError
from haptorb.numerics.arrays import Array
from haptorb.runtime.drivers.serial.protocol import CHANNELS, HALL_SENSORS
from haptorb.sensing.sample import Pose

__all__ = ["check_electronics", "invalid_pose"]

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
