"""The guided measurement: rest, every coil by itself, then the schedule; each step must be right before the next.

It needs a driver and nothing else, so that the simulated device is calibrated by the same lines as a real one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import monotonic, sleep

import numpy as np

from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.errors import CalibrationError
from haptorb.numerics.arrays import Array
from haptorb.runtime.drivers.driver import Driver
from haptorb.sensing.calibration.calibration import Calibration, MeasuredHeat
from haptorb.sensing.calibration.magnetic_calibration import MagneticCalibration, excitation, magnetic_calibration
from haptorb.sensing.sample import Sample
from haptorb.sensing.tool.tracker_state import coil_error

__all__ = ["RATE", "DriverSession", "Pace", "calibrate", "compose_calibration", "mean_field"]

RATE = 500.0  #: of readings [Hz]: a firmware's watchdog waits 15 ms
_REST = 0.4  #: how long the device is read at rest [s]
_SETTLE, _HOLD = 0.012, 0.03  #: of each current: not looked at, and in all, at least [s]
_LEAST = 3  #: readings of every field sensor at each current
_GENTLE = 1.0  #: with which each coil is tried first [A]
_NOTHING = 0.03  #: of it is no current; a tenth is a wrong shunt
_CLEAR = 0.15e-3  #: field at rest above which a magnet must be near; the earth has 0.05 mT [T]
_OFFSETS = 4.0  #: standard deviations of the sensors' offsets that may come on top
_ZERO = 0.1  #: current read at rest above which a current sensor lies [A]
_FACTOR = 1.6  #: resistance may be off the file's by this
_LEAK = 0.15  #: share of a coil's current that another's sensor may read
_NOISY, _SHARE = 2.5, 0.01  #: the regression may leave so many times the sensors' noise, and this share of the field
_REPEATS = 0.02  #: odd and even readings may differ by this


@dataclass(frozen=True)
class Pace:
    """The clock and the waiting; a simulation's time passes as fast as it is computed."""

    clock: Callable[[], float] = monotonic
    wait: Callable[[float], None] = sleep

    @classmethod
    def for_simulation(cls) -> Pace:
        """Time that passes by waiting."""
        now = [0.0]

        def wait(seconds: float) -> None:
            now[0] += seconds

        return cls(lambda: now[0], wait)


def calibrate(
    device: SphericalElectromagnet,
    driver: Driver,
    heat: MeasuredHeat | None = None,
    *,
    pace: Pace | None = None,
    say: Callable[[str], None] = lambda text: None,
) -> Calibration:
    """Measure `device` through `driver` (not open yet); coils are off afterwards in any case.

    Raises CalibrationError naming the part that is not as it must be; then the later steps are not taken.
    """
    pace = pace or Pace()
    with driver:
        session = DriverSession(device, driver, pace)
        say("1/3 rest: coils off, tool away")
        ambient = session.measure_at_rest()
        say("2/3 currents: each coil alone at low current, compared with its current sensor")
        resistance = session.coils_conduct()
        say("3/3 magnetic: scheduled currents, measured fields")
        found = session.magnetic(resistance)
    for (one, other), angle in found.skew(device.coils.names).items():
        say(f"    coils {one} and {other}: {90 + np.degrees(angle):.2f}° apart")
    return compose_calibration(device, ambient, resistance, found, heat, driver.simulated)


def compose_calibration(
    device: SphericalElectromagnet,
    ambient: Array,
    resistance: Array,
    found: MagneticCalibration,
    heat: MeasuredHeat | None,
    simulated: bool,
) -> Calibration:
    """The calibration that the steps' results make: `ambient` (m,) [K], `resistance` (m,) [Ω] at that temperature."""
    coils = device.coils
    cold = resistance / (1 + coils.temperature_coefficient * (ambient - coils.reference_temperature))
    return Calibration(
        device.name, device.digest, found.moment_per_current, found.uncertainty, found.offsets, cold,
        found.residual, found.condition, found.repeatability, heat, simulated,
    )  # fmt: skip


