"""The self-calibration of the field sensors: what was found, how well, what could not be observed, what has failed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.devices.field_sensors import FieldSensors, SensorCorrection
from haptorb.devices.state import rotation_to_axis
from haptorb.errors import CalibrationError, quote
from haptorb.files.json_file import numbers
from haptorb.numerics.arrays import Array
from haptorb.sensing.calibration.sensor_bundle import CoilReadings, SensorFit, fit_sensors
from haptorb.sensing.calibration.sensor_gauges import list_unobserved
from haptorb.sensing.calibration.tool_tour import ToolTour, check_tour, choose_readings
from haptorb.sensing.tool.sensing_accuracy import SensorKnowledge, pose_covariance
from haptorb.sensing.tool.sensor_parameters import DISPLACEMENT, MIXING, OFFSET, PARAMETERS, sensitivity, tool_readings
from haptorb.sensing.tool.tool_field import ToolModel

__all__ = ["SensorCalibration", "calibrate_sensors", "shell_sample", "uncertainty_over_shell"]

_READINGS = 360  #: of the tour that the fit uses
_STRANGE = 4.0  #: times the middle sensor's residual, above which a sensor has failed
_FAILED_SHARE = 4  #: one of so many sensors may have failed
_WORST = 3.0  #: the fit may leave so many standard deviations of the readings
_HARDLY = 0.01  #: share of the noise that is left where only lasting errors count
_FAR = 1e-3  #: the lasting error of the place over the shell may be that, rms [m]
_KEYS = ("positions_m", "gain", "offsets_t", "per_ampere_t", "used")


@dataclass(frozen=True)
class SensorCalibration:
    """What takes the place of the device file's sensors.

    positions   (k, 3) [m]; those of sensors that failed are the device file's
    correction  offset, gain, and reading per ampere of each
    place       rms lasting error of the tool's place over the shell that is left [m]
    axis        the same of its axis [rad]
    strength    of the tool's magnet, relative to the device file
    residual    of the fit, in standard deviations of a reading
    unobserved  what only the device file says, in words
    """

    positions: Array
    correction: SensorCorrection
    place: float
    axis: float
    strength: float
    residual: float
    unobserved: tuple[str, ...]

    @property
    def failed(self) -> tuple[int, ...]:
        """Numbers of the sensors that are left out, from 1."""
        return tuple(int(n) + 1 for n in np.flatnonzero(~self.correction.used))

    def apply(self, hall: FieldSensors) -> FieldSensors:
        """`hall` with what was found."""
        return replace(hall, positions=self.positions, correction=self.correction)

    def numbers(self) -> dict[str, Any]:
        """As JSON takes it, units in the keys."""
        found = self.correction
        return {
            "positions_m": self.positions.tolist(),
            "gain": found.gain.tolist(),
            "offsets_t": found.offset.tolist(),
            "per_ampere_t": found.per_ampere.tolist(),
            "used": [bool(one) for one in found.used],
            "uncertainty_t": found.uncertainty,
            "place_m": self.place,
            "axis_rad": self.axis,
            "strength": self.strength,
            "residual": self.residual,
            "unobserved": list(self.unobserved),
        }

    @classmethod
    def parse(cls, raw: Any, name: str, sensors: int, channels: int) -> SensorCalibration:
        """From what `numbers` gave, of so many sensors and channels; CalibrationError, under `name`, if it is none."""
        scalars = ("uncertainty_t", "place_m", "axis_rad", "strength", "residual")
        wanted = {*_KEYS, *scalars, "unobserved"}
        if not isinstance(raw, Mapping) or set(raw) != wanted:
            raise CalibrationError(f"{name}: field_sensors must be null or have exactly {', '.join(sorted(wanted))}")
        used = raw["used"]
        if not (isinstance(used, list) and len(used) == sensors and all(isinstance(one, bool) for one in used)):
            raise CalibrationError(
                f"{name}: used must be true or false for each of {sensors} sensors; got {quote(used)}"
            )
        lines = raw["unobserved"]
        if not (isinstance(lines, list) and all(isinstance(line, str) for line in lines)):
            raise CalibrationError(f"{name}: unobserved must be a list of texts; got {quote(lines)}")
        gain = numbers(raw, "gain", name, (sensors, 3, 3))
        if np.abs(np.linalg.det(gain)).min() < 0.1:
            raise CalibrationError(f"{name}: gain has a sensor that measures less than three directions")
        uncertainty, place, axis, strength, residual = (float(numbers(raw, key, name, ())) for key in scalars)
        correction = SensorCorrection(
            gain,
            numbers(raw, "offsets_t", name, (sensors, 3)),
            numbers(raw, "per_ampere_t", name, (sensors, 3, channels)),
            np.array(used, dtype=np.bool_),
            uncertainty,
        )
        at = numbers(raw, "positions_m", name, (sensors, 3))
        return cls(at, correction, place, axis, strength, residual, tuple(lines))


def calibrate_sensors(device: SphericalElectromagnet, coils: CoilReadings, tour: ToolTour) -> SensorCalibration:
    """Offset, gain and place of every sensor of `device` from what it reads of coils and of a tool that was led.

    A sensor that follows neither coils nor tool has failed: it is left out. Raises CalibrationError, saying what to do,
    for a tool that was not moved enough, for too many sensors that fail, and where nothing explains the readings.
    """
    check_tour(device, tour)
    chosen = choose_readings(tour, _READINGS)
    used = coils.used.copy()
    for _ in range(1 + len(used) // _FAILED_SHARE):
        check_failures(device, used)
        fit = fit_sensors(device, coils, chosen, used)
        strange = _find_failed(fit, used)
        if strange is None:
            break
        used[strange] = False
    else:
        check_failures(device, used)
    if fit.residual > _WORST:
        raise CalibrationError(
            f"the best fit leaves {fit.residual:.1f} standard deviations of the readings: keep other magnets and iron "
            "away, and check that the tool is the one of the device file"
        )
    theta, mixing = fit.theta, np.eye(3) + fit.theta[:, MIXING].reshape(-1, 3, 3)
    positions = device.hall.positions + theta[:, DISPLACEMENT]
    place, axis, uncertainty = uncertainty_over_shell(device, fit.covariance, coils.deviation, used)
    if not place < _FAR:
        raise CalibrationError(
            f"the sensors' errors are left so uncertain that the tool's place would be {1e3 * place:.1f} mm off: lead "
            "the tool more slowly and over the whole dome, and begin with the step 'fields' again (--restart)"
        )
    correction = SensorCorrection(
        np.linalg.inv(mixing), theta[:, OFFSET].copy(), coils.per_ampere, used, uncertainty
    )  # fmt: skip
    return SensorCalibration(
        positions, correction, place, axis, fit.strength, fit.residual, list_unobserved(device, fit.covariance, used)
    )


def check_failures(device: SphericalElectromagnet, used: NDArray[np.bool_]) -> None:
    """CalibrationError that names the sensors which have failed, if they are more than a quarter."""
    failed = [str(n + 1) for n in np.flatnonzero(~used)]
    if len(failed) > device.sensors // _FAILED_SHARE:
        raise CalibrationError(
            f"field sensors {', '.join(failed)} of {device.sensors} do not follow coils and tool; one in "
            f"{_FAILED_SHARE} may be left out: check their connection and supply"
        )


def _find_failed(fit: SensorFit, used: NDArray[np.bool_]) -> int | None:
    """The sensor whose residuals are far above the others', from 0."""
    each = np.where(used, fit.by_sensor, 0.0)
    worst = int(np.argmax(each))
    return worst if each[worst] > _STRANGE * max(float(np.median(each[used])), 1.0) else None


