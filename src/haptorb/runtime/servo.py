"""Servo for Python programs: start it, move the hand, stop, change the world, read rows.

The loop runs in its own process; a third process records. Leaving the `with` block in any way ends both, with the
coils off.
"""

from __future__ import annotations

import asyncio
import errno
import json
import os
import shutil
import threading
from collections.abc import AsyncIterator, Callable, Collection, Mapping
from contextlib import ExitStack, suppress
from contextvars import copy_context
from functools import cached_property
from importlib import import_module
from inspect import signature
from itertools import count
from pathlib import Path
from time import monotonic, sleep
from types import TracebackType
from typing import TYPE_CHECKING, Any, Literal, Self, final

from numpy.typing import ArrayLike

from haptorb.arrays import Array, check_finite
from haptorb.child_process import pack
from haptorb.control.linkage import MODES, Gains
from haptorb.control.registry import describe_choice, make_choice
from haptorb.control.trip_reasons import GuardState, Trip
from haptorb.devices.base import Device, State, own_implementations
from haptorb.display import format_vector
from haptorb.errors import InputError, RecordingError, ServoError, UnknownName, WorldError, quote
from haptorb.estimation.calibration_file import Calibration
from haptorb.estimation.tracker_frame import TrackerFrame
from haptorb.files import FileLock, describe_size_limit, sweep
from haptorb.recording.destination import RunRecording
from haptorb.recording.row import LatestRow, RowLayout
from haptorb.runtime import plan
from haptorb.runtime.black_box import BlackBox, TripRecord
from haptorb.runtime.config import RunConfig
from haptorb.runtime.hand_commands import HandCommands
from haptorb.runtime.linux import require_linux, run_uninterrupted
from haptorb.runtime.plan import assemble
from haptorb.runtime.prestart import PrestartedProcess
from haptorb.runtime.process_group import ProcessGroup, SignalStop
from haptorb.runtime.report import (
    RunReport,
    describe_detail,
    describe_slow_world,
    find_program,
    is_tripped,
    loop_report,
    read_detail,
    read_servers,
    tracker_facts,
    world_failure,
)
from haptorb.runtime.shared_memory import BUTTONS, TRIPS, SharedMemory, Word, engage_request
from haptorb.runtime.trackers.feed_tracker import PREDICTION
from haptorb.runtime.trackers.pose_filter import describe_missing_pose
from haptorb.runtime.trackers.registry import Preparation, prepare_tracker
from haptorb.runtime.world_requests import name_of, parse_answer, parse_postponement, request, values_of
from haptorb.simulation.hand_motion import PathFunction, ScriptedMotion
from haptorb.worlds import CATALOGUE
from haptorb.worlds.base import PARTS, World, WrenchPart
from haptorb.worlds.client_force import split_remote
from haptorb.worlds.dynamic import DynamicWorld, count_numbers
from haptorb.worlds.scene import SceneFile
from haptorb.worlds.user_world import FileWithRemote, WorldFile, note_scenes

if TYPE_CHECKING:
    from haptorb.recording.recording import Recording
    from haptorb.runtime.world_loading import WorldWatcher

__all__ = ["MAX_TORQUE_SCALE", "Servo"]

MAX_TORQUE_SCALE = 100.0  #: largest scale of a motor's torques [1]

_POLL_INTERVAL_S = 0.02  #: between two checks of loop, recorder and world
_ANSWER_TIMEOUT_S = 2.0  #: for the servo's answer to a request for another world
_LOAD_TIMEOUT_S = 30.0  #: the same if the servo must load the world, and may have to compile it
_COMPILE_TIMEOUT_S = 150.0  #: the same if another process must compile it first
_NOT_STARTED = "the servo was not started: use `with haptorb.Servo(...) as servo:`"
_PREPARING = "preparing world '{}': its code is being compiled, once on this computer; the previous world continues"