class DriverSession:
    """One open driver, read and written at a steady rate; `advance` receives every reading's time [s]."""

    def __init__(
        self,
        device: SphericalElectromagnet,
        driver: Driver,
        pace: Pace,
        passed: Callable[[float], None] = lambda seconds: None,
    ) -> None:
        self._device, self._driver, self._pace, self._passed = device, driver, pace, passed
        self._start = self._due = pace.clock()
        self._off = np.zeros(device.channels)
        self._turns = 0.0  # ticks until every field sensor has been read once; 0: not known yet

    @property
    def simulated(self) -> bool:
        """The device is a simulation."""
        return self._driver.simulated

    def hold(
        self, duties: Array, seconds: float, settle: float = 0.0, rate: float = RATE
    ) -> tuple[list[Sample], Array]:
        """Samples while `duties` are applied, from `settle` on, and (m,) what was really applied."""
        samples, applied = [], self._off
        ticks = max(2, round(seconds * rate))
        for tick in range(ticks):
            sample = self._driver.read(self._pace.clock() - self._start)
            if not np.isfinite(sample.currents).all():
                raise CalibrationError("a current sensor gives no finite reading; see `haptorb hardware monitor`")
            hot = int(np.argmax(sample.temperatures))
            if sample.temperatures[hot] > self._device.coils.heat.warn:
                raise CalibrationError(
                    f"coil '{self._device.coils.names[hot]}' is at {sample.temperatures[hot] - 273.15:.0f} °C: "
                    "let it cool and calibrate again"
                )
            if tick > settle * rate:
                samples.append(sample)
            applied = self._driver.write(duties)
            self._due += 1 / rate
            self._pace.wait(max(0.0, self._due - self._pace.clock()))
            self._passed(1 / rate)
        return samples, applied

    def now(self) -> float:
        """On the session's clock [s]."""
        return self._pace.clock() - self._start

    def reengage(self) -> None:
        """After a trip: the next duties may engage the coils, and readings are due from here on."""
        self._driver.engage()
        self._due = self._pace.clock()

    def measure_at_rest(self) -> Array:
        """(m,) the coils' temperatures [K]; nothing flows and no magnet is near, or CalibrationError."""
        samples, _ = self.hold(self._off, _REST)
        device = self._device
        currents = np.mean([sample.currents for sample in samples], axis=0)
        worst = int(np.argmax(np.abs(currents)))
        if abs(currents[worst]) > _ZERO:
            raise CalibrationError(
                f"coil '{device.coils.names[worst]}' reads {currents[worst]:+.2f} A with all coils off: its current "
                "sensor has an offset, or its bridge does not switch off"
            )
        field = np.linalg.norm(mean_field(samples), axis=1)
        if len(field) and field.max() > _CLEAR + _OFFSETS * device.hall.errors.offset:
            raise CalibrationError(
                f"field sensor {int(np.argmax(field)) + 1} reads {field.max() * 1e3:.2f} mT with all coils off: take "
                "the tool, and other magnets, at least 30 cm away"
            )
        return np.asarray(np.mean([sample.temperatures for sample in samples], axis=0))

    def coils_conduct(self) -> Array:
        """(m,) resistance [Ω] of each coil, found with about an ampere either way."""
        device = self._device
        names, voltage = device.coils.names, device.supply.voltage
        resistance = np.empty(device.channels)
        for coil, name in enumerate(names):
            swings = []
            for sign in (1.0, -1.0):
                duties = self._off.copy()
                duties[coil] = sign * _GENTLE * device.coils.resistance[coil] / voltage
                samples, applied = self.hold(duties, 0.1, 0.05)
                swings.append((applied, np.mean([sample.currents for sample in samples], axis=0)))
                self.hold(self._off, 0.02)
            duty, swing = float(swings[0][0][coil] - swings[1][0][coil]), swings[0][1] - swings[1][1]
            own, others = swing[coil], np.delete(np.abs(swing), coil)
            if duty == 0.0:
                raise CalibrationError(f"coil '{name}': the device applied no duty; check that it is engaged")
            if abs(own) < _NOTHING * 2 * _GENTLE:
                if others.size and others.max() > 2 * _LEAK * _GENTLE:
                    other = names[int(np.argmax(np.abs(swing)))]
                    raise CalibrationError(
                        f"driving coil '{name}' changes the current sensor of coil '{other}': swap their wires"
                    )
                raise CalibrationError(
                    f"coil '{name}' carries {abs(own) / 2:.2g} A instead of {_GENTLE:g} A: the coil is unplugged, or "
                    "its current sensor is; check the connector and the fuse"
                )
            if own * duty < 0:
                raise CalibrationError(
                    f"the current of coil '{name}' is negative for a positive duty: its current sensor is reversed"
                )
            if others.size and others.max() > _LEAK * abs(own):
                raise CalibrationError(f"driving coil '{name}' also shows a current in another coil: check the wiring")
            resistance[coil] = voltage * duty / own
            expected = device.coils.resistance[coil]
            ratio = resistance[coil] / expected
            if not 1 / _FACTOR < ratio < _FACTOR:  # safety: calibration-step
                ten = 6 < max(ratio, 1 / ratio) < 16
                raise CalibrationError(
                    f"coil '{name}' measures {resistance[coil]:.3g} Ω, the device file has {expected:g} Ω: "
                    + (
                        "the value of its shunt is wrong by a factor of ten"
                        if ten
                        else "check the coil, its contacts, and the value of its shunt"
                    )
                )
        return resistance

    def magnetic(self, resistance: Array, schedule: Array | None = None) -> MagneticCalibration:
        """The regression over `schedule` (n, m) [A]; CalibrationError where its result cannot be a device's."""
        device = self._device
        wanted, currents, fields = self.excite(resistance, schedule)
        found = magnetic_calibration(device, wanted, currents, fields, self._driver.field_axes)
        strength = float(np.sqrt((fields**2).mean()))
        averaged = np.sqrt(RATE * (self._hold() - _SETTLE) / self._turns)
        share = _SHARE + 2 * coil_error(device)
        most = _NOISY * np.hypot(device.hall.noise, device.hall.step) / averaged + share * strength
        if found.residual > most:
            raise CalibrationError(
                f"the coils' field is not dipolar: residual {found.residual * 1e6:.0f} µT, above {most * 1e6:.0f} "
                "µT; is something magnetic near the device, or did the tool move?"
            )
        if found.repeatability > _REPEATS:
            raise CalibrationError(
                f"odd and even readings differ by {100 * found.repeatability:.1f} %, above {100 * _REPEATS:.0f} %: "
                "keep the tool and magnets away, and calibrate again"
            )
        return found

    def excite(self, resistance: Array, schedule: Array | None = None) -> tuple[Array, Array, Array]:
        """(n, m) wanted and measured currents [A] and (n, k, 3) fields [T] over the schedule."""
        wanted = excitation(self._device) if schedule is None else schedule
        hold = self._hold()
        currents, fields = np.empty_like(wanted), np.empty((len(wanted), self._device.sensors, 3))
        for n, amperes in enumerate(wanted):
            duties = np.clip(amperes * resistance / self._device.supply.voltage, -1, 1)
            samples, _ = self.hold(duties, hold, _SETTLE)
            currents[n] = np.mean([sample.currents for sample in samples], axis=0)
            fields[n] = mean_field(samples)
        self.hold(self._off, 0.01)
        return wanted, currents, fields

    def _hold(self) -> float:
        """How long each current is held [s]: until every field sensor has been read a few times."""
        if self._turns == 0.0:
            samples, _ = self.hold(self._off, 0.06, _SETTLE)
            mean_field(samples)
            self._turns = len(samples) / int(np.isfinite([sample.field for sample in samples]).sum(axis=0).min())
        return max(_HOLD, _SETTLE + _LEAST * self._turns / RATE)


def mean_field(samples: Sequence[Sample]) -> Array:
    """(k, 3) [T] each sensor's mean over `samples`; some drivers read a part of them in each.

    Raises CalibrationError for a sensor that was never read.
    """
    fields = np.array([sample.field for sample in samples])
    read = np.isfinite(fields)
    if not read.any(axis=0).all():
        silent = int(np.argmin(read.any(axis=0).all(axis=1))) + 1
        raise CalibrationError(f"field sensor {silent} gives no finite reading; see `haptorb hardware monitor`")
    mean: Array = np.where(read, fields, 0.0).sum(axis=0) / read.sum(axis=0)
    return mean
