"""From magnet field at the sensors straight to torque per ampere of every coil: the abstract map, and its estimator."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping

import numpy as np

from haptorb.devices.motor.spherical_motor import SphericalMotor
from haptorb.devices.state import State
from haptorb.devices.wrench_map import WrenchMap
from haptorb.errors import InputError
from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel
from haptorb.numerics.state_arrays import StateArray, Stateful, make_numbers
from haptorb.sensing.estimator import Estimator
from haptorb.sensing.orientation.least_squares import LeastSquaresOrientation
from haptorb.sensing.orientation.readings import magnet_field, reading_limit
from haptorb.sensing.sample import Estimate, Sample
from haptorb.sensing.torque_maps.training_set import workspace_grid

__all__ = ["FieldToTorque", "TorqueMap"]

_COARSE = (7, 7, 24)  #: orientations from which the field's range is taken
_EDGE = np.radians(1.0)  #: so far beyond the workspace a map may still be asked


class TorqueMap(ABC):
    """Ignores the orientation."""

    @abstractmethod
    def torque(self, field: Array, usable: Array, out: Array, known: Array) -> None:
        """out (3, coils) [N·m/A], stator frame, and known (coils,) 1.0 where it could be found, else 0.0.

        field (k, 3) [T] of the magnets alone, stator frame; usable (k,) 1.0 where a sensor is usable, else 0.0.
        """


class FieldToTorque(Estimator):
    """Torque per ampere by `torque_map`; orientation by least squares beside it, or honestly not estimated.

    motor         the device whose sensors are read
    torque_map    `NetworkTorque` or `LinearTorque`
    orientation   finds the orientation, and the sensors that do not fit it; None: none, the state is NaN and the
                  estimate is not `oriented`, and only readings that cannot be are noticed

    A channel one of whose coils is not known gets no torque per ampere, so that no current is put into it; with fewer
    than half of the channels, or fewer than three, the estimate is not valid. A map cannot tell when it is wrong: with
    an orientation beyond the workspace that it learnt, it is not valid.
    """

    state_kind = "torque-map"

    def __init__(
        self, motor: SphericalMotor, torque_map: TorqueMap, orientation: LeastSquaresOrientation | None = None
    ) -> None:
        self._motor, self._map, self._orientation = motor, torque_map, orientation
        self._per_ampere = motor.sensor_field_per_ampere
        coarse = workspace_grid(motor, _COARSE)
        self._limit = reading_limit(motor, coarse, motor.sensor_field(coarse, "table"))
        edge = motor.workspace_tilt + _EDGE
        self._sine, self._tangent = float(np.sin(edge)), float(np.tan(edge))
        self._groups = np.ascontiguousarray(motor.groups, dtype=np.float64)
        self._field = np.zeros((motor.sensors, 3))
        self._usable = np.zeros(motor.sensors)
        coils = len(motor.electromagnets)
        self._single, self._known = np.zeros((3, coils)), np.zeros(coils)
        self._enough = max(3, motor.channels // 2)
        self._t, self._numbers = -np.inf, make_numbers("t")
        self._turn, self._turning = np.full((3, 3), np.nan), np.full(3, np.nan)
        self._rest, self._nothing = np.zeros(3), np.zeros(6)
        magnet_field(self._field, np.zeros(motor.channels), self._per_ampere, self._limit, self._field, self._usable)
        self._torque(self._field, self._usable)  # compiled before the loop begins

    def state_arrays(self) -> Mapping[str, StateArray]:
        """The magnets' field [T] and what the map made of it."""
        return {
            "field": self._field, "usable": self._usable, "single": self._single, "known": self._known,
            "last": self._numbers[0],
        }  # fmt: skip

    def state_parts(self) -> Mapping[str, Stateful]:
        """What finds the orientation beside it."""
        return {} if self._orientation is None else {"orientation": self._orientation}

    def gather_state(self) -> None:
        """Note when the map was last known."""
        self._numbers[1][0] = self._t

    def apply_state(self) -> None:
        """Take it over."""
        self._t = self._numbers[1][0]

    def update(self, sample: Sample) -> Estimate:
        """The estimate after `sample`; its `pose` is not looked at.

        Raises InputError for readings of other sensors than the device's.
        """
        motor = self._motor
        if sample.field.shape != self._field.shape:
            raise InputError(
                f"device '{motor.name}' has {motor.sensors} field sensors; the sample has {sample.field.shape[0]}"
            )
        beside = self._orientation
        if beside is None:
            count = magnet_field(
                sample.field, sample.currents, self._per_ampere, self._limit, self._field, self._usable
            )  # fmt: skip
            matrix, valid = self._torque(self._field, self._usable)
            if valid:
                self._t = sample.t
            state = State(sample.t, self._turn, self._rest, self._turning, self._rest)
            known = WrenchMap(matrix, self._nothing)
            return Estimate(state, known, valid, sample.t - self._t, False, disbelieved=motor.sensors - count)
        pose = beside.update(sample)
        matrix, valid = self._torque(beside.field, beside.trusted if pose.valid else beside.usable)
        z = pose.state.R_SR[:, 2].tolist()  # (sin λ, −sin ψ cos λ, cos ψ cos λ)
        inside = abs(z[0]) <= self._sine and abs(z[1]) <= self._tangent * z[2]
        return Estimate(
            pose.state, WrenchMap(matrix, pose.wrench_map.passive), valid and pose.valid and inside, pose.age,
            pose.oriented, pose.spin_period, pose.covariance, pose.strength, pose.disbelieved,
        )  # fmt: skip

    def _torque(self, field: Array, usable: Array) -> tuple[Array, bool]:
        """(6, m) per channel, and whether enough channels are known."""
        matrix = np.empty((6, self._groups.shape[1]))
        self._map.torque(field, usable, self._single, self._known)
        return matrix, _group_torques(self._single, self._known, self._groups, matrix) >= self._enough


@kernel
def _group_torques(single: Array, known: Array, groups: Array, out: Array) -> int:
    """out (6, m): no force, and torque per ampere of every channel, zero where one of its coils is not known; returns
    how many are."""
    count = 0
    for j in range(out.shape[1]):
        sure, x, y, z = 1.0, 0.0, 0.0, 0.0
        for c in range(groups.shape[0]):
            share = groups[c, j]
            if share != 0.0:
                sure = min(sure, known[c])
                x += share * single[0, c]
                y += share * single[1, c]
                z += share * single[2, c]
        if sure > 0.0 and np.isfinite(x + y + z):
            count += 1
        else:
            x, y, z = 0.0, 0.0, 0.0
        out[0, j], out[1, j], out[2, j], out[3, j], out[4, j], out[5, j] = 0.0, 0.0, 0.0, x, y, z
    return count
