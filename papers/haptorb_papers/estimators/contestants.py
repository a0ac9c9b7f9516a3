"""The compared estimators with a common interface: torque per ampere of every channel, and orientation."""

from __future__ import annotations

from time import perf_counter
from typing import NamedTuple

import numpy as np

from haptorb.arrays import Array
from haptorb.devices.motor import SphericalMotor
from haptorb.estimation.motor_orientation import LeastSquaresOrientation
from haptorb.estimation.network import FieldToTorque, LinearTorque, NetworkTorque, TrainedNetworks
from haptorb.estimation.types import Estimator, Pose, Sample

__all__ = ["EstimatorOutput", "collect_outputs", "make_estimators"]


class EstimatorOutput(NamedTuple):
    """Output of one estimator for a row of readings."""

    K: Array  #: (n, 3, channels) [N·m/A]
    R: Array  #: (n, 3, 3); NaN where it does not estimate orientation
    valid: Array  #: (n,) 1.0 or 0.0
    seconds: Array  #: (n,) that each update took


def make_estimators(motor: SphericalMotor, networks: TrainedNetworks) -> dict[str, Estimator]:
    """Name → estimator by itself: network and linear map without an orientation beside them."""
    return {
        "network": FieldToTorque(motor, NetworkTorque(motor, networks)),
        "linear": FieldToTorque(motor, LinearTorque(motor)),
        "least-squares": LeastSquaresOrientation(motor),
    }


def collect_outputs(estimator: Estimator, motor: SphericalMotor, readings: Array, interval: float) -> EstimatorOutput:
    """Outputs of `estimator` for `readings` (n, k, 3) [T] that are `interval` [s] apart."""
    count = len(readings)
    K, R = np.zeros((count, 3, motor.channels)), np.full((count, 3, 3), np.nan)
    valid, seconds = np.zeros(count), np.zeros(count)
    none, cold, rest = np.zeros(motor.channels), np.full(motor.channels, 293.0), np.zeros(3)
    pose = Pose(0.0, np.eye(3), rest, rest, rest, False)
    estimator.update(Sample(0.0, none, cold, readings[0], pose))  # compiles, and finds the rotor
    for number, field in enumerate(readings):
        sample = Sample((number + 1) * interval, none, cold, field, pose)
        start = perf_counter()
        estimate = estimator.update(sample)
        seconds[number] = perf_counter() - start
        K[number], R[number], valid[number] = estimate.wrench_map.torque, estimate.state.R_SR, estimate.valid
    return EstimatorOutput(K, R, valid, seconds)