def shell_sample(device: SphericalElectromagnet, count: int = 3) -> tuple[Array, Array]:
    """Places (n, 3) [m] all over the shell and their weights (n,), as an integral over directions and distances."""
    middle = (np.arange(count) + 0.5) / count
    distance = device.contact_distance + device.shell_thickness * middle
    angle = device.workspace_half_angle * middle
    turn = 2 * np.pi * (np.arange(2 * count) + 0.25) / (2 * count)
    d, a, t = (one.ravel() for one in np.meshgrid(distance, angle, turn, indexing="ij"))
    places: Array = d[:, None] * np.column_stack([np.sin(a) * np.cos(t), np.sin(a) * np.sin(t), np.cos(a)])
    return places, np.sin(a) / np.sin(a).sum()


def uncertainty_over_shell(
    device: SphericalElectromagnet, covariance: Array, coil_deviation: Array, used: NDArray[np.bool_]
) -> tuple[float, float, float]:
    """rms lasting errors over the shell, coils off: of place [m] and axis [rad], and of one reading of the tool [T].

    covariance (15 k, 15 k) of the sensors' errors; coil_deviation (m,) [T/A].
    """
    kept = np.flatnonzero(used)
    part = replace(
        device, hall=FieldSensors(device.hall.positions[kept], device.hall.noise, device.hall.step)
    )  # the working ones
    rows = (PARAMETERS * kept[:, None] + np.arange(PARAMETERS)).ravel()
    knowledge = SensorKnowledge(
        covariance[np.ix_(rows, rows)], np.broadcast_to(coil_deviation, (3 * len(kept), device.channels))
    )
    model, off = ToolModel.of(part), np.zeros(device.channels)
    places, weights = shell_sample(device)
    squares = np.zeros(3)
    for p, weight in zip(places, weights, strict=True):
        reached, _ = pose_covariance(part, p, p, off, knowledge, share=_HARDLY)
        B, _, gradient = tool_readings(model, p, rotation_to_axis(p))
        S = sensitivity(B, gradient)
        blocks = [
            np.trace(S[n] @ knowledge.covariance[a : a + PARAMETERS, a : a + PARAMETERS] @ S[n].T)
            for n, a in enumerate(range(0, len(rows), PARAMETERS))
        ]
        squares += weight * np.array([np.trace(reached[:3, :3]), np.trace(reached[3:, 3:]), np.mean(blocks) / 3])
    place, axis, reading = np.sqrt(squares).tolist()
    return place, axis, reading
