"""The driver of a real device wired straight to a Raspberry Pi: PWM, current sensors and Hall converter on one bus."""

from __future__ import annotations

from collections.abc import Callable
from time import monotonic
from typing import final

import numpy as np

from haptorb.control.protection.trip import CoilState
from haptorb.devices.device import Device
from haptorb.errors import DriverError
from haptorb.numerics.arrays import Array
from haptorb.runtime.drivers.driver import Driver
from haptorb.runtime.drivers.electronics import CHANNELS, DUTY_STEPS, check_electronics, counts, invalid_pose
from haptorb.runtime.drivers.hall_sensor import SPAN_3V3, HallSensors
from haptorb.runtime.drivers.i2c import ina219, max11616, output_enable, tca9534
from haptorb.runtime.drivers.i2c.coil_switch import CoilSwitch
from haptorb.runtime.drivers.i2c.i2c_bus import I2cBus
from haptorb.runtime.drivers.i2c.i2c_chips import LinuxPort, Port, UnwatchedPort
from haptorb.runtime.drivers.i2c.ina219 import Ina219
from haptorb.runtime.drivers.i2c.max11616 import HallAdc
from haptorb.runtime.drivers.i2c.pca9685 import Pca9685
from haptorb.runtime.drivers.i2c.tca9534 import HallSelect
from haptorb.runtime.drivers.i2c.w1_thermometers import Thermometers, W1Thermometers
from haptorb.sensing.sample import Pose, Sample

__all__ = ["I2cDriver"]

_FAILS_IN_A_ROW = 3
_OVER_IN_A_ROW = 2
_WARM_UP = 5.0
_IDLE = 0.02  #: of zero duties, after which the chip is switched off and confirms it [s]

_CONVERTED = 0.53e-3  #: before a current sensor is read, the middle of the conversion that it reports, on average [s]


@final
class I2cDriver(Driver):
    """Register by register, without firmware between: so the limits and the watchdogs are here.

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

    Raises DriverError for a device that has not three coils and nine Hall sensors.
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
        self._idle: float | None = None  # since when duties are zero [s]
        self._group = 0
        self._fails = 0
        self._over = np.zeros(CHANNELS, dtype=np.int64)
        self._currents = np.zeros(CHANNELS)
        self._currents_at = self._field_at = 0.0  # [s], by the loop's clock
        self._field = self._hall_sensors.empty_field()
        self._applied = np.zeros(CHANNELS)

    @property
    def field_axes(self) -> Array | None:
        """(9, 3) unit vectors, if every Hall sensor looks along its own radius only; None: three axes."""
        return self._hall_sensors.directions

    @property
    def fault(self) -> str:
        """Why no current flows, in one clause; empty if it may."""
        return self._fault

    @property
    def coil_state(self) -> CoilState:
        """As the PWM chip confirmed it by its registers; UNKNOWN before it was first set up."""
        return CoilState.UNKNOWN if self._switch is None else self._switch.state

    def open(self) -> None:
        """Set every chip up, coils off; DriverError names the first that is missing, with its address, and what to wire
        where there is no monostable."""
        self.close()
        self._start()
        self._switch = None
        self._bus = bus = self._port.open()
        try:
            self._pwm = Pca9685(bus)
            self._pwm.setup()
            self._switch = CoilSwitch(self._pwm, self._port, self._clock)
            self._sensors = [Ina219(bus, address, self._shunt) for address in ina219.ADDRESSES]
            for sensor in self._sensors:
                sensor.setup()
            self._hall = HallAdc(bus)
            self._hall.setup()
            self._select = HallSelect(bus)
            axes = 3 if self._select.present() else 1
            needed = 3 if self._watchdog else self._hall_axes  # the TCA9534 triggers the monostable, too
            if axes < needed:  # safety: chip-axes
                raise DriverError(tca9534.explain_absence(self.name, self._hall_axes))
            self._hall_sensors = HallSensors(self._positions, axes, SPAN_3V3)
            if axes > 1:
                self._select.setup()
            if self._watchdog:  # safety: i2c-monostable
                output_enable.pulse(self._select, self._clock)
            for _ in range(axes * len(max11616.BLOCKS)):
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
        """Coils off, then close the bus. May be called twice. DriverError if the PWM chip did not confirm within a
        quarter of a second that they are off: the bus is then closed, and the guardian keeps trying."""
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
        """A person wants the coils on again: forget a trip; chips that had disappeared are set up again. DriverError
        while the PWM chip has not confirmed that it is off, or has no guardian or monostable."""
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
                output_enable.check_output_enable(self._select, self._clock)
        except (DriverError, OSError) as cause:
            raise self._fail(_explain(cause, "the I²C bus fails")) from cause
        self._fault = ""
        self._armed = True
        self._fails = 0
        self._over[:] = 0

    def _fail(self, why: str) -> DriverError:
        """Coils off, and off they stay until `engage`."""
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
        """The three currents, one group of Hall sensors and the last temperatures, at `now` [s].

        Raises DriverError while not open, or with the reason why the coils are switched off.
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
            # the middle of either's reading; a bus takes its time, and the tick's `now` is when it began
            self._currents_at = now + (had - start) / 2 - _CONVERTED
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
        """One axis of one block, the next time the other block, then the next axis."""
        axis, block = divmod(self._group, len(max11616.BLOCKS))
        if self._hall_sensors.axes > 1:
            self._select.show(axis)
        self._hall_sensors.put(self._field, axis, max11616.BLOCKS[block][0], self._hall.read(block))
        self._group = (self._group + 1) % (self._hall_sensors.axes * len(max11616.BLOCKS))

    def write(self, duties: Array) -> Array:
        """One burst of `duties` (3,) in −1…1 [1] to the PWM chip; returns (3,) what was applied, zeros while the coils
        are off. Raises DriverError if a chip does not answer, or the guardian has switched off or does not answer."""
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
            if not some and self._clock() - self._idle > _IDLE:  # type: ignore[operator]
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
        """Nothing was wanted for a while: off, confirmed. The next duties engage again, for nothing failed."""
        self._idle = None
        if not switch.switch_off():
            raise DriverError("the PWM chip does not confirm that the coils are off; switch off their supply")
        switch.beat(False)
        self._engaged, self._armed = False, True
        self._applied = np.zeros(CHANNELS)
        return np.zeros(CHANNELS)


def _explain(cause: DriverError | OSError, what: str) -> str:
    return str(cause) if isinstance(cause, DriverError) else f"{what}: {cause}"
