"""Rate and delay of the poses that a tracker reports."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from math import floor
from typing import final

import numpy as np

from haptorb.numerics.arrays import Array
from haptorb.runtime.drivers.imperfect_tracker import PoseDistortion
from haptorb.sensing.sample import Pose

__all__ = ["PoseDelay"]


@final
class PoseDelay(PoseDistortion):
    """A pose only every 1/`rate` [s], and each of them only `latency` [s] later.

    Between two ticks a pose is taken from the one before and its velocity; the velocity that is reported is the
    difference of the last two poses, as that of a tracker that measures positions. rate None: a pose in every tick.
    """

    def __init__(self, rate: float | None, latency: float) -> None:
        self._period, self._latency = None if rate is None else 1 / rate, latency
        self._history: deque[tuple[float, Pose]] = deque(maxlen=4096)
        self.reset()

    def reset(self) -> None:
        """No pose has been reported."""
        self._history.clear()
        self._last: Pose | None = None

    def distort(self, now: float, pose: Pose) -> Pose:
        """The pose that a late tracker would have reported by now."""
        self._history.append((now, pose))
        at = now - self._latency
        if self._period is not None:
            at = floor(at / self._period + 1e-9) * self._period
        if self._last is None:
            self._last = replace(pose, t=now, v=np.zeros(3))
        elif at > self._last.t + 1e-9:
            p, R = self._pose_at(at)
            self._last = Pose(at, R, p, pose.w, (p - self._last.p) / (at - self._last.t), True)
        return self._last

    def _pose_at(self, at: float) -> tuple[Array, Array]:
        for then, pose in reversed(self._history):
            if then <= at + 1e-9:
                return pose.p + (at - then) * pose.v, pose.R_SR
        pose = self._history[0][1]
        return pose.p, pose.R_SR
