"""A world that renders what was recorded of another one: its wrench, its contacts, its memory, and its failures."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np

from haptorb.devices.state import State
from haptorb.errors import HaptorbError, RecordingError
from haptorb.numerics.arrays import Array, Records
from haptorb.runtime.recording.recording import Recording
from haptorb.runtime.tick.tick_log import TickFailure
from haptorb.worlds.bound_world import BoundWorld
from haptorb.worlds.client_force import CLIENT_FORCE
from haptorb.worlds.dynamic_world import DynamicWorld
from haptorb.worlds.memory import MemoryField
from haptorb.worlds.world import World
from haptorb.worlds.wrench_part import check_part

__all__ = ["PlayedBudget", "RecordedTick", "WorldFailed", "list_memory_fields", "make_recorded_world"]

_FAILED = int(TickFailure.WORLD)
_DETAIL = TickFailure.LESS_DETAIL | TickFailure.MORE_DETAIL


class WorldFailed(HaptorbError):
    """The recorded world failed in this tick."""


@final
class RecordedTick:
    """What the world did in the tick that is replayed now, in a block of ticks."""

    def __init__(self) -> None:
        self._wrench: list[Array] = []
        self._contacts: list[Array] = []
        self._memory: list[Array] = []
        self._failures: list[int] = []
        self._client: dict[str, slice | int] = {}
        self._at = 0

    def load(self, block: Mapping[str, Array], *, whole: bool) -> None:
        """The next ticks: field → (n, width), each in its unit [SI]; only failures unless the `whole` is requested."""
        n = len(block["t"])
        self._failures = np.nan_to_num(block["failures"][:, 0]).astype(int).tolist()
        self._at = 0
        if not whole:
            return
        nothing = np.full((n, 6), np.nan)
        asked = block.get("object_wrench", block.get("asked", nothing))
        self._wrench = list(np.nan_to_num(np.ascontiguousarray(asked)))
        hooks = block.get("contacts")
        self._contacts = (
            [np.zeros((0, 8))] * n
            if hooks is None or not hooks.shape[1]
            else list(np.ascontiguousarray(hooks).reshape(n, -1, 8))
        )
        self._memory = list(np.ascontiguousarray(block.get("memory", np.empty((n, 0)))))

    def go_to(self, number: int) -> None:
        """The tick `number` of the block, from 0 on, is next."""
        self._at = number

    @property
    def detail_change(self) -> TickFailure:
        """The change of the recorded world's detail: LESS_DETAIL, MORE_DETAIL or 0."""
        return TickFailure(self._failures[self._at]) & _DETAIL

    @property
    def took_over(self) -> bool:
        """Whether the recorded world took over work that was computed in the background."""
        return bool(self._failures[self._at] & TickFailure.WORK)

    def render(self) -> Array:
        """(6,) the recorded wrench on the mover [N, N·m]. Raises WorldFailed where the recorded world failed."""
        if self._failures[self._at] & _FAILED:
            raise WorldFailed("the world failed in the recording")
        return self._wrench[self._at]

    @property
    def contacts(self) -> Array:
        """(n, 8) as a row has them [m, N]."""
        return self._contacts[self._at]

    def find_client(self, fields: Sequence[MemoryField], recording: Recording) -> None:
        """Where a memory with these `fields` has what a client commanded: that of the world `remote`, alone or in a
        sum. Raises RecordingError if the rows of `recording` are too narrow for it."""
        start = end = 0
        self._client = {}
        for field in fields:
            for name in CLIENT_FORCE.names or ():
                if field.name in (name, f"remote_{name}"):
                    self._client[name] = slice(start, start + field.size) if field.shape else start
                    end = start + field.size
            start += field.size
        room = next((field.width for field in recording.fields if field.name == "memory"), 0)
        if end > room:
            text = (
                f"{recording.path} cannot be replayed: the clients' commands end at number {end} of the memory of "
                f"the world, but the field 'memory' has only {room} numbers; replay the recorded wrench instead"
            )
            raise RecordingError(f"{text} with recorded_world=True", command=f"{text} with --world recorded")

    def fill_client(self, client: Records) -> None:
        """Fill `client` (1,) CLIENT_FORCE [N, s] with what the client commanded."""
        memory = self._memory[self._at]
        for name, place in self._client.items():
            client[name] = memory[place]
        if client["mapping"][0] != client["mapping"][0]:  # a recording from before the rows had it
            client["mapping"] = 0.0

    def remember(self, memory: Records) -> None:
        """Fill `memory` (1,), in the units of its fields, with what the recorded world remembered after its step."""
        numbers, recorded = memory.view(np.float64), self._memory[self._at]
        numbers[: len(recorded)] = recorded[: len(numbers)]


