"""The two steps of a calibration that find offset, gain and place of every field sensor: coils in turn, a tool led."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, final

import numpy as np

from haptorb.apps.calibrate.measure import DriverSession, mean_field
from haptorb.apps.calibrate.step import Results, Step, StepContext
from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.devices.sensor_errors import SensorErrors
from haptorb.errors import CalibrationError
from haptorb.numerics.arrays import Array
from haptorb.sensing.calibration.magnetic_calibration import check_conduction, check_switching, find_silent
from haptorb.sensing.sample import Sample
from haptorb.sensing.sensors.self_calibration import calibrate_sensors
from haptorb.sensing.sensors.sensor_bundle import CoilReadings
from haptorb.sensing.sensors.tool_tour import ToolTour
from haptorb.sensing.tool.tool_position import HallTracker

__all__ = ["FieldsStep", "SensorsStep"]

_SHARE = 0.75  #: of each coil's limit
_SETTLE, _HOLD = 0.035, 0.085  #: of each current: not looked at, six times the core's lag; and in all [s]
_PAUSE = 0.05  #: without current between two of them [s]
_TOGETHER = 10  #: samples that are averaged: 20 ms, in which a led tool moves by a millimetre


@final
class FieldsStep(Step):
    """What every sensor reads per ampere in each coil, and at rest."""

    name, title, needs = "fields", "the coils' field at every sensor", ("rest", "currents", "magnetic")
    asks = "Each coil in turn carries up to 15 amperes in both directions, for a tenth of a second. Keep the tool away."

    def seconds(self, bench: StepContext) -> float:
        """Both directions and a pause, for each coil."""
        return bench.effort.drives * bench.device.channels * (2 * _HOLD + _PAUSE) + 0.4

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

    name, title, needs, hand = "sensors", "offset, gain and place of the field sensors", ("rest", "fields"), "led"
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
        way = -_SHARE if number % 2 else _SHARE  # so that what stays in the core changes its sign, and cancels
        for coil, limit in enumerate(device.driven_current):
            for share in (way, -way, 0.0):
                want = off.copy()
                want[coil] = share * limit
                duties = np.clip(want * resistance / device.supply.voltage, -1, 1)
                samples, _ = session.hold(duties, _HOLD if share else _PAUSE + _SETTLE, _SETTLE)
                wanted.append(want)
                currents.append(np.mean([sample.currents for sample in samples], axis=0))
                check_switching(device, want, currents[-1], _SHARE * device.driven_current)
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
