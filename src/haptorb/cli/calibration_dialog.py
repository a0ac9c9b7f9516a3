"""`haptorb calibrate`, step by step: ask, measure, store; stop when a step fails, and resume where it ended.

The driver is opened separately for every step, so that nothing is engaged while a person reads a prompt.
"""

from __future__ import annotations

import csv
import io
import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from math import ceil
from pathlib import Path
from time import monotonic, sleep, time
from typing import Any, Literal, final

import numpy as np

from haptorb.arrays import Array
from haptorb.devices.base import Device, HeatCoupling, rotation_to_axis
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.devices.field_sensors import SensorErrors
from haptorb.errors import CalibrationError, DriverError, HostSilent, InputError, UnknownName, quote
from haptorb.estimation.calibration import Calibration, MeasuredHeat, write_calibration
from haptorb.estimation.coil_calibration import (
    HeatRecord,
    MagneticCalibration,
    NetworkIdentification,
    ThermalIdentification,
    check_conduction,
    check_switching,
    excitation,
    find_silent,
    magnetic_calibration,
    network_identification,
    thermal_identification,
)
from haptorb.estimation.hall_fit import ToolModel, tool_field
from haptorb.estimation.hall_tracker import HallTracker, coil_error
from haptorb.estimation.load_calibration import LoadRecord, calibrate_by_loads
from haptorb.estimation.sensor_calibration import CoilReadings, SensorCalibration, ToolTour, calibrate_sensors
from haptorb.estimation.types import Sample
from haptorb.file_kind import FileKind
from haptorb.files import open_regular, parse_json, read_bytes, replace_file
from haptorb.json_file import numbers
from haptorb.runtime.drivers.base import Driver
from haptorb.runtime.drivers.registry import is_real, real_driver
from haptorb.thermal import TwoNode

__all__ = [
    "EFFORT",
    "HEATING",
    "RATE",
    "STEPS",
    "CalibrationEffort",
    "Dialog",
    "DriverSession",
    "FieldsStep",
    "Hand",
    "HeatingResult",
    "HeatingSchedule",
    "Pace",
    "ProgressFile",
    "Results",
    "SensorsStep",
    "Step",
    "StepContext",
    "ThermalRecord",
    "calibrate",
    "calibration_of",
    "check_steps",
    "compose_calibration",
    "guide_calibration",
    "hold_tool",
    "identify_heat",
    "make_driver",
    "mean_field",
    "schedule_of",
    "thermal_record",
]


# --------------------------------------------------------------------------------------------------
# The guided measurement: rest, every coil by itself, then the schedule; each step must be right before the next.
#
# It needs a driver and nothing else, so that the simulated device is calibrated by the same lines as a real one.


RATE = 500.0  #: of readings [Hz]: a firmware's watchdog waits 15 ms
_REST = 0.4  #: how long the device is read at rest [s]
_MEASURE_SETTLE, _MEASURE_HOLD = 0.012, 0.03  #: of each current: not looked at, and in all, at least [s]
_LEAST = 3  #: readings of every field sensor at each current
_GENTLE = 1.0  #: with which each coil is tried first [A]
_MEASURE_NOTHING = 0.03  #: of it is no current; a tenth is a wrong shunt
_CLEAR = 0.15e-3  #: field at rest above which a magnet must be near; the earth has 0.05 mT [T]
_OFFSETS = 4.0  #: standard deviations of the sensors' offsets that may come on top
_ZERO = 0.1  #: current read at rest above which a current sensor lies [A]
_FACTOR = 1.6  #: resistance may be off the file's by this
_LEAK = 0.15  #: share of a coil's current that another's sensor may read
_NOISY, _MEASURE_SHARE = (
    2.5,
    0.01,
)  #: the regression may leave so many times the sensors' noise, and this share of the field
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
        coils="windings" if "exact" in device.models else "points", centres=found.centres,
        centre_uncertainty=found.centre_uncertainty,
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
            if abs(own) < _MEASURE_NOTHING * 2 * _GENTLE:
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
        averaged = np.sqrt(RATE * (self._hold() - _MEASURE_SETTLE) / self._turns)
        share = _MEASURE_SHARE + 2 * coil_error(device)
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
            samples, _ = self.hold(duties, hold, _MEASURE_SETTLE)
            currents[n] = np.mean([sample.currents for sample in samples], axis=0)
            fields[n] = mean_field(samples)
        self.hold(self._off, 0.01)
        return wanted, currents, fields

    def _hold(self) -> float:
        """How long each current is held [s]: until every field sensor has been read a few times."""
        if self._turns == 0.0:
            samples, _ = self.hold(self._off, 0.06, _MEASURE_SETTLE)
            mean_field(samples)
            self._turns = len(samples) / int(np.isfinite([sample.field for sample in samples]).sum(axis=0).min())
        return max(_MEASURE_HOLD, _MEASURE_SETTLE + _LEAST * self._turns / RATE)


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


# --------------------------------------------------------------------------------------------------
# From `--driver` to what calibration needs: a driver without a tool near the device, and a clock.


Hand = Literal["away", "summit", "led"]  #: where a hand has the tool

_STEP = 2e-3  #: of the simulated device [s]
_COARSE = 1e-3  #: of its physics: nothing moves, and currents and heat are exact in steps of any length [s]
_PATIENCE = 0.05  #: for an answer: six minutes of heat should not end with a moment's hesitation of the device [s]


@dataclass(frozen=True)
class _ClampedHand:
    """A hand that holds the tool still, upright."""

    p: Array
    q: Array
    stamp: float = 0.0
    held: bool = False
    still: bool = False


def make_driver(
    name: str, device: SphericalElectromagnet, seed: int = 0, *, watchdog: bool = True
) -> tuple[Driver, Pace]:
    """The driver `name` of `device`, not open yet, and its pace; UnknownName or InputError if there is no such."""
    if is_real(name):
        return real_driver(name, device, patience=_PATIENCE, watchdog=watchdog), Pace()
    from haptorb.runtime.drivers.registry import check_driver
    from haptorb.runtime.drivers.sim import SimDriver
    from haptorb.simulation.electromagnet import SimulatedElectromagnet

    check_driver(name)
    driver = SimDriver(SimulatedElectromagnet(device, seed, step=_COARSE), _STEP, seed=seed)
    hold_tool(driver, device, "away")
    return driver, Pace.for_simulation()


def hold_tool(driver: Driver, device: SphericalElectromagnet, hand: Hand) -> None:
    """Let a simulated hand hold the tool on the summit, half a metre above it, or lead it over the dome; with a real
    device a person does."""
    from haptorb.runtime.drivers.sim import SimDriver
    from haptorb.simulation.hand import lead_tool

    if isinstance(driver, SimDriver):
        if hand == "led":
            driver.goal = lambda now: _ClampedHand(*lead_tool(device, now), now)
            return
        height = device.contact_distance if hand == "summit" else 0.5
        held = _ClampedHand(np.array([0.0, 0.0, height]), np.array([0.0, 0.0, 0.0, 1.0]))
        driver.goal = lambda now: held


