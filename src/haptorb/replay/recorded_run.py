"""Reconstructs the chain of a recording from its metadata: device, calibration, estimator, worlds."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, final

import numpy as np

from haptorb import worlds
from haptorb.arrays import Array, Records, whole_number
from haptorb.control.trip_reasons import CoilState
from haptorb.devices.base import Device, DeviceText, State
from haptorb.devices.loader import catalogue, load, parse
from haptorb.errors import DriverError, HaptorbError, InputError, RecordingError
from haptorb.estimation.registry import list_estimators
from haptorb.estimation.types import Pose, Sample
from haptorb.recording.destination import describe_machine, list_versions
from haptorb.recording.recording import Recording
from haptorb.runtime.assembly import make_tick
from haptorb.runtime.config import RunConfig, find_number, read_object
from haptorb.runtime.drivers.base import Driver
from haptorb.runtime.tick import Tick
from haptorb.runtime.tick_log import TickFailure
from haptorb.runtime.world_requests import description
from haptorb.worlds.base import World, check_part, parameters
from haptorb.worlds.client_force import Remote, join_remote, split_remote
from haptorb.worlds.dynamic import CLIENT_FORCE, BoundWorld, DynamicWorld, MemoryField
from haptorb.worlds.user_world import find_world_file, load_noted_world

__all__ = [
    "PlayedBudget",
    "PlayedDriver",
    "RecordedRun",
    "RecordedTick",
    "WorldFailed",
    "list_memory_fields",
    "make_recorded_world",
]


@final
class RecordedRun:
    """Device, estimator, model and worlds of `recording`, reconstructed from its metadata.

    device    from the device file in the recording, else from the catalogue
    rate      rate of the loop [Hz]
    remarks   what could not be reconstructed, and what replaces it

    Raises RecordingError if the device or the rate cannot be determined.
    """

    def __init__(self, recording: Recording) -> None:
        self.remarks: list[str] = []
        self._path, self._notes = recording.path, recording.metadata
        self._run: Mapping[str, str] = self._notes.get("run", {})
        self.device: Device = self._load_device()
        self.rate = find_number(self._run, "rate_hz") or self._measure_rate(recording)
        estimator, known = self._run.get("estimator", ""), tuple(list_estimators(self.device))
        self.estimator: str = estimator if estimator in known else known[0]
        if estimator not in ("", self.estimator):
            self.remarks.append(f"estimator '{estimator[:60]}' is unknown to this version; '{self.estimator}' is used")
        self.model: str | None = self._run.get("model") or None
        self.device = self.device.with_recorded_models(tuple(self._run.get("models", "").split()))
        if self.model == "exact" and "point-coils" in self.device.models and "exact" not in self.device.models:
            self.model = "point-coils"
        if self.model is not None and self.model not in self.device.models:
            self.remarks.append(f"model '{self.model}' is unknown to this version; '{self.device.models[0]}' is used")
            self.model = None
        self._descriptions = self._read_descriptions(recording)
        self._made = read_object(self._run, "worlds")
        self._worlds: dict[int, World] = {}
        self._known: dict[str, World | InputError] = {}  # by name, as in `_made`: made once, or impossible
        self.code: dict[str, str] = {}  #: world → file and name of the user's code that is run for it

    @property
    def software(self) -> Mapping[str, str]:
        """Software versions and processor that the recording states."""
        return {**self._notes.get("versions", {}), **self._notes.get("machine", {})}

    @property
    def same_software(self) -> bool:
        """Whether the recording was made with the software versions and processor of this computer."""
        return self.software == {**list_versions(), **describe_machine()}

    def describe_software(self) -> str:
        """Versions and processor that differ from this computer: "haptorb 0.9 (here 1.0)"."""
        made, here = self.software, {**list_versions(), **describe_machine()}
        apart = [name for name in here if made.get(name) != here[name]]
        if not any(name in made for name in apart):
            return "another version of unknown number"
        return ", ".join(f"{name} {made.get(name, 'unknown')} (here {here[name]})" for name in apart)

    def make_tick(
        self, world: World, driver: Driver, rate: float, estimator: str | None = None, model: str | None = None
    ) -> Tick:
        """Make the recorded chain with `driver` at `rate` [Hz]; `estimator` and `model` override the recorded ones.

        Raises what `RunConfig.from_notes` and `make_tick` of the assembly raise.
        """
        # The poses and the coupling of a scene are recorded: a frame or hand that cannot be read prevents no replay.
        noted = {key: text for key, text in self._run.items() if key not in ("frame", "coupling")}
        config = RunConfig.from_notes(self.device, world, noted, str(self._path))
        return make_tick(
            replace(
                config,
                tracker="pointer",  # no tracker is opened
                rate=rate,
                model=model or self.model,
                estimator=estimator or self.estimator,
                learned=config.learned if estimator in (None, self.estimator) else b"",
            ),
            driver,
        )

    def describe_world(self, change: int) -> str:
        """Recorded description of the world after `change` changes; empty if the recording has none."""
        return self._descriptions.get(change, "")

    def world(self, change: int) -> World:
        """Reconstruct the world after `change` changes. Raises InputError with the reason if this is impossible."""
        if change not in self._worlds:
            self._worlds[change] = self._make_world(change)
        return self._worlds[change]

    def remote(self, change: int) -> Remote | None:
        """Client force added to the world after `change` changes; None if there was none."""
        try:
            values = json.loads(self.describe_world(change)).get("remote")
        except (ValueError, AttributeError, RecursionError):
            return None
        if values is None:
            return None
        remote = Remote()
        return remote.replace(**values) if isinstance(values, dict) else remote

    def _make_world(self, change: int) -> World:
        text = self.describe_world(change)
        try:
            note = json.loads(text)
            name, values = str(note["name"]), dict(note.get("values", {}))
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as cause:
            raise InputError("the recording does not state the world") from cause
        if name in self._made:
            world = self._load_noted_world(name)
            if found := find_world_file(world):
                self.code[name] = f"{found[0]} ({found[1]})"
        elif name in worlds.CATALOGUE:
            world = worlds.find_world(name)()
        else:
            raise InputError("the recording does not state its source")
        plain, _ = split_remote(world)
        world = join_remote(plain.replace(**values) if values else plain, self.remote(change))
        if json.loads(description(world)) != note:
            raise InputError("this version of haptorb describes it differently")
        return world

    def _load_noted_world(self, name: str) -> World:
        """World of the note `name`, made once however often the run changed to it."""
        if name not in self._known:
            try:
                self._known[name] = load_noted_world(str(self._made[name]))
            except InputError as cause:
                self._known[name] = cause
        known = self._known[name]
        if isinstance(known, InputError):
            raise known
        return known

    def _read_descriptions(self, recording: Recording) -> dict[int, str]:
        found = {}
        for note in recording.worlds:
            if (number := whole_number(note.get("change", ""))) is not None:
                found[number] = note.get("world", "")
        first = self._run.get("first_world", "")
        if 0 not in found and first:
            found[0] = first
        if not found:  # recording of an earlier version
            found[0] = json.dumps({"name": self.device.kind.world, "values": {}})
        return found

    def _measure_rate(self, recording: Recording) -> float:
        steps = np.diff(recording["t"][:1000])
        steps = steps[steps > 0]
        if not len(steps):
            raise RecordingError(f"{self._path} cannot be replayed: it does not state its rate")
        return float(1.0 / np.median(steps))

    def _load_device(self) -> Device:
        noted = self._notes.get("device", {})
        text, name, digest = DeviceText.from_note(noted), noted.get("name", ""), noted.get("digest", "")
        try:
            if text:
                # it ran when it was recorded, even if today's checks reject it
                device = parse(text.own, f"the device in {self._path}", bases=text.bases, override=True)
            elif name in catalogue():
                device = load(name)
            else:
                raise RecordingError(f"{self._path} cannot be replayed: it does not contain the device file")
        except RecordingError:
            raise
        except HaptorbError as cause:
            raise RecordingError(f"{self._path} cannot be replayed: {cause}") from cause
        if device.digest != digest:
            self.remarks.append(f"device '{name}' is not the one of the recording: its file has changed since")
        return device


# --------------------------------------------------------------------------------------------------
# A world that renders the recorded output of another one: its wrench, contacts, memory, and failures.


_RECORDED_WORLD_FAILED = int(TickFailure.WORLD)
_DETAIL = TickFailure.LESS_DETAIL | TickFailure.MORE_DETAIL


class WorldFailed(HaptorbError):
    """The recorded world failed in this tick."""


@final
class RecordedTick:
    """Recorded outputs of the world in the tick being replayed, from a block of ticks.

    room   values of a world's memory in one recorded row
    whole  whether the outputs of the block are loaded, or only failures
    """

    def __init__(self, room: int) -> None:
        self._wrench: list[Array] = []
        self._contacts: list[Array] = []
        self._memory: list[Array] = []
        self._failures: list[int] = []
        self._client: dict[str, slice | int] = {}
        self._at = 0
        self.room, self.whole = room, False

    def load(self, block: Mapping[str, Array], *, whole: bool) -> None:
        """Load the next ticks: field → (n, width), each in its unit [SI]; only failures unless `whole` is set."""
        n = len(block["t"])
        failures = np.nan_to_num(block["failures"][:, 0], posinf=0.0, neginf=0.0)
        self._failures = np.clip(failures, 0.0, _MAX_FAILURE_CODE).astype(int).tolist()
        self._at, self.whole = 0, whole
        if not whole:
            return
        nothing = np.full((n, 6), np.nan)
        asked = block.get("object_wrench", block.get("wrench_commanded", nothing))
        self._wrench = list(np.nan_to_num(np.ascontiguousarray(asked)))
        hooks = block.get("contacts")
        self._contacts = (
            [np.zeros((0, 8))] * n
            if hooks is None or not hooks.shape[1]
            else list(np.ascontiguousarray(hooks).reshape(n, -1, 8))
        )
        self._memory = list(np.ascontiguousarray(block.get("memory", np.empty((n, 0)))))

    def select(self, number: int) -> None:
        """Select tick `number` of the block, counted from 0."""
        self._at = number

    @property
    def detail_change(self) -> TickFailure:
        """Change of the recorded world's level of detail: LESS_DETAIL, MORE_DETAIL or 0."""
        return TickFailure(self._failures[self._at]) & _DETAIL

    @property
    def took_over(self) -> bool:
        """Whether the recorded world applied a result that was computed in the background."""
        return bool(self._failures[self._at] & TickFailure.WORK)

    def render(self) -> Array:
        """Return (6,) the recorded wrench on the mover [N, N·m]. Raises WorldFailed if the recorded world failed."""
        if self._failures[self._at] & _RECORDED_WORLD_FAILED:
            raise WorldFailed("the world failed in the recording")
        return self._wrench[self._at]

    @property
    def contacts(self) -> Array:
        """Contacts (n, 8), as in a row [m, N]."""
        return self._contacts[self._at]

    def has_room(self, fields: Sequence[MemoryField]) -> bool:
        """Whether the recorded rows have room for a memory with these `fields`."""
        return sum(field.size for field in fields) <= self.room

    def find_client(self, fields: Sequence[MemoryField], recording: Recording) -> None:
        """Find the client's command in a memory with these `fields`: that of the world `remote`, alone or in a
        sum. Raises RecordingError if the rows of `recording` are too narrow for it."""
        start = end = 0
        self._client = {}
        for field in fields:
            for name in CLIENT_FORCE.names or ():
                if field.name in (name, f"remote_{name}"):
                    self._client[name] = slice(start, start + field.size) if field.shape else start
                    end = start + field.size
            start += field.size
        if end > self.room:
            text = (
                f"{recording.path} cannot be replayed: the clients' commands end at number {end} of the memory of "
                f"the world, but the field 'memory' has only {self.room} numbers; replay the recorded wrench instead"
            )
            raise RecordingError(f"{text} with recorded_world=True", command=f"{text} with --world recorded")

    def fill_client(self, client: Records) -> None:
        """Fill `client` (1,) CLIENT_FORCE [N, s] with the client's recorded command."""
        memory = self._memory[self._at]
        for name, place in self._client.items():
            client[name] = memory[place]
        if client["mapping"][0] != client["mapping"][0]:  # a recording of a version without this field
            client["mapping"] = 0.0

    def remember(self, memory: Records) -> None:
        """Fill `memory` (1,), in the units of its fields, with the recorded world's memory after its step."""
        numbers, recorded = memory.view(np.float64), self._memory[self._at]
        numbers[: len(recorded)] = recorded[: len(numbers)]


