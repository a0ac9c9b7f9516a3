"""The driver of a real device wired straight to a Raspberry Pi: PWM, current sensors and Hall converter on one bus."""

from __future__ import annotations

from collections.abc import Callable
from time import monotonic
from typing import Protocol, final

import numpy as np

from haptorb.devices.device import Device
from haptorb.errors import DriverError
from haptorb.physics.arrays import Array
from haptorb.runtime import hall_adc, hall_select, ina219, pca9685
from haptorb.runtime.driver import Driver
from haptorb.runtime.hall_adc import HallAdc
from haptorb.runtime.hall_select import HallSelect
from haptorb.runtime.hall_sensor import SPAN_3V3, HallSensors
from haptorb.runtime.i2c_bus import I2cBus, LinuxBus
from haptorb.runtime.i2c_guardian import Guardian
from haptorb.runtime.ina219 import Ina219
from haptorb.runtime.pca9685 import Pca9685
from haptorb.runtime.protocol import CHANNELS, DUTY_STEPS, HALL_SENSORS, counts
from haptorb.runtime.serial_driver import untracked
from haptorb.runtime.w1_thermometers import W1Thermometers
from haptorb.sensing.sample import Pose, Sample

__all__ = ["I2cDriver", "Thermometers", "Watcher"]

_FAILS_IN_A_ROW = 3
_OVER_IN_A_ROW = 2
_WARM_UP = 5.0

_CONVERTED = 0.53e-3  #: before a current sensor is read, the middle of what it tells, on average [s]

_NOTHING_KNOWN = np.full(6, np.nan)


class Watcher(Protocol):
    """Whoever switches off when this process does not beat."""

    @property
    def alive(self) -> bool:
        """Still watching."""

    def beat(self, engaged: bool) -> None:
        """Still here."""

    def close(self) -> None:
        """No longer needed."""


class Thermometers(Protocol):
    """Whoever knows the temperatures at the coils' boundaries."""

    def ready(self, patience: float) -> bool:
        """Wait for the first reading [s]."""

    def read(self) -> Array:
        """(m,) [K]."""

    def close(self) -> None:
        """May be called twice."""