# --------------------------------------------------------------------------------------------------
# What a guided calibration has measured so far: kept beside the file that it will become, whole or not at all.


FORMAT = "haptorb-calibration-steps-1"
_PROGRESS_FILE_MOST = 4 * 1024 * 1024  #: bytes
_STALE = 24 * 3600.0  #: a device may have been rewired since [s]
_COILS, _SENSORS = -1, -2  #: lengths that the device has
#: step → what its result must have, and of which shape (None: any length)
_SHAPES: dict[str, dict[str, tuple[int | None, ...]]] = {
    "rest": {"temperatures_k": (_COILS,)},
    "currents": {"resistance_ohm": (_COILS,)},
    "magnetic": {
        "moment_per_current_m2": (3, _COILS),
        "uncertainty_m2": (3, _COILS),
        "offsets_t": (_SENSORS, 3),
        "residual_t": (),
        "condition": (),
        "repeatability": (),
        "failed": (None,),
    },
    "fields": {
        "per_ampere_t": (_SENSORS, 3, _COILS),
        "deviation_t": (_COILS,),
        "at_rest_t": (_SENSORS, 3),
        "deviation_at_rest_t": (),
        "failed": (None,),
    },
    "heat": {
        **dict.fromkeys(("winding_capacity", "body_capacity", "winding_to_body", "body_to_air", "residual_k"), ()),
        "uncertainty": (None,),
    },
    "tool": {"likeness": (), "strength": ()},
    "sensors": {
        "positions_m": (_SENSORS, 3),
        "gain": (_SENSORS, 3, 3),
        "offsets_t": (_SENSORS, 3),
        "per_ampere_t": (_SENSORS, 3, _COILS),
        **dict.fromkeys(("uncertainty_t", "place_m", "axis_rad", "strength", "residual"), ()),
    },
}
#: what a result may have, of coupled coils: all of it or nothing
_OPTIONAL: dict[str, dict[str, tuple[int | None, ...]]] = {
    "heat": {"core_capacity": (), "winding_to_core": (_COILS,)},
    "magnetic": {"centres_m": (_COILS, 3), "centre_uncertainty_m": (_COILS, 3)},
}


@final
class ProgressFile:
    """Results by step, in a file that is replaced after every one of them.

    `left` says what was found and not taken up, in one sentence; empty if all was.
    """

    def __init__(
        self, out: Path, device: SphericalElectromagnet, driver: str, clock: Callable[[], float] = time
    ) -> None:
        self.path = out.with_name(out.name + ".steps")
        self._head = {"format": FORMAT, "device": device.name, "digest": device.digest, "driver": driver}
        self._lengths: dict[int | None, int | None] = {_COILS: device.channels, _SENSORS: device.sensors}
        self._clock = clock
        self.results: dict[str, dict[str, Any]] = {}
        self.left = ""
        if self.path.exists():
            self.left = self._resume()

    def _resume(self) -> str:
        try:
            raw = parse_json(read_bytes(self.path, _PROGRESS_FILE_MOST, "progress", CalibrationError))
            head = {key: raw[key] for key in self._head}
            written, results = float(raw["written"]), _check_steps(raw["steps"], self._lengths)
        except (CalibrationError, ValueError, KeyError, TypeError, OverflowError):
            return f"{self.path} is damaged and is ignored"
        if head != self._head:
            return f"{self.path} is for driver {quote(raw['driver'])} or another device file, and is ignored"
        if not 0.0 <= self._clock() - written <= _STALE:
            return f"{self.path} is older than a day and is ignored"
        self.results = results
        return ""

    def keep(self, name: str, result: dict[str, Any]) -> None:
        """Add the result of a step; CalibrationError if it cannot be written."""
        self.results[name] = result
        content = {**self._head, "written": self._clock(), "steps": self.results}
        try:
            with replace_file(self.path, sync=True) as part:
                part.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")
        except OSError as cause:
            raise CalibrationError(f"cannot write {self.path}: {cause.strerror}") from cause

    def forget(self) -> None:
        """Start again, or finish."""
        self.results = {}
        self.path.unlink(missing_ok=True)


def _check_steps(steps: Any, lengths: Mapping[int | None, int | None]) -> dict[str, dict[str, Any]]:
    """`steps` if every known one has what those after it use, and its line on the screen; ValueError otherwise."""
    for name, result in dict(steps).items():
        if name not in _SHAPES or not isinstance(result, dict):
            raise ValueError(f"{name} is not a step")
        optional = _OPTIONAL.get(name, {})
        shapes = _SHAPES[name] | (optional if optional.keys() & result.keys() else {})
        for key, shape in shapes.items():
            numbers(result, key, name, tuple(lengths.get(one, one) for one in shape))
        if name == "magnetic" and not np.linalg.norm(result["moment_per_current_m2"], axis=0).all():
            raise ValueError("a coil without a moment has no axis")
    return dict(steps)


# --------------------------------------------------------------------------------------------------
# Heat, measured: a coil is warmed as the paper did it, each after the other where they warm each other, and watched.
#
# Its resistance gives the winding's temperature, so a small current stays on in every observed coil. Zárate 2020,
# Fig. 6: 30 % duty for three minutes.
#
# In minutes, a computer may once be silent for 15 ms. If it was, and the firmware switched off for that reason alone,
# the second is lost and the record continues in the next: less heat went in, and that is recorded.
# The person has agreed to current in the coils for all of the step, with the tool away; any other trip ends it.


_RATE = 250.0  #: a firmware's watchdog waits 15 ms: three readings may come late, in six minutes [Hz]
_UNWATCHED = 100.0  #: nothing watches a simulation [Hz]
_HEATING_BIN = 1.0  #: readings are averaged over this [s]
_MARGIN = 5.0  #: heating ends so far below the device's warning [K]
_COLD = 4.0  #: a coil that is warmer than the others by this is not cold [K]
_LOST = 0.2  #: share of the seconds that may be lost: with more, the record is one of this computer
_HEATING_NOTHING = 0.02  #: current of a driven coil that is none [A]
_TOO_MUCH, _OFFSET = 1.5, 0.3  #: times the expected current, and [A], beyond which a coil does not switch
_NOBODY = -1
_BREATH = 0.1  #: a pause lasts at least this [s]


