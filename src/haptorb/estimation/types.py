"""Sample and estimate, the abstract estimator, and the estimator that uses a tracker."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from haptorb.arrays import Array, StateArray, Stateful, choose, make_block, record
from haptorb.compiled import tick_kernel
from haptorb.devices.base import Device, State, WrenchMap
from haptorb.errors import GeometryError, InputError
from haptorb.estimation.controller_model import ControllerModel

__all__ = [
    "Estimate",
    "Estimator",
    "EstimatorChoice",
    "EstimatorSettings",
    "HandGoal",
    "KeptEstimate",
    "Pose",
    "Sample",
    "TrackedPose",
]


# --------------------------------------------------------------------------------------------------
# Measurements of a driver in one tick, and the estimate from them.


@record
class Pose:
    """Pose from a tracker, with the time of measurement and whether it is valid.

    Parameters
    ----------
    t : float
        Time of measurement [s], on the sample's clock.
    R_SR : ndarray, shape (3, 3)
        Rotation from the mover's frame to the stator frame.
    p : ndarray, shape (3,)
        Position of the mover's origin in the stator frame [m].
    w : ndarray, shape (3,)
        Angular velocity in the stator frame [rad/s].
    v : ndarray, shape (3,)
        Velocity of p in the stator frame [m/s].
    valid : bool
        False: the tracker has lost the mover; the guard switches the coils off.
    """

    t: float
    R_SR: Array
    p: Array
    w: Array
    v: Array
    valid: bool


@record
class HandGoal:
    """Goal of the simulated hand for the tool, with its timestamp.

    p      (3,) tool's magnet centre [m], frame S
    q      (4,) quaternion (x, y, z, w) of R_SR
    stamp  time of the goal on the loop's clock [s]: a pointer that is no longer refreshed ages
    held   the user holds the pointer; False: the guided motion
    still  the guided motion is over, and the hand rests: it yields to forces
    grip   opening to which thumb and finger of a gripper move [m]; NaN: they are relaxed
    """

    p: Array
    q: Array
    stamp: float
    held: bool
    still: bool = False
    grip: float = math.nan


@record
class Sample:
    """Measurements of a driver in one tick.

    Parameters
    ----------
    t : float
        Time of the tick that read [s].
    currents : ndarray, shape (m,)
        Measured current of each channel [A].
    temperatures : ndarray, shape (m,)
        Temperature at the boundary of each coil [K].
    field : ndarray, shape (k, 3)
        Flux density at the field sensors in the stator frame [T]; (0, 3) for a device without any.
    pose : Pose
        Last pose of the tracker; not valid for a rotor whose pose is estimated from its field.
    currents_age : float
        Age of the currents at t [s], from the middle of their sensors' averaging time; negative if they were measured
        after the tick began.
    field_age : float
        Age of the field at t [s], in the same sense.
    gripper : float
        Opening of the device's gripper [m]; NaN: it has none.
    gripper_velocity : float
        Rate of the opening [m/s].
    """

    t: float
    currents: Array
    temperatures: Array
    field: Array
    pose: Pose
    currents_age: float = 0.0
    field_age: float = 0.0
    gripper: float = math.nan
    gripper_velocity: float = math.nan


@record
class Estimate:
    """State of the mover and wrench map there, as the controller uses them in one tick.

    Parameters
    ----------
    state : State
        Estimated pose and motion.
    wrench_map : WrenchMap
        Wrench per ampere at that state.
    valid : bool
        False: the mover's pose is unknown; no force is rendered.
    age : float
        Age of the underlying measurement [s]; the guard trips when it exceeds the device's `limits.expiry`.
    oriented : bool
        False: orientation and angular velocity are not estimated (NaN); the wrench map was found without them.
    spin_period : float
        Rotations about the mover's z are known except for a multiple of this [rad]; 0: absolutely.
    covariance : ndarray, shape (3, 3), optional
        Covariance of the orientation as a rotation vector in the stator frame [rad²].
    strength : float
        Strength of the mover's magnets relative to the device file [1], where the estimator finds it.
    disbelieved : int
        Number of field sensors whose readings were rejected.
    reversed : bool
        True: the mover's magnet is reversed, so that every force would be inverted.
    """

    state: State
    wrench_map: WrenchMap
    valid: bool
    age: float
    oriented: bool = True
    spin_period: float = 0.0
    covariance: Array | None = None
    strength: float = 1.0
    disbelieved: int = 0
    reversed: bool = False


# --------------------------------------------------------------------------------------------------
# Last estimate of an estimator, in arrays of fixed size: for its snapshot.


@final
class KeptEstimate:
    """Storage for one estimate of a device with `channels` channels."""

    def __init__(self, channels: int) -> None:
        #: by name; `motion` is position [m], angular velocity [rad/s] and velocity [m/s]
        self.arrays: Mapping[str, StateArray]
        self.arrays, self._cells = make_block(
            {"rotation": (3, 3), "motion": (3, 3), "wrench_map": (6, channels), "passive": (6,), "covariance": (3, 3)},
            estimate=(
                "t", "valid", "age", "oriented", "spin_period", "has_covariance", "strength", "disbelieved", "reversed"
            ),
        )  # fmt: skip
        _, self._turn, self._motion, self._matrix, self._passive, self._covariance = self.arrays.values()
        self._p, self._w, self._v = self._motion
        rest = np.zeros(3)  # compiled at construction, not in the loop
        _copy_estimate(self._turn, self._motion, self._matrix, self._turn, rest, rest, rest, self._matrix)

    def store(self, estimate: Estimate) -> None:
        """Copy the estimate into the arrays."""
        state, cells = estimate.state, self._cells
        matrix = estimate.wrench_map.matrix
        _copy_estimate(self._turn, self._motion, self._matrix, state.R_SR, state.p, state.w, state.v, matrix)
        self._passive[:] = estimate.wrench_map.passive
        cells[0], cells[1], cells[2], cells[3] = state.t, estimate.valid, estimate.age, estimate.oriented
        cells[4], cells[6], cells[7] = estimate.spin_period, estimate.strength, estimate.disbelieved
        cells[8] = estimate.reversed
        covariance = estimate.covariance
        cells[5] = covariance is not None
        if covariance is not None:
            self._covariance[:] = covariance

    def load(self) -> Estimate:
        """Estimate described by the arrays. Raises ValueError for invalid numbers."""
        t, valid, age, oriented, period, has, strength, disbelieved, reversed_ = self._cells
        p, w, v = self._p.copy(), self._w.copy(), self._v.copy()
        return Estimate(
            State(t, self._turn.copy(), p, w, v),
            WrenchMap(self._matrix.copy(), self._passive.copy()),
            bool(valid), age, bool(oriented), period, self._covariance.copy() if has else None, strength,
            choose(disbelieved, 1 << 20), bool(reversed_),
        )  # fmt: skip


@tick_kernel
def _is_finite(p: Array, R: Array, v: Array, w: Array) -> bool:
    total = 0.0  # a sum is not finite as soon as one summand is not
    for i in range(3):
        total += p[i] + v[i] + w[i]
        for j in range(3):
            total += R[i, j]
    return bool(np.isfinite(total))


@tick_kernel
def _copy_estimate(
    turn: Array, motion: Array, wrench_map: Array, R: Array, p: Array, w: Array, v: Array, K: Array
) -> None:
    """Copy in compiled code, three times faster than numpy's assignments; the guard's kernels use these arrays too."""
    for i in range(3):
        motion[0, i], motion[1, i], motion[2, i] = p[i], w[i], v[i]
        for j in range(3):
            turn[i, j] = R[i, j]
    for i in range(6):
        for j in range(min(K.shape[1], wrench_map.shape[1])):
            wrench_map[i, j] = K[i, j]


class Estimator(Stateful, ABC):
    """Computes state and wrench map from the sample of a tick; the base class of every estimator.

    A subclass implements `update`. It reads no clock (time is `sample.t`), allocates no growing memory, and lists its
    state from tick to tick in `state_arrays`, so that a replay can start in the middle of a recording.
    """

    @abstractmethod
    def update(self, sample: Sample) -> Estimate:
        """Estimate the state after a sample; called in every tick.

        Parameters
        ----------
        sample : Sample
            Measurements of the tick.

        Returns
        -------
        Estimate
            State and wrench map; `valid=False` where the pose is not known.
        """

    @property
    def model(self) -> str:
        """Device model of the wrench maps; empty: none."""
        return ""

    @property
    def remark(self) -> str:
        """A remark for the user about this estimator; empty if there is none."""
        return ""

    def change_model(self, name: str) -> None:
        """Change the model of the wrench maps, without a step of the force.

        Parameters
        ----------
        name : str
            One of the device's `tick_models`.

        Raises
        ------
        InputError
            If the estimator has one model only.
        """
        raise InputError(f"this estimator has one model only; it cannot switch to '{name}'")


class TrackedPose(Estimator):
    """Estimator that takes the tracker's pose as the state.

    Parameters
    ----------
    device : Device
        Device whose wrench map is evaluated.
    model : str, optional
        Model of the wrench map, one of `device.models`; None: the first.

    Notes
    -----
    A pose older than the guard's expiry is still passed on, with its age; the guard decides what to do. An impossible
    pose (not finite, or inside the device) is replaced by the last valid pose, marked as not valid.
    """

    state_kind = "tracker"

    def __init__(self, device: Device, model: str | None = None) -> None:
        self._model, self._kept = ControllerModel(device, model), KeptEstimate(device.channels)
        nowhere = State(0.0, np.eye(3), np.zeros(3), np.zeros(3), np.zeros(3))
        self._last = Estimate(nowhere, WrenchMap(np.zeros((6, device.channels)), np.zeros(6)), False, np.inf)

    def update(self, sample: Sample) -> Estimate:
        """Return the estimate after `sample`."""
        pose = sample.pose
        last = self._last
        if not _is_finite(pose.p, pose.R_SR, pose.v, pose.w):
            return Estimate(last.state, last.wrench_map, False, sample.t - pose.t)
        state = State(sample.t, pose.R_SR, pose.p, pose.w, pose.v)
        try:
            wrench_map = self._model.wrench_map(state)
        except GeometryError:
            return Estimate(last.state, last.wrench_map, False, sample.t - pose.t)
        self._last = Estimate(state, wrench_map, pose.valid, sample.t - pose.t)
        return self._last

    def state_arrays(self) -> Mapping[str, StateArray]:
        """The last valid estimate."""
        return self._kept.arrays

    def state_parts(self) -> Mapping[str, Stateful]:
        """The controller model."""
        return {"model": self._model}

    def gather_state(self) -> None:
        """Copy the last estimate."""
        self._kept.store(self._last)

    def apply_state(self) -> None:
        """Restore the last estimate."""
        self._last = self._kept.load()

    @property
    def model(self) -> str:
        """The controller model."""
        return self._model.name

    def change_model(self, name: str) -> None:
        """Change to the device's model `name`, without a step."""
        self._model.change(name)


