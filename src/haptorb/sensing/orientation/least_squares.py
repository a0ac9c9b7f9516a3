"""Orientation by least squares over the field tables, and the torque characteristic there: `least-squares`."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from haptorb.devices.motor.spherical_motor import SphericalMotor
from haptorb.devices.state import State
from haptorb.devices.wrench_map import WrenchMap
from haptorb.errors import InputError
from haptorb.numerics.arrays import Array, Records, fields, rotation
from haptorb.numerics.compiled import kernel, tick_kernel
from haptorb.numerics.so3 import correct_rotation, turn_by
from haptorb.numerics.state_arrays import StateArray, Stateful, make_numbers
from haptorb.sensing.estimator import Estimator
from haptorb.sensing.kept_estimate import KeptEstimate
from haptorb.sensing.orientation.cold_start import ColdStart
from haptorb.sensing.orientation.field_model import field_model, torque_per_ampere, unpack
from haptorb.sensing.orientation.gauss_newton import FIT, fit_orientation
from haptorb.sensing.orientation.readings import magnet_field
from haptorb.sensing.orientation.spin_ambiguity import nearest_branch, spin_period
from haptorb.sensing.sample import Estimate, Pose, Sample

__all__ = ["TRACK", "LeastSquaresOrientation"]

_TOLERANCE = 1e-4  #: [rad]: after such a step the error is a hundredth of that squared, times ten
_STEPS = 6  #: at most, from the last orientation on
_POOR = 0.1  #: residual over field: more is not noise, it is another orientation
_PAUSE = 0.05  #: without a sample for so long [s], the angular velocity says nothing any more

#: What tracking remembers between two ticks, and the settings that it goes by.
TRACK = fields(
    ("limit", "f8"),  # reading that no sensor can give unless it is broken [T]
    ("memory", "f8"),  # of the filter [s]
    ("dt", "f8"),  # since the last orientation [s]; 0: the filter restarts
    ("rotation", "f8", (3, 3)),  # R as filtered
    ("w", "f8", (3,)),  # angular velocity, stator frame [rad/s]
    ("fit", FIT),  # strength 0: there is no last orientation
)


class LeastSquaresOrientation(Estimator):
    """Gauss–Newton on the rotations, from the last orientation on; from a grid where there is none.

    motor           whose tables explain the readings
    start           R_SR (3, 3) near which the spin is taken at first; the field leaves `spin_period` open (60° here)
    lag             by which the angular velocity is late [s]; the orientation is not late

    field, usable and trusted are what the last update made of its readings: (k, 3) of the magnets alone [T], and (k,)
    1.0 for every sensor that is usable and fits the orientation, else 0.0.

    The estimate's `strength` is that of the rotor's magnets against the device file: the torque per ampere follows it.
    It is not valid while too few sensors are usable, or none of the orientations explains their readings.

    Raises InputError for a lag outside 0 to 1 s, or a start that is no rotation.
    """

    state_kind = "least-squares"

    def __init__(self, motor: SphericalMotor, start: Array | None = None, lag: float = 5e-3) -> None:
        if not 0 < lag < 1:
            raise InputError(f"lag must be a time between 0 and 1 s; got {lag!r}")
        self._motor, self.lag = motor, lag
        self._model = field_model(motor)
        noise = float(np.hypot(max(motor.hall.noise, 1e-6), motor.hall.step / np.sqrt(12)))
        self._cold = ColdStart(motor, self._model, noise)
        self._track: Records = np.zeros(1, TRACK)
        self._track["limit"], self._track["memory"] = self._cold.limit, 0.5 * lag
        self._fit = self._track["fit"]
        self._fit["noise"], self._fit["taken"] = noise, np.nan
        # views of the one record, copied from in every tick
        self._dt: Array = self._track["dt"]
        self._w: Array = self._track["w"][0]
        self._period = spin_period(motor)
        self._near = np.eye(3) if start is None else rotation(start, "start")
        if self._near.shape != (3, 3):
            raise InputError(f"start must be one rotation, shape (3, 3); got {self._near.shape}")
        self.field = np.zeros((motor.sensors, 3))
        self.usable = np.zeros(motor.sensors)
        self.trusted = np.zeros(motor.sensors)
        self._slopes, self._rest = np.zeros((motor.sensors, 3, 3)), np.zeros(3)
        self._kept, self._kept_near = KeptEstimate(motor.channels), np.zeros((3, 3))
        self._numbers = make_numbers("found", "t")
        self._forget(self._near)
        self._rehearse()

    def _forget(self, near: Array) -> None:
        """Nothing is known yet, but that the spin is near that of `near` (3, 3)."""
        self._found, self._t, self._near = False, -np.inf, near
        self._w[:] = self._fit["strength"] = 0.0
        unknown = State(0.0, near, self._rest, self._rest, self._rest)
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

    def state_arrays(self) -> Mapping[str, StateArray]:
        """The filter, the magnets' field [T], which sensors are used, and the last estimate."""
        own = {
            "track": self._track, "slopes": self._slopes, "field": self.field, "usable": self.usable,
            "trusted": self.trusted, "near": self._kept_near, "found": self._numbers[0],
        }  # fmt: skip
        return {**own, **self._kept.arrays}

    def state_parts(self) -> Mapping[str, Stateful]:
        """The search from nothing."""
        return {"cold": self._cold}

    def gather_state(self) -> None:
        """Copy the last estimate."""
        self._kept.store(self._last)
        self._kept_near[:] = self._near
        self._numbers[1][0], self._numbers[1][1] = self._found, self._t

    def apply_state(self) -> None:
        """Take it over."""
        self._last, self._near = self._kept.load(), self._kept_near.copy()
        found, self._t = self._numbers[1]
        self._found = bool(found)

    @property
    def model(self) -> str:
        """The tables: the fit and the torque per ampere come from them."""
        return "table"

    def update(self, sample: Sample) -> Estimate:
        """The estimate after `sample`; its `pose` is not looked at.

        Raises InputError for readings of other sensors than the device's.
        """
        if sample.field.shape != self.field.shape:
            raise InputError(
                f"device '{self._motor.name}' has {self._motor.sensors} field sensors; the sample has "
                f"{sample.field.shape[0]}"
            )
        t, last = sample.t, self._t if self._found else -np.inf
        dt = t - last
        if not 0.0 <= dt <= _PAUSE:
            self._w[:] = 0.0
            dt = 0.0
        self._dt[0] = dt
        K, result = np.empty((6, self._motor.channels)), np.empty((9, 3))
        passive: Array = result[7:].reshape(6)
        found, strength, disbelieved = _track_orientation(
            self._track, self._model, sample.field, sample.currents, self.field, self.usable, self.trusted,
            self._slopes, K, result,
        )  # fmt: skip
        if found:
            R, covariance, w = result[:3], result[3:6], result[6]
        else:
            again = self._cold.search(self.field, self.usable, self.trusted)
            if again is None:
                self._found, self._fit["strength"] = False, 0.0
                before, left_out = self._last, self._motor.sensors - int(self.trusted.sum())
                return Estimate(
                    before.state, before.wrench_map, False, t - self._t, spin_period=self._period,
                    disbelieved=left_out,
                )  # fmt: skip
            strength, covariance, w = again.strength, again.covariance, np.zeros(3)
            disbelieved = self._motor.sensors - int(self.usable.sum()) + again.outliers
            R = nearest_branch(again.R_SR, self._near, self._period)
            _fill_wrench_map(self._model, R, strength, K, passive)
            self._track["rotation"], self._fit["strength"] = R, strength
            self._w[:] = 0.0
        self._found, self._t, self._near = True, t, R
        state = State(t, R, self._rest, w, self._rest)
        self._last = Estimate(
            state, WrenchMap(K, passive), True, 0.0, True, self._period, covariance, strength, disbelieved
        )  # fmt: skip
        return self._last


