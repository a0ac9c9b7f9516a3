"""The servo for Python programs: start it, move the hand, stop, change the world, read rows.

The loop runs in its own process; a third process records. Leaving the `with` block in any way ends both, with the
coils off.
"""

from __future__ import annotations

import asyncio
import json
import os
import shutil
import threading
from abc import abstractmethod
from base64 import b64encode
from collections.abc import AsyncIterator, Callable, Iterable, Mapping
from contextlib import ExitStack
from dataclasses import asdict
from functools import cached_property, partial
from importlib import import_module
from pathlib import Path
from time import monotonic, monotonic_ns, sleep, time_ns
from types import MappingProxyType, TracebackType
from typing import TYPE_CHECKING, Any, Literal, Self, final

import numpy as np
from numpy.typing import DTypeLike

from haptorb.analysis.coupling import CouplingSetting
from haptorb.analysis.stability import check_grip
from haptorb.arrays import Array, check_finite
from haptorb.control.allocation import WrenchChoice
from haptorb.control.linkage import Gains
from haptorb.control.trips import CoilState, GuardState, Trip
from haptorb.devices.base import Device, State
from haptorb.devices.electromagnet import electromagnet
from haptorb.devices.loader import find_device
from haptorb.display import facts_html, format_number, format_quantity, format_vector
from haptorb.errors import InputError, RecordingError, ServoError, UnknownName, WorldError
from haptorb.estimation.calibration import Calibration, read_calibration, read_frame
from haptorb.estimation.tracker_frame import TrackerFrame
from haptorb.files import FileLock, sweep
from haptorb.recording.destination import RunRecording, describe_machine, list_versions
from haptorb.recording.row import RowLayout
from haptorb.runtime import plan
from haptorb.runtime.assembly import (
    assemble,
    check_driver,
    check_estimator,
    choice_of,
    default_world,
    linkage_of,
    modes_of,
    read_learned,
)
from haptorb.runtime.black_box import BlackBox, TripRecord
from haptorb.runtime.clock import check_rate
from haptorb.runtime.commands import Commands
from haptorb.runtime.hand_file import choose_hand
from haptorb.runtime.linux import require_linux, run_uninterrupted
from haptorb.runtime.prestart import PrestartedProcess
from haptorb.runtime.process_group import ProcessGroup, SignalStop
from haptorb.runtime.report import (
    RunReport,
    describe_detail,
    describe_slow_world,
    is_tripped,
    loop_report,
    read_detail,
    tracker_facts,
    world_failure,
)
from haptorb.runtime.shared_memory import SharedMemory, Word
from haptorb.runtime.trackers.feed_tracker import PREDICTION, check_prediction
from haptorb.runtime.trackers.pose_filter import describe_missing_pose
from haptorb.runtime.trackers.registry import Preparation, check_frame, check_tracker, has_feed, prepare_tracker
from haptorb.runtime.warm_up import Compilation
from haptorb.runtime.world_change import description, name_of
from haptorb.runtime.world_loading import WorldWatcher, choose_world
from haptorb.simulation.hand import ScriptedMotion
from haptorb.worlds.base import PARTS, World, WrenchPart
from haptorb.worlds.dynamic import DynamicWorld, check_world_period, count_numbers
from haptorb.worlds.scene import SceneFile
from haptorb.worlds.user_world import FileWithRemote, WorldFile, fit_world, note_world

if TYPE_CHECKING:
    from haptorb.recording.recording import Recording

__all__ = [
    "LatestRow",
    "Servo",
    "ServoContext",
    "ServoObserver",
    "check_seed",
    "describe_choices",
    "notes",
    "recorder_spec",
    "tracker_spec",
]


# --------------------------------------------------------------------------------------------------
# The newest tick of a servo, by field name, with units.


#: what people call a field first → its name
_ALSO = {"temperature": "winding"}
_STATES = {"guard": GuardState, "trip": Trip, "coil_state": CoilState}
_ICE = 273.15  #: [K]


