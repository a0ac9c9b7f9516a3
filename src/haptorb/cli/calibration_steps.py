"""Steps of a guided calibration: the prompt, measurement and stored result of each."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np

from haptorb.arrays import Array
from haptorb.cli.calibration_measurement import DriverSession, Hand, compose_calibration, mean_field
from haptorb.cli.heat_measurement import HEATING, HeatingSchedule, identify_heat
from haptorb.devices.base import HeatCoupling, rotation_to_axis
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.devices.field_sensors import SensorErrors
from haptorb.errors import CalibrationError
from haptorb.estimation.calibration_file import Calibration, MeasuredHeat
from haptorb.estimation.coil_calibration import (
    MagneticCalibration,
    check_conduction,
    check_switching,
    excitation,
    find_silent,
)
from haptorb.estimation.hall_pose_fit import ToolModel, tool_field
from haptorb.estimation.hall_tracker import HallTracker
from haptorb.estimation.heat_calibration import NetworkIdentification
from haptorb.estimation.sensor_calibration import CoilReadings, SensorCalibration, ToolTour, calibrate_sensors
from haptorb.estimation.types import Sample
from haptorb.thermal import TwoNode

__all__ = [
    "EFFORT",
    "STEPS",
    "CalibrationEffort",
    "FieldsStep",
    "Results",
    "SensorsStep",
    "Step",
    "StepContext",
    "calibration_of",
    "schedule_of",
]


# --------------------------------------------------------------------------------------------------
# Interface of a calibration step: prompt, duration, measurement, report.


Results = Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True)
class CalibrationEffort:
    """Extent of the measurements; tests use a reduced one that takes seconds instead of minutes.

    levels, repeats  current levels and repetitions in the step `magnetic`
    drives           excitations of each coil in the step `fields`
    course           schedule of the step `heat`
    led              duration for which the tool is moved over the dome [s]
    """

    levels: int = 5
    repeats: int = 4
    drives: int = 10
    course: HeatingSchedule = HEATING
    led: float = 45.0


EFFORT = CalibrationEffort()


@dataclass(frozen=True)
class StepContext:
    """One device with its driver open: the resources of a step.

    axes      (k, 3) directions of one-axis field sensors; None: three axes each
    schedule  (n, m) currents of the magnetic step [A]
    effort    extent of the other steps
    """

    device: SphericalElectromagnet
    session: DriverSession
    axes: Array | None
    schedule: Array
    effort: CalibrationEffort = EFFORT


class Step(ABC):
    """One measurement; `needs` names the steps that must precede it."""

    name: str
    title: str
    instruction: str  #: instruction to the person before it begins
    needs: tuple[str, ...] = ()
    hand: Hand = "away"  #: tool position: away, at the summit, or moved over the dome

    @abstractmethod
    def seconds(self, bench: StepContext) -> float:
        """Return the expected duration [s], for the progress bar."""

    @abstractmethod
    def measure(self, bench: StepContext, before: Results) -> dict[str, Any]:
        """Take the measurement; CalibrationError names the faulty part."""

    @abstractmethod
    def describe(self, device: SphericalElectromagnet, result: Mapping[str, Any]) -> str:
        """Describe the result in one line."""


# --------------------------------------------------------------------------------------------------
# Steps that determine offset, gain and position of every field sensor: coils driven in turn, a guided tool.


_CURRENT_SHARE = 0.75  #: share of each coil's current limit
_SETTLE_S, _HOLD_S = (
    0.035,
    0.085,
)  #: for each current: discarded settling time, six times the core's lag, and total time [s]
_PAUSE_S = 0.05  #: pause without current between two of them
_AVERAGED_SAMPLES = 10  #: samples per average: 20 ms, in which the tool moves by a millimetre


@final
class FieldsStep(Step):
    """Field at every sensor per ampere in each coil, and at rest."""

    name, title, needs = "fields", "the coils' field at every sensor", ("rest", "currents", "magnetic")
    instruction = (
        "Each coil in turn carries up to 15 amperes in both directions, for a tenth of a second. Keep the tool away."
    )

    def seconds(self, bench: StepContext) -> float:
        """Return the duration of both directions and a pause for each coil [s]."""
        return bench.effort.drives * bench.device.channels * (2 * _HOLD_S + _PAUSE_S) + 0.4

    def measure(self, bench: StepContext, before: Results) -> dict[str, Any]:
        """Fit each sensor axis separately by linear regression: no field model is needed."""
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
        """Describe the uncertainty of the readings per ampere, and the failed sensors."""
        full = float(np.array(result["deviation_t"]) @ device.coils.current_limit)
        failed = "".join(f"; field sensor {n + 1} does not respond: left out" for n in result["failed"])
        return f"known to {1e6 * full:.1f} µT at full current in all coils{failed}"


@final
class SensorsStep(Step):
    """Offset, gain and position of every sensor, from a tool that a person moves over the dome."""

    name, title, hand = "sensors", "offset, gain and place of the field sensors", "led"
    needs = ("rest", "magnetic", "fields")
    instruction = (
        "Coils stay off. For 45 seconds move the tool slowly over the whole dome: round it several times, from the "
        "summit down to the edge, on the dome and up to 20 mm above it, tilted to all sides."
    )

    def seconds(self, bench: StepContext) -> float:
        """Return the duration of the tool's motion [s]."""
        return bench.effort.led

    def measure(self, bench: StepContext, before: Results) -> dict[str, Any]:
        """Run the bundle adjustment over tool poses and sensor parameters."""
        device, known = bench.device, before["fields"]
        if "centres_m" in before["magnetic"]:  # otherwise misplaced coils would be attributed to the sensors
            device = replace(device, coil_centres=np.array(before["magnetic"]["centres_m"]))
        used = ~np.isin(np.arange(device.sensors), known["failed"])
        coils = CoilReadings(
            np.array(known["per_ampere_t"]), np.array(known["deviation_t"]), np.array(known["at_rest_t"]),
            float(known["deviation_at_rest_t"]), used,
        )  # fmt: skip
        samples, _ = bench.session.hold(np.zeros(device.channels), bench.effort.led)
        return calibrate_sensors(device, coils, follow_led_tool(device, samples, coils)).numbers()

    def describe(self, device: SphericalElectromagnet, result: Mapping[str, Any]) -> str:
        """Describe remaining errors, failed sensors, and parameters that could not be observed."""
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
    """Drive the coils in turn; return currents commanded and measured (n, m) [A], fields (n, k, 3) [T], readings each.

    Raises at the first reading in which a coil does not switch: 15 A must not last for seconds.
    """
    wanted, currents, fields, count = [], [], [], 0.0
    off = np.zeros(device.channels)
    for number in range(drives):
        way = -_CURRENT_SHARE if number % 2 else _CURRENT_SHARE  # so that the core's remanence changes sign and cancels
        for coil, limit in enumerate(device.driven_current):
            for share in (way, -way, 0.0):
                want = off.copy()
                want[coil] = share * limit
                duties = np.clip(want * resistance / device.supply.voltage, -1, 1)
                samples, _ = session.hold(duties, _HOLD_S if share else _PAUSE_S + _SETTLE_S, _SETTLE_S)
                wanted.append(want)
                currents.append(np.mean([sample.currents for sample in samples], axis=0))
                check_switching(device, want, currents[-1], _CURRENT_SHARE * device.driven_current)
                fields.append(mean_field(samples))
                count = float(np.isfinite([sample.field for sample in samples]).sum(axis=0).mean())
    session.hold(off, 0.01)
    return np.array(wanted), np.array(currents), np.array(fields), count