@final
class I2cDriver(Driver):
    """Register by register, without firmware between: so the limits and the dead man's switch are here.

    A guardian process switches the PWM chip off when this one dies or hangs for 15 ms. Two current readings in a row
    above the device's limit by 5 %, or a chip that does not answer three times in a row, switch off and latch: `read`
    raises DriverError with the reason until `engage`.

    `bus` is the number of a Linux bus; for tests a bus of simulated chips, with their thermometers and no guardian.
    `shunt` is the resistance over which each coil's current is measured [Ω]. Hall sensors and their converter run on
    3.3 V. Where a TCA9534 answers, the Hall sensors
    have three axes, else the radial one; `open` refuses fewer than `hall_axes`. Each `read` brings one axis of four or
    five of them, the rest of a sample's `field` is NaN.

    Raises DriverError for a device that has not three coils and nine Hall sensors.
    """

    simulated = False

    def __init__(
        self,
        device: Device,
        bus: int | I2cBus,
        pose: Callable[[float], Pose] = untracked,
        *,
        thermometers: Callable[[], Thermometers] = W1Thermometers,
        shunt: float = 0.01,
        hall_axes: int = 1,
    ) -> None:
        if device.channels != CHANNELS:
            raise DriverError(f"the I²C driver serves {CHANNELS} coils; device '{device.name}' has {device.channels}")
        positions = getattr(getattr(device, "hall", None), "positions", None)
        if positions is None or len(positions) != HALL_SENSORS:
            raise DriverError(f"the I²C driver reads {HALL_SENSORS} Hall sensors; device '{device.name}' has others")
        self.name = f"i2c:{bus}" if isinstance(bus, int) else "i2c:simulated"
        self._limit = device.coils.current_limit * 1.05
        self._positions, self._hall_axes = positions, hall_axes
        self._hall_sensors = HallSensors(positions, span=SPAN_3V3)
        self._where = bus
        self._pose = pose
        self._make_thermometers = thermometers
        self._shunt = shunt
        self._bus: I2cBus | None = None
        self._watcher: Watcher | None = None
        self._thermometers: Thermometers | None = None
        self._start()

    def _start(self) -> None:
        self._fault = ""
        self._engaged = False
        self._armed = True
        self._group = 0
        self._fails = 0
        self._over = np.zeros(CHANNELS, dtype=np.int64)
        self._currents = np.zeros(CHANNELS)
        self._currents_at = self._field_at = 0.0  # [s], by the loop's clock
        self._field = self._hall_sensors.nothing()
        self._applied = np.zeros(CHANNELS)

    @property
    def field_axes(self) -> Array | None:
        """(9, 3) unit vectors, if every Hall sensor looks along its own radius only; None: three axes."""
        return self._hall_sensors.directions

    @property
    def fault(self) -> str:
        """Why no current flows, in one clause; empty if it may."""
        return self._fault

    def open(self) -> None:
        """Set every chip up, coils off; DriverError names the first that is missing, with its address."""
        self.close()
        self._start()
        self._bus = bus = LinuxBus(self._where) if isinstance(self._where, int) else self._where
        try:
            self._pwm = Pca9685(bus)
            self._pwm.setup()
            self._sensors = [Ina219(bus, address, self._shunt) for address in ina219.ADDRESSES]
            for sensor in self._sensors:
                sensor.setup()
            self._hall = HallAdc(bus)
            self._hall.setup()
            self._select = HallSelect(bus)
            axes = 3 if self._select.present() else 1
            if axes < self._hall_axes:
                raise DriverError(
                    f"nobody answers at {hall_select.ADDRESS:#04x} on {self.name}: without a TCA9534 and multiplexers "
                    f"the Hall sensors have {axes} axis, and the tracker 'hall' needs {self._hall_axes}"
                )
            self._hall_sensors = HallSensors(self._positions, axes, SPAN_3V3)
            if axes > 1:
                self._select.setup()
            for _ in range(axes * len(hall_adc.BLOCKS)):
                self._read_hall()
            self._thermometers = self._make_thermometers()
            if not self._thermometers.ready(_WARM_UP):
                raise DriverError("the DS18B20 thermometers did not answer in time; check the 1-wire bus")
            if isinstance(self._where, int):
                self._watcher = Guardian(self._where, pca9685.ADDRESS)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Coils off, then let go of the bus. May be called twice."""
        bus, self._bus = self._bus, None
        watcher, self._watcher = self._watcher, None
        thermometers, self._thermometers = self._thermometers, None
        self._engaged = False
        self._applied = np.zeros(CHANNELS)
        if bus is not None:
            try:
                bus.transfer([(pca9685.ADDRESS, pca9685.ALL_OFF)])
            except OSError:
                pass  # the guardian tries once more, from a process of its own
            finally:
                bus.close()
        if watcher is not None:
            watcher.close()
        if thermometers is not None:
            thermometers.close()

    def engage(self) -> None:
        """A person wants the coils on again: forget a trip; chips that had gone are set up anew."""
        if self._engaged:
            return
        self._fault = ""
        self._armed = True
        self._fails = 0
        self._over[:] = 0
        if self._bus is not None:
            try:
                self._pwm.setup()
                for sensor in self._sensors:
                    sensor.setup()
                self._hall.setup()
                if self._hall_sensors.axes > 1:
                    self._select.setup()
                if isinstance(self._where, int) and not (self._watcher is not None and self._watcher.alive):
                    self._watcher = Guardian(self._where, pca9685.ADDRESS)
            except DriverError as cause:
                raise self._failed(str(cause)) from cause
            except OSError as cause:
                raise self._failed(f"the I²C bus fails: {cause}") from cause

    def _failed(self, why: str) -> DriverError:
        """Coils off, and off they stay until `engage`."""
        self._engaged = self._armed = False
        self._applied = np.zeros(CHANNELS)
        self._fault = why
        try:
            self._pwm.off()
        except OSError:
            if self._watcher is not None:  # it will try, too
                self._watcher.close()
                self._watcher = None
        return DriverError(why)

    def read(self, now: float) -> Sample:
        """The three currents, one group of Hall sensors and the last temperatures, at `now` [s].

        Raises DriverError while not open, or with the reason why the coils are switched off.
        """
        if self._bus is None or self._thermometers is None:
            raise DriverError(f"the device at {self.name} is not open; use it in a `with` block or call open() first")
        if self._fault:
            raise DriverError(self._fault)
        begun = monotonic()
        try:
            for i, sensor in enumerate(self._sensors):
                self._currents[i] = sensor.current()
            had = monotonic()
            self._read_hall()
        except OSError as cause:
            self._fails += 1
            if self._fails >= _FAILS_IN_A_ROW:
                raise self._failed(f"a chip on the I²C bus does not answer: {cause}") from cause
        else:
            self._fails = 0
            # the middle of either's reading; a bus takes its time, and the tick's `now` is when it began
            self._currents_at = now + (had - begun) / 2 - _CONVERTED
            self._field_at = now + (had + monotonic()) / 2 - begun
        self._over = np.where(np.abs(self._currents) > self._limit, self._over + 1, 0)
        if (self._over >= _OVER_IN_A_ROW).any():
            coil = "xyz"[int(np.argmax(self._over))]
            raise self._failed(f"the current of coil {coil} was above its limit; look for a short before going on")
        field, self._field = self._field, self._hall_sensors.nothing()
        return Sample(
            now, self._currents.copy(), self._thermometers.read(), field, self._pose(now),
            now - self._currents_at, now - self._field_at,
        )  # fmt: skip

    def _read_hall(self) -> None:
        """One axis of one block, the next time the other block, then the next axis."""
        axis, block = divmod(self._group, len(hall_adc.BLOCKS))
        if self._hall_sensors.axes > 1:
            self._select.show(axis)
        self._hall_sensors.put(self._field, axis, hall_adc.BLOCKS[block][0], self._hall.read(block))
        self._group = (self._group + 1) % (self._hall_sensors.axes * len(hall_adc.BLOCKS))

    def write(self, duties: Array) -> Array:
        """One burst of `duties` (3,) in −1…1 [1] to the PWM chip; returns (3,) what was applied, zeros while the coils
        are off. Raises DriverError if the chip does not answer or the guardian has switched off."""
        steps = counts(duties)
        if self._bus is None or self._fault or not (self._engaged or (self._armed and any(steps))):
            return np.zeros(CHANNELS)
        self._engaged, self._armed = True, False
        try:
            if self._watcher is not None:
                self._watcher.beat(True)
            self._pwm.write(steps)
        except OSError as cause:
            raise self._failed(f"the PWM chip does not answer: {cause}") from cause
        except DriverError as cause:
            raise self._failed(str(cause)) from cause
        self._applied = np.array(steps) / DUTY_STEPS
        return self._applied.copy()

    def truth(self) -> Array:
        """(6,) NaN for the wrench [N, N·m]: nobody can know it on a real device."""
        return _NOTHING_KNOWN
