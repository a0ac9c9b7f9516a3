"""A tick in which nothing happens, of a controller whose code is to be compiled or loaded."""

from __future__ import annotations

from typing import final

import numpy as np

from haptorb.control.clutch.gains import Gains
from haptorb.devices.device import Device
from haptorb.devices.state import State
from haptorb.devices.wrench_map import WrenchMap
from haptorb.numerics.arrays import Array
from haptorb.runtime.drivers.driver import Driver
from haptorb.runtime.tick.assembly import allocator_of, choice_of, linkage_of
from haptorb.runtime.tick.tick import Tick
from haptorb.sensing.estimator import Estimator
from haptorb.sensing.sample import Estimate, Pose, Sample
from haptorb.worlds.world import World

__all__ = ["make_idle_tick"]

_DT = 1e-3  #: [s]
_AMBIENT = 298.15  #: [K]


def make_idle_tick(device: Device, world: World, gains: Gains | None = None) -> Tick:
    """`world` on `device` between a driver and an estimator for which nothing needs to be compiled."""
    return Tick(
        device, world, _IdleDriver(device), _IdleEstimator(device), allocator_of(device), _DT,
        linkage_of(device, gains), choice=choice_of(device),
    )  # fmt: skip


@final
class _IdleEstimator(Estimator):
    """Knows that nothing happens, and needs nothing compiled for it."""

    def __init__(self, device: Device) -> None:
        self._nothing = WrenchMap(np.zeros((6, device.channels)), np.zeros(6))

    def update(self, sample: Sample) -> Estimate:
        """The tracker's pose, where no current has an effect."""
        pose = sample.pose
        return Estimate(State(sample.t, pose.R_SR, pose.p, pose.w, pose.v), self._nothing, True, 0.0)


@final
class _IdleDriver(Driver):
    """A device in which nothing happens, and about which nothing needs to be compiled."""

    name, simulated = "still", True

    def __init__(self, device: Device) -> None:
        self._currents, self._field = np.zeros(device.channels), np.zeros((device.sensors, 3))
        self._place = device.rest_position

    def open(self) -> None:
        """Nothing is to be done."""

    def close(self) -> None:
        """Nothing is to be done."""

    def read(self, now: float) -> Sample:
        """The same as ever."""
        still = np.zeros(3)
        pose = Pose(now, np.eye(3), self._place, still, still, True)
        return Sample(now, self._currents, self._currents + _AMBIENT, self._field, pose)

    def write(self, duties: Array) -> Array:
        """What was asked."""
        return duties.copy()

    def truth(self) -> Array:
        """None."""
        return np.zeros(6)