@final
class PlayedBudget:
    """Reduces and restores the level of detail in the same ticks as the recorded run."""

    def __init__(self, tick: RecordedTick) -> None:
        self._tick = tick

    def begin(self, bound: BoundWorld) -> None:
        """Apply the background step in the tick in which the recorded run applied it; it is computed here."""
        if self._tick.took_over and (work := bound.world.find_work(bound.memory)) is not None:
            bound.world.take_over(bound.memory, work.compute())

    def end(self, bound: BoundWorld) -> TickFailure:
        """Change the level of detail as the recorded run did after its step."""
        change = self._tick.detail_change
        if change & TickFailure.LESS_DETAIL:
            bound.world.lighten(bound.memory)
        elif change & TickFailure.MORE_DETAIL:
            bound.world.restore(bound.memory)
        return change | (TickFailure.WORK if self._tick.took_over else TickFailure(0))


def make_recorded_world(description: str, tick: RecordedTick) -> World:
    """Create a substitute for the world of `description`, of a separate class for each name.

    A change between two worlds of one name remains a change of values.
    """
    note = _parse(description)
    name, fields = str(note.get("name", "recorded")), _memory_fields(note)
    kind = _dynamic_kind(name) if fields else _still_kind(name)
    asks = check_part(str(note["asks"])) if note.get("asks") else None
    remote = _find_remote(note) if tick.has_room(fields) else None
    world: World = kind(tick, fields, note.get("stores_energy"), remote) if fields else kind(tick)
    object.__setattr__(world, "passive", note.get("passive", True) is not False)
    object.__setattr__(world, "asks", asks)
    return world


