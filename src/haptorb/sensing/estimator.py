"""From a sample to an estimate: the abstract estimator, and the one that believes a tracker."""

from __future__ import annotations

from abc import ABC, abstractmethod

from haptorb.devices.device import Device
from haptorb.devices.state import State
from haptorb.sensing.sample import Estimate, Sample

__all__ = ["Estimator", "TrackedPose"]


class Estimator(ABC):
    """What every way of knowing answers."""

    @abstractmethod
    def update(self, sample: Sample) -> Estimate:
        """The estimate after `sample`."""


class TrackedPose(Estimator):
    """Believes the tracker: state as tracked, wrench map by the device's model at `level`.

    A pose that is older than the guard's expiry is still passed on, with its age: what to do then is the guard's
    decision. A pose that was never valid stays not valid.
    """

    def __init__(self, device: Device, level: str | None = None) -> None:
        self._device = device
        self._level = device.known_level(level or device.levels[0])

    def update(self, sample: Sample) -> Estimate:
        """The estimate after `sample`."""
        pose = sample.pose
        state = State(sample.t, pose.R_SR, pose.p, pose.w, pose.v)
        return Estimate(state, self._device.wrench_map(state, self._level), pose.valid, sample.t - pose.t)