@final
class LatestRow:
    """One tick: `row.given` or `row["given"]`, in SI units; `row.units["given"]` is the unit.

    A field with one number is a float, any other an array (width,). `row.temperature` is `row.winding`. `row.numbers`
    holds all numbers in the order of the layout; a slice of the layout selects from it, as `row[layout["p"]]`.
    `print(row)` shows every field with its unit.

    >>> layout = RowLayout(channels=1, sensors=0)
    >>> row = LatestRow(layout, np.zeros(layout.width))
    >>> row.gain, row["p"].tolist(), row.units["p"]
    (0.0, [0.0, 0.0, 0.0], 'm')
    >>> row["giben"]  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    haptorb.errors.UnknownName: unknown field of a row 'giben'; did you mean 'given'? (known: age, ...)
    """

    __slots__ = ("layout", "numbers")

    def __init__(self, layout: RowLayout, numbers: Array) -> None:
        """`numbers` (width,) in the order and the units [..] of `layout`."""
        self.layout = layout
        self.numbers = numbers

    @property
    def units(self) -> MappingProxyType[str, str]:
        """The unit of every field by its name; "N, N·m": three numbers in newtons, three in newton metres."""
        units = {field.name: field.unit for field in self.layout.fields}
        return MappingProxyType(units | {also: units[name] for also, name in _ALSO.items()})

    def __getitem__(self, name: str | slice | int) -> Any:
        """The field `name`, or numbers at places of the layout. Raises UnknownName if there is no such field."""
        if not isinstance(name, str):
            return self.numbers[name]
        known = {field.name: field.width for field in self.layout.fields}
        name = _ALSO.get(name, name)
        if name not in known:
            raise UnknownName("field of a row", name, [*known, *_ALSO])
        values = self.numbers[self.layout[name]]
        return float(values[0]) if known[name] == 1 else values

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name in self.__slots__:  # what Python itself looks for
            raise AttributeError(name)
        try:
            return self[name]
        except UnknownName as cause:
            raise AttributeError(str(cause)) from None

    def __dir__(self) -> list[str]:
        return sorted([*super().__dir__(), *self.units])

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> Any:
        return np.array(self.numbers, dtype=dtype) if copy else np.asarray(self.numbers, dtype=dtype)

    def __repr__(self) -> str:
        """When it was, what the guard does, and the main quantities with their units; two lines."""
        coils = _describe_state("coil_state", self.coil_state)
        warm = f"winding at most {format_number(float(np.max(self.winding)) - _ICE)} °C"
        main = [f"{name} {self._format(name)}" for name in ("p", "asked", "given")]
        return (
            f"<LatestRow of tick {format_number(self.tick, 15)}, {self.t:.3f} s: guard "
            f"{_describe_state('guard', self.guard)}, coils {coils}\n  {'; '.join([*main, warm])}>"
        )

    def __str__(self) -> str:
        """Every field: name, value and unit."""
        return "\n".join(f"{name:14} {text}" for name, text in self._list_facts())

    def _repr_html_(self) -> str:
        return facts_html(f"Tick {format_number(self.tick, 15)} at {self.t:.3f} s", self._list_facts())

    def _list_facts(self) -> list[tuple[str, str]]:
        facts = [(field.name, self._format(field.name)) for field in self.layout.fields if field.width]
        used = np.isfinite(self.numbers[self.layout["memory"]]).any()
        return facts if used else [(name, text) for name, text in facts if name != "memory"]

    def _format(self, name: str) -> str:
        """The value of a field with its unit, and in words where it is a code."""
        value, unit = self[name], self.units[name]
        if name in _STATES:
            return f"{format_number(value)} ({_describe_state(name, value)})"
        if isinstance(value, float):
            return format_quantity(value, unit.removeprefix("1"), 15 if name == "tick" else 4)
        if unit == "N, N·m":
            return f"{format_vector(value[:3], 'N')}, {format_vector(value[3:], 'N·m')}"
        return format_vector(value, unit.removeprefix("1"), 4)


def _describe_state(name: str, code: float) -> str:
    """The code's name; `unknown` for a number that is none."""
    kind = _STATES[name]
    found = [one for one in kind if one.value == code]
    return found[0].name.lower().replace("_", " ") if found else "unknown"


# --------------------------------------------------------------------------------------------------
# Observing a running servo: rows, report, trips, recording, and whether it is alive.


_PREPARING = "preparing world '{}': its code is being compiled, once on this computer; the previous world continues"


