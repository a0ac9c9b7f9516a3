"""Replay of a recording: passes the recorded samples through the same `Tick`, and compares every value."""

from __future__ import annotations

import gc
import re
from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from typing import final

import numpy as np
from numpy.typing import NDArray

from haptorb.arrays import Array, StateArray, record
from haptorb.control.linkage import MODES
from haptorb.errors import HaptorbError, InputError, RecordingError
from haptorb.files import replace_file
from haptorb.recording.export import units_of
from haptorb.recording.mcap import Recorder
from haptorb.recording.recording import Recording
from haptorb.recording.row import Field, RowLayout
from haptorb.recording.state_notes import LAYOUT_NOTE, STATE_NOTE, unpack_arrays
from haptorb.replay.recorded_run import (
    PlayedBudget,
    PlayedDriver,
    RecordedRun,
    RecordedTick,
    list_memory_fields,
    make_recorded_world,
)
from haptorb.replay.rows import PlayedRows
from haptorb.runtime.clock import check_rate
from haptorb.runtime.tick import Tick
from haptorb.runtime.tick_log import MODEL, NO_TICK, TickCommand, find_model
from haptorb.runtime.tick_state import load_state
from haptorb.runtime.world_requests import description, name_of
from haptorb.worlds.base import World
from haptorb.worlds.client_force import join_remote
from haptorb.worlds.dynamic import DynamicWorld

__all__ = [
    "CLOCK_FIELDS",
    "Difference",
    "FieldBound",
    "KeptStates",
    "Replay",
    "ReplayFile",
    "RunComparison",
    "Timetable",
    "are_same",
    "check_replay_file",
    "choose_beginnings",
    "find_gaps",
    "list_gaps",
    "play_commands",
    "without_collection",
    "write_replay",
]


# --------------------------------------------------------------------------------------------------
# Comparison of two runs of the same ticks, bit by bit: first difference, and size of the differences.


#: fields from the computer's clock and the tool's buttons, which the chain does not compute
CLOCK_FIELDS = frozenset({"tick", "wall", "lateness", "missed", "stages", "ahead", "buttons", "grip", "hand_t"})


@record
class Difference:
    """Difference in one number: `recorded` and `replayed` at index `number` of `field`, in its `unit`."""

    tick: int
    t: float  #: [s]
    field: str
    number: int
    unit: str
    recorded: float
    replayed: float

    @property
    def size(self) -> float:
        """Size of the difference, in the field's unit."""
        return abs(self.replayed - self.recorded)


@record
class FieldBound:
    """Differences in a field: number of ticks, `largest` difference, and `greatest` recorded value.

    largest   in the field's unit; NaN: one of the two values is NaN
    """

    field: str
    unit: str
    ticks: int
    first: int
    largest: float
    greatest: float


