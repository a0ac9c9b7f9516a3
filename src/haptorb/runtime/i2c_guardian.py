"""A second process that switches the coils off when the first one dies or hangs: a Raspberry Pi has no firmware.

    python -m haptorb.runtime.i2c_guardian BUS ADDRESS

It reads heartbeats from its standard input: `1` while coils are engaged, `0` when they are not. While engaged, 15 ms
without one, or the end of the input, write "all off" into the PWM chip. It cannot help when the computer's own kernel
stops: only a hardware watchdog on the chip's OE pin can (docs/reference/hardware.md).
"""

from __future__ import annotations

import os
import select
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import final

from haptorb.errors import DriverError
from haptorb.runtime.i2c_bus import LinuxBus
from haptorb.runtime.pca9685 import ALL_OFF

__all__ = ["PATIENCE", "Guardian", "watch"]

PATIENCE = 0.015  #: between two heartbeats while the coils are engaged [s]


def watch(heartbeats: int, off: Callable[[], None], patience: float = PATIENCE) -> bool:
    """Watch the file descriptor `heartbeats` until it ends (True) or falls silent while engaged (False); then `off`.

    After a silence nobody is heard again: the descriptor is closed first, so that a program which comes back to life
    finds that out with its next heartbeat and cannot switch on by itself.
    """
    engaged = False
    while True:
        ready, _, _ = select.select((heartbeats,), (), (), patience if engaged else None)
        data = os.read(heartbeats, 4096) if ready else b""
        if not data:
            os.close(heartbeats)
            off()
            return bool(ready)
        engaged = data.endswith(b"1")


@final
class Guardian:
    """The other process, seen from the one with the loop.

    Raises DriverError if it ends before it has opened the bus.
    """

    def __init__(self, bus: int, address: int) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "haptorb.runtime.i2c_guardian", str(bus), str(address)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,  # what stops the program by the keyboard must not stop its guardian first
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._beat = self._process.stdin.fileno()
        if self._process.stdout.read(1) != b"+":
            raise DriverError("the guardian process of the I²C bus did not start")

    def beat(self, engaged: bool) -> None:
        """Still here. DriverError if the guardian is not: without it no current may flow."""
        try:
            os.write(self._beat, b"1" if engaged else b"0")
        except OSError as cause:
            raise DriverError(
                "the guardian of the I²C bus has switched off: the host was silent for 15 ms (a busy computer)"
            ) from cause

    @property
    def alive(self) -> bool:
        """It has not ended."""
        return self._process.poll() is None

    def close(self) -> None:
        """Its last deed is to switch off once more. May be called twice."""
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(2.0)


def main(arguments: list[str]) -> int:
    """The guardian's own program."""
    bus, address = LinuxBus(int(arguments[0])), int(arguments[1])

    def off() -> None:
        for _ in range(5):  # the bus may be in the middle of the dead program's transfer
            try:
                bus.transfer([(address, ALL_OFF)])
                return
            except OSError:
                continue

    off()
    os.write(1, b"+")
    watch(0, off)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