@final
class Servo:
    """Real-time loop that connects a device with a world, in a process of its own.

    A `with` block starts it and ends it with the coils off, in whatever way the block ends.

    Parameters
    ----------
    device : str, Path, Device or RunConfig
        Name in the catalogue, path of a device file, or a Device; or the whole description of a run, which then states
        everything from `world` to `hand`.
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
        (docs/how-to/scripted-hand.md); None: the guided motion. `hand.point`, `hold` and `follow` replace it.
    about : Mapping, optional
        Texts by name that are stored in the recording, such as a study and its session.

    Attributes
    ----------
    config : RunConfig
        Description of the run.
    hand : HandCommands
        Commands to the hand: `servo.hand.point(p)`, `hold`, `follow`, `release`.

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
        If this is not Linux and the driver is a real one, or the tracker has a process of its own.
    """

    def __init__(
        self,
        device: str | Path | Device | RunConfig,
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
        settings: dict[str, Any] = {
            "world": world, "driver": driver, "tracker": tracker, "prediction": prediction, "frame": frame,
            "rate": rate, "seed": seed, "model": model, "estimator": estimator, "gains": gains,
            "calibration": calibration, "watchdog": watchdog, "render": render, "torque_arm": torque_arm,
            "grip": grip, "latency": latency, "hand": hand,
        }  # fmt: skip
        self.config = config = _describe(device, settings)
        if config.driver != "sim":
            require_linux("a real driver")
        if config.has_feed:
            require_linux("a tracker in a process of its own")
        self.hand = HandCommands(config, lambda: self._memory)
        self.tracker_token = ""  #: token that senders on other computers must send first; set by `open`
        name, (plain, _) = name_of(config.world), split_remote(config.world)
        #: worlds beside the catalogue's that `set_world` accepts, by name: the first one, if it is none of those
        self.own_worlds: Mapping[str, World] = {} if type(plain) is CATALOGUE.get(name) else {name: plain}
        self.world_ahead = ""  #: requested world whose code is being compiled, once on this computer
        self._requests = 0
        self._requesting = threading.Lock()
        self._stop_numbers = count(1)
        self._stopped = 0  # number of the last stop
        self._recording = RunRecording(record, overwrite=overwrite)
        self._about = {name: str(text) for name, text in (about or {}).items()}
        self._trips_folder = None if black_box is None else Path(black_box).expanduser().absolute()
        self._black_box: BlackBox | None = None
        self._shared: SharedMemory | None = None
        self._signals: SignalStop | None = None
        self._children: ProcessGroup | None = None
        self._folder: Path | None = None
        self._watcher: WorldWatcher | None = None
        self._claim: FileLock | None = None  # lock of the folder

    # Settings of the run.

    @property
    def device(self) -> Device:
        """The device."""
        return self.config.device

    @property
    def driver(self) -> str:
        """ "sim", or the port or bus of a real device."""
        return self.config.driver

    @property
    def tracker(self) -> str:
        """Source of the pose."""
        return self.config.tracker

    @property
    def rate(self) -> float:
        """Rate of the loop [Hz]."""
        return self.config.rate

    @property
    def seed(self) -> int:
        """Seed of the simulated device."""
        return self.config.seed

    @property
    def estimator(self) -> str:
        """Name of the estimator."""
        return self.config.estimator or ""

    @property
    def render(self) -> WrenchPart | None:
        """Part of the wrench to render, overriding the world; None: the world's."""
        return self.config.render

    @property
    def models(self) -> tuple[str, ...]:
        """Controller models that `set_model` accepts, the default first."""
        return self.device.tick_models

    @property
    def modes(self) -> tuple[str, ...]:
        """Modes that `set_mode` accepts; empty where the device acts directly."""
        return self.device.kind.modes

    @property
    def coupling(self) -> str:
        """The coupling between mover and held body, and its stability margin; empty without a scene."""
        setting = self.config.coupling
        return "" if setting is None else setting.describe(self.config.world)

    # Start and end.

    def open(self, standby: PrestartedProcess | None = None) -> None:
        """Start the servo; returns when the loop runs.

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
        preparation = prepare_tracker(self.tracker) if self.config.has_feed else None
        descriptor: int | None = None
        tidying = threading.Thread(target=sweep, name="haptorb-tidying", daemon=True)  # in parallel with the start
        tidying.start()
        try:
            descriptor = self._recording.open()
            self._start(descriptor, preparation, standby)
            self._recording.keep()
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
        """Switch the coils off and end the loop within a tick; returns at once.

        Every end of a run begins with this; `close` does the rest. May be called from any thread, and twice.
        """
        if self._shared is not None:
            self._shared.words[Word.QUIT] = 1  # safety: stop-first

    def close(self) -> None:
        """Switch the coils off, end all processes and complete the recording. May be called twice.

        A signal meanwhile has its effect afterwards; Ctrl-C while the recorder takes long ends it at once.
        """
        try:
            self.end_loop()
        finally:
            run_uninterrupted(self._tidy)

    def _tidy(self, interrupted: threading.Event) -> None:
        with ExitStack() as last:
            # In reverse order: each is executed even if another one fails.
            if self._claim is not None:
                last.callback(self._claim.close)
            if self._folder is not None:
                last.callback(shutil.rmtree, self._folder, ignore_errors=True)
            if self._shared is not None:
                last.callback(self._shared.unlink)
            if self._signals is not None:
                last.callback(self._signals.close)
            last.callback(self.hand.end)
            if self._children is not None:
                last.callback(self._children.end, interrupted)
            if self._watcher is not None:
                self._watcher.end()

    def _start(self, descriptor: int | None, tracker: Preparation | None, standby: PrestartedProcess | None) -> None:
        with standby or PrestartedProcess() as process:
            file = process.plan
            try:
                plan.save(self._make_plan(), file)
            except OSError as cause:
                advice = "free some room there, or name another folder by TMPDIR"
                if cause.errno == errno.EFBIG:
                    advice = describe_size_limit()
                raise ServoError(f"cannot write to {file.parent.parent}: {cause.strerror}; {advice}") from cause
            except Exception as cause:
                raise InputError(f"world or device cannot be sent to the servo's process: {cause}") from cause
            self._attach(SharedMemory.create(self.layout))
            assert self._shared is not None
            notes = self.config.notes(self.own_worlds.values()) | ({"about": self._about} if self._about else {})
            self._black_box = BlackBox(self._shared, self.device.name, self.rate, self._trips_folder, notes)
            self._claim, self._folder = process.claim, process.folder
            self._signals = SignalStop(self._shared, self.stop)
            self._children = ProcessGroup(process, self._shared, self._black_box, self._signals)
        note_scenes(self.config.world)  # replays of this run's recordings may read them again
        if descriptor is not None:
            path, temporary = self._recording.path, self._recording.temporary_path is not None
            assert path is not None
            self._children.record(descriptor, path, self.rate, notes, temporary=temporary)
        if tracker is not None:
            self.tracker_token = tracker.token
            self._children.track(tracker, self.config.frame)
        # Load the code of reports, trips' recordings and the watcher now: while the loop runs it would delay the
        # heartbeat of this program.
        import_module("numpy.ma")
        import_module("haptorb.recording.mcap")
        if self.config.world_file is not None:
            from haptorb.runtime.world_loading import WorldWatcher  # loads the compiler
        self._children.wait_until_running()
        if self.config.world_file is not None:
            self._watcher = WorldWatcher(
                self.config.world_file, self.config.world, self.device, self._reload, lambda: self.world
            )

    def _reload(self, world: World, values: dict[str, Any]) -> None:
        assert self._folder is not None
        coupling = self.config.coupling
        self.replace_own_world(world if coupling is None else coupling.couple(world), values, self._folder)

    def _make_plan(self) -> plan.Plan:
        """Make the startup data of the servo's process."""
        return plan.Plan(self.config, self.own_worlds, own_implementations(self.device), assemble)

    def _attach(self, shared: SharedMemory) -> None:
        """Exchange commands and rows with a loop through `shared`; an earlier stop takes effect from its first tick."""
        self._shared = shared
        if self._stopped:
            shared.words[Word.STOP] = self._stopped

    @property
    def _memory(self) -> SharedMemory:
        if self._shared is None:
            raise ServoError(_NOT_STARTED)
        return self._shared

    # Context managers, and waiting within their blocks.

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    async def __aenter__(self) -> Self:
        try:
            await _complete(self.open, cancelled=self._end_start)
            if self._signals is not None:
                self._signals.install()  # `open` ran in another thread than this one, the main thread as a rule
        except BaseException:  # the block is not entered, so nothing else ends the loop
            self.end_loop()
            await _complete(self.close)
            raise
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None
    ) -> None:
        self.end_loop()  # safety: async-stop-first
        try:
            await _complete(self.close)
        finally:
            if self._signals is not None:
                self._signals.close()  # again, as the other thread may not restore it

    def _end_start(self) -> None:
        """Switch the coils off although the start goes on, in another thread."""
        self.stop()  # in effect from the first tick
        self.end_loop()

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
        if self._signals is not None:
            self._signals.poll()  # earlier signals, whose exception was caught, are not repeated in here
        begun = monotonic()
        end = begun + _check_seconds(seconds)
        try:
            while (left := self._check_all(end)) > 0:
                sleep(min(left, _POLL_INTERVAL_S))
                if self._signals is not None:
                    self._signals.repeat_lost(begun)
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
            await asyncio.sleep(min(left, _POLL_INTERVAL_S))

    async def watch(self, every: float = _POLL_INTERVAL_S) -> AsyncIterator[LatestRow]:
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

    def _check_all(self, end: float) -> float:
        """Check everything, and return the time until `end` [s]; raises if something is wrong."""
        self.check()
        self.check_world()
        self.hand.check()
        return end - monotonic()

    # Commands, written to shared memory that the loop reads in every tick.

    @property
    def stops(self) -> int:
        """Number of calls of `stop`. Read it when a person requests to engage, and pass it to `engage`."""
        shared = self._shared
        return self._stopped if shared is None else int(shared.words[Word.STOP])

    def stop(self) -> None:
        """Switch the coils off within a tick, until `engage`. May be called from any thread.

        Before or during the start, it takes effect from the first tick.
        """
        # Every stop has its own number: of two threads that stop at once, neither overwrites the other's stop.
        self._stopped = number = next(self._stop_numbers)
        shared = self._shared
        if shared is not None:
            shared.words[Word.STOP] = number

    def engage(self, stops: int | None = None) -> None:
        """Engage after a stop or a trip, from zero force. The guard refuses while the reason persists.

        Parameters
        ----------
        stops : int, optional
            Value of `stops` when the person requested to engage; None: now. The servo refuses if `stop` was called
            since then.
        """
        words = self._memory.words
        words[Word.ENGAGE] = engage_request(words[Word.ENGAGE], self.stops if stops is None else stops)

    def cool(self) -> None:
        """Set simulated coils to the ambient temperature, from the next tick on.

        Raises
        ------
        InputError
            On a real device.
        """
        if self.driver != "sim":
            raise InputError(f"only simulated coils can be cooled at once; driver '{self.driver}' drives a real device")
        self._memory.words[Word.COOL] += 1

    def press(self, buttons: Collection[str]) -> None:
        """Press buttons of the tool for connected programs, and release the others.

        Parameters
        ----------
        buttons : collection of str
            Pressed buttons, of "a", "b" and "c".

        Raises
        ------
        UnknownName
            If there is no such button.
        """
        for name in buttons:
            if name not in BUTTONS:
                raise UnknownName("button", str(name), BUTTONS)
        self._memory.words[Word.BUTTONS] = sum(1 << i for i, name in enumerate(BUTTONS) if name in buttons)

    def set_mode(self, mode: str) -> None:
        """Change the mode of a motor, without a step of the object's pose or of torque.

        Parameters
        ----------
        mode : str
            "translate" or "rotate".

        Raises
        ------
        UnknownName
            If the device does not have this mode.
        """
        if mode not in self.modes:
            raise UnknownName(f"mode of device '{self.device.name}'", str(mode), self.modes)
        self._memory.words[Word.MODE] = 1 + MODES.index(mode)

    def clutch(self, engaged: bool) -> None:
        """Engage or release the clutch of a motor, to turn the handle back and reach further.

        Parameters
        ----------
        engaged : bool
            False: release it.

        Raises
        ------
        InputError
            If the device has no modes.
        """
        if not self.modes:
            raise InputError(f"device '{self.device.name}' has no clutch; its mover acts directly")
        self._memory.words[Word.CLUTCH] = 1 if engaged else 2

    def set_torque_scale(self, scale: float) -> None:
        """Scale all torques of a motor's handle, without a step.

        The motion does not change, so the wrench on the object feels weaker or stronger.

        Parameters
        ----------
        scale : float
            Factor above 0 and up to 100 [1].

        Raises
        ------
        InputError
            For another number, or a device without modes.
        """
        if not self.modes:
            raise InputError(f"device '{self.device.name}' has no torque scale; its mover acts directly")
        if isinstance(scale, bool) or not isinstance(scale, int | float) or not 1e-6 <= scale <= MAX_TORQUE_SCALE:
            raise InputError(f"torque scale must be above 0 and at most {MAX_TORQUE_SCALE:g}; got {quote(scale)}")
        self._memory.words[Word.SCALE] = round(scale * 1e6)

    def pause_recording(self, paused: bool) -> None:
        """Pause or continue the recording; the file states how many rows are missing.

        Parameters
        ----------
        paused : bool
            True: leave rows out from now on.
        """
        self._memory.words[Word.RECORDING_PAUSED] = int(paused)

    @property
    def model(self) -> str:
        """The controller model, or the one to which it is changing."""
        shared = self._shared
        number = 0 if shared is None else int(shared.words[Word.MODEL])
        return self.device.models[number - 1] if number else (self.config.model or self.models[0])

    def set_model(self, name: str) -> None:
        """Change the controller model, without a step of the force: the currents change within 50 ms.

        Parameters
        ----------
        name : str
            One of `models`.

        Raises
        ------
        UnknownName
            If there is no such model.
        InputError
            If the model takes too long for a tick.
        """
        self._memory.words[Word.MODEL] = 1 + self.device.models.index(self.device.check_tick_model(name))

    @property
    def world(self) -> tuple[str, dict[str, Any]]:
        """Name and parameters of the current world."""
        shared = self._shared
        if shared is None or not (known := shared.words[Word.WORLD]):
            return name_of(self.config.world), dict(values_of(self.config.world))
        world = json.loads(shared.worlds_since(known - 1)[-1][1])
        return world["name"], world["values"]

    def add_world(self, world: World, name: str = "") -> None:
        """Make a world available to `set_world`, before the start.

        Parameters
        ----------
        world : World
            The world.
        name : str
            Name for `set_world`; empty: the world's own.

        Raises
        ------
        ServoError
            After the start.
        """
        if self._shared is not None:
            raise ServoError("call add_world before the start: the servo's process receives all worlds at once")
        self.own_worlds = {**self.own_worlds, name or world.name: world}

    def set_world(self, name: str, values: Mapping[str, Any] | None = None) -> None:
        """Render another world, or the same with other parameters, from the next tick on.

        After a first start its code may have to be compiled first; `world_ahead` then has its name.

        Parameters
        ----------
        name : str
            Name in the catalogue, or of a world of this servo.
        values : Mapping, optional
            Parameter → value; those not given stay the same, or are the defaults of a new world.

        Raises
        ------
        UnknownName
            If there is no such world or parameter; nothing changes.
        InputError
            If a value is invalid; nothing changes.
        """
        self._request(name, values or {})

    def replace_own_world(self, world: World, values: Mapping[str, Any], folder: Path) -> None:
        """Render `world` with `values` instead of the own world of its name, as soon as the servo has loaded it.

        `folder` is the servo's own. Raises InputError if the world cannot be sent, or fails there;
        then nothing changes.
        """
        file = folder / f"world-{self._requests + 1}"
        try:
            file.write_bytes(pack(world.replace(**values)))
        except Exception as cause:
            raise InputError(f"world '{world.name}' cannot be sent to the servo's process: {cause}") from cause
        try:
            self._request(world.name, {}, file)
        finally:
            file.unlink(missing_ok=True)
        self.own_worlds = {**self.own_worlds, world.name: world}

    def _request(self, name: str, values: Mapping[str, Any], file: Path | None = None) -> None:
        shared = self._memory
        with self._requesting:
            self.check()
            self._requests += 1
            shared.request.write(request(self._requests, name, values, "" if file is None else str(file)))
            try:
                self._await_answer(shared, name, _ANSWER_TIMEOUT_S if file is None else _LOAD_TIMEOUT_S)
            finally:
                self.world_ahead = ""

    def _await_answer(self, shared: SharedMemory, name: str, longest: float) -> None:
        """Wait until the request for the world `name` is answered, for at most `longest` [s]."""
        deadline = monotonic() + longest
        while True:
            text = shared.answer.read()[1]
            number, error = parse_answer(text)
            if number == self._requests:
                if error is not None:
                    raise error
                return
            if not self.world_ahead and parse_postponement(text) == self._requests:
                self.world_ahead, longest = name, _COMPILE_TIMEOUT_S
                deadline = monotonic() + longest
                self._processes.compiler.compile_world(name)
            self.check()
            if self.world_ahead:
                self._processes.compiler.check()
            if monotonic() > deadline:
                raise ServoError(f"the servo did not respond within {longest:g} s; close other programs, and try again")
            sleep(0.0005)

    # Data from the loop.

    @property
    def layout(self) -> RowLayout:
        """Layout of a row, with room for the memory of every world that this servo was given."""
        if self._shared is not None:
            return self._shared.layout
        given = (self.config.world, *self.own_worlds.values())
        sizes = [count_numbers(one.memory_fields) for one in given if isinstance(one, DynamicWorld)]
        return RowLayout.of(self.device, max(sizes, default=0))

    def __repr__(self) -> str:
        return (
            f"<Servo of {self.device.name}, world '{self.world[0]}', driver {self.driver}, tracker {self.tracker}, "
            f"{self.rate:g} Hz: {self._describe_phase()}>"
        )

    def _describe_phase(self) -> str:
        """Describe whether it runs, and with which force; or why not."""
        if self._children is None:
            return "not started"
        try:
            self._children.check()
            row = self.latest()
        except (ServoError, RecordingError) as cause:
            return str(cause)
        if row.guard == GuardState.TRIPPED:
            return f"running, coils off. {Trip(int(row.trip)).text}"
        return f"running, actual force {format_vector(row.wrench_actual[:3], 'N')}"

    @property
    def alive(self) -> bool:
        """Whether the loop runs."""
        return self._children is not None and self._children.alive

    @property
    def _processes(self) -> ProcessGroup:
        if self._children is None:
            raise ServoError(_NOT_STARTED)
        return self._children

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
        `address`, `clients`, each with its name, `session`, `rate_hz` and whether it `holds` the device, and
        `programs`, the last ones that commanded: `ProgramHold`."""
        shared = self._shared
        return [] if shared is None else read_servers(shared)

    @property
    def trip_program(self) -> str:
        """Name of the program that commanded at the last trip; empty: none, or no trip."""
        shared = self._shared
        count = 0 if shared is None else min(int(shared.words[Word.TRIPS]), TRIPS)
        return "" if shared is None or not count else find_program(shared, float(shared.trips[count - 1, 0]))

    @property
    def recording_trouble(self) -> str:
        """Why the recording ended early, or is stalled; empty if there is no problem."""
        return self._children.recorder_trouble if self._children is not None else ""

    @property
    def warning(self) -> str:
        """Warnings for the user: about the connected device, the servo's memory, the code of world and path, and a
        world that is being prepared; empty if there are none."""
        if self._shared is None or self._children is None:
            return ""
        found = (
            self._shared.warning.read()[1], self._children.memory.warning, self.world_trouble, self.hand.trouble,
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
            raise ServoError(_NOT_STARTED)
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
            New rows, oldest first, each field in its unit [SI]; `layout["wrench_actual"]` are the columns of a field.
        """
        return self._memory.ring.read_since(cursor, most)

    def latest(self) -> LatestRow:
        """Read the newest tick, by field name: `latest().wrench_actual` or `latest()["wrench_actual"]`.

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
        loop, children = loop_report(self._memory, self.tracker), self._processes
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
        shared = self._shared
        return dict(tracker_facts(shared).get("refused", {})) if shared is not None else {}

    @property
    def missing_pose(self) -> str:
        """The missing pose, with the counts so far, while the newest row has no valid pose from a tracker with its own
        process; else empty."""
        shared = self._shared
        row = None if shared is None else shared.ring.latest()
        if shared is None or row is None or row[shared.layout["valid"].start] == 1.0:
            return ""
        return describe_missing_pose(self.tracker, tracker_facts(shared))

    @cached_property
    def part_remarks(self) -> tuple[str, ...]:
        """Remarks about each part of the wrench that can be rendered, by its number in the row; empty for a device
        without a choice, and for a part without remarks."""
        choice = make_choice(self.device, self.config.render, self.config.torque_arm)
        return () if choice is None else describe_choice(self.device, choice)

    @property
    def rendered_part(self) -> WrenchPart | None:
        """The part of the world's wrench that is rendered now; None for a device without a choice, and before the first
        tick."""
        shared = self._shared
        row = None if shared is None else shared.ring.latest()
        number = -1.0 if row is None else float(row[self.layout["part"].start])
        return PARTS[int(number)] if number >= 0.0 else None  # NaN too: unknown

    @property
    def trips(self) -> tuple[TripRecord, ...]:
        """The first 64 trips, each with the last 100 ticks up to it."""
        if self._black_box is None:
            return ()
        self._black_box.collect()
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

    # Commands to the hand by their names in earlier versions.

    def point(self, p: ArrayLike, q: ArrayLike | None = None, *, patience: float = 0.0) -> None:
        """Earlier name of `hand.point`; see there.

        Parameters
        ----------
        p : array_like, shape (3,)
            Position [m].
        q : array_like, shape (4,), optional
            Orientation as a unit quaternion [1].
        patience : float
            Time for which a simulated hand stays there longer [s].
        """
        self.hand.point(p, q, keep_alive=patience)

    def hold(self, p: ArrayLike, q: ArrayLike | None = None) -> None:
        """Earlier name of `hand.hold`; see there.

        Parameters
        ----------
        p : array_like, shape (3,)
            Position [m].
        q : array_like, shape (4,), optional
            Orientation as a unit quaternion [1].
        """
        self.hand.hold(p, q)

    def follow(self, path: PathFunction | ArrayLike, times: ArrayLike | None = None) -> None:
        """Earlier name of `hand.follow`; see there.

        Parameters
        ----------
        path : callable or array_like, shape (n, 3) or (n, 7)
            Function of time, or poses [m].
        times : array_like, shape (n,), optional
            Times of the poses [s].
        """
        self.hand.follow(path, times)

    def release(self) -> None:
        """Earlier name of `hand.release`; see there."""
        self.hand.release()


def _check_seconds(seconds: float) -> float:
    duration = float(check_finite(seconds, "seconds"))
    if duration < 0:
        raise InputError(f"seconds must not be negative; got {seconds!r}")
    return duration


async def _complete(work: Callable[[], None], cancelled: Callable[[], None] = lambda: None) -> None:
    """Run `work` in a thread, to its end: a cancelled task calls `cancelled` and waits for it, because a servo that was
    started in part must be closed.

    In a thread of its own: those of the event loop's executor may all be blocked, or it may have been shut down.
    """
    loop, ended, failures = asyncio.get_running_loop(), asyncio.Event(), list[BaseException]()

    def run() -> None:
        try:
            work()
        except BaseException as cause:
            failures.append(cause)
        with suppress(RuntimeError):  # the event loop was closed meanwhile
            loop.call_soon_threadsafe(ended.set)

    threading.Thread(target=copy_context().run, args=(run,), name=f"haptorb-{work.__name__}").start()
    interruption: asyncio.CancelledError | None = None
    while not ended.is_set():
        try:
            await ended.wait()
        except asyncio.CancelledError as cause:
            interruption = cause
            cancelled()
    if interruption is not None:
        raise interruption
    if failures:
        raise failures[0]


def _describe(device: str | Path | Device | RunConfig, settings: Mapping[str, Any]) -> RunConfig:
    """Make the description of a run, or return the given one. Raises InputError for settings beside a given one."""
    if not isinstance(device, RunConfig):
        return RunConfig.of(device, **settings)
    usual = {name: parameter.default for name, parameter in signature(RunConfig.of).parameters.items()}
    beside = [name for name, value in settings.items() if value is not usual[name] and value != usual[name]]
    if beside:
        raise InputError(
            f"a RunConfig states everything about the run: leave out {', '.join(beside)}, or replace them in it"
        )
    return device