@final
class RunComparison:
    """Collects blocks of recorded and replayed rows of `fields`.

    compared   number of compared ticks
    differing  number of ticks with a difference
    first      first difference; None: there is none
    """

    def __init__(self, fields: tuple[Field, ...], left_out: frozenset[str] = frozenset()) -> None:
        looked_at = [field for field in fields if field.name not in CLOCK_FIELDS | left_out]
        self._units = {field.name: field.unit for field in looked_at}
        self._unit_of = {field.name: units_of(field) for field in looked_at}
        self._width = sum(field.width for field in looked_at)
        self._bounds: dict[str, FieldBound] = {}
        self.compared = self.differing = self.numbers = 0
        self.first: Difference | None = None

    @property
    def identical(self) -> bool:
        """Whether every number of every tick is the same, bit for bit."""
        return self.first is None

    @property
    def bounds(self) -> tuple[FieldBound, ...]:
        """Bounds of the differing fields, ordered by their first difference."""
        return tuple(sorted(self._bounds.values(), key=lambda one: one.first))

    def add(self, recorded: Mapping[str, Array], replayed: Mapping[str, Array], ticks: Array, t: Array) -> None:
        """Add a block: field → (n, width) in the field's unit [SI], its `ticks` (n,) and their times t (n,) [s]."""
        n = len(ticks)
        any_differs = np.zeros(n, dtype=np.bool_)
        found: list[tuple[int, str, Array]] = []
        for name in self._units:
            a, b = recorded.get(name), replayed.get(name)
            if a is None or b is None or a.shape != b.shape or not a.shape[1]:
                continue
            self.numbers += a.size
            if np.array_equal(_bits(a), _bits(b)):
                continue
            differs = (_bits(a) != _bits(b)) & ~(np.isnan(a) & np.isnan(b))
            rows = differs.any(axis=1)
            if not rows.any():
                continue
            any_differs |= rows
            found.append((int(np.argmax(rows)), name, differs))
            self._widen(name, a, b, rows, ticks)
        if found and self.first is None:
            at = min(row for row, _, _ in found)
            name, differs = next((name, differs) for row, name, differs in found if row == at)
            number = int(np.argmax(differs[at]))
            self.first = Difference(
                int(ticks[at]), float(t[at]), name, number, self._unit_of[name][number],
                float(recorded[name][at, number]), float(replayed[name][at, number]),
            )  # fmt: skip
        self.compared += n
        self.differing += int(any_differs.sum())

    def add_same(self, n: int) -> None:
        """Add a block of `n` ticks that `are_same` has found identical."""
        self.numbers, self.compared = self.numbers + n * self._width, self.compared + n

    def merge(self, later: RunComparison) -> None:
        """Merge the result `later` of the following ticks."""
        self.first = self.first or later.first
        self.compared, self.differing = self.compared + later.compared, self.differing + later.differing
        self.numbers += later.numbers
        for name, one in later._bounds.items():
            before = self._bounds.get(name)
            self._bounds[name] = one if before is None else _comparison_join(before, one)

    def _widen(self, name: str, a: Array, b: Array, rows: Array, ticks: Array) -> None:
        with np.errstate(invalid="ignore", over="ignore"):
            apart = np.abs(a - b)
        largest = float(np.nanmax(apart)) if np.isfinite(apart).any() else float("nan")
        finite = np.abs(a[np.isfinite(a)])
        greatest = float(finite.max()) if finite.size else float("nan")
        first = int(ticks[int(np.argmax(rows))])
        found = FieldBound(name, self._units[name], int(rows.sum()), first, largest, greatest)
        before = self._bounds.get(name)
        self._bounds[name] = found if before is None else _comparison_join(before, found)


def are_same(recorded: Array, replayed: Array) -> bool:
    """Whether rows (n, width) are identical bit for bit, each number in the unit [..] of its field: much faster than a
    comparison field by field."""
    return np.array_equal(recorded.view(np.uint64), replayed.view(np.uint64))


def _comparison_join(before: FieldBound, after: FieldBound) -> FieldBound:
    return FieldBound(
        before.field, before.unit, before.ticks + after.ticks, before.first,
        float(np.fmax(before.largest, after.largest)), float(np.fmax(before.greatest, after.greatest)),
    )  # fmt: skip


def _bits(values: Array) -> Array:
    bits: Array = np.ascontiguousarray(values).view(np.uint64)
    return bits


# --------------------------------------------------------------------------------------------------
# Timetable of a replay: the recorded tick, time and commands of each replayed tick.


_TIMETABLE_MODES = int(TickCommand.TRANSLATE | TickCommand.ROTATE)
_TIMETABLE_CLUTCH = int(TickCommand.HOLD | TickCommand.RELEASE)
_TIME_TOLERANCE_S = 1e-7  #: tolerance between two equal times [s]


