"""From a sample to an estimate: the abstract estimator, and the one that uses a tracker."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from haptorb.devices.device import Device
from haptorb.devices.state import State
from haptorb.devices.wrench_map import WrenchMap
from haptorb.errors import GeometryError, InputError
from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import tick_kernel
from haptorb.numerics.state_arrays import StateArray, Stateful
from haptorb.sensing.controller_model import ControllerModel
from haptorb.sensing.kept_estimate import KeptEstimate
from haptorb.sensing.sample import Estimate, Sample

__all__ = ["Estimator", "EstimatorChoice", "EstimatorSettings", "TrackedPose", "tracker_only"]


@tick_kernel
def _is_finite(p: Array, R: Array, v: Array, w: Array) -> bool:
    total = 0.0  # a sum is not finite as soon as one part of it is not
    for i in range(3):
        total += p[i] + v[i] + w[i]
        for j in range(3):
            total += R[i, j]
    return bool(np.isfinite(total))


class Estimator(Stateful, ABC):
    """The interface of every estimator. What it remembers from tick to tick, `state_arrays` names."""

    @abstractmethod
    def update(self, sample: Sample) -> Estimate:
        """The estimate after `sample`."""

    @property
    def model(self) -> str:
        """The device's model of the wrench maps; empty: none of them."""
        return ""

    @property
    def remark(self) -> str:
        """A remark for the user about this estimator; empty if there is none."""
        return ""

    def change_model(self, name: str) -> None:
        """Change the wrench maps to the device's model `name`, without a step; InputError if there is only one."""
        raise InputError(f"this estimator has one model only; it cannot switch to '{name}'")


class TrackedPose(Estimator):
    """Uses the tracker's pose: state as tracked, wrench map by the device's `model`, by default the first.

    A pose older than the guard's expiry is still passed on, with its age; the guard decides what to do. An
    impossible pose (not finite, or inside the device) is replaced by the last valid pose, marked as not valid.
    """

    state_kind = "tracker"

    def __init__(self, device: Device, model: str | None = None) -> None:
        self._model, self._kept = ControllerModel(device, model), KeptEstimate(device.channels)
        nowhere = State(0.0, np.eye(3), np.zeros(3), np.zeros(3), np.zeros(3))
        self._last = Estimate(nowhere, WrenchMap(np.zeros((6, device.channels)), np.zeros(6)), False, np.inf)

    def update(self, sample: Sample) -> Estimate:
        """The estimate after `sample`."""
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
        """Take it over."""
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
    """Settings that the loop passes to an estimator."""

    model: str | None = None  #: of the device's model; None: the device's first
    offsets: Array | None = None  #: (k, 3) of the field sensors, where calibration found them [T]
    in_turns: bool = False  #: whether the driver reads a part of the field sensors in each tick
    learned: bytes = b""  #: what it learned, as `EstimatorChoice.read_learned` has it; empty: what this computer has


@dataclass(frozen=True)
class EstimatorChoice:
    """One estimator that a kind of device can have."""

    make: Callable[[Any, EstimatorSettings], Estimator]  #: from the device
    check: Callable[[Any], object] | None = None  #: before anything starts: InputError if it cannot be made
    axes: int = 1  #: that each of the device's field sensors must measure
    read_learned: Callable[[Any], bytes] | None = None  #: the file with what it learned, beside the device's


def tracker_only(device: Device) -> dict[str, EstimatorChoice]:
    """The estimators of a device that has no other: "tracker".

    >>> from haptorb.devices.loader import load
    >>> list(tracker_only(load("omni")))
    ['tracker']
    """
    return {"tracker": EstimatorChoice(lambda device, settings: TrackedPose(device, settings.model))}
