"""Driver of a real device wired directly to a Raspberry Pi: PWM, current sensors and Hall converter on one bus."""

from __future__ import annotations

import os
import stat
import sys
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from time import monotonic
from typing import Protocol, final

import numpy as np

from haptorb.arrays import Array
from haptorb.child_process import python_command
from haptorb.compiled import load_compiler
from haptorb.control.trip_reasons import CoilState
from haptorb.devices.base import Device
from haptorb.errors import DriverError
from haptorb.estimation.types import Pose, Sample
from haptorb.runtime.drivers import i2c_chips
from haptorb.runtime.drivers.base import (
    CHANNELS,
    DUTY_STEPS,
    SPAN_3V3,
    Driver,
    HallSensors,
    check_electronics,
    counts,
    invalid_pose,
)
from haptorb.runtime.drivers.i2c_chips import ADDRESS, HallAdc, HallSelect, I2cBus, Ina219, LinuxBus, Pca9685
from haptorb.runtime.drivers.i2c_guardian import Guardian

__all__ = [
    "BusLock",
    "CoilSwitch",
    "I2cDriver",
    "LinuxPort",
    "Port",
    "Thermometers",
    "UnwatchedPort",
    "W1Thermometers",
    "Watchdog",
    "device_number",
    "pwm_lock",
]


# --------------------------------------------------------------------------------------------------
# Exclusive access: a lock per I²C bus and chip, which is released when the process that holds it ends.


#: the same for every user of this computer, whose own folder for temporary files may be another
_FOLDERS = (Path("/run/lock"), Path("/tmp"))
_I2C_LOCK_TRIES = 10


@final
class BusLock:
    """Lock on a chip, held from the creation on; `bus` is the device number, so that aliases are the same bus.

    Every process that has the `descriptor` shares the lock: a guardian that still tries to switch off holds it
    when the program itself has ended. The lock file remains, and names the last holder.

    Raises DriverError that names the holder if there is one, or if no file can be made.
    """

    def __init__(self, bus: int, address: int, name: str, folder: Path | None = None) -> None:
        self._name = name
        places = [one for one in _FOLDERS if one.is_dir()] if folder is None else [folder]
        if not places:
            raise DriverError(f"{name} cannot be locked: neither {_FOLDERS[0]} nor {_FOLDERS[1]} is a folder")
        self._path = places[0] / f"haptorb-i2c-{os.major(bus)}-{os.minor(bus)}-{address:02x}.lock"
        self.descriptor = self._lock()
        self.write_holder()

    def _lock(self) -> int:
        import fcntl  # not at the top: Windows has none

        for _ in range(_I2C_LOCK_TRIES):
            try:
                descriptor = _open_file(self._path)
            except OSError as cause:
                raise DriverError(f"{self._name} cannot be locked: {self._path}: {cause.strerror}") from cause
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)  # safety: i2c-lock
                with suppress(FileNotFoundError):
                    if os.path.samestat(os.stat(self._path), os.fstat(descriptor)):  # safety: i2c-lock-named
                        return descriptor
            except BlockingIOError as cause:
                holder = _describe_holder(descriptor)
                os.close(descriptor)
                raise DriverError(f"{self._name} is in use by {holder}; end it first") from cause
            os.close(descriptor)  # the file was deleted meanwhile
        raise DriverError(f"{self._name} cannot be locked: another program keeps removing {self._path}")

    def write_holder(self, guardian: int = 0) -> None:
        """Write the holder to the file: this process, and the process id of its `guardian`."""
        text = f"{os.getpid()} {guardian} {Path(sys.argv[0]).name or 'python'}"
        with suppress(OSError):  # another user's file may be read-only; the lock is valid without it
            os.ftruncate(self.descriptor, 0)
            os.pwrite(self.descriptor, text.encode()[:200], 0)

    def close(self) -> None:
        """Release this process's lock. May be called twice."""
        descriptor, self.descriptor = self.descriptor, -1
        if descriptor >= 0:
            os.close(descriptor)


