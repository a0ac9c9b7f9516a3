"""Torque per ampere as a linear map of all readings: the `linear` estimator, quick and plain.

K ≈ M (B, 1), with M the least squares map over the workspace for readings with noise σ: a ridge of σ². The sensors sit
a few millimetres from the magnets, where the field has more detail than 48 places can carry; so the best linear map is
about a tenth of K off, whatever the noise (spatial aliasing).
"""

from __future__ import annotations

import numpy as np

from haptorb.devices.motor.spherical_motor import SphericalMotor
from haptorb.errors import InputError
from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel
from haptorb.sensing.torque_maps.neighbourhood import Numbers
from haptorb.sensing.torque_maps.torque_map import TorqueMap
from haptorb.sensing.torque_maps.training_set import workspace_grid

__all__ = ["LinearTorque"]

_MOST_MISSING = 0.25  #: share of the sensors that the others may stand in for


class LinearTorque(TorqueMap):
    """An unusable sensor is replaced by the most likely value given the others, by the same least squares.

    motor          whose tables teach the map
    noise          of one reading [T]; the device's own if not given
    orientations   (n, 3, 3) to learn from; the workspace's grid if not given

    Raises InputError for a noise that cannot be, and for readings that teach nothing.
    """

    def __init__(self, motor: SphericalMotor, *, noise: float | None = None, orientations: Array | None = None) -> None:
        sigma = motor.hall.noise if noise is None else noise
        if not 0 <= sigma < 1:
            raise InputError(f"noise must be a flux density from 0 to 1 T; got {noise!r}")
        R = workspace_grid(motor) if orientations is None else orientations
        x = motor.sensor_field(R, "table").reshape(len(R), -1)
        y = motor.torque_characteristic(R, "table").reshape(len(R), -1)
        if len(R) < 2 * x.shape[1]:
            raise InputError(f"{x.shape[1]} readings need at least {2 * x.shape[1]} orientations; got {len(R)}")
        self._mean = x.mean(axis=0)
        offset = y.mean(axis=0)
        x, y = x - self._mean, y - offset
        covariance = x.T @ x / len(x)
        spread = float(np.trace(covariance)) / x.shape[1]
        if not spread > 1e-12 * float((self._mean**2).mean()):
            raise InputError("the readings do not change over the training set: give more orientations")
        covariance[np.diag_indices(len(covariance))] += max(sigma**2, 1e-9 * spread)
        self._precision = np.linalg.inv(covariance)
        self._map = np.ascontiguousarray((self._precision @ (x.T @ y / len(x))).T)
        self._offset = offset
        self._sensors = motor.sensors
        self._completed = np.empty(3 * motor.sensors)

    def torque(self, field: Array, usable: Array, out: Array, known: Array) -> None:
        """As `TorqueMap.torque`: all coils are known, or none where too many sensors are missing."""
        missing = np.flatnonzero(usable == 0.0)
        if missing.size > _MOST_MISSING * self._sensors:
            known[:] = 0.0
            return
        np.subtract(field.ravel(), self._mean, out=self._completed)
        if missing.size:
            self._complete(missing)
        _map_readings(self._map, self._offset, self._completed, out.reshape(-1))
        known[:] = 1.0

    def _complete(self, missing: Numbers) -> None:
        """The likeliest readings given the others: x_m = −P_mm⁻¹ P_mo x_o, with P the inverse of their covariance."""
        numbers = (3 * missing[:, None] + np.arange(3)).ravel()
        self._completed[numbers] = 0.0
        known = self._precision[numbers] @ self._completed
        self._completed[numbers] = -np.linalg.solve(self._precision[np.ix_(numbers, numbers)], known)


@kernel
def _map_readings(M: Array, offset: Array, x: Array, out: Array) -> None:
    for i in range(M.shape[0]):
        total = offset[i]
        for j in range(M.shape[1]):
            total += M[i, j] * x[j]
        out[i] = total