@kernel
def _fill_wrench_map(model: Array, R: Array, strength: float, matrix: Array, passive: Array) -> None:
    torque_per_ampere(unpack(model), R, strength, matrix, passive)


@tick_kernel
def _track_orientation(
    track: Records, packed: Array, read: Array, currents: Array, field: Array, usable: Array, trusted: Array,
    slopes: Array, matrix: Array, result: Array,
) -> tuple[bool, float, int]:  # fmt: skip
    """One tick: what the magnets give of what is read; then, from the last orientation on, predict, explain, filter.

    track is (1,) TRACK; packed a `field_model`; read (k, 3) [T] and currents (m,) [A] the sample's; field (k, 3),
    usable, trusted (k,) and slopes (k, 3, 3) are kept between ticks; matrix (6, m) is what the coils do there. Rows of
    result (9, 3): R, its covariance, w, then force and torque of weight and regulator. Returns (found, strength,
    sensors left out).
    """
    t, model = track[0], unpack(packed)
    fit, dt, R, w, smooth = t.fit, t.dt, t.fit.rotation[:], t.w[:], t.rotation[:]
    places = field.shape[0]
    count = magnet_field(read, currents, model.per_ampere, t.limit, field, usable)
    if fit.strength == 0.0:
        return False, 0.0, places - count
    square = 0.0
    for k in range(places):
        trusted[k] = min(trusted[k], usable[k])
        square += field[k, 0] * field[k, 0] + field[k, 1] * field[k, 1] + field[k, 2] * field[k, 2]
    predicted = result[3:6]  # until the covariance is known
    turn_by(dt * w[0], dt * w[1], dt * w[2], smooth, predicted)
    for i in range(3):
        for j in range(3):
            R[i, j] = predicted[i, j]
    found, rms, outliers = fit_orientation(
        fit, model, field, usable, count, trusted, slopes, _TOLERANCE, _STEPS
    )  # fmt: skip
    # safety: field-explained
    if not found or 2 * outliers > count or not rms * rms <= _POOR * _POOR * square / (3.0 * count):
        return False, fit.strength, places - count + outliers
    if dt > 0.0:
        correct_rotation(predicted, R, w, dt, t.memory, smooth)
    else:
        for i in range(3):
            for j in range(3):
                smooth[i, j] = R[i, j]
    torque_per_ampere(model, R, fit.strength, matrix, result[7:].reshape(6))
    for i in range(3):
        result[6, i] = w[i]
        for j in range(3):
            result[i, j], result[3 + i, j] = R[i, j], fit.covariance[i, j]
    return True, fit.strength, places - count + outliers
