"""The abstract world with memory: what it renders depends on what was done to it before."""

from __future__ import annotations

from abc import abstractmethod
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

__all__ = ["DynamicSum", "DynamicWorld"]

_FIRST = 1e-3  #: time step of a wrench that is asked for outside a loop [s]


@dataclass(frozen=True)
class DynamicWorld(World):
    """A world that remembers: its memory, a structured array of one record, is advanced by `dt` in every tick.

    It says which fields its memory has (`memory_fields`), begins one (`begin`), and in each tick changes it in place
    and returns the wrench (`advance`). Nothing else remembers: the world itself is frozen, has no clock, and keeps
    nothing that grows, so the same memory, state and dt give the same memory and wrench, bit for bit.

    It is advanced in every tick with a valid pose, also while the coils are off: a hand moves things there, too, it
    only does not feel them. Without a valid pose it stands still and renders nothing. dt is always the loop's nominal
    period: where ticks are missed, its time goes slower, and never jumps. After a trip or a stop it goes on. If it
    fails, or its memory is no longer finite, the coils go off, and it restarts when a person engages.

    passive  no more energy comes out of it than was put in since it began. If it has a memory field `energy` [J], what
             it holds after the tick, the passivity control counts that beside what the hand gives and takes, and damps
             what a time step has made out of nothing.
    """

    remembers: ClassVar[bool] = True
    takes_commands: ClassVar[bool] = False  #: renders what programs outside the loop command: see `take_command`

    @property
    @abstractmethod
    def memory_fields(self) -> tuple[MemoryField, ...]:
        """The fields of its memory, in order. They may depend on parameters, but not on the device."""

    def begin(self) -> Records:
        """(1,) its memory at the beginning: all zero, unless a world begins otherwise. It must take little time: it is
        made between two ticks. What depends on the device, `for_device` has put into the world's own fields."""
        return make_memory(self.memory_fields)

    @abstractmethod
    def advance(self, memory: Records, state: State, dt: float) -> Array:
        """(6,) what the mover should feel at `state`, `dt` [s] after the tick before; `memory` (1,) is changed in
        place. Force [N] and torque about the mover's origin [N·m]."""

    def take_command(self, memory: Records, client: Records) -> None:
        """Before each `advance` of a world that `takes_commands`: copy into `memory` (1,) what a program outside the
        loop commands, `client` (1,) CLIENT_FORCE [N, s]. Most worlds have nothing to do."""

    def keep(self, memory: Records, previous: DynamicWorld, old: Records) -> None:
        """This world takes over from `previous`, whose memory is `old` (1,): parameters were changed, or its file was
        saved. `memory` (1,) has just begun; copy into it what goes on, each field in its unit.

        Default rule: the memory is kept if name and fields are the same, else the world restarts.
        """
        if previous.name == self.name and old.dtype == memory.dtype:
            memory[:] = old

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """Bodies that the console draws where the memory has them; none unless a world says so."""
        return ()

    def check_period(self, dt: float) -> None:
        """Raise InputError if it cannot be advanced in ticks of `dt` [s]; asked before the first one."""

    def lighten(self, memory: Records) -> None:
        """Steps take too long for their tick: note in `memory` (1,), in the unit of a field, that the next ones do
        less. Most worlds have nothing to leave out."""

    def restore(self, memory: Records) -> None:
        """There is time again: take back in `memory` (1,), in the unit of a field, one step of `lighten`."""

    @property
    def stores_energy(self) -> bool:
        """Whether its memory says in a field `energy` [J] what it holds."""
        return any(field.name == "energy" for field in self.memory_fields)

    def wrench(self, state: State) -> Array:
        """(6,) what it renders at `state` in the first millisecond after its beginning [N, N·m]."""
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


@dataclass(frozen=True)
class DynamicSum(Sum, DynamicWorld):
    """Several worlds at once, with and without memory: their wrenches add, and each remembers for itself."""

    @property
    def name(self) -> str:
        """`sum`, as of worlds without memory."""
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
        total = np.zeros(6)
        for name, part in self._remembering:
            total += part.advance(memory[name], state, dt)
        for still in self._still:
            total += still.wrench(state)
        return total

    @property
    def takes_commands(self) -> bool:  # type: ignore[override]  # of a class, but a sum does what one of its parts does
        """Whether one of the parts renders what a program outside the loop commands."""
        return any(part.takes_commands for _, part in self._remembering)

    def take_command(self, memory: Records, client: Records) -> None:
        """Each part that takes commands copies `client` (1,) CLIENT_FORCE [N, s] into its own part of `memory` (1,)."""
        for name, part in self._remembering:
            if part.takes_commands:
                part.take_command(memory[name], client)

    def keep(self, memory: Records, previous: DynamicWorld, old: Records) -> None:
        """Each part by its own rule, with the memory of the part that had its name; in the fields' units."""
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
        """Whether all parts say what they hold."""
        return all(isinstance(part, DynamicWorld) and part.stores_energy for part in self.parts)


def _identify(name: str) -> str:
    """The `name` of a world as the beginning of a field's: a scene's has a hyphen, and a user's may have anything."""
    return "".join(letter if letter.isalnum() else "_" for letter in name)
