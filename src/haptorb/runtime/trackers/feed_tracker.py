"""Tracker in another process: reads its last pose from shared memory, and extrapolates it for a limited time."""

from __future__ import annotations

from typing import final

import numpy as np

from haptorb.arrays import Array
from haptorb.compiled import kernel
from haptorb.errors import InputError
from haptorb.estimation.types import HandGoal, Pose
from haptorb.runtime.shared_memory import PoseBlock
from haptorb.runtime.trackers.base import Tracker

__all__ = ["MAX_PREDICTION_S", "PREDICTION", "FeedTracker", "check_prediction"]

PREDICTION = 0.004  #: longest prediction of a pose, by default [s]
MAX_PREDICTION_S = 0.020  #: longest useful prediction of a hand [s]

_NOWHERE = float("-inf")


def check_prediction(seconds: float) -> float:
    """Return `seconds`; raise InputError if it is not a valid prediction time."""
    if not 0.0 <= seconds <= MAX_PREDICTION_S:
        raise InputError(f"prediction must be from 0 to {1e3 * MAX_PREDICTION_S:g} ms; got {1e3 * seconds:g} ms")
    return float(seconds)


@kernel
def _extrapolate(p: Array, q: Array, v: Array, w: Array, ahead: float, out_p: Array, out_q: Array, R: Array) -> None:
    """Extrapolate at constant velocity for `ahead` [s]; rotate by the exact exponential of w·ahead, stator frame."""
    for i in range(3):
        out_p[i] = p[i] + v[i] * ahead
    rate = np.sqrt(w[0] ** 2 + w[1] ** 2 + w[2] ** 2)
    half = 0.5 * rate * ahead
    s = np.sin(half) / rate if rate * ahead > 1e-12 else 0.5 * ahead
    x, y, z, c = s * w[0], s * w[1], s * w[2], np.cos(half)
    out_q[0] = c * q[0] + x * q[3] + y * q[2] - z * q[1]
    out_q[1] = c * q[1] - x * q[2] + y * q[3] + z * q[0]
    out_q[2] = c * q[2] + x * q[1] - y * q[0] + z * q[3]
    out_q[3] = c * q[3] - x * q[0] - y * q[1] - z * q[2]
    x, y, z, c = out_q[0], out_q[1], out_q[2], out_q[3]
    R[0, 0], R[0, 1], R[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - z * c), 2 * (x * z + y * c)
    R[1, 0], R[1, 1], R[1, 2] = 2 * (x * y + z * c), 1 - 2 * (x * x + z * z), 2 * (y * z - x * c)
    R[2, 0], R[2, 1], R[2, 2] = 2 * (x * z - y * c), 2 * (y * z + x * c), 1 - 2 * (x * x + y * y)


@final
class FeedTracker(Tracker):
    """Reads the poses that a tracker's own process writes to `block`.

    A valid pose is extrapolated with its own velocity to the present, by at most `prediction` [s]; its timestamp is
    that of the measurement, so that it ages as without prediction. After a loss the last pose is returned as not valid.
    `rest` is the pose of a simulated hand before the first pose.
    """

    def __init__(self, block: PoseBlock, prediction: float = PREDICTION, *, rest: Array | None = None) -> None:
        self._block = block
        self._prediction = check_prediction(prediction)
        self._p = np.array([0.0, 0.0, 0.062]) if rest is None else np.array(rest, dtype=np.float64)
        self._q = np.array([0.0, 0.0, 0.0, 1.0])
        self._R = np.eye(3)
        self._v = self._w = np.zeros(3)
        self._read_pose(0.0)  # compiled now, and not in the first tick

    def _read_pose(self, now: float) -> float:
        """Update p, q, R, v and w to `now`; return the pose's timestamp on the loop's clock, −inf if unknown."""
        record = self._block.read_pose()
        stamp = record.stamp - self.origin
        age = now - stamp
        if not (record.valid and age < float("inf")):  # also false for NaN
            if not record.valid:
                self._v = self._w = np.zeros(3)
            return _NOWHERE
        self._p, self._q, self._R = np.empty(3), np.empty(4), np.empty((3, 3))
        ahead = min(max(age, 0.0), self._prediction)  # safety: prediction-end
        _extrapolate(record.p, record.q, record.v, record.w, ahead, self._p, self._q, self._R)
        self._v, self._w = record.v, record.w
        return min(stamp, now)  # safety: prediction-age

    def goal(self, now: float) -> HandGoal:
        """Goal of the hand for the mover; a simulated hand stays at its last goal while the tracker has no pose."""
        stamp = self._read_pose(now)
        return HandGoal(self._p, self._q, stamp, True)

    def pose(self, now: float) -> Pose:
        """Pose of the tool; not valid before the tracker's first pose and after it lost the tool."""
        stamp = self._read_pose(now)
        valid = stamp != _NOWHERE
        return Pose(stamp if valid else now, self._R, self._p, self._w, self._v, valid)
