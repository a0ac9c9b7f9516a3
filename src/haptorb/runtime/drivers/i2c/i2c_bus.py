"""An I²C bus as its messages: all that chip drivers need, real through Linux or simulated."""

from __future__ import annotations

import errno
import fcntl
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol, TypeAlias, final

from haptorb.errors import DriverError

__all__ = ["I2cBus", "LinuxBus", "Message", "bus_list"]

#: address, and the bytes to write or how many to read
Message: TypeAlias = tuple[int, bytes | int]

_SET_TIMEOUT, _TIMEOUT = 0x0702, 1  #: I2C_TIMEOUT, in units of 10 ms


class I2cBus(Protocol):
    """Carries messages joined by repeated STARTs, one STOP at the end."""

    def transfer(self, messages: Sequence[Message]) -> list[bytes]:
        """Transfer `messages`; returns what was read, in order. OSError without an acknowledgement."""

    def close(self) -> None:
        """May be called twice."""


def bus_list() -> list[int]:
    """Numbers of the I²C buses of this computer that programs may use."""
    return sorted(int(path.name[4:]) for path in Path("/dev").glob("i2c-*") if path.name[4:].isdecimal())


@final
class LinuxBus:
    """/dev/i2c-N through smbus2. A Raspberry Pi's controller takes one read per transfer, as its last message.

    Raises DriverError if smbus2 is not installed, or if the bus is not there or may not be opened.
    """

    def __init__(self, number: int) -> None:
        try:
            import smbus2
        except ImportError as cause:
            raise DriverError(
                "an I²C bus needs the package smbus2; install it with `pip install 'haptorb[hardware]'`"
            ) from cause
        self._messages: Any = smbus2.i2c_msg
        self.number = number
        self._bus: Any
        try:
            self._bus = smbus2.SMBus(number)
        except OSError as cause:
            raise _explain_bus_error(number, cause) from cause
        # A transfer that hangs must not hang for the second that the kernel gives it by itself: every try to switch
        # off waits for it. Controllers that do not know the setting keep theirs.
        with suppress(OSError, TypeError):
            fcntl.ioctl(self._bus.fd, _SET_TIMEOUT, _TIMEOUT)

    def transfer(self, messages: Sequence[Message]) -> list[bytes]:
        """Carry `messages` in one system call."""
        make = self._messages
        carried = [make.read(to, what) if isinstance(what, int) else make.write(to, what) for to, what in messages]
        self._bus.i2c_rdwr(*carried)
        return [bytes(one) for one, (_, what) in zip(carried, messages, strict=True) if isinstance(what, int)]

    def close(self) -> None:
        """May be called twice."""
        with suppress(OSError, TypeError):
            self._bus.close()


def _explain_bus_error(number: int, cause: OSError) -> DriverError:
    path = f"/dev/i2c-{number}"
    if cause.errno in (errno.EACCES, errno.EPERM):
        return DriverError(
            f"no permission to open {path}: join its group with `sudo usermod -aG i2c $USER`, then log out and in again"
        )
    if cause.errno == errno.ENOENT:
        there = ", ".join(f"i2c:{one}" for one in bus_list()) or "none"
        return DriverError(f"there is no bus {path} (switch I²C on with `raspi-config`); buses here: {there}")
    return DriverError(f"cannot open {path}: {cause}")