def _open_file(path: Path) -> int:
    """Open the file; create it if it is missing. An existing one is opened without O_CREAT, which the kernel may refuse
    for another user's file in a world-writable folder."""
    flags = os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
    for _ in range(_I2C_LOCK_TRIES):
        try:
            return _regular(os.open(path, os.O_RDWR | flags))
        except PermissionError:
            return _regular(os.open(path, os.O_RDONLY | flags))
        except FileNotFoundError:
            with suppress(FileExistsError):
                descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | flags, 0o666)
                os.fchmod(descriptor, 0o666)  # regardless of the umask: other users must be able to lock it
                return descriptor
    raise FileNotFoundError(2, "appears and disappears", str(path))


def _regular(descriptor: int) -> int:
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(22, "is not a regular file")
    return descriptor


def _describe_holder(descriptor: int) -> str:
    """Describe the holder of the lock; the file's content is untrusted."""
    text = os.pread(descriptor, 200, 0).decode("utf-8", "replace")
    number, _, rest = text.partition(" ")
    guardian, _, program = rest.partition(" ")
    if not (number.isdecimal() and guardian.isdecimal() and len(number) < 9 and len(guardian) < 9):
        return "another program"
    shown = "".join(letter if letter.isprintable() else "?" for letter in program)[:80]
    if _is_alive(int(number)):
        return f"process {number} ({shown}): end it first"
    return (
        f"the guardian (process {guardian}) of the ended process {number} ({shown}) is still trying to switch the "
        "coils off. Check bus and supply"
    )