class ServoObserver(Commands):
    """Base of `Servo`: everything that comes back from the loop."""

    device: Device
    driver: str
    tracker: str
    estimator: str
    rate: float
    seed: int
    _recording: RunRecording
    _black_box: BlackBox | None
    _shared: SharedMemory | None
    _children: ProcessGroup | None
    _choice: WrenchChoice | None
    _watcher: WorldWatcher | None

    @property
    def layout(self) -> RowLayout:
        """Which numbers of a row are what, with room for the memory of every world that this servo was given."""
        if self._shared is not None:
            return self._shared.layout
        given = (self._first, *self.own_worlds.values())
        sizes = [count_numbers(one.memory_fields) for one in given if isinstance(one, DynamicWorld)]
        return RowLayout.of(self.device, max(sizes, default=0))

    def __repr__(self) -> str:
        return (
            f"<Servo of {self.device.name}, world '{self.world[0]}', driver {self.driver}, tracker {self.tracker}, "
            f"{self.rate:g} Hz: {self._describe_phase()}>"
        )

    def _describe_phase(self) -> str:
        """Whether it runs, and with which force; or why not."""
        if self._children is None:
            return "not started"
        try:
            self._children.check()
            row = self.latest()
        except (ServoError, RecordingError) as cause:
            return str(cause)
        if row.guard == GuardState.TRIPPED:
            return f"running, coils off. {Trip(int(row.trip)).text}"
        return f"running, given {format_vector(row.given[:3], 'N')}"

    @property
    def alive(self) -> bool:
        """Whether the loop runs."""
        return self._children is not None and self._children.alive

    @property
    def servo_pid(self) -> int:
        """Process id of the loop; 0 before the start."""
        return self._children.servo_pid if self._children is not None else 0

    @property
    def memory_path(self) -> Path:
        """The file that loop, recorder and servers share. Raises ServoError before the start."""
        return self._memory.path

    @property
    def connections(self) -> list[dict[str, Any]]:
        """The programs connected to each server, in the order of the `--serve` options: `server`,
        `address`, and `clients`, each with its name, `session`, `rate_hz` and whether it `holds` the device."""
        shared = self._memory_or_none
        texts = () if shared is None else [slot.read()[1] for slot in shared.server_facts]
        return [json.loads(text) for text in texts if text]

    @property
    def recording_trouble(self) -> str:
        """Why the recording ended early, or is stalled; empty if there is no problem."""
        return self._children.recorder_trouble if self._children is not None else ""

    def _compile_world(self, name: str) -> None:
        assert self._children is not None
        self._children.compiler.compile_world(name)

    def _check_compiler(self) -> None:
        assert self._children is not None
        self._children.compiler.check()

    @property
    def warning(self) -> str:
        """Warnings for the user: about the connected device, the servo's memory, the code of world and path, and a
        world that is being prepared; empty if there are none."""
        if self._shared is None or self._children is None:
            return ""
        found = (
            self._shared.warning.read()[1], self._children.memory.warning, self.world_trouble, self.hand_trouble,
            _PREPARING.format(self.world_ahead) if self.world_ahead else "",
        )  # fmt: skip
        return "; ".join(filter(None, found))

    @property
    def world_trouble(self) -> str:
        """Problem of the world's code: it failed (with file and line), takes too long, or a saved file is not used,
        and why. Empty if there is no problem."""
        if self._shared is None:
            return ""
        failed = world_failure(self._shared) or describe_slow_world(self._shared, self.rate)
        failed = failed or describe_detail(read_detail(self._shared), now=True)
        return failed or ("" if self._watcher is None else self._watcher.trouble)

    def check_world(self) -> None:
        """Raise WorldError if the coils are off because the world's code failed, or takes too long."""
        shared = self._memory
        if failed := world_failure(shared):
            raise WorldError(f"{failed}\nThe coils are off.")
        if is_tripped(shared, Trip.OVERRUN) and (slow := describe_slow_world(shared, self.rate)):
            raise WorldError(f"{slow} The coils are off.")

    def check(self) -> None:
        """Raise ServoError with the servo's reason if the loop no longer runs, RecordingError if the recorder no
        longer runs."""
        if self._children is None:
            raise ServoError("the servo was not started: use `with haptorb.Servo(...) as servo:`")
        self._children.check()

    def check_end(self) -> None:
        """Raise what `check` raises, unless the loop ended because `end_loop` asked it to."""
        if self._children is None or not self._children.ended_on_request:
            self.check()

    def rows(self, cursor: int = 0, most: int | None = None) -> tuple[int, Array]:
        """Read the rows of the loop since the last call, for plots of a running servo.

        The last 8191 rows are kept; (new cursor − cursor − n) rows were lost to a slower reader.

        Parameters
        ----------
        cursor : int
            Cursor of the last call; 0: from the oldest row.
        most : int, optional
            Only the newest of this many, where more are new: copying all 8191 takes longer than a tick.

        Returns
        -------
        cursor : int
            New cursor.
        rows : ndarray, shape (n, width)
            New rows, oldest first, each field in its unit [SI]; `layout["given"]` are the columns of a field.
        """
        return self._memory.ring.read_since(cursor, most)

    def latest(self) -> LatestRow:
        """Read the newest tick, by field name: `latest().given` or `latest()["given"]`.

        Returns
        -------
        LatestRow
            The fields in SI units; `units` names them.

        Raises
        ------
        ServoError
            Before the first tick.
        """
        numbers = self._memory.ring.latest()
        if numbers is None:
            raise ServoError("the servo has not ticked yet: `open` returns, and `with` begins, when it has")
        return LatestRow(self.layout, numbers)

    def report(self) -> RunReport:
        """Report of the run so far, as plain JSON types: see `loop_report`."""
        world, values = self.world
        loop, children = loop_report(self._memory, self.tracker), self._children
        assert children is not None
        troubles = {"recording_trouble": children.recorder_trouble, "tracker_trouble": children.tracker_trouble}
        found = {
            "device": self.device.name,
            "world": world,
            "world_values": values,
            "rendered_part": self.rendered_part,
            "driver": self.driver,
            "tracker": self.tracker,
            "estimator": self.estimator,
            "model": self.model,
            "rate_hz": self.rate,
            "seed": self.seed,
            "recording": self._recording.user_path,
            **loop,
            **({"scene": scene} if (scene := read_detail(self._memory)) else {}),
            "recorded": children.recorder_counts,
            **({"servers": served} if (served := self.connections) else {}),
            "memory_mb": children.memory.facts(),
            "warning": self.warning,
            **{name: trouble for name, trouble in troubles.items() if trouble},
        }
        return RunReport(found)

    @property
    def tracker_refusals(self) -> dict[str, int]:
        """Number of messages that the tracker's process has rejected so far, by the reasons of `pose_filter`."""
        shared = self._memory_or_none
        return dict(tracker_facts(shared).get("refused", {})) if shared is not None else {}

    @property
    def missing_pose(self) -> str:
        """The pose that the servo waits for, with the counts so far, while the newest row has no valid pose from a
        tracker with its own process; else empty."""
        shared = self._memory_or_none
        row = None if shared is None else shared.ring.latest()
        if shared is None or row is None or row[shared.layout["valid"].start] == 1.0:
            return ""
        return describe_missing_pose(self.tracker, tracker_facts(shared))

    @cached_property
    def part_remarks(self) -> tuple[str, ...]:
        """Remarks about each part of the wrench that can be rendered, by its number in the row; empty for a device
        without a choice, and for a part without remarks."""
        remarks = self.device.kind.part("part_remarks")
        return () if self._choice is None or remarks is None else tuple(remarks(self.device, self._choice))

    @property
    def rendered_part(self) -> WrenchPart | None:
        """The part of the world's wrench that is rendered now; None for a device without a choice, and before the first
        tick."""
        shared = self._memory_or_none
        row = None if shared is None else shared.ring.latest()
        number = -1.0 if row is None else float(row[self.layout["part"].start])
        return PARTS[int(number)] if number >= 0.0 else None  # NaN too: nothing is known

    @property
    def trips(self) -> tuple[TripRecord, ...]:
        """The first 64 trips, each with the last 100 ticks up to it."""
        if self._black_box is None:
            return ()
        self._black_box.look()
        return tuple(self._black_box.trips)

    @property
    def trip_files(self) -> tuple[Path, ...]:
        """Recordings in the `black_box` folder so far."""
        return () if self._black_box is None else tuple(file for file in self._black_box.files if file is not None)

    @property
    def recording(self) -> Recording:
        """The recording so far. While the loop runs, and after a crash, it is marked as truncated.

        Raises RecordingError if nothing was recorded, or if the file cannot be read.
        """
        return self._recording.read()


