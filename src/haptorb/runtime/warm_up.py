"""Compilation at a first start: the controller before the loop, the catalogue's worlds while it runs."""

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

__all__ = ["Compilation", "dry_run", "find_uncompiled", "list_companions", "make_idle_tick"]


# --------------------------------------------------------------------------------------------------
# A tick with stub driver and estimator, used to compile or load the controller's code.


_TICK_S = 1e-3  #: [s]
_AMBIENT_K = 298.15  #: [K]


def make_idle_tick(device: Device, world: World, gains: Gains | None = None) -> Tick:
    """Make the chain of `world` on `device` with a stub driver and a stub estimator, which need no compiled code."""
    return Tick(
        device, world, _IdleDriver(device), _IdleEstimator(device), make_allocator(device), _TICK_S,
        make_linkage(device, gains), choice=make_choice(device),
    )  # fmt: skip


@final
class _IdleEstimator(Estimator):
    """Stub estimator: returns the tracker's pose; needs no compiled code."""

    def __init__(self, device: Device) -> None:
        self._nothing = WrenchMap(np.zeros((6, device.channels)), np.zeros(6))

    def update(self, sample: Sample) -> Estimate:
        """Return the tracker's pose; currents have no effect there."""
        pose = sample.pose
        return Estimate(State(sample.t, pose.R_SR, pose.p, pose.w, pose.v), self._nothing, True, 0.0)


@final
class _IdleDriver(Driver):
    """Stub driver: returns a constant sample; needs no compiled code."""

    name, simulated = "still", True

    def __init__(self, device: Device) -> None:
        self._currents, self._field = np.zeros(device.channels), np.zeros((device.sensors, 3))
        self._place = device.rest_position

    def open(self) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""

    def read(self, now: float) -> Sample:
        """Return the constant sample."""
        still = np.zeros(3)
        pose = Pose(now, np.eye(3), self._place, still, still, True)
        return Sample(now, self._currents, self._currents + _AMBIENT_K, self._field, pose)

    def write(self, duties: Array) -> Array:
        """Return the duties unchanged."""
        return duties.copy()

    def wrench_actual(self) -> Array:
        """Return zeros."""
        return np.zeros(6)


_TICKS = 3


def dry_run(chain: Chain, world: World, row: Array, now: float) -> None:
    """Dry-run one step of `chain` at `now` [s] with `world`, which fills `row` (width,); a world that the device cannot
    render is skipped, as it cannot be chosen either."""
    with suppress(HaptorbError):
        chain.change_world(world)
        chain.step(row, now)


def find_uncompiled(chain: Chain, world: World, row: Array, now: float) -> list[str]:
    """Load the cached code of `world` by a `dry_run` at `now` [s], which fills `row` (width,); return the names of
    kernels that are not in the cache. Nothing is compiled."""
    with forbid_compiling() as missing, suppress(UncompiledKernelError):
        dry_run(chain, world, row, now)
    return missing


def list_companions(device: Device, world: World) -> list[World]:
    """Worlds that use the torque allocation, if only the wrenches of `world` will show whether it needs that, too."""
    if world.asks is not None or not has_choice(device):
        return []
    return [kind() for kind in worlds.CATALOGUE.values() if kind.asks in ("torque", "both")]


@final
@dataclass(frozen=True)
class Compilation:
    """Compiles the code that a run needs into the shared cache, for processes beside the servo's.

    Failures are not reported: the servo's process meets them too, and reports them.
    """

    config: RunConfig

    def make_tick(self) -> Tick:
        """Make the controller with a stub driver and a stub estimator."""
        return make_idle_tick(self.config.device, self.config.world, self.config.gains)

    def compile_controller(self) -> Iterator[None]:
        """Compile the controller with the first world, one part per iteration.

        The order keeps what is compiled twice small. The servo's process compiles its simulated device, then the
        allocation, then what fills a row, then the rest; here that comes in the opposite order. The estimator is first
        where the device acts directly; that of a motor shares code with the simulated device, and comes last.
        """
        with suppress(HaptorbError):
            chain, row = self.make_tick(), self._make_row()
            yield
            device, world = self.config.device, self.config.world
            early = not device.kind.modes
            if early:
                yield from self._compile_estimator(chain)
            sample, still = chain.driver.read(0.0), np.zeros(device.channels)
            estimate = _IdleEstimator(device).update(sample)
            chain.protection.protect_currents(still, estimate, sample, still.copy())
            yield
            chain.protection.protect_wrench(np.zeros(6), estimate, sample.t)
            yield
            chain.load_row(row)
            yield
            for n, one in enumerate((world, *list_companions(device, world))):
                dry_run(chain, one, row, 1e-3 * n)
                yield
            if not early:
                yield from self._compile_estimator(chain)

    def _compile_estimator(self, chain: Tick) -> Iterator[None]:
        device = self.config.device
        learning = make_estimator(device, check_estimator(device, self.config.estimator), self.config.model)
        yield
        for n in range(_TICKS):
            learning.update(chain.driver.read(1e-3 * n))
            yield

    def compile_catalogue(self, find_wanted: Callable[[], str]) -> Iterator[str]:
        """Compile one world per iteration, and yield its name.

        find_wanted   returns the name of a requested world, which comes next; empty for none
        """
        chain, row = self.make_tick(), self._make_row()
        left = list(worlds.CATALOGUE)
        while left:
            wanted = find_wanted()
            name = left.pop(left.index(wanted) if wanted in left else 0)
            dry_run(chain, worlds.CATALOGUE[name](), row, 1e-3 * (len(worlds.CATALOGUE) - len(left)))
            yield name

    def _make_row(self) -> Array:
        return RowLayout.of(self.config.device).empty()
