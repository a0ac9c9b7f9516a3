"""The controller compiled beside a servo's first start: `python -m haptorb.runtime.processes.first_start PLAN PARENT`.

The servo's process rehearses its simulated device first and the controller after it; meanwhile this one has the
controller compiled first, and then the worlds. What one of them has compiled lies in the cache for the other, so that
two processors need little more than half the time. It is killed when the loop runs.
"""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import final

import numpy as np

from haptorb import worlds
from haptorb.control.clutch.modes import Gains
from haptorb.devices.device import Device
from haptorb.devices.state import State
from haptorb.devices.wrench_map import WrenchMap
from haptorb.errors import HaptorbError
from haptorb.numerics.arrays import Array
from haptorb.runtime.drivers.driver import Driver
from haptorb.runtime.exchange import plan as plans
from haptorb.runtime.realtime.parent_death import die_with_parent, is_parent_gone
from haptorb.runtime.tick.assembly import allocator_of, choice_of, estimator_of, linkage_of
from haptorb.runtime.tick.tick import Tick
from haptorb.sensing.estimator import Estimator
from haptorb.sensing.sample import Estimate, Pose, Sample
from haptorb.worlds.world import World

__all__ = ["compiling"]

_TICKS = 3
_AMBIENT = 298.15  #: [K]


def compiling(
    device: Device, world: World, estimator: str, model: str | None = None, gains: Gains | None = None
) -> Iterator[None]:
    """Compile part after part, as it is iterated: what controls `device`, then the catalogue's worlds.

    The estimators come last: they have the magnetics in common with the simulated device, which the servo's process
    compiles at that time. What fails here is not told: the servo's process meets it, too, and there it has
    consequences.
    """
    with suppress(HaptorbError):
        driver = _IdleDriver(device)
        tick = Tick(
            device, world, driver, _IdleEstimator(device), allocator_of(device), 1e-3, linkage_of(device, gains),
            choice=choice_of(device),
        )  # fmt: skip
        row = tick.layout.empty()
        yield
        tick.step(row, 0.0)
        yield
        for n, kind in enumerate(worlds.CATALOGUE.values(), start=1):
            with suppress(HaptorbError):  # not for this device
                tick.change_world(kind())
                tick.step(row, 1e-3 * n)
            yield
        learning = estimator_of(device, estimator, model)
        yield
        for n in range(_TICKS):
            learning.update(driver.read(1e-3 * n))
            yield


def main(plan: Path, parent: int) -> int:
    """Compile what the plan says until that is done or the parent has gone."""
    die_with_parent()
    gc.disable()  # as in the servo's process: nearly all that compiling makes lives on
    for _ in plans.load(plan).compiling():
        if is_parent_gone(parent):
            return 1
    return 0


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


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), int(sys.argv[2])))