@dataclass(frozen=True)
class HeatingSchedule:
    """How long and how strongly: duties [1] and seconds, of heating for each coil."""

    hot: float = 0.3
    heating: float = 180.0
    warm: float = 0.05
    cooling: float = 180.0

    def seconds(self, device: SphericalElectromagnet) -> float:
        """From the first to the last reading of `device`: coupled coils are heated one after the other."""
        heated = 1 if device.coils.heat.coupling is None else device.channels
        return heated * self.heating + self.cooling


HEATING = HeatingSchedule()


@dataclass(frozen=True)
class HeatingResult:
    """What was found, and how many seconds were lost because this computer hesitated."""

    found: ThermalIdentification | NetworkIdentification
    lost: int


def identify_heat(
    session: DriverSession, device: SphericalElectromagnet, resistance: Array, course: HeatingSchedule = HEATING
) -> HeatingResult:
    """The heat of `device`, found over `course`; `resistance` (m,) [Ω] as it was when cold.

    Coils that are coupled are driven one after the other while all are watched; of coils that are alike and do not warm
    each other the first is enough. Begin with a cold device: its first temperature is taken as the room's. Raises
    CalibrationError if it is not, if a coil does not switch, if the record determines too little, or if more than a
    fifth of it was lost.
    """
    coils, rate = device.coils, _UNWATCHED if session.simulated else _RATE
    watched = list(range(device.channels if coils.heat.coupling is not None else 1))
    rest, _ = session.hold(np.zeros(device.channels), 0.2, rate=rate)
    cold = np.mean([sample.temperatures for sample in rest], axis=0)
    warmest = max(watched, key=lambda k: float(cold[k]))
    if cold[warmest] - cold.min() > _COLD:
        raise CalibrationError(
            f"coil '{coils.names[warmest]}' is {cold[warmest] - cold.min():.0f} K warmer than the others: let it cool "
            "for ten minutes"
        )
    hot, cool = int(course.heating / _HEATING_BIN), int(course.cooling / _HEATING_BIN)
    plan = [coil for coil in watched for _ in range(hot)] + [_NOBODY] * cool  # who is driven in each second
    hottest, start, record = coils.heat.warn - _MARGIN, session.now(), _Record(len(watched))
    ohms = np.array(resistance, dtype=np.float64)
    n = lost = 0
    while n < len(plan):
        duties = np.zeros(device.channels)
        duties[watched] = course.warm
        if plan[n] != _NOBODY:
            duties[plan[n]] = course.hot
        try:
            samples, applied = session.hold(duties, _HEATING_BIN, 0.2 * _HEATING_BIN, rate=rate)
        except HostSilent as cause:  # safety: silence-forgiven
            lost += 1
            if lost > _LOST * len(plan):  # safety: heating-end
                raise CalibrationError(
                    f"this computer was too busy: {lost} of {n + 1} s of readings are lost; close other programs, or "
                    "use another computer"
                ) from cause
            last = (duties * device.supply.voltage) ** 2 / ohms
            record.spend(min(max(session.now() - start, n * _HEATING_BIN), (n + 1) * _HEATING_BIN), last[watched])
            after = _pause(session, device, start, n, rate)
            record.spend(after * _HEATING_BIN, 0.0 * last[watched])
            lost, n = lost + after - n - 1, after
            continue
        currents = np.mean([sample.currents for sample in samples], axis=0)
        edge = np.mean([sample.temperatures for sample in samples], axis=0)
        volts = np.abs(applied) * device.supply.voltage
        _check_currents(device, np.abs(currents), volts / resistance, watched)
        ohms[watched] = volts[watched] / np.abs(currents[watched])
        warm = cold + (ohms / resistance - 1) / coils.temperature_coefficient
        record.tell(
            (n + 0.6) * _HEATING_BIN, warm[watched], edge[watched]
        )  # readings are averaged over the last four fifths
        record.spend((n + 1) * _HEATING_BIN, (volts * np.abs(currents))[watched])
        if plan[n] != _NOBODY and edge[plan[n]] > hottest:
            plan = plan[: n + 1] + [coil for coil in plan[n + 1 :] if coil != plan[n]]
        n += 1
    session.hold(np.zeros(device.channels), 0.02, rate=rate)
    whole = record.compose(float(cold[watched].mean()))
    if coils.heat.coupling is not None:
        return HeatingResult(network_identification(whole, coils.names, coils.heat), lost)
    power, winding, boundary = whole.power[:, 0], whole.winding[:, 0], whole.boundary[:, 0]
    return HeatingResult(thermal_identification(whole.t, power, winding, boundary, whole.ambient), lost)


def _check_currents(device: SphericalElectromagnet, currents: Array, expected: Array, watched: list[int]) -> None:
    """CalibrationError unless the coils carry about what they should: `currents` and `expected` (m,) [A]."""
    for k, name in enumerate(device.coils.names):
        if k in watched and currents[k] < _HEATING_NOTHING:
            raise CalibrationError(f"coil '{name}' carries no current during heating: check that the device is engaged")
        if currents[k] > _TOO_MUCH * expected[k] + _OFFSET:
            raise CalibrationError(
                f"coil '{name}' carries {currents[k]:.1f} A where {expected[k]:.1f} A should flow: it does not switch. "
                "Switch off the coils' supply, and check the coil's bridge, its driver and its wiring"
            )


@final
class _Record:
    """Temperatures [K] of some coils at times [s], and the heat [J] that went into each, at times of its own."""

    def __init__(self, coils: int) -> None:
        self._times: list[float] = []
        self._winding: list[Array] = []
        self._boundary: list[Array] = []
        self._until, self._joules = [0.0], [np.zeros(coils)]

    def tell(self, t: float, winding: Array, boundary: Array) -> None:
        """The temperatures of all coils (m,) at one time."""
        self._times.append(t)
        self._winding.append(winding)
        self._boundary.append(boundary)

    def spend(self, until: float, watts: Array) -> None:
        """So much power (m,) from the last such time until this one."""
        self._joules.append(self._joules[-1] + watts * (until - self._until[-1]))
        self._until.append(until)

    def compose(self, ambient: float) -> HeatRecord:
        """All of it, with the mean power from each of the times to the next, from the last to the end."""
        times = np.array([*self._times, self._until[-1]])
        heat = np.array([np.interp(times, self._until, joules) for joules in np.transpose(self._joules)])
        power = np.diff(heat) / np.diff(times)
        return HeatRecord(times[:-1], power.T, np.array(self._winding), np.array(self._boundary), ambient)


def _pause(session: DriverSession, device: SphericalElectromagnet, start: float, second: int, rate: float) -> int:
    """Coils off until a second begins: which."""
    session.reengage()
    after = max(second + 1, ceil((session.now() - start + _BREATH) / _HEATING_BIN))
    session.hold(np.zeros(device.channels), start + after * _HEATING_BIN - session.now(), rate=rate)
    return after


