"""The abstract world with memory: its wrench depends on the past."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from haptorb.devices.state import State
from haptorb.numerics.arrays import Array, Records
from haptorb.worlds.memory import MemoryField, make_memory
from haptorb.worlds.shape import Shape
from haptorb.worlds.world import Sum, World

__all__ = ["DynamicSum", "DynamicWorld", "WorldWork"]

_FIRST = 1e-3  #: time step of a wrench that is asked for outside a loop [s]


class WorldWork(ABC):
    """Work of a world that may take longer than a tick: it is computed in the background, from copies of a memory."""

    @abstractmethod
    def compute(self) -> Any:
        """The result, for `DynamicWorld.take_over`. The same copies give the same result, bit for bit."""

    @abstractmethod
    def fits(self, memory: Records) -> bool:
        """Whether `memory` (1,) still waits for this work: it has not been restarted, or replaced."""


@dataclass(frozen=True)
class DynamicWorld(World):
    """A world with memory: a structured array of one record, advanced by `dt` in every tick.

    It declares the fields of its memory (`memory_fields`), creates one (`begin`), and in each tick changes it in
    place and returns the wrench (`advance`). Nothing else has state: the world itself is frozen, has no clock,
    and stores nothing that grows, so the same memory, state and dt give the same memory and wrench, bit for bit.

    It advances in every tick with a valid pose, even while the coils are off: a hand still moves objects then,
    without feeling them. Without a valid pose its time stops and it renders nothing. dt is always the loop's
    nominal period: if ticks are missed, its time slows down, but never jumps. After a trip or a stop it
    continues. If it fails, or its memory is no longer finite, the coils go off, and it restarts when a person
    engages.

    passive  it delivers no more energy than it received since it began. If it has a memory field `energy` [J], the
             energy stored after the tick, the passivity control includes it in the energy of the hand, and damps
             energy that a time step generates.
    """

    remembers: ClassVar[bool] = True
    takes_commands: ClassVar[bool] = False  #: renders what programs outside the loop command: see `take_command`

    @property
    @abstractmethod
    def memory_fields(self) -> tuple[MemoryField, ...]:
        """The fields of its memory, in order. They may depend on parameters, but not on the device."""

    def begin(self) -> Records:
        """(1,) the initial memory: all zero unless overridden. It must be fast, because it runs between two ticks.
        `for_device` has already put device-dependent values into the world's own fields."""
        return make_memory(self.memory_fields)

    @abstractmethod
    def advance(self, memory: Records, state: State, dt: float) -> Array:
        """(6,) the wrench on the mover at `state`, `dt` [s] after the previous tick; changes `memory` (1,) in
        place. Force [N] and torque about the mover's origin [N·m]."""

    def take_command(self, memory: Records, client: Records) -> None:
        """Before each `advance` of a world that `takes_commands`: copy the command of a program outside the loop,
        `client` (1,) CLIENT_FORCE [N, s], into `memory` (1,). By default it does nothing."""

    def advance_with_client(self, memory: Records, state: State, dt: float, commanded: Array) -> Array:
        """As `advance`; the part of the wrench that programs outside the loop command is added to `commanded` (6,)
        [N, N·m]. Of a world that takes commands it is all of it."""
        wrench = self.advance(memory, state, dt)
        if self.takes_commands:
            commanded += wrench
        return wrench

    def keep(self, memory: Records, previous: DynamicWorld, old: Records) -> None:
        """This world replaces `previous`, whose memory is `old` (1,): parameters were changed, or its file was
        saved. `memory` (1,) is the new initial memory; copy into it what shall be kept, each field in its unit.

        Default rule: the memory is kept if name and fields are the same, else the world restarts.
        """
        if previous.name == self.name and old.dtype == memory.dtype:
            memory[:] = old

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """Bodies that the console draws at poses from the memory; none by default."""
        return ()

    def check_period(self, dt: float) -> None:
        """Raise InputError if it cannot be advanced in ticks of `dt` [s]; called before the first one."""

    def lighten(self, memory: Records) -> None:
        """Steps take too long for their tick: reduce the work of the next ones, noted in `memory` (1,) in the unit
        of a field. By default it does nothing."""

    def restore(self, memory: Records) -> None:
        """There is time again: undo one step of `lighten` in `memory` (1,), in the unit of a field."""

    def find_work(self, memory: Records) -> WorldWork | None:
        """The work that `memory` (1,) waits for, each field in its unit; by default none."""
        return None

    def is_work_due(self, memory: Records) -> bool:
        """Whether that work's result may be taken over before the next `advance` of `memory` (1,), in its units."""
        return False

    def take_over(self, memory: Records, result: Any) -> None:
        """Take the `result` of the work into `memory` (1,), each field in its unit."""

    @property
    def stores_energy(self) -> bool:
        """Whether its memory has a field `energy` [J]."""
        return any(field.name == "energy" for field in self.memory_fields)

    def wrench(self, state: State) -> Array:
        """(6,) its wrench at `state` in the first millisecond after the start [N, N·m]."""
        return self.advance(self.begin(), state, _FIRST)

    @property
    def wrench_code(self) -> Callable[..., Any]:
        """The code that computes the wrench, for messages about it."""
        return type(self).advance

    def __add__(self, other: World) -> DynamicSum:
        """Both at once."""
        return DynamicSum((*_parts_of(self), *_parts_of(other)))

    def __radd__(self, other: World) -> DynamicSum:
        """Both at once, of a world without memory and this one."""
        return DynamicSum((*_parts_of(other), *_parts_of(self)))


def _parts_of(world: World) -> tuple[World, ...]:
    return world.parts if isinstance(world, Sum) else (world,)