@final
class PlayedBudget:
    """Reduces detail where the recorded run did, and restores it there."""

    def __init__(self, tick: RecordedTick) -> None:
        self._tick = tick

    def begin(self, bound: BoundWorld) -> None:
        """Take over what was computed in the background where the recorded run did; it is computed here."""
        if self._tick.took_over and (work := bound.world.find_work(bound.memory)) is not None:
            bound.world.take_over(bound.memory, work.compute())

    def end(self, bound: BoundWorld) -> TickFailure:
        """Change the detail as the recorded run did after its step."""
        change = self._tick.detail_change
        if change & TickFailure.LESS_DETAIL:
            bound.world.lighten(bound.memory)
        elif change & TickFailure.MORE_DETAIL:
            bound.world.restore(bound.memory)
        return change | (TickFailure.WORK if self._tick.took_over else TickFailure(0))


def make_recorded_world(description: str, tick: RecordedTick) -> World:
    """A world that stands in for the one of `description`, in a class of its own for each name.

    A change between two of one name is so the change of values that it was.
    """
    note = _parse(description)
    name, fields = str(note.get("name", "recorded")), _memory_fields(note)
    kind = _dynamic_kind(name) if fields else _still_kind(name)
    asks = check_part(note["asks"]) if note.get("asks") else None
    world: World = kind(tick, fields, note.get("stores_energy")) if fields else kind(tick)
    object.__setattr__(world, "passive", note.get("passive", True) is not False)
    object.__setattr__(world, "asks", asks)
    return world


def _parse(description: str) -> dict[str, Any]:
    try:
        note = json.loads(description)
    except (ValueError, RecursionError):
        note = None
    return note if isinstance(note, dict) else {}


def list_memory_fields(description: str) -> tuple[MemoryField, ...]:
    """Fields of the memory of the world of `description`; none where it does not say."""
    return _memory_fields(_parse(description))


def _memory_fields(note: Mapping[str, Any]) -> tuple[MemoryField, ...]:
    try:
        found = tuple(
            MemoryField(str(one["name"]), str(one["unit"]), str(one["about"]), tuple(int(n) for n in one["shape"]))
            for one in note.get("memory", ())
        )
    except (KeyError, TypeError, ValueError, OverflowError):
        return ()
    too_long = any(n < 0 for one in found for n in one.shape) or sum(one.size for one in found) > _MEMORY
    return () if too_long else found  # safety: memory-length


_MEMORY = 1_000_000  #: numbers of a memory, much more than a row has room for
_KINDS: dict[tuple[str, bool], Any] = {}


def _still_kind(known_as: str) -> Any:
    """The class of the stand-ins without memory for worlds of that name."""
    if (known_as, False) in _KINDS:
        return _KINDS[known_as, False]

    @final
    @dataclass(frozen=True)
    class RecordedWrench(World):
        """Renders the recorded wrench, wherever the mover is."""

        tick: RecordedTick
        called: ClassVar[str] = known_as

        @property
        def name(self) -> str:
            """That of the world which it stands in for."""
            return self.called

        def wrench(self, state: State) -> Array:
            """(6,) as recorded [N, N·m]."""
            return self.tick.render()

        def render_contacts(self, state: State) -> tuple[Array, Array]:
            """(6,) and (n, 8) as recorded."""
            return self.tick.render(), self.tick.contacts

    return _KINDS.setdefault((known_as, False), RecordedWrench)


def _dynamic_kind(known_as: str) -> Any:
    """The class of the stand-ins with memory for worlds of that name."""
    if (known_as, True) in _KINDS:
        return _KINDS[known_as, True]

    @final
    @dataclass(frozen=True)
    class RecordedMemory(DynamicWorld):
        """Renders the recorded wrench, and remembers what the recorded world did."""

        tick: RecordedTick
        numbers: tuple[MemoryField, ...]
        says_energy: bool | None
        called: ClassVar[str] = known_as

        @property
        def name(self) -> str:
            """That of the world which it stands in for."""
            return self.called

        @property
        def memory_fields(self) -> tuple[MemoryField, ...]:
            """As the recording notes them."""
            return self.numbers

        @property
        def stores_energy(self) -> bool:
            """As the recording notes it."""
            usual = any(field.name == "energy" for field in self.numbers)
            return usual if self.says_energy is None else bool(self.says_energy)

        def advance(self, memory: Records, state: State, dt: float) -> Array:
            """(6,) as recorded [N, N·m]; `memory` (1,) becomes what was recorded. dt [s] is not looked at."""
            self.tick.remember(memory)
            return self.tick.render()

    return _KINDS.setdefault((known_as, True), RecordedMemory)
