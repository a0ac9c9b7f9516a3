"""A serial port at 1 Mbaud, opened for one program alone; what cannot be opened is explained."""

from __future__ import annotations

import errno
import os
import select
from contextlib import suppress
from typing import Any, final

from haptorb.errors import DriverError

__all__ = ["BAUD", "SerialPort", "port_list"]

BAUD = 1_000_000


def _serial() -> Any:
    try:
        from serial import Serial
    except ImportError as cause:
        raise DriverError(
            "serial ports need the package pyserial; install it with `pip install 'haptorb[hardware]'`"
        ) from cause
    return Serial


def port_list() -> list[tuple[str, str]]:
    """Serial ports of this computer, (path, description) each, those that look like an Arduino first."""
    _serial()
    from serial.tools.list_ports import comports

    found = [(port.device, port.description or "", port.vid is not None) for port in comports()]
    return [(path, about) for path, about, usb in sorted(found, key=lambda one: (not one[2], one[0])) if usb]


def _explain_port_error(path: str, cause: OSError) -> DriverError:
    number = cause.errno
    text = str(cause)
    if number in (errno.EACCES, errno.EPERM):
        return DriverError(
            f"no permission to open {path}: join its group with `sudo usermod -aG dialout $USER`, "
            "then log out and in again"
        )
    if number == errno.ENOENT:
        with suppress(DriverError):
            ports = ", ".join(one for one, _ in port_list())
            return DriverError(f"there is no port {path}; plugged in now: {ports or 'none'}")
    if number == errno.EBUSY or "exclusively lock" in text:
        return DriverError(f"{path} is in use by another program; close that one first")
    return DriverError(f"cannot open {path}: {text}")


@final
class SerialPort:
    """Bytes out, bytes in with a time limit. A failure of the line is a DriverError, and then the port is closed."""

    def __init__(self, path: str) -> None:
        serial = _serial()
        self.path = path
        try:
            self._port = serial(path, BAUD, timeout=0, write_timeout=0, exclusive=True)
        except OSError as cause:  # pyserial's own error is one
            raise _explain_port_error(path, cause) from cause
        except ValueError as cause:
            raise DriverError(f"{path} is not a serial port for {BAUD} baud: {cause}") from cause
        with suppress(OSError, ValueError, NotImplementedError, AttributeError):
            self._port.set_low_latency_mode(True)  # USB adapters hold bytes back for 16 ms otherwise
        self._number = self._port.fileno()

    def close(self) -> None:
        """May be called twice."""
        with suppress(OSError):
            self._port.close()

    def _lose_port(self, cause: Exception | None) -> DriverError:
        self.close()
        why = f": {cause}" if cause else ""
        return DriverError(f"{self.path} has disappeared{why}; check the cable")

    def send(self, data: bytes | memoryview) -> None:
        """All of `data`; what the line does not take is an error, because half a frame is worth nothing."""
        try:
            if os.write(self._number, data) != len(data):
                raise self._lose_port(None)
        except (OSError, ValueError) as cause:
            raise self._lose_port(cause) from cause

    def receive(self, room: memoryview, patience: float) -> int:
        """How many bytes have come into `room`, waiting at most `patience` [s]; 0 if none did."""
        try:
            count = os.readv(self._number, (room,))  # most often the answer is there: no need to ask first
            if count:
                return count
        except BlockingIOError:
            pass
        except (OSError, ValueError) as cause:
            raise self._lose_port(cause) from cause
        try:
            ready, _, _ = select.select((self._number,), (), (), max(patience, 0.0))
            if not ready:
                return 0
            count = os.readv(self._number, (room,))
        except BlockingIOError:
            return 0
        except (OSError, ValueError) as cause:
            raise self._lose_port(cause) from cause
        if not count:  # readable and empty: the other end was closed
            raise self._lose_port(None)
        return count
