"""Effect of field-based estimation on rate and errors, with haptorb's own estimators (Bai 2012, §1 and §2.3)."""

from __future__ import annotations

from time import perf_counter

import numpy as np
from scipy.spatial.transform import Rotation

from haptorb.arrays import Array
from haptorb.devices.api import torque_characteristic
from haptorb.devices.motor import SphericalMotor
from haptorb.estimation.motor_orientation import LeastSquaresOrientation
from haptorb.estimation.network import FieldToTorque, LinearTorque, workspace_grid
from haptorb.estimation.types import Pose, Sample
from haptorb.rotations import rotation_from_euler

__all__ = ["compare_rates", "find_accumulation"]

_PERIOD = 1e-3  #: between two readings [s]
_NOISE = 0.1e-3  #: of one component of a reading [T]


def find_accumulation(device: SphericalMotor, count: int = 400) -> float:
    """Rms error of the orientation over the last half of `count` estimates, over what the noise of one reading allows.

    The readings are those of the exact bodies; the bound is Cramér and Rao's for orientation and strength together, by
    differences of the same exact field. An error that added up from estimate to estimate would grow beyond it.
    """
    R = _swing(count)
    rng = np.random.default_rng(7)
    estimator, errors, bounds = LeastSquaresOrientation(device, start=R[0]), [], []
    for n, (turn, sample) in enumerate(zip(R, _list_samples(device, R, rng), strict=True)):
        found = estimator.update(sample).state.R_SR
        if n >= count // 2:
            errors.append(float(np.sum(Rotation.from_matrix(found @ turn.T).as_rotvec() ** 2)))
            if n % 50 == 0:
                bounds.append(_bound_error(device, turn))
    return float(np.sqrt(np.mean(errors) / np.mean(bounds)))


def compare_rates(device: SphericalMotor, count: int = 40) -> tuple[float, float, float]:
    """Median time [s] from a reading to the torque per ampere: by a direct map of the readings, by the orientation and
    then eq. (9) over all pairs of poles, by the orientation and then haptorb's table."""
    R = _swing(count)
    samples = _list_samples(device, R, np.random.default_rng(7))
    linear = LinearTorque(device, orientations=workspace_grid(device, (5, 5, 24)))
    direct, first = FieldToTorque(device, linear), LeastSquaresOrientation(device, start=R[0])
    times = np.zeros((count, 3))
    for row, sample in zip(times, samples, strict=True):
        begin = perf_counter()
        direct.update(sample)
        row[0] = perf_counter() - begin
        begin = perf_counter()
        found = first.update(sample).state.R_SR
        row[2] = perf_counter() - begin
        torque_characteristic(device, found, "published")
        row[1] = perf_counter() - begin
    straight, model, table = np.median(times[10:], axis=0)
    return float(straight), float(model), float(table)


def _swing(count: int) -> Array:
    """(count, 3, 3) orientations of a rotor that a hand swings."""
    t = _PERIOD * np.arange(count)
    return rotation_from_euler(0.17 * np.sin(6 * t), 0.09 * np.sin(6 * t), 0.1 + 0.3 * np.sin(3 * t))


def _list_samples(device: SphericalMotor, R: Array, rng: np.random.Generator) -> list[Sample]:
    rest, none, cool = np.zeros(3), np.zeros(device.channels), np.full(device.channels, 293.0)
    nobody = Pose(0.0, np.eye(3), rest, rest, rest, False)
    field = device.field(R, device.sensor_layout.positions)
    field = field + _NOISE * rng.standard_normal(field.shape)
    return [Sample(n * _PERIOD, none, cool, reading, nobody) for n, reading in enumerate(field)]


def _bound_error(device: SphericalMotor, turn: Array, step: float = 1e-5) -> float:
    """Least mean square error of the orientation [rad²] from one reading, the magnets' strength unknown too."""
    ways = Rotation.from_rotvec(step * np.vstack([np.eye(3), -np.eye(3)])).as_matrix() @ turn
    places = device.sensor_layout.positions
    field = device.field(np.concatenate([ways, turn[None]]), places).reshape(7, -1)
    slopes = np.vstack([(field[:3] - field[3:6]) / (2 * step), field[6:]])
    covariance = _NOISE**2 * np.linalg.inv(slopes @ slopes.T)
    return float(np.trace(covariance[:3, :3]))