@final
class Timetable:
    """Timetable for recorded ticks at `t` (n,) [s] with `commands` (n,): unchanged, or at another `rate` [Hz].

    At another rate every tick uses the newest sample available at its time, with the corresponding age; a command takes
    effect in the first tick after it.

    index     (k,) of the recorded tick
    t         (k,) time at which it is replayed [s]
    commands  (k,) all commands since the previous tick
    """

    def __init__(self, t: Array, commands: Array, rate: float | None = None) -> None:
        if rate is None:
            self.index, self.t, self.commands = np.arange(len(t)), t, commands
            return
        live = commands != NO_TICK
        last = int(np.flatnonzero(live)[-1]) if live.any() else 0
        count = int(np.floor((t[last] - t[0]) * rate + _TIME_TOLERANCE_S)) + 1
        self.t = t[0] + np.arange(count) / rate
        self.index = np.clip(np.searchsorted(t[: last + 1], self.t + _TIME_TOLERANCE_S, side="right") - 1, 0, last)
        before = np.concatenate(([-1], self.index[:-1]))
        self.commands = np.zeros(count)
        given = np.flatnonzero(np.nan_to_num(commands[: last + 1]) > 0.0)
        for at in given.tolist():
            tick = int(np.searchsorted(self.index, at))
            if tick < count and before[tick] < at:
                self.commands[tick] = _timetable_join(int(self.commands[tick]), int(commands[at]))

    def cut(self, first: int, last: int) -> Timetable:
        """Timetable of the ticks from `first` up to `last`."""
        part = Timetable(self.t[:1], self.commands[:1])
        part.index = self.index[first:last].copy()
        part.t, part.commands = self.t[first:last].copy(), self.commands[first:last].copy()
        return part

    def __len__(self) -> int:
        return len(self.index)


