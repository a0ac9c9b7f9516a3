"""Abstract world with memory: its wrench depends on the past."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from math import prod
from typing import Any, ClassVar, final

import numpy as np

from haptorb.arrays import Array, Records, fields
from haptorb.compiled import tick_kernel
from haptorb.devices.base import State
from haptorb.errors import HaptorbError, InputError, quote
from haptorb.worlds.base import Shape, Sum, World

__all__ = [
    "CLIENT_FORCE",
    "BoundWorld",
    "DynamicSum",
    "DynamicWorld",
    "MemoryField",
    "MemoryNotFinite",
    "WorldWork",
    "bind_world",
    "check_memory",
    "check_world_period",
    "count_numbers",
    "find_number",
    "make_client_force",
    "make_memory",
    "memory_dtype",
    "numbers_of",
]


# --------------------------------------------------------------------------------------------------
# Memory of a world: named numbers with units, in a structured array of one record.
#
# Every field is float64, a flag is 0 or 1: so a memory is also a plain row of numbers, which is recorded, sent to the
# console and checked for non-finite numbers without a loop over fields.


@dataclass(frozen=True)
class MemoryField:
    """One named part of a world's memory: a number or an array.

    Parameters
    ----------
    name : str
        Name of the field.
    unit : str
        SI unit.
    about : str
        Meaning, in a few words.
    shape : tuple of int
        Shape of the array; empty: one number.

    Examples
    --------
    >>> MemoryField("place", "m", "of the ball, stator frame", (3,)).size
    3
    """

    name: str
    unit: str
    about: str
    shape: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if not (isinstance(self.name, str) and self.name.isidentifier()):
            raise InputError(f"a memory field needs a name like 'place'; got {quote(self.name)}")
        if not isinstance(self.shape, tuple) or any(type(n) is not int or n < 1 for n in self.shape):
            raise InputError(
                f"memory field '{self.name}': its shape must be a tuple of whole numbers above 0, () for a single "
                f"number; got {quote(self.shape)}"
            )

    @property
    def size(self) -> int:
        """Number of elements."""
        return prod(self.shape)


@cache
def memory_dtype(fields: tuple[MemoryField, ...]) -> np.dtype[Any]:
    """Dtype of a memory with these `fields`: all float64, contiguous.

    Raises InputError for no fields, and for two fields of the same name.
    """
    names = [field.name for field in fields]
    if not names or len(set(names)) != len(names):
        raise InputError(f"a memory needs fields, each with its own name; got {quote(names)}")
    return np.dtype([(field.name, np.float64, field.shape) for field in fields])


def make_memory(fields: tuple[MemoryField, ...]) -> Records:
    """Create the memory of a world, all zero; a world's own `begin` starts from it.

    Parameters
    ----------
    fields : tuple of MemoryField
        Fields of the memory.

    Returns
    -------
    ndarray, shape (1,)
        Structured array of one record with these fields, in their units.

    Examples
    --------
    >>> memory = make_memory((MemoryField("speed", "m/s", "of the fluid"),))
    >>> memory["speed"].tolist()
    [0.0]
    """
    return np.zeros(1, dtype=memory_dtype(tuple(fields)))


def numbers_of(memory: Records) -> Array:
    """(n,) all numbers of `memory` (1,) in the order of its fields, each in the unit [..] of its field: a view."""
    return memory.view(np.float64)


def count_numbers(fields: Sequence[MemoryField]) -> int:
    """Number of elements of a memory with these `fields`."""
    return sum(field.size for field in fields)


def find_number(fields: Sequence[MemoryField], name: str, row: int = 0) -> int:
    """Index of the first number of the field `name`, or of its `row`, among all numbers of the memory.

    Raises InputError if there is no such field or row.
    """
    start = 0
    for field in fields:
        if field.name == name:
            if not 0 <= row < (field.shape[0] if len(field.shape) > 1 else 1):
                raise InputError(f"memory field '{name}' has no row {row}; its shape is {field.shape}")
            return start + row * (prod(field.shape[1:]) if len(field.shape) > 1 else 0)
        start += field.size
    raise InputError(f"the memory has no field '{name}'; it has {', '.join(field.name for field in fields)}")


def check_memory(memory: object, name: str) -> Records:
    """Return `memory` if it is valid, (1,) a record of float64 fields in their own units.

    Raises InputError, naming the world `name`, for anything else and for numbers that are not finite.
    """
    if not isinstance(memory, np.ndarray) or memory.dtype.names is None:
        raise InputError(
            f"world '{name}': begin must return a structured array of one record, such as from make_memory(fields); "
            "got "
            f"{quote(memory)}"
        )
    if memory.shape != (1,) or not memory.flags.writeable:
        raise InputError(
            f"world '{name}': begin must return one record, shape (1,), that may be written to; got shape "
            f"{memory.shape}"
        )
    others = [path for path, kind in _leaves(memory.dtype) if kind != np.float64]
    if others or memory.dtype.itemsize != 8 * _size(memory.dtype):
        raise InputError(
            f"world '{name}': every field of a memory must be float64 (a flag is 0.0 or 1.0), without gaps; "
            f"{', '.join(others) or 'its fields'} is not: use make_memory(fields)"
        )
    if not np.isfinite(numbers_of(memory)).all():
        raise InputError(f"world '{name}': its memory begins with a number that is not finite")
    return memory


def _leaves(dtype: np.dtype[Any], path: str = "") -> Iterator[tuple[str, Any]]:
    for name in dtype.names or ():
        kind = dtype[name]
        base = kind.subdtype[0] if kind.subdtype else kind
        if base.names is None:
            yield f"{path}{name}", base
        else:
            yield from _leaves(base, f"{path}{name}.")


def _size(dtype: np.dtype[Any]) -> int:
    total = 0
    for name in dtype.names or ():
        kind = dtype[name]
        base, shape = kind.subdtype if kind.subdtype else (kind, ())
        total += prod(shape) * (_size(base) if base.names else 1)
    return total


_SINGLE_STEP_S = 1e-3  #: time step of a wrench evaluated outside a loop [s]


class WorldWork(ABC):
    """Background work of a world that may take longer than a tick: it is computed from copies of a memory."""

    @abstractmethod
    def compute(self) -> Any:
        """Result for `DynamicWorld.take_over`. The same copies give the same result, bit for bit."""

    @abstractmethod
    def fits(self, memory: Records) -> bool:
        """Whether `memory` (1,) still waits for this work: it was not restarted, or replaced."""


@dataclass(frozen=True)
class DynamicWorld(World):
    """World with memory, advanced by the loop's period in every tick; base class of such worlds.

    A subclass declares the fields of its memory (`memory_fields`), and `advance` changes the memory in place and
    returns the wrench, shape (6,) [N, N·m]. The world itself is frozen, has no clock, and stores nothing that grows:
    the same memory, state and dt give the same memory and wrench, bit for bit.

    Attributes
    ----------
    passive : bool
        Whether it delivers no more energy than it received. If it has a memory field `energy` [J], the energy stored
        after the tick, the passivity control includes it and damps energy that the numerical integration generates.
    remembers : bool
        True: it has a memory.
    takes_commands : bool
        Whether it renders commands of programs outside the loop, see `take_command`.

    Notes
    -----
    It advances in every tick with a valid pose, even while the coils are off: a hand still moves objects then, without
    feeling them. Without a valid pose it is paused and renders nothing. dt is always the loop's nominal period: if
    ticks are missed, its time slows down, but never jumps. After a trip or a stop it continues. If it fails, or its
    memory is no longer finite, the coils go off, and it restarts when a person engages.
    """

    remembers: ClassVar[bool] = True
    takes_commands: ClassVar[bool] = False

    @property
    @abstractmethod
    def memory_fields(self) -> tuple[MemoryField, ...]:
        """Fields of its memory, in order. They may depend on parameters, but not on the device."""

    def begin(self) -> Records:
        """Make the initial memory: all zero unless overridden.

        It must be fast, because it runs between two ticks. `for_device` has already put device-dependent values into
        the world's own fields.

        Returns
        -------
        ndarray, shape (1,)
            Structured array of one record, with the fields of `memory_fields`.
        """
        return make_memory(self.memory_fields)

    @abstractmethod
    def advance(self, memory: Records, state: State, dt: float) -> Array:
        """Advance the memory by one tick, in place, and render the wrench.

        Parameters
        ----------
        memory : ndarray, shape (1,)
            Structured array of one record; each field in its unit.
        state : State
            Pose and motion of the mover.
        dt : float
            Period of the loop [s].

        Returns
        -------
        ndarray, shape (6,)
            Force [N], then torque about the mover's origin [N·m], in the stator frame.
        """

    def take_command(self, memory: Records, client: Records) -> None:
        """Copy the command of a program outside the loop into the memory.

        Called before each `advance` of a world that `takes_commands`; by default it does nothing.

        Parameters
        ----------
        memory : ndarray, shape (1,)
            Structured array of one record, changed in place.
        client : ndarray, shape (1,)
            Structured array CLIENT_FORCE: force [N] and time [s].
        """

    def advance_with_client(self, memory: Records, state: State, dt: float, commanded: Array) -> Array:
        """As `advance`; the part of the wrench that programs outside the loop command is added to `commanded` (6,)
        [N, N·m]. Of a world that takes commands it is all of it."""
        wrench = self.advance(memory, state, dt)
        if self.takes_commands:
            commanded += wrench
        return wrench

    def gripper_force(self, memory: Records) -> float:
        """[N] on the device's gripper after `advance`, positive to open; by default none.

        Parameters
        ----------
        memory : ndarray, shape (1,)
            Structured array of one record, each field in its unit.

        Returns
        -------
        float
            Force between thumb and finger [N].
        """
        return 0.0

    def keep(self, memory: Records, previous: DynamicWorld, old: Records) -> None:
        """Decide what of the memory remains when this world replaces another.

        Called after parameters were changed, or its file was saved. By default the memory is kept if name and fields
        are the same, else the world restarts.

        Parameters
        ----------
        memory : ndarray, shape (1,)
            Structured array with the new initial memory, changed in place, each field in its unit.
        previous : DynamicWorld
            World that is replaced.
        old : ndarray, shape (1,)
            Structured array with its memory.
        """
        if previous.name == self.name and old.dtype == memory.dtype:
            memory[:] = old

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """Bodies drawn in the console at poses from the memory; none by default."""
        return ()

    def check_period(self, dt: float) -> None:
        """Raise InputError if it cannot be advanced in ticks of `dt` [s]; called before the first one."""

    def lighten(self, memory: Records) -> None:
        """Reduce the work of the next steps, because the last ones took too long; noted in `memory` (1,) in the unit
        of a field. The default does nothing."""

    def restore(self, memory: Records) -> None:
        """Undo one step of `lighten` in `memory` (1,), in the unit of a field, once the time is sufficient again."""

    def find_work(self, memory: Records) -> WorldWork | None:
        """Background work that `memory` (1,) waits for, each field in its unit; by default none."""
        return None

    def is_work_due(self, memory: Records) -> bool:
        """Whether the result of that work is due before the next `advance` of `memory` (1,), in its units."""
        return False

    def take_over(self, memory: Records, result: Any) -> None:
        """Copy the `result` of the work into `memory` (1,), each field in its unit."""

    @property
    def stores_energy(self) -> bool:
        """Whether its memory has a field `energy` [J]."""
        return any(field.name == "energy" for field in self.memory_fields)

    def wrench(self, state: State) -> Array:
        """(6,) wrench at `state` in the first millisecond after the start [N, N·m]."""
        return self.advance(self.begin(), state, _SINGLE_STEP_S)

    @property
    def wrench_code(self) -> Callable[..., Any]:
        """Code that computes the wrench, for messages."""
        return type(self).advance

    def __add__(self, other: World) -> DynamicSum:
        """Sum of both worlds."""
        return DynamicSum((*_parts_of(self), *_parts_of(other)))

    def __radd__(self, other: World) -> DynamicSum:
        """Sum of a world without memory and this one."""
        return DynamicSum((*_parts_of(other), *_parts_of(self)))


def _parts_of(world: World) -> tuple[World, ...]:
    return world.parts if isinstance(world, Sum) else (world,)


class _PartsWork(WorldWork):
    """Background work of the parts of a sum, by their names."""

    def __init__(self, works: dict[str, WorldWork]) -> None:
        self._works = works

    def compute(self) -> dict[str, Any]:
        """Results of the parts."""
        return {name: work.compute() for name, work in self._works.items()}

    def fits(self, memory: Records) -> bool:
        """By each part's own memory, in `memory` (1,) [1]."""
        return all(work.fits(memory[name]) for name, work in self._works.items())