def _is_alive(number: int) -> bool:
    try:
        os.kill(number, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True


# --------------------------------------------------------------------------------------------------
# Access to a device's chips: the bus, the lock, and the guardian process.


class Watchdog(Protocol):
    """Switches off when this process sends no heartbeat."""

    @property
    def ended(self) -> bool:
        """Whether it has ended."""

    def wait_until_ready(self, timeout: float) -> bool:
        """Wait until it is active, for at most `timeout` [s]; return whether it is."""

    def beat(self, engaged: bool) -> None:
        """Send a heartbeat. DriverError if the watchdog is not active."""

    def leave(self) -> None:
        """Let it switch off until the chip confirms it, then end; non-blocking."""

    def end(self, timeout: float) -> bool:
        """End it once off is confirmed, within `timeout` [s], or kill it; return whether it has ended."""


class Port(ABC):
    """Access to a bus, for one driver at a time."""

    name: str  #: as in `--driver`

    @abstractmethod
    def open(self) -> I2cBus:
        """Open the bus. Raises DriverError if it does not exist or another program uses it."""

    @abstractmethod
    def watcher(self) -> Watchdog | None:
        """Start a new watchdog, not ready yet; None on a bus without one. OSError if it cannot be started."""

    @abstractmethod
    def close(self) -> None:
        """Close the bus. May be called twice."""


def device_number(bus: int) -> int:
    """Device number of the bus, independent of the name of its device file. OSError if it does not exist."""
    return os.stat(f"/dev/i2c-{bus}").st_rdev


def pwm_lock(bus: int) -> BusLock:
    """Lock the PWM chip of the bus; DriverError that names the holder if it is locked."""
    return BusLock(device_number(bus), ADDRESS, f"the PWM chip at {ADDRESS:#04x} on i2c:{bus}")


@final
class LinuxPort(Port):
    """Access to /dev/i2c-N."""

    def __init__(self, number: int) -> None:
        self.name = f"i2c:{number}"
        self._number = number
        self._bus: LinuxBus | None = None
        self._lock: BusLock | None = None

    def open(self) -> I2cBus:
        """Open the bus, and lock its PWM chip."""
        self._bus = LinuxBus(self._number)
        try:
            self._lock = pwm_lock(self._number)
        except BaseException:
            self.close()
            raise
        return self._bus

    def watcher(self) -> Watchdog:
        """Start a guardian process, which shares the lock."""
        command = python_command("haptorb.runtime.drivers.i2c_guardian", str(self._number), str(ADDRESS), isolated=True)
        if self._lock is None:
            return Guardian(command)
        guardian = Guardian(command, (self._lock.descriptor,))
        self._lock.write_holder(guardian.pid)
        return guardian

    def close(self) -> None:
        """Close the bus and release the lock, unless the guardian is still active, which then holds it."""
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
        """Return the bus."""
        return self._bus

    def watcher(self) -> None:
        """Return None: no guardian."""
        return

    def close(self) -> None:
        """Close the bus."""
        self._bus.close()


# --------------------------------------------------------------------------------------------------
# Confirmed switching off: the PWM chip, and the guardian that supervises it.


_CLOSE_TIMEOUT_S = 0.25  #: longest time for which `close` tries
_COIL_SWITCH_TRIES = 2000  #: the same in tries, for a clock that does not advance
_START_S = 5.0  #: timeout of the start of a guardian's interpreter
_KILL_TIMEOUT_S = 0.05  #: for the end of a killed guardian, when the user engages
_END_TIMEOUT_S = 0.5  #: for a guardian to read the chip once more and end
_RESTART_INTERVAL_S = 1.0  #: between two starts of a guardian


@final
class CoilSwitch:
    """Switches the outputs of `pwm`; `state` is whether current can flow, as far as the chip confirmed it.

    A write that failed may have been executed in part, so the state is UNKNOWN until reading the registers back
    shows every output off. A loop that calls `recover` in every tick tries in every tick; a guardian tries in parallel.
    """

    def __init__(self, pwm: Pca9685, port: Port, clock: Callable[[], float]) -> None:
        self.state = CoilState.OFF  # the chip was configured, and read back
        self._pwm = pwm
        self._port = port
        self._clock = clock
        self._watcher: Watchdog | None = None
        self._leaving = False
        self._started = float("-inf")

    def start(self) -> None:
        """Start a guardian, and wait for it. DriverError if it does not start."""
        if self._watcher is None:
            self._started = self._clock()
            try:
                self._watcher, self._leaving = self._port.watcher(), False
            except OSError as cause:
                raise DriverError(f"the guardian process of the I²C bus did not start: {cause}") from cause
        if self._watcher is not None and not self._watcher.wait_until_ready(_START_S):
            self._release_watcher()
            raise DriverError(
                f"the guardian process of the I²C bus did not start within {_START_S:g} s; close other programs, and "
                "try again"
            )

    def beat(self, engaged: bool) -> None:
        """Send a heartbeat to the guardian. DriverError if it has ended or does not answer."""
        if self._watcher is not None:
            try:
                self._watcher.beat(engaged)
            except DriverError:
                self._release_watcher()
                raise

    def write(self, steps: list[int]) -> None:
        """Write new duties, in signed steps of 1/4096. OSError if the chip does not answer."""
        self.state = CoilState.ON  # before the write: a partial message may switch an output
        self._pwm.write(steps)

    def switch_off(self) -> bool:
        """Try once to switch off; True if the chip confirms that every output is off."""
        self.state = CoilState.UNKNOWN  # safety: i2c-off-unsaid
        with suppress(OSError):
            if self._pwm.switch_off():
                self.state = CoilState.OFF
        return self.state is CoilState.OFF

    def fail(self) -> None:
        """Try once to switch off, and let the guardian try, too, if that failed."""
        if not self.switch_off():
            self._release_watcher()
        elif not self._leaving:
            with suppress(DriverError):
                self.beat(False)

    def _release_watcher(self) -> None:
        if self._watcher is not None:
            self._watcher.leave()
            self._leaving = True

    def recover(self) -> None:
        """Recover from a failure, one step per tick: switch off until that is confirmed, then restart the guardian, so
        that engaging need not wait for it. Non-blocking."""
        if self.state is not CoilState.OFF:  # safety: i2c-reading-off
            self.switch_off()
        elif self._is_guardian_gone() and self._clock() - self._started > _RESTART_INTERVAL_S:
            self._started = self._clock()
            with suppress(OSError):
                self._watcher, self._leaving = self._port.watcher(), False

    def _is_guardian_gone(self, timeout: float = 0.0) -> bool:
        """Whether the guardian has ended. One that still tries is told to end, as off is confirmed."""
        if self._watcher is not None and (self._leaving or self._watcher.ended) and self._watcher.end(timeout):
            self._watcher = None
        return self._watcher is None

    def require(self) -> None:
        """Raise DriverError unless the chip confirms that it is off and a guardian is active: until then, engaging is
        not allowed."""
        if self.state is not CoilState.OFF and not self.switch_off():  # safety: i2c-engage-off
            raise DriverError(
                "coil state unknown: the PWM chip has not confirmed that the coils are off. Check the bus and the "
                "supply, then engage again"
            )
        if (self._leaving or (self._watcher is not None and self._watcher.ended)) and not self._is_guardian_gone(
            _KILL_TIMEOUT_S
        ):
            raise DriverError("the guardian of the I²C bus is still trying to switch off. Engage again in a moment")
        self.start()

    def close(self) -> None:
        """Switch off, confirmed; then end the guardian. DriverError if it was not confirmed within 0.25 s: a guardian
        then continues to try."""
        end = self._clock() + _CLOSE_TIMEOUT_S
        for _ in range(_COIL_SWITCH_TRIES):
            if self.switch_off() or self._clock() > end:
                break
        watcher, self._watcher = self._watcher, None
        if self.state is CoilState.OFF:  # safety: i2c-closing
            if watcher is not None:
                watcher.end(_END_TIMEOUT_S)
            return
        if watcher is not None:
            watcher.leave()
        raise DriverError(
            f"COIL STATE UNKNOWN: the PWM chip on {self._port.name} did not confirm that the coils are off. Switch the "
            "supply off" + ("; a guardian process keeps trying" if watcher is not None else "")
        )


# --------------------------------------------------------------------------------------------------
# DS18B20 thermometers through Linux' 1-wire driver: a conversion takes 0.75 s, so a separate thread reads them.


_FOLDER = Path("/sys/bus/w1/devices")


class Thermometers(Protocol):
    """Source of the temperatures at the coils' boundaries."""

    def wait_until_ready(self, timeout: float) -> bool:
        """Wait for the first reading, for at most `timeout` [s]."""

    def read(self) -> Array:
        """Temperatures (m,) [K]."""

    def close(self) -> None:
        """May be called twice."""


@final
class W1Thermometers:
    """Thermometers 28-… in `folder`, in the order of their numbers: coils x, y, z.

    Raises DriverError if there are not exactly `count` of them.
    """

    def __init__(self, count: int = 3, folder: Path = _FOLDER) -> None:
        self._files = [path / "temperature" for path in sorted(folder.glob("28-*"))]
        if len(self._files) != count:
            found = ", ".join(file.parent.name for file in self._files) or "none"
            raise DriverError(
                f"{count} DS18B20 thermometers are needed on the 1-wire bus, found: {found} "
                "(switch 1-wire on with `raspi-config`, check the 4.7 kΩ pull-up)"
            )
        self._kelvin = np.full(count, np.nan)
        self._end = threading.Event()
        self._first = threading.Event()
        self._thread = threading.Thread(target=self._run, name="thermometers", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._end.is_set():
            for i, file in enumerate(self._files):
                try:
                    self._kelvin[i] = int(file.read_text(encoding="utf-8")) / 1000 + 273.15
                except (OSError, ValueError):
                    self._kelvin[i] = np.nan
            self._first.set()
            self._end.wait(0.05)

    def wait_until_ready(self, timeout: float) -> bool:
        """Wait until each has been read once, at most `timeout` [s]."""
        return self._first.wait(timeout)

    def read(self) -> Array:
        """Last readings (count,) [K]; NaN where a sensor does not answer."""
        return self._kelvin.copy()

    def close(self) -> None:
        """May be called twice."""
        self._end.set()


_FAILS_IN_A_ROW = 3
_OVER_IN_A_ROW = 2
_WARM_UP = 5.0
_IDLE_TIME_S = 0.02  #: time of zero duties after which the chip is switched off, confirmed

_CONVERSION_AGE_S = 0.53e-3  #: average age of the middle of a current sensor's conversion when it is read


@final
class I2cDriver(Driver):
    """Driver that accesses the chips' registers without a firmware: limits and watchdogs are here.

    A guardian process switches the PWM chip off when this one ends or hangs for 15 ms, and a monostable on the
    chip's OE pin when both hang; without the monostable `open` refuses, unless `watchdog` is False. Two readings of a
    current in a row above the device's limit by 5 %, or a chip that does not answer three times in a row, switch off
    and latch: `read` raises DriverError with the reason until `engage`, and tries to switch off until the chip confirms
    it.

    `bus` is the number of a Linux bus; for tests a bus of simulated chips, with their thermometers, their `clock` [s]
    and no guardian. `shunt` is the resistance over which each coil's current is measured [Ω]. Hall sensors and their
    converter run on 3.3 V. Where a TCA9534 answers, the Hall sensors have three axes, else the radial one; `open`
    refuses fewer than `hall_axes`. Each `read` brings one axis of four or five of them, the rest of a sample's `field`
    is NaN.

    Raises DriverError for a device without three coils and nine Hall sensors.
    """

    simulated = False

    def __init__(
        self,
        device: Device,
        bus: int | I2cBus | Port,
        pose: Callable[[float], Pose] = invalid_pose,
        *,
        thermometers: Callable[[], Thermometers] = W1Thermometers,
        shunt: float = 0.01,
        hall_axes: int = 1,
        watchdog: bool = True,
        clock: Callable[[], float] = monotonic,
    ) -> None:
        positions = check_electronics(device, "the I²C driver", "the I²C driver")
        self._port = bus if isinstance(bus, Port) else LinuxPort(bus) if isinstance(bus, int) else UnwatchedPort(bus)
        self.name = self._port.name
        self._limit = device.coils.current_limit * 1.05
        self._positions, self._hall_axes = positions, hall_axes
        self._hall_sensors = HallSensors(positions, span=SPAN_3V3)
        self._watchdog = watchdog
        self._clock = clock
        self._pose = pose
        self._make_thermometers = thermometers
        self._shunt = shunt
        self._bus: I2cBus | None = None
        self._switch: CoilSwitch | None = None
        self._thermometers: Thermometers | None = None
        self._start()

    def _start(self) -> None:
        self._fault = ""
        self._engaged = False
        self._armed = True
        self._idle: float | None = None  # time since which duties are zero [s]
        self._group = 0
        self._fails = 0
        self._over = np.zeros(CHANNELS, dtype=np.int64)
        self._currents = np.zeros(CHANNELS)
        self._currents_at = self._field_at = 0.0  # on the loop's clock [s]
        self._field = self._hall_sensors.empty_field()
        self._applied = np.zeros(CHANNELS)

    @property
    def field_axes(self) -> Array | None:
        """(9, 3) unit vectors, if every Hall sensor measures only its radial component; None: three axes."""
        return self._hall_sensors.directions

    @property
    def fault(self) -> str:
        """Reason why no current flows, in one clause; empty if it may."""
        return self._fault

    @property
    def coil_state(self) -> CoilState:
        """Coil state, as confirmed by the PWM chip's registers; UNKNOWN before it was first configured."""
        return CoilState.UNKNOWN if self._switch is None else self._switch.state

    def open(self) -> None:
        """Configure every chip, coils off; DriverError names the first that is missing, with its address, and the
        wiring needed where there is no monostable."""
        self.close()
        self._start()
        self._switch = None
        self._bus = bus = self._port.open()
        try:
            self._pwm = Pca9685(bus)
            self._pwm.setup()
            self._switch = CoilSwitch(self._pwm, self._port, self._clock)
            self._sensors = [Ina219(bus, address, self._shunt) for address in i2c_chips.ADDRESSES]
            for sensor in self._sensors:
                sensor.setup()
            self._hall = HallAdc(bus)
            self._hall.setup()
            self._select = HallSelect(bus)
            axes = 3 if self._select.present() else 1
            needed = 3 if self._watchdog else self._hall_axes  # the TCA9534 triggers the monostable, too
            if axes < needed:  # safety: chip-axes
                raise DriverError(i2c_chips.explain_absence(self.name, self._hall_axes))
            self._hall_sensors = HallSensors(self._positions, axes, SPAN_3V3)
            if axes > 1:
                self._select.setup()
            if self._watchdog:  # safety: i2c-monostable
                i2c_chips.pulse(self._select, self._clock)
            for _ in range(axes * len(i2c_chips.BLOCKS)):
                self._read_hall()
            self._thermometers = self._make_thermometers()
            if not self._thermometers.wait_until_ready(_WARM_UP):
                raise DriverError("the DS18B20 thermometers did not respond in time; check the 1-wire bus")
            self._switch.start()
        except DriverError as cause:
            try:
                self.close()
            except DriverError as unconfirmed:
                raise DriverError(f"{cause}. {unconfirmed}") from cause
            raise
        except OSError as cause:
            self.close()
            raise DriverError(f"the I²C bus fails: {cause}; check its wiring and pull-ups") from cause
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Coils off, then close the bus. May be called twice. DriverError if the PWM chip did not confirm within 0.25 s
        that they are off: the bus is then closed, and the guardian continues to try."""
        bus, self._bus = self._bus, None
        thermometers, self._thermometers = self._thermometers, None
        self._engaged = False
        self._applied = np.zeros(CHANNELS)
        if thermometers is not None:
            thermometers.close()
        if bus is None:
            return
        try:
            if self._switch is not None:
                self._switch.close()
        finally:
            self._port.close()

    def engage(self) -> None:
        """Clear a trip when the user engages; configure chips again that had disappeared. DriverError while the PWM
        chip has not confirmed that it is off, or has no guardian or monostable."""
        if self._bus is None or self._switch is None or self._engaged or (self._armed and not self._fault):
            return
        self._switch.require()
        try:
            self._pwm.setup()
            for sensor in self._sensors:
                sensor.setup()
            self._hall.setup()
            if self._hall_sensors.axes > 1:
                self._select.setup()
            if self._watchdog:  # safety: i2c-monostable-bridged
                i2c_chips.check_output_enable(self._select, self._clock)
        except (DriverError, OSError) as cause:
            raise self._fail(_explain(cause, "the I²C bus fails")) from cause
        self._fault = ""
        self._armed = True
        self._fails = 0
        self._over[:] = 0

    def _fail(self, why: str) -> DriverError:
        """Latch a failure: coils off until `engage`."""
        self._engaged = self._armed = False
        self._applied = np.zeros(CHANNELS)
        self._fault = why
        if self._switch is not None:
            self._switch.fail()
        return DriverError(self._describe_fault())

    def _describe_fault(self) -> str:
        if self.coil_state is CoilState.OFF:
            return self._fault
        return f"{self._fault}. COIL STATE UNKNOWN: the PWM chip has not confirmed that the coils are off"

    def read(self, now: float) -> Sample:
        """Read the three currents, one group of Hall sensors and the last temperatures, at `now` [s].

        Raises DriverError while not open, or if the coils are switched off, with the reason.
        """
        if self._bus is None or self._thermometers is None or self._switch is None:
            raise DriverError(f"the device at {self.name} is not open; use it in a `with` block or call open() first")
        if self._fault:
            self._switch.recover()
            raise DriverError(self._describe_fault())
        start = self._clock()
        try:
            for i, sensor in enumerate(self._sensors):
                self._currents[i] = sensor.current()
            had = self._clock()
            self._read_hall()
        except OSError as cause:
            self._fails += 1
            if self._fails >= _FAILS_IN_A_ROW:
                raise self._fail(f"a chip on the I²C bus does not respond: {cause}") from cause
        else:
            self._fails = 0
            # the middle of each reading: a bus is slow, and the tick's `now` is the begin of the tick
            self._currents_at = now + (had - start) / 2 - _CONVERSION_AGE_S
            self._field_at = now + (had + self._clock()) / 2 - start
        self._over = np.where(np.abs(self._currents) > self._limit, self._over + 1, 0)
        if (self._over >= _OVER_IN_A_ROW).any():
            coil = "xyz"[int(np.argmax(self._over))]
            raise self._fail(f"the current of coil {coil} was above its limit; look for a short circuit first")
        field, self._field = self._field, self._hall_sensors.empty_field()
        return Sample(
            now, self._currents.copy(), self._thermometers.read(), field, self._pose(now),
            now - self._currents_at, now - self._field_at,
        )  # fmt: skip

    def _read_hall(self) -> None:
        """Read one axis of one block, the next time the other block, then the next axis."""
        axis, block = divmod(self._group, len(i2c_chips.BLOCKS))
        if self._hall_sensors.axes > 1:
            self._select.show(axis)
        self._hall_sensors.put(self._field, axis, i2c_chips.BLOCKS[block][0], self._hall.read(block))
        self._group = (self._group + 1) % (self._hall_sensors.axes * len(i2c_chips.BLOCKS))

    def write(self, duties: Array) -> Array:
        """Write `duties` (3,) in −1…1 [1] to the PWM chip in one burst; return those applied (3,), zeros while the
        coils are off. DriverError if a chip or the guardian does not answer, or the guardian has switched off."""
        steps = counts(duties)
        some, switch = any(steps), self._switch
        if self._bus is None or switch is None:
            return np.zeros(CHANNELS)
        if self._fault and switch.state is not CoilState.OFF:  # safety: i2c-writing-off
            switch.switch_off()
        if self._fault or not (self._engaged or (self._armed and some)):
            return np.zeros(CHANNELS)
        if some:
            self._idle = None
        elif self._idle is None:
            self._idle = self._clock()
        try:
            # safety: i2c-zero-off
            if not some and self._clock() - self._idle > _IDLE_TIME_S:  # type: ignore[operator]
                return self._resume_after_rest(switch)
            self._engaged, self._armed = True, False
            switch.beat(True)
            if self._watchdog:
                self._select.trigger()
            switch.write(steps)
        except (DriverError, OSError) as cause:
            raise self._fail(_explain(cause, "the PWM chip does not respond")) from cause
        self._applied = np.array(steps) / DUTY_STEPS
        return self._applied.copy()

    def _resume_after_rest(self, switch: CoilSwitch) -> Array:
        """Switch off, confirmed, after a time of zero duties; the next duties engage again, as nothing has failed."""
        self._idle = None
        if not switch.switch_off():
            raise DriverError("the PWM chip does not confirm that the coils are off; switch off their supply")
        switch.beat(False)
        self._engaged, self._armed = False, True
        self._applied = np.zeros(CHANNELS)
        return np.zeros(CHANNELS)


def _explain(cause: DriverError | OSError, what: str) -> str:
    return str(cause) if isinstance(cause, DriverError) else f"{what}: {cause}"


load_compiler()  # at import, so that no device waits for it