# --------------------------------------------------------------------------------------------------
# A step of a guided calibration, as the dialog takes it: what it asks of the person, measures, and leaves.


Results = Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True)
class CalibrationEffort:
    """How much is measured: what a test does in seconds takes a real device minutes.

    levels, repeats  of the currents in the magnetic step
    drives           of every coil in the step `fields`
    course           of the heat step
    led              for so long the tool is led over the dome [s]
    """

    levels: int = 5
    repeats: int = 4
    drives: int = 10
    course: HeatingSchedule = HEATING
    led: float = 45.0


EFFORT = CalibrationEffort()


@dataclass(frozen=True)
class StepContext:
    """One device with its driver open: what a step may use.

    axes      (k, 3) directions of one-axis field sensors; None: three axes each
    schedule  (n, m) [A] of the magnetic step
    effort    of the other steps
    """

    device: SphericalElectromagnet
    session: DriverSession
    axes: Array | None
    schedule: Array
    effort: CalibrationEffort = EFFORT


class Step(ABC):
    """One measurement; `needs` are the steps before it."""

    name: str
    title: str
    asks: str  #: of the person, before it begins
    needs: tuple[str, ...] = ()
    hand: Hand = "away"  #: where the tool is: away, at the summit, or led over the dome

    @abstractmethod
    def seconds(self, bench: StepContext) -> float:
        """How long it takes, for a bar."""

    @abstractmethod
    def measure(self, bench: StepContext, before: Results) -> dict[str, Any]:
        """Do it; CalibrationError names what is not as it must be."""

    @abstractmethod
    def describe(self, device: SphericalElectromagnet, result: Mapping[str, Any]) -> str:
        """The result in one line."""


# --------------------------------------------------------------------------------------------------
# The two steps of a calibration that find offset, gain and place of every field sensor: coils in turn, a tool led.


_SENSOR_STEPS_SHARE = 0.75  #: of each coil's limit
_SENSOR_STEPS_SETTLE, _SENSOR_STEPS_HOLD = (
    0.035,
    0.085,
)  #: of each current: not looked at, six times the core's lag; and in all [s]
_PAUSE = 0.05  #: without current between two of them [s]
_TOGETHER = 10  #: samples that are averaged: 20 ms, in which a led tool moves by a millimetre


@final
class FieldsStep(Step):
    """What every sensor reads per ampere in each coil, and at rest."""

    name, title, needs = "fields", "the coils' field at every sensor", ("rest", "currents", "magnetic")
    asks = "Each coil in turn carries up to 15 amperes in both directions, for a tenth of a second. Keep the tool away."

    def seconds(self, bench: StepContext) -> float:
        """Both directions and a pause, for each coil."""
        return bench.effort.drives * bench.device.channels * (2 * _SENSOR_STEPS_HOLD + _PAUSE) + 0.4

    def measure(self, bench: StepContext, before: Results) -> dict[str, Any]:
        """A regression for each reading by itself: no model of the field is needed."""
        if bench.axes is not None:
            raise CalibrationError(
                "the sensors measure one axis each; offset, gain and position can be determined for three-axis "
                "sensors only: leave out the steps 'fields' and 'sensors' (--steps)"
            )
        device = bench.device
        resistance = np.array(before["currents"]["resistance_ohm"])
        wanted, currents, fields, counts = _drive_in_turn(device, bench.session, resistance, bench.effort.drives)
        check_conduction(device, wanted, currents)
        failed = find_silent(device, currents, fields)
        design = np.column_stack([currents, np.ones(len(currents))])
        spread = np.linalg.inv(design.T @ design)
        found = np.einsum("ab,nb,nki->kia", spread, design, fields)
        left = fields - np.einsum("na,kia->nki", design, found)
        used = ~np.isin(np.arange(device.sensors), failed)
        freedom = 3 * int(used.sum()) * (len(currents) - design.shape[1])
        least = np.hypot(device.hall.noise, device.hall.step / np.sqrt(12)) / np.sqrt(max(counts, 1))
        sigma = max(float(np.sqrt((left[:, used] ** 2).sum() / freedom)), float(least))
        deviation = sigma * np.sqrt(np.diag(spread))
        return {
            "per_ampere_t": found[:, :, :-1].tolist(),
            "deviation_t": deviation[:-1].tolist(),
            "at_rest_t": found[:, :, -1].tolist(),
            "deviation_at_rest_t": float(deviation[-1]),
            "failed": list(failed),
        }

    def describe(self, device: SphericalElectromagnet, result: Mapping[str, Any]) -> str:
        """How sure the readings per ampere are, and who does not answer."""
        full = float(np.array(result["deviation_t"]) @ device.coils.current_limit)
        failed = "".join(f"; field sensor {n + 1} does not respond: left out" for n in result["failed"])
        return f"known to {1e6 * full:.1f} µT at full current in all coils{failed}"


@final
class SensorsStep(Step):
    """Offset, gain and place of every sensor, by a tool that a person leads over the dome."""

    name, title, hand = "sensors", "offset, gain and place of the field sensors", "led"
    needs = ("rest", "magnetic", "fields")
    asks = (
        "Coils stay off. For 45 seconds move the tool slowly over the whole dome: round it several times, from the "
        "summit down to the edge, on the dome and up to 20 mm above it, tilted to all sides."
    )

    def seconds(self, bench: StepContext) -> float:
        """As long as the tool is led."""
        return bench.effort.led

    def measure(self, bench: StepContext, before: Results) -> dict[str, Any]:
        """The bundle adjustment."""
        device, known = bench.device, before["fields"]
        if "centres_m" in before["magnetic"]:  # or sensors would be looked for where a coil seems to be
            device = replace(device, coil_centres=np.array(before["magnetic"]["centres_m"]))
        used = ~np.isin(np.arange(device.sensors), known["failed"])
        coils = CoilReadings(
            np.array(known["per_ampere_t"]), np.array(known["deviation_t"]), np.array(known["at_rest_t"]),
            float(known["deviation_at_rest_t"]), used,
        )  # fmt: skip
        samples, _ = bench.session.hold(np.zeros(device.channels), bench.effort.led)
        return calibrate_sensors(device, coils, follow_led_tool(device, samples, coils)).numbers()

    def describe(self, device: SphericalElectromagnet, result: Mapping[str, Any]) -> str:
        """What is left, who has failed, and what could not be observed."""
        failed = "".join(f"; field sensor {n + 1} has failed and is left out" for n, used in enumerate(result["used"])
                         if not used)  # fmt: skip
        unobserved = "".join(f"; not observed: {line}" for line in result["unobserved"])
        return (
            f"lasting errors of the tool's position {1e3 * result['place_m']:.2f} mm, of its axis "
            f"{np.degrees(result['axis_rad']):.2f}° rms over the shell; magnet {100 * result['strength']:.1f} % of the "
            f"device file's{failed}{unobserved}"
        )