def _timetable_join(first: int, then: int) -> int:
    """Merge two sets of commands; of two modes, models or clutch commands the later one applies.

    >>> _timetable_join(int(TickCommand.TRANSLATE), int(TickCommand.ROTATE)) == TickCommand.ROTATE
    True
    """
    flags, model = first % MODEL, first // MODEL
    for group in (_TIMETABLE_MODES, _TIMETABLE_CLUTCH):
        if then & group:
            flags &= ~group
    return (flags | then % MODEL) + MODEL * (then // MODEL or model)


# --------------------------------------------------------------------------------------------------
# Suspension of Python's garbage collector during a long computation.


@contextmanager
def without_collection() -> Iterator[None]:
    """Suspend garbage collection: every block creates thousands of samples, and the collector would visit each."""
    collected = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collected:
            gc.enable()


# --------------------------------------------------------------------------------------------------
# Recorded states of the chain, from which a replay may start.


_LONGEST_TICK = re.compile(r"[0-9]{1,15}")


@final
class KeptStates:
    """States of the chain in `recording`, read on demand.

    older  whether there are pickled states of an older version, which are not read
    """

    def __init__(self, recording: Recording) -> None:
        self._layout, self._texts, self.older = "", dict[float, str](), False
        for name, values in recording.notes:
            if name == f"haptorb/{LAYOUT_NOTE}":
                self._layout = values.get("arrays", "")
            elif name == f"haptorb/{STATE_NOTE}" and _LONGEST_TICK.fullmatch(tick := values.get("tick", "")):
                if "arrays" in values:
                    self._texts[float(tick)] = values["arrays"]
                else:
                    self.older = True

    def __contains__(self, tick: float) -> bool:
        return tick in self._texts

    def __iter__(self) -> Iterator[float]:
        return iter(self._texts)

    def read(self, tick: float) -> Mapping[str, StateArray]:
        """Return name → array of the state after `tick`, each number in its own unit. Raises RecordingError if it is
        invalid."""
        return unpack_arrays(self._layout, self._texts[tick])


def choose_beginnings(recording: Recording, parts: int) -> list[int]:
    """Rows with a stored state that divide `recording` into at most that many parts of similar length [1].

    The first is 0.
    """
    ticks, count, states = recording["tick"], len(recording), sorted(KeptStates(recording))
    found = {0}
    for number in range(1, parts):
        wanted = number * count // parts
        at = bisect_left(states, float(ticks[wanted]))
        near = states[max(at - 2, 0) : at + 2]
        rows = [bisect_left(range(count), tick, key=lambda row: float(ticks[row])) for tick in near]
        places = [row for row, tick in zip(rows, near, strict=True) if 0 < row < count - 1 and ticks[row] == tick]
        found.update(sorted(places, key=lambda row: abs(row - wanted))[:1])
    return sorted(found)


def list_gaps(ticks: Array) -> NDArray[np.intp]:
    """Rows of `ticks` (n,) [1] that are followed by missing rows."""
    with np.errstate(invalid="ignore"):  # in a damaged file
        return np.flatnonzero(np.diff(ticks) != 1)


def find_gaps(ticks: Array, states: Iterable[float]) -> tuple[NDArray[np.bool_], set[int]]:
    """Mask (n,) [1] of the rows of `ticks` (n,) at which the chain's state is unknown, after lost ticks; and the rows,
    with one of the stored `states`, at which it is known again."""
    blind, resume = np.zeros(len(ticks), dtype=np.bool_), set[int]()
    at_ticks = np.array(sorted(states))
    at = np.searchsorted(ticks, at_ticks)
    there = at < len(ticks)
    rows = at[there][ticks[at[there]] == at_ticks[there]]
    for gap in list_gaps(ticks).tolist():
        later = rows[rows > gap]
        end = int(later[0]) if len(later) else len(ticks) - 1
        blind[gap + 1 : end + 1] = True
        if len(later):
            resume.add(end)
    return blind, resume


# --------------------------------------------------------------------------------------------------
# Replay of the commands before a tick, in the loop's order.


_EXCUSE, _STOP, _ENGAGE, _SCALE, _COOL = map(
    int, (TickCommand.EXCUSE, TickCommand.STOP, TickCommand.ENGAGE, TickCommand.SCALE, TickCommand.COOL)
)
_PLAYED_COMMANDS_MODES = tuple(zip((int(TickCommand.TRANSLATE), int(TickCommand.ROTATE)), MODES, strict=True))
_PLAYED_COMMANDS_CLUTCH = ((int(TickCommand.HOLD), True), (int(TickCommand.RELEASE), False))


def play_commands(tick: Tick, commands: int, scale: float) -> None:
    """Pass the sum `commands` of a row to `tick`, except those of its world; scale: of a motor's torques, if known
    [1]."""
    if commands & _EXCUSE:
        tick.exclude_next_lateness()
    if commands & _STOP:
        tick.stop()
    if commands & _ENGAGE:
        tick.engage()
    for flag, mode in _PLAYED_COMMANDS_MODES:
        if commands & flag:
            tick.joining.set_mode(mode)
    if (model := find_model(commands)) >= 0:
        with suppress(InputError):  # another estimator, with one model only
            tick.change_model(model)
    if commands & _SCALE:
        tick.joining.set_torque_scale(scale)
    if commands & _COOL:
        tick.cool()
    for flag, engaged in _PLAYED_COMMANDS_CLUTCH:
        if commands & flag:
            tick.joining.set_clutch(engaged)


# --------------------------------------------------------------------------------------------------
# Recording of a replay: metadata of the recorded run, and the replaced parts.


_OWN = frozenset(
    {
        "haptorb/layout",
        "haptorb/clock",
        "haptorb/end",
        "haptorb/gap",
        "haptorb/pause",
        "haptorb/resume",
        "haptorb/world",
        "haptorb/run",
    }
)

_STATES = frozenset({f"haptorb/{LAYOUT_NOTE}", f"haptorb/{STATE_NOTE}"})  #: of the recorded run only


def check_replay_file(path: Path, *, overwrite: bool) -> Path:
    """Return `path` if a recording can be written to it. RecordingError if it exists and `overwrite` is not set."""
    if path.exists() and not overwrite:
        text = f"{path} exists; choose another name, or replace it"
        raise RecordingError(f"{text} with overwrite=True", command=f"{text} with --force")
    if path.is_dir() or not path.parent.is_dir():
        raise RecordingError(f"cannot write {path}: name a file in a folder that exists")
    return path


@final
class ReplayFile:
    """Writes rows of `layout` to the open `recorder`, with the notes of `recording` and those of the replay."""

    def __init__(
        self, recorder: Recorder, recording: Recording, rate: float, replaced: Mapping[str, str], world: str
    ) -> None:
        self._recorder = recorder
        for name, values in recording.notes:
            if name not in _OWN and not (replaced and name in _STATES):
                recorder.add_metadata(name.removeprefix("haptorb/"), values)
        changes = {key: text for key, text in replaced.items() if key in ("estimator", "model")}
        changes |= {"rate_hz": repr(rate)} if "rate" in replaced else {}
        recorder.add_metadata("run", {**recording.metadata.get("run", {}), **changes})
        recorder.add_metadata("replay", {"of": recording.path.name, **replaced})
        for note in [{"change": "0", "tick": "0", "world": world}] if world else recording.worlds:
            recorder.add_metadata("world", note)

    def append(self, rows: Array) -> None:
        """Add rows (n, width), each number in its field's unit [SI]."""
        self._recorder.append(rows)

    def finish(self) -> None:
        """Write the end of the recording, which is then complete."""
        rows = str(self._recorder.written)
        self._recorder.add_metadata("end", {"rows": rows, "lost": "0", "reason": "replayed"})
        self._recorder.finish()


@contextmanager
def write_replay(
    path: Path, recording: Recording, layout: RowLayout, rate: float, replaced: Mapping[str, str], world: str = ""
) -> Iterator[ReplayFile]:
    """Open the file at `path` for rows of `layout` at `rate` [Hz]; written atomically at the end of the block.

    Raises RecordingError if it cannot be written.

    replaced  part → its substitute; world: description of the substituted world, if there is one
    """
    offset = recording.metadata.get("clock", {}).get("unix_minus_monotonic_ns", "0")
    try:
        with replace_file(path) as part, part.open("wb") as file:
            recorder = Recorder(file, layout, rate, int(offset) if offset.lstrip("-").isdecimal() else 0)
            written = ReplayFile(recorder, recording, rate, replaced, world)
            yield written
            written.finish()
    except OSError as cause:
        raise RecordingError(f"cannot write {path}: {cause.strerror or cause}") from cause


_BLOCK = 1024  #: ticks
_CHANGES = 1000  #: limit of changes of the world without a description, in all: of notes that cannot be read
_REPLACE = int(TickCommand.REPLACE)


@final
class Replay:
    """Replay of a recording, with the same or other parts; call `run` once.

    Parameters
    ----------
    recording : Recording
        Recording of the run.
    world : World, optional
        World in place of the recorded one.
    estimator : str, optional
        Name of an estimator in place of the recorded one.
    model : str, optional
        Controller model in place of the recorded one.
    rate : float, optional
        Rate of the loop in place of the recorded one [Hz].
    recorded_world : bool
        Render the recorded wrench instead of running a world.
    part : tuple of int, optional
        First row and the row after the last one of the part to replay; the recording must have the loop's state before
        the first.
    rows : PlayedRows, optional
        The rows, if they are already decoded.

    Attributes
    ----------
    comparison : RunComparison
        Recorded and replayed numbers compared, after `run`.
    replaced : dict
        Part → its substitute.
    remarks : list of str
        Differences from the recorded run.
    approximate : bool
        True: the recording lacks data for a bit-exact replay.
    seconds : float
        Duration of the run [s].

    Raises
    ------
    RecordingError
        If the recording cannot be replayed.
    InputError
        If a part does not fit the device.
    """

    def __init__(
        self,
        recording: Recording,
        *,
        world: World | None = None,
        estimator: str | None = None,
        model: str | None = None,
        rate: float | None = None,
        recorded_world: bool = False,
        part: tuple[int, int] | None = None,
        rows: PlayedRows | None = None,
    ) -> None:
        self._recording = recording
        self._rows, self.recorded = rows or PlayedRows(recording), RecordedRun(recording)
        given = {
            "world": world and name_of(world), "estimator": estimator, "model": model, "rate": rate and f"{rate:g} Hz",
        }  # fmt: skip
        self.replaced = {name: str(one) for name, one in given.items() if one}
        self.rate = self.recorded.rate if rate is None else check_rate(rate)
        self._first = part[0] if part else 0
        device = self.recorded.device
        self._driver, self._other_world, self._only_recorded = PlayedDriver(device.sensors), world, recorded_world
        self.remarks = self.recorded.remarks
        self._stand_ins: set[str] = set()
        room = next((field.width for field in recording.fields if field.name == "memory"), 0)
        self._recorded_tick = RecordedTick(room)
        self._change, self._resampled = 0, rate is not None
        self._changes_left = len(recording.worlds) + _CHANGES
        self._state: Mapping[str, StateArray] | None = None
        self._begin_late()
        self._has_clients = False
        first = self._choose_world(self._change)
        self.tick = self.recorded.make_tick(first, self._driver, self.rate, estimator, model)
        self.tick.world_changes = self._change
        # All rows are needed only now: the chain's code was loaded while another process unpacked them.
        table = Timetable(self._rows.t, self._rows.commands, rate)
        self._length, self.seconds = len(table), float(table.t[-1] - table.t[0]) + 1.0 / self.rate
        self._timetable = table if part is None else table.cut(*part)
        self._find_gaps()
        self._restore_state()
        self.tick.budget = PlayedBudget(self._recorded_tick)
        self.approximate = bool(self._rows.missing) or self._near
        room = next((field.width for field in recording.fields if field.name == "memory"), 0)
        self._layout = RowLayout.of(device, room)
        self._alike = [(one.name, one.width) for one in recording.fields] == [
            (one.name, one.width) for one in self._layout.fields if one.width
        ]
        self.comparison = RunComparison(self._layout.fields, frozenset(self._rows.missing))

    def __len__(self) -> int:
        return self._length

    @property
    def missing(self) -> tuple[str, ...]:
        """Missing fields, without which the replay is only approximate."""
        return self._rows.missing

    def read_recorded(self, names: Sequence[str]) -> dict[str, Array]:
        """Read fields of all recorded ticks.

        Parameters
        ----------
        names : sequence of str
            Names of the fields.

        Returns
        -------
        dict of str to ndarray
            Field → values (n, width) at all ticks, in its unit [SI].
        """
        block = self._rows.split(self._rows.read(0, len(self._rows)))
        return {name: block[name] for name in names}

    def write_to(self, path: Path) -> AbstractContextManager[ReplayFile]:
        """Open a recording of the replayed rows.

        Parameters
        ----------
        path : Path
            File of the recording; it is written as a whole at the end of the block.

        Returns
        -------
        context manager
            Its value takes the rows that `run` keeps.
        """
        world = "" if self._other_world is None else description(self._other_world)
        return write_replay(path, self._recording, self._layout, self.rate, self.replaced, world)

    @property
    def layout(self) -> RowLayout:
        """Layout of the replayed rows, with the recording's room for memory."""
        return self._layout

    def run(
        self,
        report: Callable[[int], None] = lambda ticks: None,
        keep: Callable[[Array], None] = lambda rows: None,
    ) -> RunComparison:
        """Replay all ticks.

        Parameters
        ----------
        report : callable, optional
            Called with the number of ticks that are done.
        keep : callable, optional
            Called with the next rows (n, width), each number in its unit.

        Returns
        -------
        RunComparison
            Differences between the recorded and the replayed rows.
        """
        table, layout = self._timetable, self._layout
        with without_collection(), np.errstate(all="ignore"):  # the file may contain any numbers
            for first in range(0, len(table), _BLOCK):
                last = min(first + _BLOCK, len(table))
                index = table.index[first:last]
                recorded = self._rows.read(int(index[0]), int(index[-1]) + 1)
                if self._resampled:
                    recorded = recorded[index - index[0]]
                block, t = self._rows.split(recorded), table.t[first:last]
                out = self._run_block(block, t, table.commands[first:last], index)
                self._copy_clock(out, block, first)
                run = ~self._blind[index]
                if first == 0 and self._state is not None:
                    run[0] = False
                if self._alike and run.all() and are_same(recorded, out):
                    self.comparison.add_same(len(out))
                else:
                    fields = {field.name: out[run, layout[field.name]] for field in layout.fields}
                    block = {name: values[run] for name, values in block.items()}
                    self.comparison.add(block, fields, self._rows.ticks[index[run]], t[run])
                keep(out)
                report(last)
        return self.comparison

    def skip_to(self, first: int, last: int) -> bool:
        """Restrict the replay to some rows, before `run`.

        Parameters
        ----------
        first : int
            First row.
        last : int
            Row after the last one.

        Returns
        -------
        bool
            False if the recording has no state at row `first`, or another world was active there: nothing is changed.
        """
        block = self._rows.read_one(first)
        tick, change = float(block["tick"][0, 0]), np.nan_to_num(block["world"][0, 0])
        if self._state is not None or tick not in self._states or change != self._change:
            return False
        self._first, self._state = first, self._states.read(tick)
        self._timetable = Timetable(self._rows.t, self._rows.commands).cut(first, last)
        self._restore_state()
        return True

    def _begin_late(self) -> None:
        """Start a trip's black box, which begins in the middle of its run, with the chain's recorded state."""
        self._near, self._states = bool(self._rows.missing), KeptStates(self._recording)
        if self._recording.truncated:
            self.remarks.append("the recording was cut short")
        self.remarks += self._recording.damage
        block = self._rows.read_one(self._first)
        tick = float(block["tick"][0, 0])
        if self._states.older:
            self.remarks.append(
                "its stored states of the loop are of an older version and are not read: the replay starts at its "
                "first tick"
            )
        if not tick > 0.0:
            return
        if tick in self._states:
            self._state = self._states.read(tick)
        elif self._states.older:
            self._near = True
        else:
            self._near = True
            self.remarks.append(f"its first tick is {tick:.0f}, and the state of the loop at that tick is missing")
        self._change = int(np.nan_to_num(block["world"][0, 0]))

    def _find_gaps(self) -> None:
        """Find the gaps of lost ticks, after which the chain's state is unknown."""
        rows = self._rows
        self._blind, self._resume = find_gaps(rows.ticks, self._states)
        if len(gaps := list_gaps(rows.ticks)):
            self.remarks.append(
                f"{len(gaps)} gaps with lost ticks, first after tick {rows.ticks[gaps[0]]:.0f}: "
                f"{int(self._blind.sum())} ticks up to the next stored state of the loop are not compared"
            )

    def _restore_after_gap(self, at: int, block: Mapping[str, Array], n: int) -> None:
        """After lost ticks: restore the recorded chain's state after row `at`, tick `n` of the block."""
        self._change_world(float(block["world"][n, 0]), 0)
        memory = block.get("memory", np.empty((n + 1, 0)))[n]
        load_state(self.tick, self._states.read(float(self._rows.ticks[at])), memory)

    def _restore_state(self) -> None:
        """Restore the recorded chain's state after the first row, which is not replayed."""
        if self._state is not None:
            block = self._rows.read_one(self._first)
            load_state(self.tick, self._state, block.get("memory", np.empty((1, 0)))[0])
            self._timetable.commands[0] = NO_TICK
        if not (self._resampled or self.replaced):
            for at in self._resume:
                if self._first < at < self._first + len(self._timetable):
                    self._timetable.commands[at - self._first] = NO_TICK

    def _run_block(self, block: Mapping[str, Array], t: Array, commands: Array, index: NDArray[np.intp]) -> Array:
        driver, tick, recorded = self._driver, self.tick, self._recorded_tick
        driver.load(block, t)
        recorded.load(block, whole=self._needs_outputs)
        out = np.full((len(t), self._layout.width), np.nan)
        changes, scales = block["world"][:, 0].tolist(), block["torque_scale"][:, 0].tolist()
        step = tick.step
        for n, (now, command, change, row) in enumerate(zip(t.tolist(), commands.tolist(), changes, out, strict=True)):
            if command:
                if command < 0.0:
                    self._copy_row(row, block, n)
                    if int(index[n]) in self._resume:
                        self._restore_after_gap(int(index[n]), block, n)
                    continue
                driver.select(n)
                play_commands(tick, int(command), scales[n])
            if change != self._change:
                self._change_world(change, int(command))
                if self._needs_outputs and not recorded.whole:
                    recorded.load(block, whole=True)
            driver.select(n)
            recorded.select(n)
            if self._has_clients:
                recorded.fill_client(tick.client)
            step(row, now)
        return out

    @property
    def _needs_outputs(self) -> bool:
        """Whether the recorded outputs of worlds are read, not only their failures."""
        return bool(self._stand_ins) or self._only_recorded or self._has_clients

    def _change_world(self, change: float, command: int) -> None:
        """Change the world up to number `change`; `command` states whether the last one was a new version."""
        if not change > self._change:  # NaN: unknown
            return
        if not change - self._change <= self._changes_left:  # safety: changes-are-counted
            raise RecordingError(
                f"{self._recording.path} cannot be replayed: its world changes to number {change:g}, but it describes "
                f"{len(self._recording.worlds)} changes"
            )
        self._changes_left -= int(change) - self._change
        for number in range(self._change + 1, int(change) + 1):
            world = self._choose_world(number)
            last = number == int(change)
            if last and command & _REPLACE:
                self.tick.replace_world(world)
            else:
                self.tick.change_world(world)
        self._change = int(change)

    def _choose_world(self, change: int) -> World:
        """World after `change` changes: the recorded one, or its substitute with the same clients."""
        other = self._other_world
        world = self._find_world(change) if other is None else join_remote(other, self.recorded.remote(change))
        self._has_clients = isinstance(world, DynamicWorld) and world.takes_commands
        if self._has_clients:  # their commands are in the recorded memory
            fields = list_memory_fields(self.recorded.describe_world(change))
            self._recorded_tick.find_client(fields, self._recording)
        return world

    def _find_world(self, change: int) -> World:
        """World after `change` changes, or its recorded output."""
        text = self.recorded.describe_world(change)
        if not self._only_recorded:
            try:
                return self.recorded.world(change)
            except HaptorbError as cause:
                name = text[:60]
                if name not in self._stand_ins:
                    self._stand_ins.add(name)
                    self.remarks.append(f"the recorded wrench is replayed instead of a world: {cause}")
        return make_recorded_world(text, self._recorded_tick)

    def _copy_clock(self, out: Array, block: Mapping[str, Array], first: int) -> None:
        for name in CLOCK_FIELDS:
            if name in block:
                place = self._layout[name]
                out[:, place] = block[name][:, : place.stop - place.start]
        if self._resampled:
            out[:, self._layout["tick"].start] = np.arange(first, first + len(out))

    def _copy_row(self, row: Array, block: Mapping[str, Array], n: int) -> None:
        for field in self._layout.fields:
            if field.name in block:
                values = block[field.name][n][: field.width]
                start = self._layout[field.name].start
                row[start : start + len(values)] = values
