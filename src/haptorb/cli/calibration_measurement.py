"""The measurement of a calibration: rest, each coil alone, then the schedule, through any driver."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import monotonic, sleep
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from haptorb.arrays import Array
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.errors import CalibrationError
from haptorb.estimation.calibration_file import Calibration, MeasuredHeat
from haptorb.estimation.coil_calibration import MagneticCalibration, excitation, magnetic_calibration
from haptorb.estimation.hall_tracker import coil_error
from haptorb.estimation.types import Sample
from haptorb.runtime.drivers.base import Driver
from haptorb.runtime.drivers.registry import is_real, real_driver
from haptorb.thermal import resistance_ratio

__all__ = [
    "RATE_HZ",
    "DriverSession",
    "Hand",
    "Pace",
    "calibrate",
    "compose_calibration",
    "hold_tool",
    "make_driver",
    "mean_field",
]


# --------------------------------------------------------------------------------------------------
# Automatic measurement: rest, each coil by itself, then the schedule; each step must pass before the next begins.
#
# It needs only a driver, so that simulated and real devices are calibrated by the same code.


RATE_HZ = 500.0  #: readings per second [Hz]: a firmware's watchdog waits 15 ms
_REST_S = 0.4  #: duration of the readings at rest
_SETTLE_S, _HOLD_S = 0.012, 0.03  #: for each current: settling time that is discarded, and least total time
_MIN_READINGS = 3  #: readings of every field sensor at each current
_FIRST_CURRENT_A = 1.0  #: first test current of each coil
_NO_CURRENT_SHARE = 0.03  #: below this share of it the coil carries no current; a tenth means a wrong shunt
_MAX_REST_FIELD_T = 0.15e-3  #: field at rest above which a magnet must be near; the earth's field is 0.05 mT
_OFFSET_SIGMAS = 4.0  #: permitted sensor offsets in addition, in standard deviations
_MAX_REST_CURRENT_A = 0.1  #: current read at rest above which the current sensor is faulty
_MAX_RESISTANCE_RATIO = 1.6  #: permitted ratio of measured to nominal resistance, either way
_MAX_CROSSTALK = 0.15  #: permitted share of a coil's current in another coil's reading
_MAX_NOISE_SHARE, _MEASURE_SHARE = (
    2.5,
    0.01,
)  #: permitted residual of the regression: so many times the sensor noise, and this share of the field
_MAX_REPEAT_ERROR = 0.02  #: permitted difference between odd and even readings


@dataclass(frozen=True)
class Pace:
    """Clock and wait function; simulated time passes as fast as it is computed."""

    clock: Callable[[], float] = monotonic
    wait: Callable[[float], None] = sleep

    @classmethod
    def for_simulation(cls) -> Pace:
        """Return a pace whose clock advances only by waiting."""
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
    notify: Callable[[str], None] = lambda text: None,
) -> Calibration:
    """Measure `device` through `driver` (not open yet); coils are off afterwards in any case.

    Raises CalibrationError that names the faulty part; later steps are not taken.
    """
    pace = pace or Pace()
    with driver:
        session = DriverSession(device, driver, pace)
        notify("1/3 rest: coils off, tool away")
        ambient = session.measure_at_rest()
        notify("2/3 currents: each coil alone at low current, compared with its current sensor")
        resistance = session.coils_conduct()
        notify("3/3 magnetic: scheduled currents, measured fields")
        found = session.magnetic(resistance)
    for (one, other), angle in found.skew(device.coils.names).items():
        notify(f"    coils {one} and {other}: {90 + np.degrees(angle):.2f}° apart")
    return compose_calibration(device, ambient, resistance, found, heat, driver.simulated)


def compose_calibration(
    device: SphericalElectromagnet,
    ambient: Array,
    resistance: Array,
    found: MagneticCalibration,
    heat: MeasuredHeat | None,
    simulated: bool,
) -> Calibration:
    """Compose a calibration from the steps' results: `ambient` (m,) [K], `resistance` (m,) [Ω] at that temperature."""
    coils = device.coils
    cold = resistance / resistance_ratio(coils.temperature_coefficient, coils.reference_temperature, ambient)
    return Calibration(
        device.name, device.digest, found.moment_per_current, found.uncertainty, found.offsets, cold,
        found.residual, found.condition, found.repeatability, heat, simulated,
        coils="windings" if "exact" in device.models else "points", centres=found.centres,
        centre_uncertainty=found.centre_uncertainty,
    )  # fmt: skip