# --------------------------------------------------------------------------------------------------
# A servo in a `with` block, and in an `async with` block, whose event loop keeps running.


_LOOK = 0.02  #: between two looks whether all is well [s]


class ServoContext(ServoObserver):
    """Base of `Servo`: it is open in the block and closed after it, however the block ends."""

    @abstractmethod
    def open(self) -> None:
        """Start; returns when the loop runs."""

    @abstractmethod
    def close(self) -> None:
        """Coils off, processes ended."""

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    async def __aenter__(self) -> Self:
        try:
            await _complete(self.open)
        except asyncio.CancelledError:
            await _complete(self.close)
            raise
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None
    ) -> None:
        await _complete(self.close)

    def run(self, seconds: float) -> None:
        """Wait while the loop runs, and raise as soon as something fails.

        Ctrl-C closes the servo first, then raises KeyboardInterrupt; so does whatever else ends the program.

        Parameters
        ----------
        seconds : float
            Time to wait [s].

        Raises
        ------
        ServoError
            If the loop ends by itself.
        RecordingError
            If the recorder ends.
        WorldError
            If the world's code fails, or takes too long.
        InputError
            If the path of the hand fails, or `seconds` is negative or not finite.
        """
        self._note_signals()  # what came before, and was caught, is not lost in here
        begun = monotonic()
        end = begun + _check_seconds(seconds)
        try:
            while (left := self._check_all(end)) > 0:
                sleep(min(left, _LOOK))
                self._repeat_lost_signal(begun)
        except BaseException as cause:
            if not isinstance(cause, Exception):
                self.close()
            raise

    async def wait(self, seconds: float) -> None:
        """Wait while the loop runs, as `run` does, in an event loop: other tasks continue.

        Parameters
        ----------
        seconds : float
            Time to wait [s].

        Raises
        ------
        ServoError
            As `run`, with the other errors of `run`.
        """
        end = monotonic() + _check_seconds(seconds)
        while (left := self._check_all(end)) > 0:
            await asyncio.sleep(min(left, _LOOK))

    async def watch(self, every: float = _LOOK) -> AsyncIterator[LatestRow]:
        """Read the newest tick at an interval: `async for row in servo.watch()`.

        Parameters
        ----------
        every : float
            Interval [s].

        Yields
        ------
        LatestRow
            The newest tick.

        Raises
        ------
        ServoError
            As `run`, with the other errors of `run`.
        """
        pause = _check_seconds(every)
        while True:
            self._check_all(0.0)
            yield self.latest()
            await asyncio.sleep(pause)

    @abstractmethod
    def _note_signals(self) -> None:
        """The signals that came until now are known."""

    @abstractmethod
    def _repeat_lost_signal(self, since: float) -> None:
        """A signal that came after `since` [s] and whose exception was lost has its effect now."""

    def _check_all(self, end: float) -> float:
        """Time until `end` [s]; raises if something is wrong."""
        self.check()
        self.check_world()
        self.check_hand()
        return end - monotonic()


