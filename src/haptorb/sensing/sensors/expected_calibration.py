"""What the self-calibration will know of a device's sensors, before anybody takes it: from its information matrix."""

from __future__ import annotations

import numpy as np

from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.devices.state import rotation_to_axis
from haptorb.numerics.arrays import Array
from haptorb.sensing.sensors.sensing_accuracy import SensorKnowledge
from haptorb.sensing.sensors.sensor_bundle import CoilReadings, predict_covariance
from haptorb.sensing.sensors.sensor_parameters import tool_readings
from haptorb.sensing.sensors.tool_tour import ToolTour
from haptorb.sensing.tool.tool_field import ToolModel, coil_field

__all__ = ["predict_coils", "predict_knowledge", "spread_tour"]

_TOGETHER = 10  #: samples that one reading of the tour is the mean of
_COIL_SAMPLES = 20 * 25  #: samples at ± 75 % of each coil's current
_COIL_SHARE = 0.75


def spread_tour(device: SphericalElectromagnet, count: int = 360, noise: float | None = None) -> ToolTour:
    """`count` ideal readings of a tool all over the shell, leaning by up to 23° to all sides, of `noise` [T] each.

    >>> from haptorb.devices.loader import load
    >>> spread_tour(load("omni"), 12).fields.shape
    (12, 9, 3)
    """
    n = np.arange(count)
    z = 1 - (n + 0.5) / count * (1 - np.cos(device.workspace_half_angle))
    turn, s = np.pi * (1 + np.sqrt(5)) * n, np.sqrt(1 - z * z)
    outward = np.column_stack([s * np.cos(turn), s * np.sin(turn), z])
    lift = device.shell_thickness * ((n * 0.7548776662) % 1.0)  # a low-discrepancy sequence in three more dimensions
    lean, side = 0.4 * np.sqrt((n * 0.5698402909) % 1.0), 2 * np.pi * ((n * 0.4301597090) % 1.0)
    places = (device.contact_distance + lift)[:, None] * outward
    model = ToolModel.of(device, azimuth=8)
    axes, fields = np.empty_like(places), np.empty((count, device.sensors, 3))
    for k in range(count):
        R = rotation_to_axis(outward[k])
        axis = outward[k] + lean[k] * (np.cos(side[k]) * R[:, 0] + np.sin(side[k]) * R[:, 1])
        axes[k] = axis / np.linalg.norm(axis)
        fields[k] = tool_readings(model, np.ascontiguousarray(places[k]), rotation_to_axis(axes[k]))[0]
    return ToolTour(fields, places, axes, _reading_noise(device) / np.sqrt(_TOGETHER) if noise is None else noise)


def predict_coils(device: SphericalElectromagnet) -> CoilReadings:
    """What the step `fields` of a calibration finds of ideal sensors, and how sure."""
    noise = _reading_noise(device)
    deviation = noise / np.sqrt(_COIL_SAMPLES) / (_COIL_SHARE * device.driven_current)
    rest = noise / np.sqrt(_COIL_SAMPLES)
    k = device.sensors
    return CoilReadings(coil_field(device), deviation, np.zeros((k, 3)), float(rest), np.ones(k, dtype=np.bool_))


def predict_knowledge(device: SphericalElectromagnet, readings: int = 360) -> SensorKnowledge:
    """What is known of the sensors' errors after the steps `fields` and `sensors`, with so many readings."""
    coils = predict_coils(device)
    covariance = predict_covariance(device, coils, spread_tour(device, readings))
    per_reading: Array = np.broadcast_to(coils.deviation, (3 * device.sensors, device.channels))
    return SensorKnowledge(covariance, per_reading)


def _reading_noise(device: SphericalElectromagnet) -> float:
    return float(np.hypot(device.hall.noise, device.hall.step / np.sqrt(12)))
