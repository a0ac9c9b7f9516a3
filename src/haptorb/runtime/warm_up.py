"""What a first start compiles: the controller at once, and the catalogue's worlds when the loop runs already."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import final

import numpy as np

from haptorb import worlds
from haptorb.arrays import Array
from haptorb.compiled import UncompiledKernelError, forbid_compiling
from haptorb.control.linkage import Gains, make_linkage
from haptorb.control.registry import has_choice, make_allocator, make_choice
from haptorb.devices.base import Device, State, WrenchMap
from haptorb.errors import HaptorbError
from haptorb.estimation.registry import check_estimator, make_estimator
from haptorb.estimation.types import Estimate, Estimator, Pose, Sample
from haptorb.recording.row import RowLayout
from haptorb.runtime.config import RunConfig
from haptorb.runtime.drivers.base import Driver
from haptorb.runtime.tick import Chain, Tick
from haptorb.worlds.base import World

__all__ = ["Compilation", "find_uncompiled", "list_companions", "make_idle_tick", "practise"]


# --------------------------------------------------------------------------------------------------
# A tick in which nothing happens, of a controller whose code is to be compiled or loaded.


_DT = 1e-3  #: [s]
_AMBIENT = 298.15  #: [K]


def make_idle_tick(device: Device, world: World, gains: Gains | None = None) -> Tick:
    """`world` on `device` between a driver and an estimator for which nothing needs to be compiled."""
    return Tick(
        device, world, _IdleDriver(device), _IdleEstimator(device), make_allocator(device), _DT,
        make_linkage(device, gains), choice=make_choice(device),
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


_TICKS = 3


def practise(chain: Chain, world: World, row: Array, now: float) -> None:
    """One step of `chain` at `now` [s] with `world`, which fills `row` (width,); nothing if the device cannot render
    it: then it cannot be chosen either."""
    with suppress(HaptorbError):
        chain.change_world(world)
        chain.step(row, now)


def find_uncompiled(chain: Chain, world: World, row: Array, now: float) -> list[str]:
    """Names of kernels of `world` that lie in no cache, after one step at `now` [s] as `practise` has it, which fills
    `row` (width,). What is in the cache was loaded; nothing was compiled."""
    with forbid_compiling() as missing, suppress(UncompiledKernelError):
        practise(chain, world, row, now)
    return missing


def list_companions(device: Device, world: World) -> list[World]:
    """Worlds that have a tool's torque allocated, if only the wrenches of `world` will tell whether it does, too."""
    if world.asks is not None or not has_choice(device):
        return []
    return [kind() for kind in worlds.CATALOGUE.values() if kind.asks in ("torque", "both")]


@final
@dataclass(frozen=True)
class Compilation:
    """Of the code that a run needs, for processes beside the servo's: what one of them has compiled lies in the cache
    for the others.

    Failures are not reported: the servo's process meets them too, and reports them.
    """

    config: RunConfig

    def make_tick(self) -> Chain:
        """The controller between a driver and an estimator for which nothing needs to be compiled."""
        return make_idle_tick(self.config.device, self.config.world, self.config.gains)

    def compile_controller(self) -> Iterator[None]:
        """Compile part after part, as it is iterated, what controls the device in the first world.

        The estimator comes last: it has the magnetics in common with the simulated device, which the servo's process
        compiles at that time.
        """
        with suppress(HaptorbError):
            chain, row = self.make_tick(), self._make_row()
            yield
            device, world = self.config.device, self.config.world
            for n, one in enumerate((world, *list_companions(device, world))):
                practise(chain, one, row, 1e-3 * n)
                yield
            learning = make_estimator(device, check_estimator(device, self.config.estimator), self.config.model)
            yield
            for n in range(_TICKS):
                learning.update(chain.driver.read(1e-3 * n))
                yield

    def compile_catalogue(self, find_wanted: Callable[[], str]) -> Iterator[str]:
        """Compile world after world, as it is iterated, and yield its name.

        find_wanted   → name of the world that is waited for, which comes next; empty for none
        """
        chain, row = self.make_tick(), self._make_row()
        left = list(worlds.CATALOGUE)
        while left:
            wanted = find_wanted()
            name = left.pop(left.index(wanted) if wanted in left else 0)
            practise(chain, worlds.CATALOGUE[name](), row, 1e-3 * (len(worlds.CATALOGUE) - len(left)))
            yield name

    def _make_row(self) -> Array:
        return RowLayout.of(self.config.device).empty()
