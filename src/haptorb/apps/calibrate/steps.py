"""The steps of a guided calibration: what each asks of the person, measures, and leaves for those after it.

A result is plain JSON, so that it can be kept between two sittings. A step that fails raises CalibrationError naming
the part, and leaves nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, final

import numpy as np

from haptorb.apps.calibrate.heating import identify_heat
from haptorb.apps.calibrate.measure import compose_calibration, mean_field
from haptorb.apps.calibrate.sensor_steps import FieldsStep, SensorsStep
from haptorb.apps.calibrate.step import Results, Step, StepContext
from haptorb.devices.device import HeatCoupling
from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.devices.state import rotation_to_axis
from haptorb.errors import CalibrationError
from haptorb.numerics.arrays import Array
from haptorb.physics.thermal import TwoNode
from haptorb.sensing.calibration.calibration import Calibration, MeasuredHeat
from haptorb.sensing.calibration.magnetic_calibration import MagneticCalibration, excitation
from haptorb.sensing.calibration.network_identification import NetworkIdentification
from haptorb.sensing.calibration.sensor_calibration import SensorCalibration
from haptorb.sensing.tool.tool_field import ToolModel, tool_field

__all__ = ["STEPS", "calibration_of", "schedule_of"]


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
        return {
            "moment_per_current_m2": found.moment_per_current.tolist(),
            "uncertainty_m2": found.uncertainty.tolist(),
            "offsets_t": found.offsets.tolist(),
            "residual_t": found.residual,
            "condition": found.condition,
            "repeatability": found.repeatability,
            "failed": list(found.failed),
        }

    def describe(self, device: SphericalElectromagnet, result: Mapping[str, Any]) -> str:
        """How well it fits, and the coils' skew."""
        skew = _magnetic(result).skew(device.coils.names)
        angles = ", ".join(f"{a} and {b} {90 + np.degrees(angle):.2f}° apart" for (a, b), angle in skew.items())
        failed = "".join(f"; field sensor {n + 1} does not follow the coils: left out" for n in result["failed"])
        return f"residual {1e6 * result['residual_t']:.1f} µT rms; coils {angles}{failed}"


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