@dataclass(frozen=True)
class DynamicSum(Sum, DynamicWorld):
    """Sum of several worlds, with and without memory: their wrenches add, and each has its own memory.

    `first + second` makes one.

    Parameters
    ----------
    parts : tuple of World
        The worlds.
    """

    @property
    def name(self) -> str:
        """`sum`, as for worlds without memory."""
        return "sum"

    @cached_property
    def _remembering(self) -> tuple[tuple[str, DynamicWorld], ...]:
        """Parts with memory, each with its own name in this sum: `ball`, `ball_2`."""
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
        """Fields of all parts, each named after its part: "ball_place"."""
        return tuple(
            replace(field, name=f"{name}_{field.name}")
            for name, part in self._remembering
            for field in part.memory_fields
        )

    def begin(self) -> Records:
        """(1,) record with the memory of each part under its name."""
        memories = {name: part.begin() for name, part in self._remembering}
        memory: Records = np.zeros(1, dtype=[(name, one.dtype) for name, one in memories.items()])
        for name, one in memories.items():
            memory[name] = one
        return memory

    def advance(self, memory: Records, state: State, dt: float) -> Array:
        """(6,) sum over the parts [N, N·m], each with its own part of `memory`; dt in [s]."""
        return self.advance_with_client(memory, state, dt, np.empty(6))

    def advance_with_client(self, memory: Records, state: State, dt: float, commanded: Array) -> Array:
        """(6,) sum; the wrenches of the parts that accept commands are added to `commanded` (6,) [N, N·m] too."""
        total = np.zeros(6)
        for name, part in self._remembering:
            total += part.advance_with_client(memory[name], state, dt, commanded)
        for still in self._still:
            total += still.wrench(state)
        return total

    @property
    def takes_commands(self) -> bool:  # type: ignore[override]  # an attribute of the base; depends on the parts
        """Whether one of the parts renders commands of a program outside the loop."""
        return any(part.takes_commands for _, part in self._remembering)

    def take_command(self, memory: Records, client: Records) -> None:
        """Copy `client` (1,) CLIENT_FORCE [N, s] into each part of `memory` (1,) that accepts commands."""
        for name, part in self._remembering:
            if part.takes_commands:
                part.take_command(memory[name], client)

    def gripper_force(self, memory: Records) -> float:
        """[N] sum over the parts, each in its part of `memory` (1,), in the units of its fields."""
        return sum(part.gripper_force(memory[name]) for name, part in self._remembering)

    def keep(self, memory: Records, previous: DynamicWorld, old: Records) -> None:
        """Each part by its own rule, with the memory of the previous part of the same name; in the fields' units."""
        before = (
            dict(previous._remembering) if isinstance(previous, DynamicSum) else {_identify(previous.name): previous}
        )
        for name, part in self._remembering:
            if name in before:
                part.keep(memory[name], before[name], old[name] if isinstance(previous, DynamicSum) else old)

    def check_period(self, dt: float) -> None:
        """Check every part for ticks of `dt` [s]."""
        for _, part in self._remembering:
            part.check_period(dt)

    def lighten(self, memory: Records) -> None:
        """Lighten every part, in its own part of `memory` (1,), in the units of its fields."""
        for name, part in self._remembering:
            part.lighten(memory[name])

    def find_work(self, memory: Records) -> WorldWork | None:
        """Work of every part that has any, in its own part of `memory` (1,), in the units of its fields."""
        found = {name: part.find_work(memory[name]) for name, part in self._remembering}
        works = {name: work for name, work in found.items() if work is not None}
        return _PartsWork(works) if works else None

    def is_work_due(self, memory: Records) -> bool:
        """Whether all parts with work are due, in their own parts of `memory` (1,), in the units of their fields."""
        due = [part.is_work_due(memory[name]) for name, part in self._remembering if part.find_work(memory[name])]
        return bool(due) and all(due)

    def take_over(self, memory: Records, result: Any) -> None:
        """Copy each part's result into its part of `memory` (1,), in the units of its fields."""
        for name, part in self._remembering:
            if name in result:
                part.take_over(memory[name], result[name])

    def restore(self, memory: Records) -> None:
        """Restore every part, in its own part of `memory` (1,), in the units of its fields."""
        for name, part in self._remembering:
            part.restore(memory[name])

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """Shapes of all parts."""
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
    """Identifier from the `name` of a world: a scene's has a hyphen, and a user's may have any character."""
    return "".join(letter if letter.isalnum() else "_" for letter in name)