@dataclass(frozen=True)
class EstimatorSettings:
    """Settings that the loop passes to an estimator.

    Parameters
    ----------
    model : str, optional
        Name of the device's model; None: the device's first.
    offsets : ndarray, shape (k, 3), optional
        Offsets of the field sensors, from calibration [T].
    in_turns : bool
        Whether the driver reads the field sensors in turn, some in each tick.
    learned : bytes
        Trained data, as returned by `EstimatorChoice.read_learned`; empty: from this computer's file.
    """

    model: str | None = None  #: name of the device's model; None: the device's first
    offsets: Array | None = None  #: (k, 3) of the field sensors, from calibration [T]
    in_turns: bool = False  #: whether the driver reads the field sensors in turn, some in each tick
    learned: bytes = (
        b""  #: trained data, as returned by `EstimatorChoice.read_learned`; empty: from this computer's file
    )


@dataclass(frozen=True)
class EstimatorChoice:
    """Estimator available for a kind of device.

    Parameters
    ----------
    make : callable
        Creates it for a device: `make(device, settings)` with `EstimatorSettings`.
    check : callable, optional
        Called with the device before start: raises InputError if it cannot be created.
    axes : int
        Number of axes that each field sensor must measure.
    read_learned : callable, optional
        Reads its trained data, stored outside the device file, for a device.
    """

    make: Callable[[Any, EstimatorSettings], Estimator]  #: creates it for a device
    check: Callable[[Any], object] | None = None  #: called before start: InputError if it cannot be created
    axes: int = 1  #: number of axes that each field sensor must measure
    read_learned: Callable[[Any], bytes] | None = None  #: reads its trained data, stored outside the device file
