"""Orientation by least squares over the field tables, and the torque characteristic there: `least-squares`."""

from __future__ import annotations

import numpy as np

from haptorb.devices.spherical_motor import SphericalMotor
from haptorb.devices.state import State
from haptorb.devices.wrench_map import WrenchMap
from haptorb.errors import InputError
from haptorb.physics.arrays import Array, rotation
from haptorb.physics.compiled import kernel
from haptorb.sensing.cold_start import ColdStart
from haptorb.sensing.estimator import Estimator
from haptorb.sensing.gauss_newton import FieldModel, explained, torque_per_ampere
from haptorb.sensing.readings import coil_field_per_ampere, magnet_field
from haptorb.sensing.sample import Estimate, Pose, Sample
from haptorb.sensing.spin import nearest_branch, spin_period
from haptorb.sensing.turning import corrected, turn_by

__all__ = ["LeastSquaresOrientation"]

_TOLERANCE = 1e-4  #: [rad]: after such a step the error is a hundredth of that squared, times ten
_STEPS = 6  #: at most, from the last orientation on
_POOR = 0.1  #: residual over field: more is not noise, it is another orientation
_PAUSE = 0.05  #: without a sample for so long [s], the angular velocity says nothing any more


class LeastSquaresOrientation(Estimator):
    """Gauss–Newton on the rotations, from the last orientation on; from a grid where there is none.

    motor           whose tables explain the readings
    start           R_SR (3, 3) near which the spin is taken at first; the field leaves `spin_period` open (60° here)
    lag             by which the angular velocity is late [s]; the orientation is not late

    The estimate's `strength` is that of the rotor's magnets against the device file: the torque per ampere follows it.
    It is not valid while too few sensors can be believed, or none of the orientations explains what they read.

    Raises InputError for a lag outside 0 to 1 s, or a start that is no rotation.
    """

    def __init__(self, motor: SphericalMotor, start: Array | None = None, lag: float = 5e-3) -> None:
        if not 0 < lag < 1:
            raise InputError(f"lag must be a time between 0 and 1 s; got {lag!r}")
        self._motor = motor
        self._model = FieldModel.of(motor)
        self._cold = ColdStart(motor, self._model)
        self._per_ampere = coil_field_per_ampere(motor)
        self._tau = 0.5 * lag
        self._floor = float(np.hypot(max(motor.hall.noise, 1e-6), motor.hall.step / np.sqrt(12)))
        self._period = spin_period(motor)
        self._near = np.eye(3) if start is None else rotation(start, "start")
        if self._near.shape != (3, 3):
            raise InputError(f"start must be one rotation, shape (3, 3); got {self._near.shape}")
        self._field = np.zeros((motor.sensors, 3))
        self._usable = np.zeros(motor.sensors)
        self._trusted = np.zeros(motor.sensors)
        self._filtered, self._w, self._strength = np.eye(3), np.zeros(3), 1.0
        self._forget(self._near)
        self._rehearse()

    def _forget(self, near: Array) -> None:
        """Nothing is known yet, but that the spin is near that of `near` (3, 3)."""
        self._found, self._t, self._near, self._strength = False, -np.inf, near, 1.0
        self._w[:] = 0.0
        unknown = State(0.0, near, np.zeros(3), np.zeros(3), np.zeros(3))
        nothing = WrenchMap(np.zeros((6, self._motor.channels)), np.zeros(6))
        self._last = Estimate(unknown, nothing, False, np.inf, spin_period=self._period)

    def _rehearse(self) -> None:
        """Search and track once, so that everything is compiled before the loop begins."""
        near, rest = self._near, np.zeros(3)
        upright = self._motor.sensor_field(np.eye(3)[None], "table")[0]
        for t in (0.0, 1e-3):
            pose = Pose(t, np.eye(3), rest, rest, rest, False)
            self.update(Sample(t, np.zeros(self._motor.channels), np.zeros(self._motor.channels), upright, pose))
        self._forget(near)

    @property
    def trusted(self) -> Array:
        """(k,) 1.0 for every sensor whose last reading fits the orientation that was found, else 0.0."""
        return self._trusted

    def update(self, sample: Sample) -> Estimate:
        """The estimate after `sample`; its `pose` is not looked at.

        Raises InputError for readings of other sensors than the device's.
        """
        if sample.field.shape != self._field.shape:
            raise InputError(
                f"device '{self._motor.name}' has {self._motor.sensors} field sensors; the sample has "
                f"{sample.field.shape[0]}"
            )
        count = magnet_field(
            sample.field, sample.currents, self._per_ampere, self._cold.limit, self._field, self._usable
        )
        dt = sample.t - self._t
        R, K, covariance = np.empty((3, 3)), np.zeros((6, self._motor.channels)), np.empty((3, 3))
        found = False
        if self._found:
            if not 0.0 <= dt <= _PAUSE:
                self._w[:] = 0.0
                dt = 0.0
            found, strength, outliers = _tracked(
                self._model, self._field, self._usable, count, self._floor, dt, self._tau, self._strength,
                self._trusted, self._filtered, self._w, R, K, covariance,
            )  # fmt: skip
        if not found:
            again = self._cold.search(self._field, self._usable, count, self._floor, self._trusted, covariance)
            if again is None:
                self._found = False
                last = self._last
                return Estimate(
                    last.state, last.wrench_map, False, sample.t - self._t, spin_period=self._period,
                    disbelieved=self._motor.sensors - int(self._trusted.sum()),
                )  # fmt: skip
            strength, outliers = again.strength, again.outliers
            R = nearest_branch(again.R_SR, self._near, self._period)
            torque_per_ampere(self._model, R, strength, K[3:])
            self._filtered[:] = R
            self._w[:] = 0.0
        self._found, self._t, self._strength, self._near = True, sample.t, strength, R
        state = State(sample.t, R, np.zeros(3), self._w.copy(), np.zeros(3))
        self._last = Estimate(
            state, WrenchMap(K, self._motor.passive(R)), True, 0.0, True, self._period, covariance, strength,
            self._motor.sensors - count + outliers,
        )  # fmt: skip
        return self._last


@kernel
def _tracked(
    model: FieldModel, field: Array, usable: Array, count: int, floor: float, dt: float, tau: float, strength: float,
    trusted: Array, filtered: Array, w: Array, R: Array, K: Array, covariance: Array,
) -> tuple[bool, float, int]:  # fmt: skip
    """One tick from the last orientation on: predict, explain, filter, torque per ampere; all but K in place."""
    predicted = np.empty((3, 3))
    turn_by(dt * w[0], dt * w[1], dt * w[2], filtered, predicted)
    R[:] = predicted
    square = 0.0
    for k in range(field.shape[0]):
        trusted[k] = min(trusted[k], usable[k])
        if usable[k] > 0.0:
            square += field[k, 0] ** 2 + field[k, 1] ** 2 + field[k, 2] ** 2
    found, new, rms, _, outliers = explained(
        model, field, usable, count, floor, _TOLERANCE, _STEPS, R, strength, trusted, covariance
    )
    if not found or 2 * outliers > count or not rms * rms <= _POOR * _POOR * square / (3.0 * count):
        return False, strength, outliers
    if dt > 0.0:
        corrected(predicted, R, w, dt, tau, filtered)
    else:
        filtered[:] = R
    torque_per_ampere(model, R, new, K[3:])
    return True, new, outliers
