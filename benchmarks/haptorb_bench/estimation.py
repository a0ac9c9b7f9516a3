"""Time of one update of each estimator of a spherical motor, with the rotor moving at hand speed."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter

import numpy as np

from haptorb.devices.api import motor
from haptorb.estimation.motor_orientation import LeastSquaresOrientation
from haptorb.estimation.network import FieldToTorque, LinearTorque, NetworkTorque, train, workspace_grid
from haptorb.estimation.types import Estimator, Pose, Sample
from haptorb.rotations import rotation_from_euler
from haptorb_bench.result import Metric

__all__ = ["rows"]

_PERIOD = 1e-3
_GRID = (9, 9, 32)  #: orientations that are learnt from


def rows(effort: float, notify: Callable[[str], None]) -> list[Metric]:
    """Medians and 99 percentiles over 4000 updates times `effort`."""
    device = motor("pmsm")
    ticks = max(int(4000 * effort), 300)
    t = _PERIOD * np.arange(ticks)
    R = rotation_from_euler(0.17 * np.sin(6 * t), 0.09 * np.sin(6 * t), 0.1 + 0.3 * np.sin(3 * t))
    field = device.sensor_field(R, "table")
    field += device.hall.noise * np.random.default_rng(0).standard_normal(field.shape)
    rest, none, cool = np.zeros(3), np.zeros(device.channels), np.full(device.channels, 293.0)
    nobody = Pose(0.0, np.eye(3), rest, rest, rest, False)
    samples = [Sample(float(at), none, cool, reading, nobody) for at, reading in zip(t, field, strict=True)]
    notify("training")  # how well does not change how long an update takes
    networks = NetworkTorque(device, train(device, starts=1, iterations=2, grid=_GRID))
    linear = LinearTorque(device, orientations=workspace_grid(device, _GRID))
    out = []
    for name, estimator, limit in (
        ("least squares", LeastSquaresOrientation(device), 40.0),
        ("network", FieldToTorque(device, networks), 15.0),
        ("linear map", FieldToTorque(device, linear), None),
    ):
        notify(name)
        median, p99 = _percentiles(estimator, samples)
        out += [
            Metric("estimation", f"144 readings to torque per ampere, {name}, median", median, "µs", limit=limit),
            Metric("estimation", f"the same, {name}, 99 %", p99, "µs"),
        ]
    return out


def _percentiles(estimator: Estimator, samples: list[Sample]) -> tuple[float, float]:
    """Median and 99 % of one update [µs], without the first hundred."""
    seconds = []
    for sample in samples:
        start = perf_counter()
        estimate = estimator.update(sample)
        seconds.append(perf_counter() - start)
        assert estimate.valid
    median, p99 = np.percentile(seconds[100:], (50, 99)) * 1e6
    return float(median), float(p99)
