"""Where a device's chips hang: the bus, the lock that keeps others away, and the process that watches over it."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from typing import Protocol, final

from haptorb.cluster.python_process import python_command
from haptorb.runtime.drivers.i2c.i2c_bus import I2cBus, LinuxBus
from haptorb.runtime.drivers.i2c.i2c_guardian import Guardian
from haptorb.runtime.drivers.i2c.i2c_lock import BusLock
from haptorb.runtime.drivers.i2c.pca9685 import ADDRESS

__all__ = ["LinuxPort", "Port", "UnwatchedPort", "Watchdog", "device_number", "pwm_lock"]


class Watchdog(Protocol):
    """What switches off when this process sends no heartbeat."""

    @property
    def ended(self) -> bool:
        """No longer there."""

    def wait_until_ready(self, patience: float) -> bool:
        """Whether it watches; waits for at most `patience` [s]."""

    def beat(self, engaged: bool) -> None:
        """Still here. DriverError if it is not."""

    def leave(self) -> None:
        """Switch off until the chip confirms it, then end; the caller does not wait."""

    def end(self, patience: float) -> bool:
        """Off is confirmed: end within `patience` [s], or be killed; whether it has ended."""


class Port(ABC):
    """A place with a bus, for one driver at a time."""

    name: str  #: as in `--driver`

    @abstractmethod
    def open(self) -> I2cBus:
        """The bus. Raises DriverError if it does not exist or another program drives it."""

    @abstractmethod
    def watcher(self) -> Watchdog | None:
        """A new one, not ready yet; None on a bus without a guardian. OSError if it cannot be started."""

    @abstractmethod
    def close(self) -> None:
        """Close the bus. May be called twice."""


def device_number(bus: int) -> int:
    """The kernel's number of the bus, whatever name its device file goes by. OSError if it does not exist."""
    return os.stat(f"/dev/i2c-{bus}").st_rdev


def pwm_lock(bus: int) -> BusLock:
    """The lock on the PWM chip of the bus; DriverError that names the holder, if it is taken."""
    return BusLock(device_number(bus), ADDRESS, f"the PWM chip at {ADDRESS:#04x} on i2c:{bus}")


@final
class LinuxPort(Port):
    """/dev/i2c-N."""

    def __init__(self, number: int) -> None:
        self.name = f"i2c:{number}"
        self._number = number
        self._bus: LinuxBus | None = None
        self._lock: BusLock | None = None

    def open(self) -> I2cBus:
        """The bus, and the lock on its PWM chip."""
        self._bus = LinuxBus(self._number)
        try:
            self._lock = pwm_lock(self._number)
        except BaseException:
            self.close()
            raise
        return self._bus

    def watcher(self) -> Watchdog:
        """A guardian process, which shares the lock."""
        command = python_command(
            "haptorb.runtime.drivers.i2c.i2c_guardian", str(self._number), str(ADDRESS), isolated=True
        )
        if self._lock is None:
            return Guardian(command)
        guardian = Guardian(command, (self._lock.descriptor,))
        self._lock.tell(guardian.pid)
        return guardian

    def close(self) -> None:
        """The guardian, if it is still at work, keeps the lock."""
        bus, self._bus = self._bus, None
        lock, self._lock = self._lock, None
        if bus is not None:
            bus.close()
        if lock is not None:
            lock.close()


@final
class UnwatchedPort(Port):
    """A bus of simulated chips, for tests: without a lock and without a guardian."""

    name = "i2c:simulated"

    def __init__(self, bus: I2cBus) -> None:
        self._bus = bus

    def open(self) -> I2cBus:
        """The bus."""
        return self._bus

    def watcher(self) -> None:
        """No guardian."""
        return

    def close(self) -> None:
        """And the bus."""
        self._bus.close()
