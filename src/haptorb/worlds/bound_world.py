"""A world with memory in one run of a loop: world, memory and time step together."""

from __future__ import annotations

from typing import final

import numpy as np

from haptorb.devices.state import State
from haptorb.errors import HaptorbError, InputError
from haptorb.numerics.arrays import Array, Records
from haptorb.numerics.compiled import tick_kernel
from haptorb.worlds.client_force import make_client_force
from haptorb.worlds.dynamic_world import DynamicWorld
from haptorb.worlds.memory import check_memory, numbers_of
from haptorb.worlds.world import World

__all__ = ["BoundWorld", "MemoryNotFinite", "bind_world", "check_world_period"]


class MemoryNotFinite(HaptorbError):
    """A world computed a memory with numbers that are not finite."""


@tick_kernel
def _is_finite(numbers: Array) -> bool:
    finite = True
    for i in range(numbers.size):
        finite &= np.isfinite(numbers[i])
    return finite


@final
class BoundWorld:
    """`world` with a memory of its own, advanced by `dt` [s] in each call of `wrench`; what a linkage renders.

    numbers  (n,) all of its memory, in the units of its fields: a view
    paused   there is no pose: its time stops and it renders nothing
    failed   it raised an exception, or its memory is not finite: it renders nothing until `restart`
    client   (1,) CLIENT_FORCE: the command of a program outside the loop; filled by the loop
    commanded  (6,) the part of the last wrench that this program commands [N, N·m]
    """

    def __init__(self, world: DynamicWorld, dt: float) -> None:
        self.world = world
        self.paused = self.failed = False
        self.memory = check_memory(world.begin(), world.name)
        self.numbers = numbers_of(self.memory)
        names = [field.name for field in world.memory_fields]
        sizes = [field.size for field in world.memory_fields]
        if sum(sizes) != self.numbers.size:
            raise InputError(
                f"world '{world.name}': its memory has {self.numbers.size} numbers, but its memory_fields state "
                f"{sum(sizes)}"
            )
        starts = np.cumsum([0, *sizes]).tolist()
        stored = [start for name, start in zip(names, starts, strict=False) if name.rpartition("_")[2] == "energy"]
        self._energies = stored if world.stores_energy else []
        self._dt, self._advance, self._still = dt, world.advance, np.zeros(6)
        self.takes_commands, self.client = world.takes_commands, make_client_force()
        self.commanded: Array = np.zeros(6)
        _is_finite(self.numbers)  # compiled now

    @property
    def energy(self) -> float:
        """Energy stored in its memory [J]; NaN if the world does not state it, or renders nothing now."""
        if not self._energies or self.paused or self.failed:
            return np.nan
        return sum(map(self.numbers.item, self._energies))

    def wrench(self, state: State) -> Array:
        """(6,) the wrench of the world at `state` after one more time step [N, N·m].

        Raises MemoryNotFinite, and any exception of the world.
        """
        self.commanded[:] = 0.0
        if self.paused or self.failed:
            return self._still
        # After any failure in there: half of a step is no memory to continue with.
        self.failed = True  # safety: half-a-step
        if self.takes_commands:
            self.world.take_command(self.memory, self.client)
            wrench = self.world.advance_with_client(self.memory, state, self._dt, self.commanded)
        else:
            wrench = self._advance(self.memory, state, self._dt)
        if not _is_finite(self.numbers):  # safety: memory-finite
            raise MemoryNotFinite(self._explain())
        self.failed = False
        return wrench

    def restart(self) -> None:
        """Restart."""
        self.memory[:] = check_memory(self.world.begin(), self.world.name)
        self.failed = False

    def _explain(self) -> str:
        start, bad = 0, []
        for field in self.world.memory_fields:
            if not np.isfinite(self.numbers[start : start + field.size]).all():
                bad.append(field.name)
            start += field.size
        return f"the memory of world '{self.world.name}' is no longer finite in {', '.join(bad)}"


def check_world_period(world: World, dt: float) -> None:
    """Raise InputError if `world` cannot be advanced in ticks of `dt` [s]; one without memory always can."""
    if isinstance(world, DynamicWorld):
        world.check_period(dt)


def bind_world(
    world: World, dt: float, before: BoundWorld | None = None, client: Records | None = None
) -> BoundWorld | None:
    """`world` bound to a memory, for ticks `dt` [s] apart; None for a world without memory.

    before: the previous world, whose memory it may keep by its own rule; client: (1,) CLIENT_FORCE that
    a loop fills before every tick [N, s]. Raises InputError for an invalid memory.
    """
    if not isinstance(world, DynamicWorld):
        return None
    bound = BoundWorld(world, dt)
    bound.client = bound.client if client is None else client
    if before is not None and not before.failed:
        world.keep(bound.memory, before.world, before.memory)
        if not np.isfinite(bound.numbers).all():
            raise InputError(f"world '{world.name}': after keep, its memory has numbers that are not finite")
    return bound
