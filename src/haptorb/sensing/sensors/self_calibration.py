"""The self-calibration of the field sensors: what was found, how well, what could not be observed, what has failed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.devices.field_sensors import FieldSensors, SensorCorrection
from haptorb.devices.state import rotation_to_axis
from haptorb.errors import CalibrationError
from haptorb.numerics.arrays import Array
from haptorb.sensing.calibration.sensor_calibration import SensorCalibration
from haptorb.sensing.sensors.sensing_accuracy import SensorKnowledge, pose_covariance
from haptorb.sensing.sensors.sensor_bundle import CoilReadings, SensorFit, fit_sensors
from haptorb.sensing.sensors.sensor_gauges import list_unobserved
from haptorb.sensing.sensors.sensor_parameters import (
    DISPLACEMENT,
    MIXING,
    OFFSET,
    PARAMETERS,
    sensitivity,
    tool_readings,
)
from haptorb.sensing.sensors.tool_tour import ToolTour, check_tour, choose_readings
from haptorb.sensing.tool.tool_field import ToolModel

__all__ = ["calibrate_sensors", "shell_sample", "uncertainty_over_shell"]

_READINGS = 360  #: of the tour that the fit uses
_STRANGE = 4.0  #: times the middle sensor's residual, above which a sensor has failed
_FAILED_SHARE = 4  #: one of so many sensors may have failed
_WORST = 3.0  #: the fit may leave so many standard deviations of the readings
_HARDLY = 0.01  #: share of the noise that is left where only lasting errors count
_FAR = 1e-3  #: the lasting error of the place over the shell may be that, rms [m]


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
            f"the sensors' errors remain so uncertain that the tool's position would be {1e3 * place:.1f} mm off: "
            "move the tool more slowly and over the whole dome, and repeat from the step 'fields' (--restart)"
        )
    gain = np.asarray(np.linalg.inv(mixing), dtype=np.float64)
    correction = SensorCorrection(gain, theta[:, OFFSET].copy(), coils.per_ampere, used, uncertainty)
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
    working = np.flatnonzero(used)
    part = replace(
        device, hall=FieldSensors(device.hall.positions[working], device.hall.noise, device.hall.step)
    )  # the working ones
    rows = (PARAMETERS * working[:, None] + np.arange(PARAMETERS)).ravel()
    knowledge = SensorKnowledge(
        covariance[np.ix_(rows, rows)], np.broadcast_to(coil_deviation, (3 * len(working), device.channels))
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
