"""The pointer as the tracker of a real tool: valid only while a person holds it."""

from __future__ import annotations

from typing import final

import numpy as np

from haptorb.numerics.arrays import Array
from haptorb.runtime.trackers.tracker import Goal
from haptorb.sensing.sample import Pose

__all__ = ["PointerPose"]

_FASTEST = 3.0  #: no hand moves the tool faster, a pointer that jumps does [m/s]


@final
class PointerPose:
    """Where the host's pointer is, as the word of a tracker.

    A simulated hand may play a guided motion while the pointer is not held; a real tool is not where a script says,
    so then the pose is not valid. The velocity is that between the pointer's last two words.
    """

    def __init__(self) -> None:
        self._p = np.zeros(3)
        self._v = np.zeros(3)
        self._stamp = -np.inf

    def __call__(self, goal: Goal, now: float) -> Pose:
        """The pose at `now` [s], when the pointer's word is `goal`."""
        if not goal.held:
            self._stamp = -np.inf
            return Pose(now, _rotation(goal.q), goal.p, np.zeros(3), np.zeros(3), valid=False)
        if goal.stamp > self._stamp:
            passed = goal.stamp - self._stamp
            v = (goal.p - self._p) / passed if np.isfinite(passed) else np.zeros(3)
            speed = float(np.linalg.norm(v))
            self._v = v if speed <= _FASTEST else np.zeros(3)
            self._p, self._stamp = goal.p, goal.stamp
        valid = bool(np.isfinite(goal.stamp))
        return Pose(min(goal.stamp, now) if valid else now, _rotation(goal.q), goal.p, np.zeros(3), self._v, valid)


def _rotation(q: Array) -> Array:
    """(3, 3) from a quaternion (x, y, z, w) of length 1."""
    x, y, z, w = q.tolist()
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