def _drive_in_turn(
    device: SphericalElectromagnet, session: DriverSession, resistance: Array, drives: int
) -> tuple[Array, Array, Array, float]:
    """(n, m) wanted and measured currents [A], (n, k, 3) fields [T], and how many readings are in each.

    Ends at the first reading in which a coil does not switch: 15 A are not for many seconds.
    """
    wanted, currents, fields, count = [], [], [], 0.0
    off = np.zeros(device.channels)
    for number in range(drives):
        way = (
            -_SENSOR_STEPS_SHARE if number % 2 else _SENSOR_STEPS_SHARE
        )  # so that what stays in the core changes its sign, and cancels
        for coil, limit in enumerate(device.driven_current):
            for share in (way, -way, 0.0):
                want = off.copy()
                want[coil] = share * limit
                duties = np.clip(want * resistance / device.supply.voltage, -1, 1)
                samples, _ = session.hold(
                    duties, _SENSOR_STEPS_HOLD if share else _PAUSE + _SENSOR_STEPS_SETTLE, _SENSOR_STEPS_SETTLE
                )
                wanted.append(want)
                currents.append(np.mean([sample.currents for sample in samples], axis=0))
                check_switching(device, want, currents[-1], _SENSOR_STEPS_SHARE * device.driven_current)
                fields.append(mean_field(samples))
                count = float(np.isfinite([sample.field for sample in samples]).sum(axis=0).mean())
    session.hold(off, 0.01)
    return np.array(wanted), np.array(currents), np.array(fields), count