def _check_seconds(seconds: float) -> float:
    duration = float(check_finite(seconds, "seconds"))
    if duration < 0:
        raise InputError(f"seconds must not be negative; got {seconds!r}")
    return duration


async def _complete(work: Callable[[], None]) -> None:
    """`work` in a thread, to its end: a task that is cancelled waits until it is done, because a servo
    that has half started must be closed."""
    task = asyncio.ensure_future(asyncio.to_thread(work))
    cancelled: asyncio.CancelledError | None = None
    while not task.done():
        try:
            await asyncio.wait({task})
        except asyncio.CancelledError as cause:
            cancelled = cause
    if cancelled is not None:
        task.exception()  # otherwise it is reported nowhere
        raise cancelled
    task.result()


# --------------------------------------------------------------------------------------------------
# The parameters of the processes beside the loop, as plain JSON types.


_LONGEST = 1_000_000  #: characters of how a world is made


def recorder_spec(
    shared: SharedMemory, servo: int, descriptor: int, rate: float, *, temporary: Path | None, notes: Mapping[str, Any]
) -> dict[str, Any]:
    """For `recorder_process`: `servo` is the loop's process id, `rate` in Hz; a `temporary` file it may delete."""
    return {
        "shared": str(shared.path),
        "descriptor": descriptor,
        "servo": servo,
        "parent": os.getpid(),
        "rate": rate,
        "unix_minus_monotonic": time_ns() - monotonic_ns(),
        "temporary": None if temporary is None else str(temporary),
        "notes": notes,
    }


def notes(device: Device, run: Mapping[str, str]) -> dict[str, dict[str, str]]:
    """Metadata of a recording: its `device` (with its file, if it has one), the `run` (with what its estimator learned,
    in base64), and the software."""
    learned = b64encode(read_learned(device, run["estimator"])).decode()
    return {
        "device": {
            "name": device.name,
            "digest": device.digest,
            "title": device.title,
            "source": device.source,
            **(device.text.as_note() if device.text else {"file": ""}),
            "coils": json.dumps(device.coils.names),
        },
        "run": {**run, "learned": learned} if learned else dict(run),
        "versions": list_versions(),
        "machine": describe_machine(),
    }


def tracker_spec(shared: SharedMemory, tracker: Preparation, frame: TrackerFrame | None) -> dict[str, Any]:
    """For `tracker_process`: the prepared tracker, and the `frame` between tracker and stator if there is one."""
    return {
        "shared": str(shared.path),
        "descriptor": tracker.descriptor,
        "parent": os.getpid(),
        "feed": tracker.spec,
        "frame": "" if frame is None else frame.text(),
    }