class DriverSession:
    """One open driver, read and written at a constant rate; `advance` receives the time of each reading [s]."""

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
        """Whether the device is simulated."""
        return self._driver.simulated

    def hold(
        self, duties: Array, seconds: float, settle: float = 0.0, rate: float = RATE_HZ
    ) -> tuple[list[Sample], Array]:
        """Apply `duties` for `seconds`; return the samples after `settle` [s] and the applied duties (m,)."""
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
        """Return the session's time [s]."""
        return self._pace.clock() - self._start

    def reengage(self) -> None:
        """Re-enable the coils after a trip: the next duties may engage them, and the watchdog period starts here."""
        self._driver.engage()
        self._due = self._pace.clock()

    def measure_at_rest(self) -> Array:
        """Return the coils' temperatures (m,) [K]; CalibrationError if a current flows or a magnet is near."""
        samples, _ = self.hold(self._off, _REST_S)
        device = self._device
        currents = np.mean([sample.currents for sample in samples], axis=0)
        worst = int(np.argmax(np.abs(currents)))
        if abs(currents[worst]) > _MAX_REST_CURRENT_A:
            raise CalibrationError(
                f"coil '{device.coils.names[worst]}' reads {currents[worst]:+.2f} A with all coils off: its current "
                "sensor has an offset, or its bridge does not switch off"
            )
        field = np.linalg.norm(mean_field(samples), axis=1)
        if len(field) and field.max() > _MAX_REST_FIELD_T + _OFFSET_SIGMAS * device.hall.errors.offset:
            raise CalibrationError(
                f"field sensor {int(np.argmax(field)) + 1} reads {field.max() * 1e3:.2f} mT with all coils off: take "
                "the tool, and other magnets, at least 30 cm away"
            )
        return np.asarray(np.mean([sample.temperatures for sample in samples], axis=0))

    def coils_conduct(self) -> Array:
        """Return each coil's resistance (m,) [Ω], measured with about 1 A in both directions."""
        device = self._device
        names, voltage = device.coils.names, device.supply.voltage
        resistance = np.empty(device.channels)
        for coil, name in enumerate(names):
            swings = []
            for sign in (1.0, -1.0):
                duties = self._off.copy()
                duties[coil] = sign * _FIRST_CURRENT_A * device.coils.resistance[coil] / voltage
                samples, applied = self.hold(duties, 0.1, 0.05)
                swings.append((applied, np.mean([sample.currents for sample in samples], axis=0)))
                self.hold(self._off, 0.02)
            duty, swing = float(swings[0][0][coil] - swings[1][0][coil]), swings[0][1] - swings[1][1]
            own, others = swing[coil], np.delete(np.abs(swing), coil)
            if duty == 0.0:
                raise CalibrationError(f"coil '{name}': the device applied no duty; check that it is engaged")
            if abs(own) < _NO_CURRENT_SHARE * 2 * _FIRST_CURRENT_A:
                if others.size and others.max() > 2 * _MAX_CROSSTALK * _FIRST_CURRENT_A:
                    other = names[int(np.argmax(np.abs(swing)))]
                    raise CalibrationError(
                        f"driving coil '{name}' changes the current sensor of coil '{other}': swap their wires"
                    )
                raise CalibrationError(
                    f"coil '{name}' carries {abs(own) / 2:.2g} A instead of {_FIRST_CURRENT_A:g} A: the coil is "
                    "unplugged, or its current sensor is; check the connector and the fuse"
                )
            if own * duty < 0:
                raise CalibrationError(
                    f"the current of coil '{name}' is negative for a positive duty: its current sensor is reversed"
                )
            if others.size and others.max() > _MAX_CROSSTALK * abs(own):
                raise CalibrationError(f"driving coil '{name}' also shows a current in another coil: check the wiring")
            resistance[coil] = voltage * duty / own
            expected = device.coils.resistance[coil]
            ratio = resistance[coil] / expected
            if not is_plausible_resistance(resistance[coil], expected):  # safety: calibration-step
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
        """Run the regression over `schedule` (n, m) [A]; CalibrationError if its result is implausible."""
        device = self._device
        wanted, currents, fields = self.excite(resistance, schedule)
        found = magnetic_calibration(device, wanted, currents, fields, self._driver.field_axes)
        strength = float(np.sqrt((fields**2).mean()))
        averaged = np.sqrt(RATE_HZ * (self._hold() - _SETTLE_S) / self._turns)
        share = _MEASURE_SHARE + 2 * coil_error(device)
        most = _MAX_NOISE_SHARE * np.hypot(device.hall.noise, device.hall.step) / averaged + share * strength
        if found.residual > most:
            raise CalibrationError(
                f"the coils' field is not dipolar: residual {found.residual * 1e6:.0f} µT, above {most * 1e6:.0f} "
                "µT; is something magnetic near the device, or did the tool move?"
            )
        if found.repeatability > _MAX_REPEAT_ERROR:
            raise CalibrationError(
                f"odd and even readings differ by {100 * found.repeatability:.1f} %, "
                f"above {100 * _MAX_REPEAT_ERROR:.0f} %: keep the tool and magnets away, and calibrate again"
            )
        return found

    def excite(self, resistance: Array, schedule: Array | None = None) -> tuple[Array, Array, Array]:
        """Drive the schedule; return commanded and measured currents (n, m) [A] and fields (n, k, 3) [T]."""
        wanted = excitation(self._device) if schedule is None else schedule
        hold = self._hold()
        currents, fields = np.empty_like(wanted), np.empty((len(wanted), self._device.sensors, 3))
        for n, amperes in enumerate(wanted):
            duties = np.clip(amperes * resistance / self._device.supply.voltage, -1, 1)
            samples, _ = self.hold(duties, hold, _SETTLE_S)
            currents[n] = np.mean([sample.currents for sample in samples], axis=0)
            fields[n] = mean_field(samples)
        self.hold(self._off, 0.01)
        return wanted, currents, fields

    def _hold(self) -> float:
        """Return the hold time of each current [s]: enough to read every field sensor a few times."""
        if self._turns == 0.0:
            samples, _ = self.hold(self._off, 0.06, _SETTLE_S)
            mean_field(samples)
            self._turns = len(samples) / int(np.isfinite([sample.field for sample in samples]).sum(axis=0).min())
        return max(_HOLD_S, _SETTLE_S + _MIN_READINGS * self._turns / RATE_HZ)