def follow_led_tool(device: SphericalElectromagnet, samples: Sequence[Sample], coils: CoilReadings) -> ToolTour:
    """Average the readings over 20 ms windows; keep those where a tracker with known offsets locates the tool."""
    fields, times, counts = [], [], []
    for first in range(0, len(samples) - _AVERAGED_SAMPLES + 1, _AVERAGED_SAMPLES):
        part = samples[first : first + _AVERAGED_SAMPLES]
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
# The steps of a guided calibration.
#
# A result is plain JSON, so that it can be stored between two sessions. A step that fails raises CalibrationError
# that names the part, and stores nothing.


@final
class RestStep(Step):
    """Readings with the coils off and the tool away."""

    name, title = "rest", "at rest"
    instruction = "Move the tool and other magnets at least 30 cm away, and switch on the coils' supply."

    def seconds(self, bench: StepContext) -> float:
        """Return the averaging time [s]."""
        return 0.4

    def measure(self, bench: StepContext, before: Results) -> dict[str, Any]:
        """Measure the temperatures of the cold device."""
        return {"temperatures_k": bench.session.measure_at_rest().tolist()}

    def describe(self, device: SphericalElectromagnet, result: Mapping[str, Any]) -> str:
        """List the temperatures [°C]."""
        return "no current, no magnet; coils at " + ", ".join(f"{t - 273.15:.1f} °C" for t in result["temperatures_k"])


