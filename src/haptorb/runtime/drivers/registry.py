"""Registry of drivers: parses `--driver serial:PORT` or `--driver i2c:BUS` and makes the driver of a real device."""

from __future__ import annotations

from collections.abc import Callable

from haptorb.devices.base import Device
from haptorb.errors import InputError, UnknownName
from haptorb.estimation.types import Pose
from haptorb.runtime.drivers.base import Driver, invalid_pose
from haptorb.runtime.linux import require_linux

__all__ = ["DRIVERS", "check_driver", "is_real", "real_driver"]


DRIVERS = ("sim",)


def check_driver(name: str) -> str:
    """Return `name`; raise UnknownName if it is not a driver. Port or bus are checked when they are opened."""
    if name not in DRIVERS and not is_real(name):
        raise UnknownName("driver", name, (*DRIVERS, "serial:PORT", "i2c:BUS"))
    return name


def is_real(name: str) -> bool:
    """Whether `name` is the driver of a real device.

    >>> is_real("serial:/dev/ttyACM0"), is_real("sim")
    (True, False)
    """
    return name.split(":", 1)[0] in ("serial", "i2c")


def real_driver(
    name: str,
    device: Device,
    pose: Callable[[float], Pose] = invalid_pose,
    *,
    duty_limit: float = 1.0,
    current_limit: float | None = None,
    hall_axes: int = 1,
    timeout: float = 5e-3,
    watchdog: bool = True,
) -> Driver:
    """Make the driver `name` of `device`, not open yet; InputError if the name is not a port or bus,
    PlatformError if this is not Linux.

    duty_limit [1] and current_limit [A] bind the firmware for this session, where there is one. Hall sensors of fewer
    than `hall_axes` are refused when it is opened. `timeout` [s] is the response timeout of a bridge: short for a
    loop, longer for a program without one. An I²C bus whose PWM chip has no monostable on OE is refused when it is
    opened, unless `watchdog` is False.
    """
    if is_real(name):
        require_linux("a real driver")
    kind, _, where = name.partition(":")
    if kind == "serial" and where:
        from haptorb.runtime.drivers.serial import SerialDriver

        return SerialDriver(
            device, where, pose, timeout=timeout, duty_limit=duty_limit, current_limit=current_limit,
            hall_axes=hall_axes,
        )  # fmt: skip
    if kind == "i2c" and where.isdecimal():
        from haptorb.runtime.drivers.i2c import I2cDriver

        return I2cDriver(device, int(where), pose, hall_axes=hall_axes, watchdog=watchdog)
    raise InputError(f"driver must be serial:PORT (serial:/dev/ttyACM0) or i2c:BUS (i2c:1); got '{name}'")