class _PartsWork(WorldWork):
    """The `works` of the parts of a sum that have any, by their names."""

    def __init__(self, works: dict[str, WorldWork]) -> None:
        self._works = works

    def compute(self) -> dict[str, Any]:
        """The result of each part."""
        return {name: work.compute() for name, work in self._works.items()}

    def fits(self, memory: Records) -> bool:
        """By each part's own memory, in `memory` (1,) [1]."""
        return all(work.fits(memory[name]) for name, work in self._works.items())


@dataclass(frozen=True)
class DynamicSum(Sum, DynamicWorld):
    """Several worlds at once, with and without memory: their wrenches add, and each has its own memory."""

    @property
    def name(self) -> str:
        """`sum`, as for worlds without memory."""
        return "sum"

    @cached_property
    def _remembering(self) -> tuple[tuple[str, DynamicWorld], ...]:
        """The parts with memory, each with the name of its own in this sum: `ball`, `ball_2`."""
        named: dict[str, DynamicWorld] = {}
        for part in self.parts:
            if isinstance(part, DynamicWorld):
                own, count = _identify(part.name), 1
                name = own
                while name in named:
                    count += 1
                    name = f"{own}_{count}"
                named[name] = part
        return tuple(named.items())

    @cached_property
    def _still(self) -> tuple[World, ...]:
        return tuple(part for part in self.parts if not part.remembers)

    @property
    def memory_fields(self) -> tuple[MemoryField, ...]:
        """Those of all parts, as `ball_place`."""
        return tuple(
            replace(field, name=f"{name}_{field.name}")
            for name, part in self._remembering
            for field in part.memory_fields
        )

    def begin(self) -> Records:
        """(1,) a record with the memory of each part under its name."""
        memories = {name: part.begin() for name, part in self._remembering}
        memory: Records = np.zeros(1, dtype=[(name, one.dtype) for name, one in memories.items()])
        for name, one in memories.items():
            memory[name] = one
        return memory

    def advance(self, memory: Records, state: State, dt: float) -> Array:
        """(6,) the sum over the parts [N, N·m], each with its own part of `memory`; dt in [s]."""
        return self.advance_with_client(memory, state, dt, np.empty(6))

    def advance_with_client(self, memory: Records, state: State, dt: float, commanded: Array) -> Array:
        """(6,) the sum; the wrenches of those parts that take commands are added to `commanded` (6,) [N, N·m] too."""
        total = np.zeros(6)
        for name, part in self._remembering:
            total += part.advance_with_client(memory[name], state, dt, commanded)
        for still in self._still:
            total += still.wrench(state)
        return total

    @property
    def takes_commands(self) -> bool:  # type: ignore[override]  # of a class, but a sum does what one of its parts does
        """Whether one of the parts renders commands of a program outside the loop."""
        return any(part.takes_commands for _, part in self._remembering)

    def take_command(self, memory: Records, client: Records) -> None:
        """Each part that takes commands copies `client` (1,) CLIENT_FORCE [N, s] into its own part of `memory` (1,)."""
        for name, part in self._remembering:
            if part.takes_commands:
                part.take_command(memory[name], client)

    def keep(self, memory: Records, previous: DynamicWorld, old: Records) -> None:
        """Each part by its own rule, with the memory of the previous part of the same name; in the fields' units."""
        before = (
            dict(previous._remembering) if isinstance(previous, DynamicSum) else {_identify(previous.name): previous}
        )
        for name, part in self._remembering:
            if name in before:
                part.keep(memory[name], before[name], old[name] if isinstance(previous, DynamicSum) else old)

    def check_period(self, dt: float) -> None:
        """Of every part, for ticks of `dt` [s]."""
        for _, part in self._remembering:
            part.check_period(dt)

    def lighten(self, memory: Records) -> None:
        """Every part, in its own part of `memory` (1,), in the units of its fields."""
        for name, part in self._remembering:
            part.lighten(memory[name])

    def find_work(self, memory: Records) -> WorldWork | None:
        """That of every part that has any, in its own part of `memory` (1,), in the units of its fields."""
        found = {name: part.find_work(memory[name]) for name, part in self._remembering}
        works = {name: work for name, work in found.items() if work is not None}
        return _PartsWork(works) if works else None

    def is_work_due(self, memory: Records) -> bool:
        """Of all parts that have work, in their own parts of `memory` (1,), in the units of their fields."""
        due = [part.is_work_due(memory[name]) for name, part in self._remembering if part.find_work(memory[name])]
        return bool(due) and all(due)

    def take_over(self, memory: Records, result: Any) -> None:
        """Each part its own, in its part of `memory` (1,), in the units of its fields."""
        for name, part in self._remembering:
            if name in result:
                part.take_over(memory[name], result[name])

    def restore(self, memory: Records) -> None:
        """Every part, in its own part of `memory` (1,), in the units of its fields."""
        for name, part in self._remembering:
            part.restore(memory[name])

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """Those of all parts."""
        return tuple(
            replace(
                shape,
                place=f"{name}_{shape.place}" if shape.place else "",
                attitude=f"{name}_{shape.attitude}" if shape.attitude else "",
            )
            for name, part in self._remembering
            for shape in part.shapes
        )

    @property
    def stores_energy(self) -> bool:
        """Whether all parts have a field `energy`."""
        return all(isinstance(part, DynamicWorld) and part.stores_energy for part in self.parts)


def _identify(name: str) -> str:
    """The `name` of a world as the beginning of a field's: a scene's has a hyphen, and a user's may have anything."""
    return "".join(letter if letter.isalnum() else "_" for letter in name)