def follow_led_tool(device: SphericalElectromagnet, samples: Sequence[Sample], coils: CoilReadings) -> ToolTour:
    """Readings along the way, averaged over 20 ms, where a tracker that knows offsets only finds the tool."""
    fields, times, counts = [], [], []
    for first in range(0, len(samples) - _TOGETHER + 1, _TOGETHER):
        part = samples[first : first + _TOGETHER]
        read = np.array([sample.field for sample in part])
        finite = np.isfinite(read)
        if finite.any(axis=0)[coils.used].all():
            sums = np.where(finite, read, 0.0).sum(axis=0)
            fields.append(sums / np.maximum(finite.sum(axis=0), 1))
            counts.append(finite.sum(axis=0)[coils.used].mean())
            times.append(part[len(part) // 2].t)
    good_fields, places, axes = [], [], []
    working = device.hall.positions[coils.used]
    rough = replace(device, hall=replace(device.hall, positions=working, errors=SensorErrors(), correction=None))
    tracker = HallTracker(rough, offsets=coils.at_rest[coils.used])
    for t, field in zip(times, fields, strict=True):
        off = np.zeros(device.channels)
        sample = Sample(t, off, off, field[coils.used], samples[0].pose)
        found = tracker.update(sample)
        if found.valid:
            good_fields.append(field)
            places.append(found.state.p)
            axes.append(found.state.axis)
    noise = np.hypot(device.hall.noise, device.hall.step / np.sqrt(12)) / np.sqrt(max(np.mean(counts or [1]), 1))
    shape = (-1, device.sensors, 3)
    return ToolTour(
        np.array(good_fields).reshape(shape),
        np.array(places).reshape(-1, 3),
        np.array(axes).reshape(-1, 3),
        float(noise),
    )


# --------------------------------------------------------------------------------------------------
# The steps of a guided calibration: what each asks of the person, measures, and leaves for those after it.
#
# A result is plain JSON, so that it can be kept between two sittings. A step that fails raises CalibrationError naming
# the part, and leaves nothing.


@final
class RestStep(Step):
    """Nothing flows, nothing is near."""

    name, title = "rest", "at rest"
    asks = "Move the tool and other magnets at least 30 cm away, and switch on the coils' supply."

    def seconds(self, bench: StepContext) -> float:
        """As long as readings are averaged."""
        return 0.4

    def measure(self, bench: StepContext, before: Results) -> dict[str, Any]:
        """Temperatures of the cold device."""
        return {"temperatures_k": bench.session.measure_at_rest().tolist()}

    def describe(self, device: SphericalElectromagnet, result: Mapping[str, Any]) -> str:
        """In degrees."""
        return "no current, no magnet; coils at " + ", ".join(f"{t - 273.15:.1f} °C" for t in result["temperatures_k"])


@final
class CurrentsStep(Step):
    """Every coil by itself, gently: polarity, current sensing, resistance."""

    name, title, needs = "currents", "polarity and current sensing", ("rest",)
    asks = "Each coil carries one ampere in both directions."

    def seconds(self, bench: StepContext) -> float:
        """Two signs a coil."""
        return 0.24 * bench.device.channels

    def measure(self, bench: StepContext, before: Results) -> dict[str, Any]:
        """Resistances."""
        return {"resistance_ohm": bench.session.coils_conduct().tolist()}

    def describe(self, device: SphericalElectromagnet, result: Mapping[str, Any]) -> str:
        """In ohms."""
        pairs = zip(device.coils.names, result["resistance_ohm"], strict=True)
        return ", ".join(f"{name} {r:.4f} Ω" for name, r in pairs)


@final
class MagneticStep(Step):
    """Moment per ampere, and the sensors' offsets: Zárate 2020 eq. (5)."""

    name, title, needs = "magnetic", "field per ampere", ("rest", "currents")
    asks = "Each coil carries up to five amperes in both directions, in steps. Keep the tool away."

    def seconds(self, bench: StepContext) -> float:
        """30 ms a row."""
        return 0.03 * len(bench.schedule) + 0.01

    def measure(self, bench: StepContext, before: Results) -> dict[str, Any]:
        """The regression, every number of it."""
        found = bench.session.magnetic(np.array(before["currents"]["resistance_ohm"]), bench.schedule)
        where: dict[str, Any] = {}
        if found.centres is not None and found.centre_uncertainty is not None:
            where = {"centres_m": found.centres.tolist(), "centre_uncertainty_m": found.centre_uncertainty.tolist()}
        return {
            "moment_per_current_m2": found.moment_per_current.tolist(),
            "uncertainty_m2": found.uncertainty.tolist(),
            "offsets_t": found.offsets.tolist(),
            "residual_t": found.residual,
            "condition": found.condition,
            "repeatability": found.repeatability,
            "failed": list(found.failed),
            **where,
        }

    def describe(self, device: SphericalElectromagnet, result: Mapping[str, Any]) -> str:
        """How well it fits, and the coils' skew."""
        skew = _magnetic(result).skew(device.coils.names)
        angles = ", ".join(f"{a} and {b} {90 + np.degrees(angle):.2f}° apart" for (a, b), angle in skew.items())
        failed = "".join(f"; field sensor {n + 1} does not follow the coils: left out" for n in result["failed"])
        where = ""
        if "centres_m" in result:
            away = np.linalg.norm(result["centres_m"], axis=1)
            where = (
                "; centres "
                + ", ".join(f"{name} {1e3 * one:.2f}" for name, one in zip(device.coils.names, away, strict=True))
                + " mm off"
            )
        return f"residual {1e6 * result['residual_t']:.1f} µT rms; coils {angles}{where}{failed}"


@final
class HeatStep(Step):
    """Windings, bodies and what couples them, from coils warmed one after the other and cooled."""

    name, title, needs = "heat", "heat", ("rest", "currents")
    asks = (
        "Each coil is heated by about 25 K in three minutes, one after the other (only the first if the device file "
        "couples none), while all are measured; then all cool for three. Start cold; do not touch them."
    )

    def seconds(self, bench: StepContext) -> float:
        """Both halves."""
        return bench.effort.course.seconds(bench.device) + 0.22

    def measure(self, bench: StepContext, before: Results) -> dict[str, Any]:
        """Capacities and conductances, and how sure they are."""
        resistance = np.array(before["currents"]["resistance_ohm"])
        did = identify_heat(bench.session, bench.device, resistance, bench.effort.course)
        found, model = did.found, did.found.model
        coupled = {}
        if isinstance(found, NetworkIdentification):
            coupled = {
                "core_capacity": found.coupling.core_capacity,
                "winding_to_core": list(found.coupling.winding_to_core),
            }
        return {
            **coupled,
            "winding_capacity": model.winding_capacity,
            "body_capacity": model.body_capacity,
            "winding_to_body": model.winding_to_body,
            "body_to_air": model.body_to_air,
            "uncertainty": found.uncertainty.tolist(),
            "residual_k": found.residual,
            "lost_s": did.lost,
        }

    def describe(self, device: SphericalElectromagnet, result: Mapping[str, Any]) -> str:
        """The continuous power, in one coil and in all coils together."""
        heat = _read_heat(result).apply(device)
        rise_per_watt = heat.network(device.channels).rise_per_watt
        rise = heat.derate - heat.ambient
        watts = f"{rise / rise_per_watt.diagonal().max():.1f} W continuous"
        if heat.coupling is not None:
            watts += f" in one coil, {rise / rise_per_watt.sum(axis=1).max():.1f} W in each of all"
        lost = f"; {n} s lost because this computer was busy" if (n := result.get("lost_s", 0)) else ""
        return f"{watts}; residual {result['residual_k']:.2f} K rms{lost}"


@final
class ToolStep(Step):
    """The tool's magnet at the summit: which way round it is. Coils stay off."""

    name, title, needs, hand = "tool", "the tool's magnet", ("rest", "magnetic"), "summit"
    asks = "Hold the tool upright on the summit of the dome. The coils stay off."

    def seconds(self, bench: StepContext) -> float:
        """As long as readings are averaged."""
        return 0.6

    def measure(self, bench: StepContext, before: Results) -> dict[str, Any]:
        """The field's likeness to that of the device file's tool (1: the same, −1: the other way round), and size."""
        samples, _ = bench.session.hold(np.zeros(bench.device.channels), 0.6, 0.2)
        field = mean_field(samples) - np.array(before["magnetic"]["offsets_t"])
        likeness, strength = _likeness(bench.device, field, bench.axes)
        size = float(np.sqrt((field**2).mean()))
        if size < 2 * max(bench.device.hall.noise, bench.device.hall.step) or abs(likeness) < 0.7:
            raise CalibrationError(
                f"no tool found at the summit (match {likeness:+.2f}, {1e3 * size:.2f} mT): hold it upright on "
                "the dome's summit, with nothing else magnetic near"
            )
        if likeness < 0.0:  # safety: tool-reversed
            raise CalibrationError(
                "the tool's magnet is reversed: the dome would pull instead of push; turn the magnet over"
            )
        return {"likeness": likeness, "strength": strength}

    def describe(self, device: SphericalElectromagnet, result: Mapping[str, Any]) -> str:
        """The magnet as seen."""
        return f"polarity correct, {100 * result['strength']:.0f} % of the device file's strength"


#: in the order in which they are taken
STEPS: tuple[Step, ...] = (
    RestStep(),
    CurrentsStep(),
    MagneticStep(),
    FieldsStep(),
    HeatStep(),
    ToolStep(),
    SensorsStep(),
)


def calibration_of(
    device: SphericalElectromagnet, results: Results, simulated: bool, heat: MeasuredHeat | None = None
) -> Calibration:
    """The file's content; `heat` from elsewhere stands where the step was not taken."""
    if "heat" in results:
        heat = _read_heat(results["heat"])
    ambient, resistance = results["rest"]["temperatures_k"], results["currents"]["resistance_ohm"]
    sensors = None
    if "sensors" in results:
        sensors = SensorCalibration.parse(results["sensors"], "step 'sensors'", device.sensors, device.channels)
    found = compose_calibration(
        device, np.array(ambient), np.array(resistance), _magnetic(results["magnetic"]), heat, simulated
    )
    return replace(found, sensors=sensors)


def schedule_of(device: SphericalElectromagnet, levels: int, repeats: int) -> Array:
    """(n, m) [A] the magnetic step's currents."""
    return excitation(device, levels=levels, repeats=repeats)


def _read_heat(result: Mapping[str, Any]) -> MeasuredHeat:
    names = ("winding_capacity", "body_capacity", "winding_to_body", "body_to_air")
    coupling = None
    if "core_capacity" in result:
        to_core = tuple(float(value) for value in result["winding_to_core"])
        coupling = HeatCoupling(float(result["core_capacity"]), to_core)
    return MeasuredHeat(TwoNode(*(float(result[name]) for name in names)), coupling)


def _magnetic(result: Mapping[str, Any]) -> MagneticCalibration:
    return MagneticCalibration(
        np.array(result["moment_per_current_m2"]), np.array(result["uncertainty_m2"]), np.array(result["offsets_t"]),
        float(result["residual_t"]), float(result["condition"]), float(result["repeatability"]),
        tuple(result["failed"]),
        *(np.array(result[key]) if key in result else None for key in ("centres_m", "centre_uncertainty_m")),
    )  # fmt: skip


def _likeness(device: SphericalElectromagnet, field: Array, axes: Array | None) -> tuple[float, float]:
    """Cosine between `field` (k, 3) [T] and that of the tool near the summit, where it fits best; ratio of sizes."""
    model = ToolModel.of(device)
    B, J = np.empty((device.sensors, 3)), np.empty((device.sensors, 3, 5))
    best, strength = 0.0, 0.0
    for height in (0.0, 0.003, 0.006, 0.010):
        for tilt in np.radians((0.0, 10.0, 20.0)):
            for turn in np.radians((0.0, 60.0, 120.0, 180.0, 240.0, 300.0)):
                up = np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
                tool_field(model, (device.contact_distance + height) * up, rotation_to_axis(up), B, J)
                visible = B if axes is None else np.einsum("ki,ki->k", B, axes)[:, None] * axes
                size = float(np.linalg.norm(visible) * np.linalg.norm(field))
                cosine = float((visible * field).sum()) / size if size > 0 else 0.0
                if abs(cosine) > abs(best):
                    best, strength = cosine, float(np.linalg.norm(field) / np.linalg.norm(visible))
    return best, strength


NEEDED = ("rest", "currents", "magnetic")  #: without these there is no file

Bar = Callable[[Step, float], AbstractContextManager[Callable[[float], None]]]


def _say_nothing(text: str) -> None:
    """Says nothing."""


def _is_ready(step: Step) -> bool:
    """Always ready."""
    return True


def _no_bar(step: Step, seconds: float) -> AbstractContextManager[Callable[[float], None]]:
    """No bar."""
    return nullcontext(lambda passed: None)


@dataclass(frozen=True)
class Dialog:
    """Who talks to the person.

    say   a line
    ask   before a step; True: continue, False: not now, the steps so far are kept
    bar   a context for a step of so many seconds, which returns a function to call as time passes
    """

    say: Callable[[str], None] = _say_nothing
    ask: Callable[[Step], bool] = _is_ready
    bar: Bar = _no_bar


def check_steps(names: Sequence[str] | None, skip: Sequence[str] = ()) -> tuple[Step, ...]:
    """The steps `names` in the order in which they are taken; all but `skip` for None. UnknownName for others."""
    known = {step.name: step for step in STEPS}
    for name in names or ():
        if name not in known:
            raise UnknownName("step", name, known)
    return tuple(step for step in STEPS if (step.name in names if names is not None else step.name not in skip))


def guide_calibration(
    device: SphericalElectromagnet,
    driver: Driver,
    out: Path,
    *,
    steps: Sequence[Step] = STEPS,
    heat: MeasuredHeat | None = None,
    loads: LoadRecord | None = None,
    pace: Pace | None = None,
    guide: Dialog | None = None,
    restart: bool = False,
    overwrite: bool = False,
    effort: CalibrationEffort = EFFORT,
) -> Calibration | None:
    """Take `steps` that were not taken yet, and write `out`; None if the person stopped, or if steps are still missing.

    loads: readings of a load cell, which tell moments and the magnet's strength beside the field sensors.

    Raises CalibrationError at the first step that fails: what was measured before it is kept beside `out`, and the same
    call resumes there. The id of what was written is stored in the device, if it can keep one.
    """
    pace, guide = pace or Pace(), guide or Dialog()
    progress = ProgressFile(out, device, driver.name)
    if restart:
        progress.forget()
    elif progress.left:
        guide.say(progress.left)
    done = [step.name for step in STEPS if step.name in progress.results]
    if done:
        guide.say(f"resumed; steps already done: {', '.join(done)} (--restart repeats them)")
    for number, step in enumerate(steps, start=1):
        if step.name in progress.results:
            continue
        missing = [name for name in step.needs if name not in progress.results]
        if missing:
            raise InputError(f"step '{step.name}' needs these steps first: {', '.join(missing)}")
        guide.say(f"{number}/{len(steps)} {step.title}: {step.asks}")
        if not guide.ask(step):
            guide.say(f"stopped before '{step.name}'; repeat the command to continue here")
            return None
        try:
            progress.keep(step.name, _take_step(step, device, driver, pace, guide, progress, effort))
        except (CalibrationError, DriverError) as cause:
            raise type(cause)(
                f"step '{step.name}': {cause}. Then repeat the command: it continues at this step"
            ) from cause
        guide.say(f"    {step.describe(device, progress.results[step.name])}")
    absent = [name for name in NEEDED if name not in progress.results]
    if absent:
        guide.say(f"progress stored in {progress.path}; a calibration also needs {', '.join(absent)}")
        return None
    calibration = calibration_of(device, progress.results, driver.simulated, heat)
    if loads is not None:
        calibration, left = calibrate_by_loads(device, calibration, loads)
        assert calibration.strength is not None
        assert calibration.strength_uncertainty is not None
        guide.say(
            f"loads: {len(loads)} readings, {1e3 * left[0]:.2g} mN and {1e3 * left[1]:.2g} mN·m rms left; the magnet "
            f"has {100 * calibration.strength:.2f} ± {100 * calibration.strength_uncertainty:.2f} % of its remanence "
            "in the device file"
        )
    write_calibration(calibration, out, overwrite=overwrite)
    progress.forget()
    with driver:
        if driver.remember(calibration.id):
            guide.say(f"the device stores the calibration's id, {calibration.id.hex()}")
    return calibration


def _take_step(
    step: Step,
    device: SphericalElectromagnet,
    driver: Driver,
    pace: Pace,
    guide: Dialog,
    progress: ProgressFile,
    effort: CalibrationEffort,
) -> dict[str, object]:
    hold_tool(driver, device, step.hand)
    schedule = schedule_of(device, effort.levels, effort.repeats)
    with driver:
        blank = StepContext(device, DriverSession(device, driver, pace), driver.field_axes, schedule, effort)
        with guide.bar(step, step.seconds(blank)) as passed:
            session = DriverSession(device, driver, pace, passed)
            bench = StepContext(device, session, driver.field_axes, schedule, effort)
            return step.measure(bench, progress.results)


# --------------------------------------------------------------------------------------------------
# A record of heating and cooling: from a recording of the loop, or from a table as CSV.
#
# Of coupled coils it has all; of coils that do not warm each other, and are alike, one.


_COLUMNS = ("power_w", "winding_degc", "boundary_degc")  #: of a coil alone; of several power_NAME_w and so on
_HEAD = 256 * 1024  #: bytes by which a file of another kind is recognised
_RECORD_BIN = 0.5  #: readings of a recording are averaged over so long [s]
_LONGEST = 30 * 24 * 3600.0  #: [s]
_LARGEST = 1e6  #: of any value, in its unit
_RECORD_MOST = 1_000_000  #: readings in a table
_TRUST = 0.5  #: current from which the resistance gives a temperature [A]


@dataclass(frozen=True)
class ThermalRecord:
    """The course of all coils of `device`, or of one if they are not coupled.

    A winding is NaN where no current gave its resistance.
    """

    measured: HeatRecord
    device: Device

    def identify(self) -> ThermalIdentification | NetworkIdentification:
        """What explains it; CalibrationError if the record is too short or too cool, or coils were not driven alone."""
        record, coils = self.measured, self.device.coils
        if coils.heat.coupling is not None:
            return network_identification(record, coils.names, coils.heat)
        power, winding, boundary = record.power[:, 0], record.winding[:, 0], record.boundary[:, 0]
        return thermal_identification(record.t, power, winding, boundary, record.ambient)

    def measure(self) -> MeasuredHeat:
        """The same, as a calibration keeps it."""
        found = self.identify()
        return MeasuredHeat(found.model, found.coupling if isinstance(found, NetworkIdentification) else None)


def thermal_record(path: str | Path, device: Device) -> ThermalRecord:
    """Read `path`: an MCAP recording of `device`, or CSV with the columns t_s, power_w, winding_degc (may be empty),
    boundary_degc; for coupled coils t_s, and power_NAME_w, winding_NAME_degc, boundary_NAME_degc of each coil. The
    ambient temperature is the boundary's at the start: begin cold."""
    place = Path(path).expanduser()
    table = place.suffix.lower() == ".csv"
    return ThermalRecord(_from_table(place, device) if table else _from_recording(place, device), device)


def _columns(device: Device) -> tuple[str, ...]:
    """t_s, then powers, windings and boundaries, each of all coils."""
    if device.coils.heat.coupling is None:
        return ("t_s", *_COLUMNS)
    named = (column.rsplit("_", 1) for column in _COLUMNS)
    return ("t_s", *(f"{what}_{name}_{unit}" for what, unit in named for name in device.coils.names))


def _from_table(path: Path, device: Device) -> HeatRecord:
    columns = _columns(device)
    try:
        with open_regular(path, "thermal record", CalibrationError) as raw:
            if other := FileKind.TABLE.explain_other(path, raw.read(_HEAD)):
                raise CalibrationError(other)
            raw.seek(0)
            file = io.TextIOWrapper(raw, encoding="utf-8", newline="")
            reader = csv.DictReader(file)
            missing = [name for name in columns if name not in (reader.fieldnames or ())]
            if missing:
                raise CalibrationError(
                    f"{path}: column {missing[0]} is missing; a thermal record of '{device.name}' has "
                    f"{', '.join(columns)}"
                )
            rows = []
            for line in reader:
                cells = [(line[name] or "").strip() for name in columns]
                try:
                    rows.append([float(cell) if cell else np.nan for cell in cells])
                except ValueError as cause:
                    raise CalibrationError(f"{path}, line {reader.line_num}: not numbers: {quote(cells)}") from cause
                if len(rows) > _RECORD_MOST:
                    raise CalibrationError(f"{path}: a thermal record has at most {_RECORD_MOST} readings")
    except csv.Error as cause:
        raise CalibrationError(f"thermal record {path}: is not a table ({cause})") from cause
    except UnicodeDecodeError as cause:
        raise CalibrationError(f"thermal record {path}: cannot be read (not a text file)") from cause
    if len(rows) < 20:
        raise CalibrationError(f"{path} has {len(rows)} readings; a thermal record needs at least 20")
    table = np.array(rows)
    k = (len(columns) - 1) // 3
    power, winding, boundary = table[:, 1 : 1 + k], table[:, 1 + k : 1 + 2 * k], table[:, 1 + 2 * k :]
    whole = np.isfinite(np.column_stack([table[:, 0], power, boundary])).all(axis=1)
    if not whole.all():
        first = int(np.flatnonzero(~whole)[0]) + 2
        raise CalibrationError(f"{path}, line {first}: t_s, power and boundary temperature must be numbers")
    _check_series(path, table[:, 0], np.nan_to_num(table[:, 1:], nan=0.0, posinf=np.inf, neginf=-np.inf))
    outside = boundary + 273.15
    return HeatRecord(table[:, 0], power, winding + 273.15, outside, float(outside[:3].mean()))


def _check_series(path: Path, t: Array, values: Array) -> None:
    """CalibrationError unless time runs forward, for a month at most, and all values are of a size that can be."""
    if not (np.abs(t) < _LONGEST).all() or not (np.diff(t) >= 0).all():
        raise CalibrationError(f"{path}: time must be in seconds and increase, for {_LONGEST:.3g} s at most")
    if not (np.abs(values) < _LARGEST).all():
        raise CalibrationError(
            f"{path}: powers [W], currents [A], resistances [Ω] and temperatures [°C] must be below {_LARGEST:g}"
        )


def _from_recording(path: Path, device: Device) -> HeatRecord:
    from haptorb.recording.recording import Recording

    recording = Recording(path)
    noted = recording.metadata.get("device", {})
    if noted.get("digest", device.digest) != device.digest:
        raise CalibrationError(
            f"{path} was recorded on device {quote(noted.get('name'))} with file {quote(noted['digest'][:12])[1:-1]}, "
            f"not on '{device.name}' with file {device.digest[:12]}"
        )
    if not len(recording) or recording.t.ndim != 1:
        raise CalibrationError(f"{path} has no readings; a thermal record needs at least 20")
    t, currents = recording.t, recording["currents"].reshape(len(recording), -1)
    resistance = recording["resistance"].reshape(len(recording), -1)
    boundary = recording["boundary"].reshape(len(recording), -1)
    whole = np.isfinite(np.column_stack([t, currents, resistance, boundary])).all(axis=1)
    t, currents, resistance, boundary = t[whole], currents[whole], resistance[whole], boundary[whole]
    if len(t) < 20:
        raise CalibrationError(f"{path} has {len(t)} complete readings; a thermal record needs at least 20")
    if currents.shape[1] != device.channels or not resistance.shape == boundary.shape == currents.shape:
        raise CalibrationError(f"{path} has {currents.shape[1]} coils, device '{device.name}' has {device.channels}")
    _check_series(path, t, np.column_stack([currents, resistance, boundary]))
    coupled = device.coils.heat.coupling is not None
    used = list(range(device.channels)) if coupled else [int(np.argmax((currents**2).mean(axis=0)))]
    bins = ((t - t[0]) / _RECORD_BIN).astype(int)
    _, where, count = np.unique(bins, return_inverse=True, return_counts=True)

    def mean(values: Array) -> Array:
        averaged: Array = np.column_stack([np.bincount(where, column) / count for column in values[:, used].T])
        return averaged

    coils = device.coils
    ratio = mean(resistance) / coils.resistance[used]
    warm = coils.reference_temperature + (ratio - 1) / coils.temperature_coefficient
    winding = np.where(np.sqrt(mean(currents**2)) > _TRUST, warm, np.nan)
    temperature = mean(boundary)
    start = t[0] + _RECORD_BIN * np.unique(bins)
    return HeatRecord(start, mean(currents**2 * resistance), winding, temperature, float(temperature[0].mean()))
