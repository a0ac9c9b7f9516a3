"""A tracker that is slow and late, between a driver that knows the pose at once and a loop that shall not."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from math import floor
from typing import final

import numpy as np

from haptorb.numerics.arrays import Array
from haptorb.runtime.drivers.driver import Driver
from haptorb.sensing.sample import Pose, Sample

__all__ = ["LateTracker"]


@final
class LateTracker(Driver):
    """Reports the poses of `inner` only every 1/`rate` [s], and each of them only `latency` [s] later.

    Between two ticks a pose is taken from the one before and its velocity; the velocity that is reported is the
    difference of the last two poses, as that of a tracker that measures places. rate None: a pose in every tick.
    """

    name, simulated = "late", False  # its poses are as old as they say, as with a real tracker

    def __init__(self, inner: Driver, rate: float | None, latency: float) -> None:
        self._inner, self._period, self._latency = inner, None if rate is None else 1 / rate, latency
        self._history: deque[tuple[float, Pose]] = deque(maxlen=4096)
        self._last: Pose | None = None

    def open(self) -> None:
        """Open what is behind."""
        self._inner.open()
        self._history.clear()
        self._last = None

    def close(self) -> None:
        """Coils off."""
        self._inner.close()

    def read(self, now: float) -> Sample:
        """The sample of `inner`, with the pose that a late tracker would have reported by now."""
        sample = self._inner.read(now)
        self._history.append((now, sample.pose))
        at = now - self._latency
        if self._period is not None:
            at = floor(at / self._period + 1e-9) * self._period
        if self._last is None:
            self._last = replace(sample.pose, t=now, v=np.zeros(3))
        elif at > self._last.t + 1e-9:
            p, R = self._pose_at(at)
            self._last = Pose(at, R, p, sample.pose.w, (p - self._last.p) / (at - self._last.t), True)
        return replace(sample, pose=self._last)

    def _pose_at(self, at: float) -> tuple[Array, Array]:
        for then, pose in reversed(self._history):
            if then <= at + 1e-9:
                return pose.p + (at - then) * pose.v, pose.R_SR
        pose = self._history[0][1]
        return pose.p, pose.R_SR

    def write(self, duties: Array) -> Array:
        """As `inner` does."""
        return self._inner.write(duties)

    def truth(self) -> Array:
        """As `inner` knows it."""
        return self._inner.truth()

    def target(self) -> Array:
        """As `inner` knows it."""
        return self._inner.target()