def describe_choices(gains: Gains | None, torque_arm: float | None, worlds: Iterable[World]) -> dict[str, str]:
    """Further data for a replay: `gains`, `torque_arm` [m], and the source of each world."""
    made = {name_of(world): note_world(world) for world in worlds}
    return {
        "gains": "" if gains is None else json.dumps(asdict(gains)),
        "torque_arm_m": "" if torque_arm is None else repr(torque_arm),
        "worlds": json.dumps({name: text for name, text in made.items() if len(text) <= _LONGEST}),
    }


def check_seed(seed: int) -> int:
    """`seed` itself; InputError unless it is a whole number, 0 or more."""
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise InputError(f"seed must be a whole number, 0 or more; got {seed!r}")
    return seed


@final
class Servo(ServoContext):
    """Real-time loop that connects a device with a world, in a process of its own.

    A `with` block starts it and ends it with the coils off, in whatever way the block ends.

    Parameters
    ----------
    device : str, Path or Device
        Name in the catalogue, path of a device file, or a Device.
    world : str, World, WorldFile, SceneFile, FileWithRemote, callable or None
        Name in the catalogue, a World, a function of a State that returns a wrench (6,) [N, N·m], "FILE.py:NAME"
        (WorldFile), or a SceneFile, which is reloaded whenever it is saved, with or without clients' force
        (FileWithRemote). None: the default world of the kind of device.
    driver : str
        "sim": the simulated device; "serial:PORT" or "i2c:BUS": a real device.
    tracker : str
        "pointer": the pose set by `point`; "hall": the field sensors, while the simulated hand follows `point`;
        "osc:PORT", "lsl:NAME", "replay:FILE", "natnet:HOST": a tracker in its own process.
    prediction : float
        Longest time by which the pose of such a tracker is extrapolated with its own velocity [s].
    frame : str, Path or TrackerFrame, optional
        File of `haptorb frame` that transforms such a tracker's poses to the tool in the stator frame; None: they are
        in it.
    rate : float
        Rate of the loop [Hz], 50 to 4000.
    record : str, Path, False or None
        File to record to (MCAP); None: a temporary one, deleted at exit; False: no recording.
    overwrite : bool
        Whether `record` may replace a file.
    seed : int
        Seed of the simulation's noise.
    model : str, optional
        Controller model, one of the device's `tick_models`; None: the first.
    estimator : str, optional
        Name of the estimator; None: the device's default.
    gains : Gains, optional
        Gains of a motor's two modes; None: the default.
    calibration : str, Path or Calibration, optional
        File of `haptorb calibrate` for this device.
    black_box : str or Path, optional
        Folder for a recording of the last 100 ticks before every trip; None: they are in `trips` only.
    watchdog : bool
        False: drive an I²C bus although nothing switches off when this computer stops; do not touch the device.
    render : str, optional
        Part of the world's wrench to render, "force", "torque" or "both"; None: the part that the world defines.
    torque_arm : float, optional
        Length that weights torque against force if both are rendered [m]; None: 43.5 mm.
    grip : str
        Hand for which the coupling of a scene is chosen: "loose", "light", "firm", or "MASS,DAMPING,STIFFNESS" in kg,
        N·s/m and N/m.
    latency : float, optional
        Latency of the tracker for the same choice [s]; None: 5 ms (assumed) if it has its own process.
    hand : str, Path or ScriptedMotion, optional
        Motion of the simulated hand from the start of the loop: a CSV file, script or recording
        (docs/how-to/scripted-hand.md); None: the guided motion. `point`, `hold` and `follow` replace it.
    about : Mapping, optional
        Texts by name that are stored in the recording, such as a study and its session.

    Raises
    ------
    UnknownName
        If a device, world, estimator or model does not exist.
    InputError
        If a value is invalid, or world, tracker or gains do not fit the device.
    DeviceError
        If a device file is invalid.
    CalibrationError
        If a calibration or frame cannot be read, or belongs to another device or tracker.
    PlatformError
        If this is not Linux.
    """

    def __init__(
        self,
        device: str | Path | Device,
        world: str | World | WorldFile | SceneFile | FileWithRemote | Callable[[State], Array] | None = None,
        *,
        driver: str = "sim",
        tracker: str = "pointer",
        prediction: float = PREDICTION,
        frame: str | Path | TrackerFrame | None = None,
        rate: float = 1000.0,
        record: str | Path | Literal[False] | None = None,
        overwrite: bool = False,
        seed: int = 0,
        model: str | None = None,
        estimator: str | None = None,
        gains: Gains | None = None,
        calibration: str | Path | Calibration | None = None,
        black_box: str | Path | None = None,
        watchdog: bool = True,
        render: str | None = None,
        torque_arm: float | None = None,
        grip: str = "light",
        latency: float | None = None,
        hand: str | Path | ScriptedMotion | None = None,
        about: Mapping[str, str] | None = None,
    ) -> None:
        require_linux("haptorb.Servo")
        self.device = find_device(device)
        self.driver = check_driver(driver)
        self.tracker = check_tracker(tracker, self.driver)
        self.tracker_token = ""  #: what senders on other computers must say first; known once the servo is open
        self.rate = check_rate(rate)
        self.seed = check_seed(seed)
        self.estimator = check_estimator(self.device, "hall" if tracker == "hall" and estimator is None else estimator)
        self.models = self.device.tick_models  #: that `set_model` knows
        self._model = self.device.check_tick_model(model or self.models[0])
        self.calibration = (
            read_calibration(calibration) if isinstance(calibration, str | Path) else calibration
        )  #: the calibration that the controller uses beside the device file
        if self.calibration is not None:
            # refuses here what is another device's
            self.calibration.apply(electromagnet(self.device, "a calibration"))
        self.modes = modes_of(self.device)  #: that `set_mode` knows; empty where the device acts directly
        self._gains, self._torque_arm = gains, torque_arm
        if gains is not None:
            linkage_of(self.device, gains)  # refuses here what does not fit
        self._choice = choice_of(self.device, render, torque_arm)  # refuses here what does not fit
        self.render = render  #: part of the wrench to render, overriding the world; None: the world's
        first, self._world_file = choose_world(default_world(self.device) if world is None else world)
        self._coupling = CouplingSetting(
            self.device, self.rate, check_grip(grip), self.estimator, has_feed(self.tracker), latency
        )
        first = self._coupling.couple(first)
        ServoContext.__init__(self, first)
        # refuses here, not in another process, what the device cannot render
        check_world_period(fit_world(first, self.device), 1.0 / self.rate)
        self.hand = choose_hand(hand, self.device, self.driver, self.tracker)  #: scripted motion of the simulated hand
        # Compiling in the first tick would be a silence at which a real device's firmware switches off.
        chain, practice = (
            partial(
                assemble, self.device, first, through, self.rate, self.seed, self._model,
                estimator=self.estimator, gains=gains, calibration=self.calibration, watchdog=watchdog,
                render=render, torque_arm=torque_arm, hand=self.hand,
            )
            for through in (self.driver, "sim")
        )  # fmt: skip
        self._ahead = check_prediction(prediction)
        self.frame = read_frame(frame) if isinstance(frame, str | Path) else frame  #: between tracker and stator
        if self.frame is not None:
            check_frame(self.frame, self.device, self.tracker, self.driver)
        self._plan = plan.Plan(
            self.device, first, self.rate, chain, practice, self._ahead if has_feed(self.tracker) else None,
            None if self.calibration is None else self.calibration.id,
            Compilation(self.device, first, self.estimator, self._model, gains),
            self.own_worlds, reloads=self._world_file is not None,
        )  # fmt: skip
        self._recording = RunRecording(record, overwrite=overwrite)
        self._about = {name: str(text) for name, text in (about or {}).items()}
        self._trips_folder = None if black_box is None else Path(black_box).expanduser().absolute()
        self._black_box: BlackBox | None = None
        self._shared: SharedMemory | None = None
        self._signals: SignalStop | None = None
        self._children: ProcessGroup | None = None
        self._folder: Path | None = None
        self._watcher: WorldWatcher | None = None
        self._claim: FileLock | None = None  # on the folder

    def open(self, standby: PrestartedProcess | None = None) -> None:
        """Start; returns when the loop runs.

        Parameters
        ----------
        standby : PrestartedProcess, optional
            Process that was started early, for this servo; None: start one now.

        Raises
        ------
        ServoError
            If the loop does not start, or this servo was already started; nothing is left running.
        RecordingError
            If the recording cannot be written; nothing is left running.
        """
        if self._children is not None:
            raise ServoError("this servo was already started; create a new one")
        preparation = prepare_tracker(self.tracker) if has_feed(self.tracker) else None
        descriptor: int | None = None
        tidying = threading.Thread(target=sweep, name="haptorb-tidying", daemon=True)  # beside the start, which waits
        tidying.start()
        try:
            descriptor = self._recording.open()
            self._start(descriptor, preparation, standby)
        except BaseException:
            self.close()
            self._recording.discard()
            raise
        finally:
            if descriptor is not None:
                os.close(descriptor)
            if preparation is not None:
                preparation.close()
            tidying.join()

    def end_loop(self) -> None:
        """Coils off and the loop ended within a tick; returns at once. Every end of a run begins with this. `close`
        does what else is to be done. May be called from any thread, and twice."""
        if self._shared is not None:
            self._shared.words[Word.QUIT] = 1  # safety: stop-first

    def close(self) -> None:
        """Coils off, processes ended, recording complete. May be called twice.

        A signal meanwhile has its effect afterwards; Ctrl-C while the recorder takes long ends it at once.
        """
        try:
            self.end_loop()
        finally:
            run_uninterrupted(self._tidy)

    def _note_signals(self) -> None:
        if self._signals is not None:
            self._signals.look()

    def _repeat_lost_signal(self, since: float) -> None:
        if self._signals is not None:
            self._signals.repeat_lost(since)

    def _tidy(self, interrupted: threading.Event) -> None:
        with ExitStack() as last:
            # The last one first: each is done, though one before it fails.
            if self._claim is not None:
                last.callback(self._claim.close)
            if self._folder is not None:
                last.callback(shutil.rmtree, self._folder, ignore_errors=True)
            if self._shared is not None:
                last.callback(self._shared.unlink)
            if self._signals is not None:
                last.callback(self._signals.close)
            last.callback(self._end_hand)
            if self._children is not None:
                last.callback(self._children.end, interrupted)
            if self._watcher is not None:
                self._watcher.end()

    @property
    def _memory_or_none(self) -> SharedMemory | None:
        return self._shared

    def _start(self, descriptor: int | None, tracker: Preparation | None, standby: PrestartedProcess | None) -> None:
        with standby or PrestartedProcess() as process:
            file = process.plan
            try:
                plan.save(self._plan, file)
            except OSError as cause:
                raise ServoError(
                    f"cannot write to {file.parent.parent}: {cause.strerror}; free some room there, or name another "
                    "folder by TMPDIR"
                ) from cause
            except Exception as cause:
                raise InputError(f"world or device cannot be sent to the servo's process: {cause}") from cause
            self._shared = SharedMemory.create(self.layout)
            self._carry_stops(self._shared)
            self._black_box = BlackBox(self._shared, self.device.name, self.rate, self._trips_folder, self._notes())
            self._claim, self._folder = process.claim, process.folder
            self._signals = SignalStop(self._shared, self.stop)
            self._children = ProcessGroup(process, self._shared, self._black_box, self._signals)
        if descriptor is not None:
            spec = recorder_spec(
                self._shared, self._children.servo_pid, descriptor, self.rate,
                temporary=self._recording.temporary_path, notes=self._notes(),
            )  # fmt: skip
            self._children.record(json.dumps(spec), descriptor)
        if tracker is not None:
            self.tracker_token = tracker.token
            listening = tracker_spec(self._shared, tracker, self.frame)
            self._children.track(json.dumps(listening), tracker.descriptor if tracker.descriptor >= 0 else None)
        # What `report` loads at its first percentile: while the loop runs it would hold up this program's heart.
        import_module("numpy.ma")
        self._children.wait_until_running()
        if self._world_file is not None:
            self._watcher = WorldWatcher(
                self._world_file, self._plan.world, self.device, self._reload, lambda: self.world
            )

    def _reload(self, world: World, values: dict[str, Any]) -> None:
        assert self._folder is not None
        self.replace_own_world(self._coupling.couple(world), values, self._folder)

    @property
    def coupling(self) -> str:
        """The coupling between mover and held body, and its stability margin; empty without a scene."""
        return self._coupling.describe(self._plan.world)

    def _notes(self) -> dict[str, dict[str, str]]:
        """What a recording says of its run."""
        run = {
            "driver": self.driver,
            "tracker": self.tracker,
            "prediction_s": repr(self._ahead) if has_feed(self.tracker) else "",
            "frame": "" if self.frame is None else self.frame.text(),
            "estimator": self.estimator,
            "model": self._model,
            "models": " ".join(self.device.models),
            "render": self.render or "",
            "calibration": "" if self.calibration is None else self.calibration.text(),
            "hand": "" if self.hand is None else f"{self.hand.name} {self.hand.digest}".strip(),
            "seed": str(self.seed),
            "rate_hz": repr(self.rate),
            "first_world": description(self._plan.world),
            **describe_choices(self._gains, self._torque_arm, (self._plan.world, *self.own_worlds.values())),
        }
        return notes(self.device, run) | ({"about": self._about} if self._about else {})