def is_plausible_resistance(measured: ArrayLike, nominal: ArrayLike) -> bool:
    """Whether all `measured` resistances [ohm] are within a factor of 1.6 of the `nominal` ones of the device file."""
    ratio = np.asarray(measured) / np.asarray(nominal)
    return bool(((ratio > 1 / _MAX_RESISTANCE_RATIO) & (ratio < _MAX_RESISTANCE_RATIO)).all())


def mean_field(samples: Sequence[Sample]) -> Array:
    """Return each sensor's mean field over `samples` (k, 3) [T]; a sample may hold a part of the sensors only.

    Raises CalibrationError for a sensor that was never read.
    """
    fields = np.array([sample.field for sample in samples])
    read = np.isfinite(fields)
    if not read.any(axis=0).all():
        silent = int(np.argmin(read.any(axis=0).all(axis=1))) + 1
        raise CalibrationError(f"field sensor {silent} gives no finite reading; see `haptorb hardware monitor`")
    mean: Array = np.where(read, fields, 0.0).sum(axis=0) / read.sum(axis=0)
    return mean


# --------------------------------------------------------------------------------------------------
# From the name of a driver to a session: a driver with the tool away from the device, and a clock.


Hand = Literal["away", "summit", "led"]  #: tool position of the simulated hand

_SIMULATION_STEP_S = 2e-3  #: step of the simulated device
_PHYSICS_STEP_S = 1e-3  #: step of its physics: nothing moves, and currents and heat are exact in steps of any length
_RESPONSE_TIMEOUT_S = 0.05  #: response timeout of the device: one late answer must not end six minutes of heating


def make_driver(
    name: str, device: SphericalElectromagnet, seed: int = 0, *, watchdog: bool = True
) -> tuple[Driver, Pace]:
    """Return the driver `name` of `device`, not open yet, and its pace; UnknownName or InputError if there is none."""
    if is_real(name):
        return real_driver(name, device, timeout=_RESPONSE_TIMEOUT_S, watchdog=watchdog), Pace()
    from haptorb.runtime.drivers.registry import check_driver
    from haptorb.runtime.drivers.sim import SimDriver
    from haptorb.simulation.electromagnet import SimulatedElectromagnet

    check_driver(name)
    driver = SimDriver(SimulatedElectromagnet(device, seed, step=_PHYSICS_STEP_S), _SIMULATION_STEP_S, seed=seed)
    hold_tool(driver, device, "away")
    return driver, Pace.for_simulation()


def hold_tool(driver: Driver, device: SphericalElectromagnet, hand: Hand) -> None:
    """Let a simulated hand hold the tool on the summit, half a metre above it, or move it over the dome; with a real
    device the user does."""
    from haptorb.estimation.types import HandGoal
    from haptorb.runtime.drivers.sim import SimDriver
    from haptorb.simulation.hand_motion import lead_tool

    if isinstance(driver, SimDriver):
        if hand == "led":
            driver.goal = lambda now: HandGoal(*lead_tool(device, now), now, False)
            return
        height = device.contact_distance if hand == "summit" else 0.5
        held = HandGoal(np.array([0.0, 0.0, height]), np.array([0.0, 0.0, 0.0, 1.0]), 0.0, False)
        driver.goal = lambda now: held
