"""A tracker with errors: in front of a driver that knows the pose exactly and at once."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import final

from haptorb.control.protection.trip import CoilState
from haptorb.numerics.arrays import Array
from haptorb.runtime.drivers.driver import Driver
from haptorb.sensing.sample import Pose, Sample

__all__ = ["ImperfectTracker", "PoseDistortion"]


class PoseDistortion(ABC):
    """What a tracker makes of the poses that it measures: noise, delay."""

    @abstractmethod
    def reset(self) -> None:
        """Forget earlier poses: the driver opens."""

    @abstractmethod
    def distort(self, now: float, pose: Pose) -> Pose:
        """The pose that the tracker reports at `now` [s], if `pose` is the true one. Called once in every tick."""


@final
class ImperfectTracker(Driver):
    """Reports the poses of `inner` with `distortions`, one after the other; everything else is that of `inner`.

    It does not count as simulated: its poses are as old as they say, as with a real tracker.
    """

    name, simulated = "imperfect", False

    def __init__(self, inner: Driver, *distortions: PoseDistortion) -> None:
        self._inner, self._distortions = inner, distortions
        self.lead = inner.lead

    def open(self) -> None:
        """Open `inner`."""
        self._inner.open()
        for distortion in self._distortions:
            distortion.reset()

    def close(self) -> None:
        """Coils off."""
        self._inner.close()

    def prepare(self, now: float) -> None:
        """As `inner` does."""
        self._inner.prepare(now)

    def read(self, now: float) -> Sample:
        """The sample of `inner` with the pose that the tracker reports."""
        sample = self._inner.read(now)
        pose = sample.pose
        for distortion in self._distortions:
            pose = distortion.distort(now, pose)
        return replace(sample, pose=pose)

    def write(self, duties: Array) -> Array:
        """Apply `duties` (m,), −1…1 [1], as `inner` does; returns (m,) those applied."""
        return self._inner.write(duties)

    @property
    def coil_state(self) -> CoilState:
        """As `inner` knows it."""
        return self._inner.coil_state

    @property
    def field_axes(self) -> Array | None:
        """(k, 3) unit vectors [1] of `inner`."""
        return self._inner.field_axes

    def engage(self) -> None:
        """As `inner` does."""
        self._inner.engage()

    def cool(self) -> None:
        """As `inner` does."""
        self._inner.cool()

    def truth(self) -> Array:
        """(6,) as `inner` knows it [N, N·m]."""
        return self._inner.truth()

    def target(self) -> Array:
        """(7,) as `inner` knows it: position [m], quaternion."""
        return self._inner.target()