def _find_remote(note: Mapping[str, Any]) -> Remote | None:
    """Client force of the world of `note`, alone or in a sum, with its recorded limit; None without clients."""
    values = note.get("values") if note.get("name") == "remote" else note.get("remote")
    if not isinstance(values, Mapping):
        return None
    return Remote(**{name: values[name] for name in parameters(Remote) if name in values})


def _parse(description: str) -> dict[str, Any]:
    try:
        note = json.loads(description)
    except (ValueError, RecursionError):
        note = None
    return note if isinstance(note, dict) else {}


def list_memory_fields(description: str) -> tuple[MemoryField, ...]:
    """Fields of the memory of the world of `description`; empty if it states none."""
    return _memory_fields(_parse(description))


def _memory_fields(note: Mapping[str, Any]) -> tuple[MemoryField, ...]:
    try:
        found = tuple(
            MemoryField(str(one["name"]), str(one["unit"]), str(one["about"]), tuple(int(n) for n in one["shape"]))
            for one in note.get("memory", ())
        )
    except (KeyError, TypeError, ValueError, OverflowError):
        return ()
    too_long = any(n < 0 for one in found for n in one.shape) or sum(one.size for one in found) > _MAX_MEMORY_NUMBERS
    return () if too_long else found  # safety: memory-length