# --------------------------------------------------------------------------------------------------
# Force commanded by a program outside the loop, as passed by the loop to the worlds that render it.


CLIENT_FORCE = fields(
    ("force", "f8", (3,)),  # commanded by the client, stator frame [N]
    ("session", "f8"),  # number of the connection; 0: no command yet
    ("age", "f8"),  # of the command [s]
    ("lost", "f8"),  # time since the connection was lost; 0: connected [s]
    ("mapping", "f8"),  # number of its mapping into the stator's frame
    ("torque", "f8", (3,)),  # commanded about the mover's origin, stator frame [N·m]
    ("gripper", "f8"),  # commanded between thumb and finger, positive to open [N]
)


def make_client_force() -> Records:
    """(1,) CLIENT_FORCE without a client: no force [N], torque [N·m] or gripper force [N], session 0."""
    return np.zeros(1, dtype=CLIENT_FORCE)


# --------------------------------------------------------------------------------------------------
# World with memory in one run of a loop: world, memory and time step.


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
    """`world` with its own memory, advanced by `dt` [s] in each call of `wrench`; rendered by a linkage.

    numbers  (n,) all of its memory, in the units of its fields: a view
    paused   without a pose: its time stops and it renders nothing
    failed   after an exception or a non-finite memory: it renders nothing until `restart`
    client   (1,) CLIENT_FORCE: the command of a program outside the loop; filled by the loop
    commanded  (6,) the part of the last wrench that this program commands [N, N·m]

    Raises InputError for a memory that does not match the world's `memory_fields`.
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
        _is_finite(self.numbers)  # compiled at construction, not in the loop

    @property
    def energy(self) -> float:
        """Energy stored in its memory [J]; NaN if the world does not define it, or renders nothing now."""
        if not self._energies or self.paused or self.failed:
            return np.nan
        return sum(map(self.numbers.item, self._energies))

    def wrench(self, state: State) -> Array:
        """(6,) wrench of the world at `state` after one more time step [N, N·m].

        Raises MemoryNotFinite, and any exception of the world.
        """
        self.commanded[:] = 0.0
        if self.paused or self.failed:
            return self._still
        # After an exception a partial update leaves an inconsistent state.
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

    @property
    def gripper_force(self) -> float:
        """Of the world on the device's gripper after its last step [N], positive to open."""
        return 0.0 if self.paused or self.failed else self.world.gripper_force(self.memory)

    def restart(self) -> None:
        """Reset the memory to the initial state."""
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
    """Bind `world` to a memory, for ticks `dt` [s] apart; None for a world without memory.

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