@final
class CurrentsStep(Step):
    """Each coil by itself at low current: polarity, current sensing, resistance."""

    name, title, needs = "currents", "polarity and current sensing", ("rest",)
    instruction = "Each coil carries one ampere in both directions."

    def seconds(self, bench: StepContext) -> float:
        """Return the duration of both polarities of each coil [s]."""
        return 0.24 * bench.device.channels

    def measure(self, bench: StepContext, before: Results) -> dict[str, Any]:
        """Measure the resistance of each coil [Ω]."""
        return {"resistance_ohm": bench.session.coils_conduct().tolist()}

    def describe(self, device: SphericalElectromagnet, result: Mapping[str, Any]) -> str:
        """List the resistances [Ω]."""
        pairs = zip(device.coils.names, result["resistance_ohm"], strict=True)
        return ", ".join(f"{name} {r:.4f} Ω" for name, r in pairs)


@final
class MagneticStep(Step):
    """Moment per ampere, and the sensors' offsets: Zárate 2020 eq. (5)."""

    name, title, needs = "magnetic", "field per ampere", ("rest", "currents")
    instruction = "Each coil carries up to five amperes in both directions, in steps. Keep the tool away."

    def seconds(self, bench: StepContext) -> float:
        """Return the duration of the schedule: 30 ms for each row [s]."""
        return 0.03 * len(bench.schedule) + 0.01

    def measure(self, bench: StepContext, before: Results) -> dict[str, Any]:
        """Run the regression and return all its results."""
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
        """Describe the residual and the angles between the coils."""
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
    """Heat capacities and conductances of windings and boundaries, from heating coils in turn and cooling them."""

    name, title, needs = "heat", "heat", ("rest", "currents")
    instruction = (
        "Each coil is heated by about 25 K in three minutes, one after the other (only the first if the device file "
        "couples none), while all are measured; then all cool for three. Start cold; do not touch them."
    )

    def seconds(self, bench: StepContext) -> float:
        """Return the duration of heating and cooling [s]."""
        return bench.effort.course.seconds(bench.device) + 0.22

    def measure(self, bench: StepContext, before: Results) -> dict[str, Any]:
        """Identify capacities and conductances with their uncertainties."""
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
        """Describe the continuous power with one coil and with all coils warm [W]."""
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
    """Polarity of the tool's magnet, held on the summit with the coils off."""

    name, title, needs, hand = "tool", "the tool's magnet", ("rest", "magnetic"), "summit"
    instruction = "Hold the tool upright on the summit of the dome. The coils stay off."

    def seconds(self, bench: StepContext) -> float:
        """Return the averaging time [s]."""
        return 0.6

    def measure(self, bench: StepContext, before: Results) -> dict[str, Any]:
        """Compare the field with that of the device file's tool: cosine (−1: magnet reversed), ratio of magnitudes."""
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
        """Describe polarity and strength of the magnet."""
        return f"polarity correct, {100 * result['strength']:.0f} % of the device file's strength"


#: in order of execution
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
    """Compose the calibration; `heat` from another source is used if the step `heat` was not taken."""
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
    """Return the currents of the magnetic step (n, m) [A]."""
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
    """Return cosine and magnitude ratio of `field` (k, 3) [T] and the tool's field at the best fit near the summit."""
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