_MAX_MEMORY_NUMBERS = 1_000_000  #: limit of the numbers of a memory, far above the room of a row
_KINDS: dict[tuple[str, bool], Any] = {}


def _still_kind(known_as: str) -> Any:
    """Class of the substitutes without memory for worlds of that name."""
    if (known_as, False) in _KINDS:
        return _KINDS[known_as, False]

    @final
    @dataclass(frozen=True)
    class RecordedWrench(World):
        """Renders the recorded wrench, at any pose of the mover."""

        tick: RecordedTick
        called: ClassVar[str] = known_as

        @property
        def name(self) -> str:
            """Name of the world that it replaces."""
            return self.called

        def wrench(self, state: State) -> Array:
            """Recorded wrench (6,) [N, N·m]."""
            return self.tick.render()

        def render_contacts(self, state: State) -> tuple[Array, Array]:
            """Recorded wrench (6,) and contacts (n, 8)."""
            return self.tick.render(), self.tick.contacts

    return _KINDS.setdefault((known_as, False), RecordedWrench)


def _dynamic_kind(known_as: str) -> Any:
    """Class of the substitutes with memory for worlds of that name."""
    if (known_as, True) in _KINDS:
        return _KINDS[known_as, True]

    @final
    @dataclass(frozen=True)
    class RecordedMemory(DynamicWorld):
        """Renders the recorded wrench, with the recorded world's memory."""

        tick: RecordedTick
        numbers: tuple[MemoryField, ...]
        recorded_stores_energy: bool | None
        remote: Remote | None
        called: ClassVar[str] = known_as

        @property
        def name(self) -> str:
            """Name of the world that it replaces."""
            return self.called

        @property
        def memory_fields(self) -> tuple[MemoryField, ...]:
            """Fields stated in the recording."""
            return self.numbers

        @property
        def stores_energy(self) -> bool:
            """Whether the recorded world stores energy, as stated in the recording."""
            usual = any(field.name == "energy" for field in self.numbers)
            return usual if self.recorded_stores_energy is None else bool(self.recorded_stores_energy)

        @property
        def takes_commands(self) -> bool:  # type: ignore[override]  # the recorded world did, or did not
            """Whether a part of the recorded wrench was commanded by a client."""
            return self.remote is not None

        def take_command(self, memory: Records, client: Records) -> None:
            """Ignore the command: it is contained in the recorded memory."""

        def advance(self, memory: Records, state: State, dt: float) -> Array:
            """Return the recorded wrench (6,) [N, N·m] and fill `memory` (1,) as recorded; dt [s] is ignored."""
            self.tick.remember(memory)
            return self.tick.render()

        def advance_with_client(self, memory: Records, state: State, dt: float, commanded: Array) -> Array:
            """Return the recorded wrench (6,) [N, N·m]; the client's part of it is added to `commanded` (6,)."""
            wrench = self.advance(memory, state, dt)
            if self.remote is not None:
                commanded += self.remote.advance(self._remote_memory(memory), state, dt)
            return wrench

        def gripper_force(self, memory: Records) -> float:
            """Recorded force of the gripper [N]."""
            return 0.0 if self.remote is None else self.remote.gripper_force(self._remote_memory(memory))

        def _remote_memory(self, memory: Records) -> Records:
            """Part (1,) of `memory` that belongs to the client force."""
            assert self.remote is not None
            part = self.remote.begin()
            for name in part.dtype.names or ():
                for known in (name, f"remote_{name}"):
                    if known in (memory.dtype.names or ()):
                        part[name] = memory[known]
            return part

    return _KINDS.setdefault((known_as, True), RecordedMemory)


# --------------------------------------------------------------------------------------------------
# Driver that returns recorded samples and results, tick by tick.


_READ, _WRITE, _ENGAGE = int(TickFailure.READ), int(TickFailure.WRITE), int(TickFailure.ENGAGE)
_MAX_FAILURE_CODE = 2.0**31  #: exclusive upper bound of the sum of all failure flags
_PLAYED_DRIVER_FAILED = "the driver failed in the recording"


@final
class PlayedDriver(Driver):
    """Driver that returns the recorded values of the tick that `select` chose in the block of the last `load`."""

    name, simulated = "played", True

    def __init__(self, sensors: int) -> None:
        self._sensors = sensors
        self._samples: list[Sample] = []
        self._duties: list[Array] = []
        self._wrenches_actual: list[Array] = []
        self._hand_goals: list[Array] = []
        self._coils: list[CoilState] = []
        self._failures: list[int] = []
        self._at = 0

    def load(self, block: Mapping[str, Array], t: Array) -> None:
        """Load the next ticks: field → (n, width), each in its unit [SI], at the times `t` (n,) [s] of the replay."""
        sensors = self._sensors
        n = len(t)

        def rows(name: str) -> Array:
            return np.ascontiguousarray(block[name], dtype=np.float64)

        R = rows("pose_r").reshape(n, 3, 3)
        field = rows("field").reshape(n, sensors, 3) if sensors and "field" in block else np.zeros((n, sensors, 3))
        with np.errstate(invalid="ignore"):  # in a damaged file
            waited = t - block["t"][:, 0]  # 0, unless the replay has another rate
        ages = rows("current_age")[:, 0] + waited, rows("field_age")[:, 0] + waited
        none = np.full((n, 1), np.nan)  # a recording of a version without grippers
        grips = (np.asarray(block.get(name, none))[:, 0].tolist() for name in ("gripper", "gripper_v"))
        poses = map(
            Pose, block["pose_t"][:, 0].tolist(), R, rows("pose_p"), rows("pose_w"), rows("pose_v"),
            (block["pose_valid"][:, 0] == 1.0).tolist(),
        )  # fmt: skip
        others = (*(age.tolist() for age in ages), *grips)
        self._samples = list(map(Sample, t.tolist(), rows("current_measured"), rows("boundary"), field, poses, *others))
        self._duties = list(rows("duty_applied"))
        self._wrenches_actual = list(rows("wrench_actual"))
        self._hand_goals = list(np.concatenate((rows("hand_goal"), rows("hand_goal_q")), axis=1))
        codes = block["coil_state"][:, 0].tolist()
        states = {code: _coil_state(code) for code in set(codes)}
        self._coils = [states[code] for code in codes]
        failures = np.nan_to_num(block["failures"][:, 0], posinf=0.0, neginf=0.0)
        self._failures = np.clip(failures, 0.0, _MAX_FAILURE_CODE).astype(int).tolist()
        self._at = 0

    def select(self, number: int) -> None:
        """Select tick `number` of the block, counted from 0."""
        self._at = number

    def open(self) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""

    def read(self, now: float) -> Sample:
        """Return the recorded sample of the tick. Raises DriverError if the recorded driver did."""
        if self._failures[self._at] & _READ:
            raise DriverError(_PLAYED_DRIVER_FAILED)
        return self._samples[self._at]

    def write(self, duties: Array) -> Array:
        """Return the recorded applied duties (m,) [1]. Raises DriverError if the recorded driver did."""
        if self._failures[self._at] & _WRITE:
            raise DriverError(_PLAYED_DRIVER_FAILED)
        return self._duties[self._at]

    def write_grip_force(self, force: float) -> float:
        """Return `force` [N]: the recorded driver applied the force commanded by the chain."""
        return force

    def engage(self) -> None:
        """Raise DriverError if the recorded driver did."""
        if self._failures[self._at] & _ENGAGE:
            raise DriverError(_PLAYED_DRIVER_FAILED)

    @property
    def coil_state(self) -> CoilState:
        """Recorded state of the coils."""
        return self._coils[self._at]

    def wrench_actual(self) -> Array:
        """Actual wrench (6,) recorded by the driver [N, N·m]; NaN if unknown."""
        return self._wrenches_actual[self._at]

    def hand_goal(self) -> Array:
        """Recorded goal (7,) of the hand: position [m] and quaternion."""
        return self._hand_goals[self._at]


def _coil_state(code: float) -> CoilState:
    try:
        return CoilState(int(code))
    except (ValueError, OverflowError):
        return CoilState.UNKNOWN
