"""The servo for Python programs: start it, move the hand, stop, change the world, read rows.

The loop runs in its own process; a third process records. Leaving the `with` block in any way ends both, with the
coils off.
"""

from __future__ import annotations

import json
import os
import shutil
import threading
from collections.abc import Callable, Mapping
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, Literal, final

from haptorb.control.clutch.gains import Gains
from haptorb.control.stability.coupling_choice import CouplingSetting
from haptorb.control.stability.hand_grip import check_grip
from haptorb.devices.device import Device
from haptorb.devices.electromagnet.api import electromagnet
from haptorb.devices.loader import load
from haptorb.devices.state import State
from haptorb.errors import InputError, ServoError
from haptorb.numerics.arrays import Array
from haptorb.runtime.exchange import plan as plans
from haptorb.runtime.exchange.black_box import BlackBox
from haptorb.runtime.exchange.shared_memory import SharedMemory, Word
from haptorb.runtime.exchange.world_change import description
from haptorb.runtime.processes.prestart import PrestartedProcess
from haptorb.runtime.realtime.end_signals import hold_signals
from haptorb.runtime.realtime.linux import require_linux
from haptorb.runtime.realtime.schedule import check_rate
from haptorb.runtime.realtime.stale_files import FileLock, sweep
from haptorb.runtime.recording.run_recording import RunRecording
from haptorb.runtime.servo.launch import check_seed, describe_choices, notes, recorder_spec, tracker_spec
from haptorb.runtime.servo.process_group import ProcessGroup
from haptorb.runtime.servo.servo_context import ServoContext
from haptorb.runtime.servo.signal_stop import SignalStop
from haptorb.runtime.servo.world_watcher import WorldWatcher, choose_world
from haptorb.runtime.tick.assembly import (
    assemble,
    check_driver,
    check_estimator,
    choice_of,
    default_world,
    linkage_of,
    modes_of,
)
from haptorb.runtime.tick.compilation import Compilation
from haptorb.runtime.trackers.feed_tracker import PREDICTION, check_prediction
from haptorb.runtime.trackers.tracker_registry import Preparation, check_frame, check_tracker, has_feed, prepare_tracker
from haptorb.sensing.calibration.calibration import Calibration
from haptorb.sensing.calibration_file import read_calibration, read_frame
from haptorb.sensing.frame.tracker_frame import TrackerFrame
from haptorb.worlds.bound_world import check_world_period
from haptorb.worlds.own.failure import fit_world
from haptorb.worlds.own.file_with_remote import FileWithRemote
from haptorb.worlds.own.world_file import WorldFile
from haptorb.worlds.scene.scene_file import SceneFile
from haptorb.worlds.world import World

__all__ = ["Servo"]


@final
class Servo(ServoContext):
    """A device, a world, and the loop that connects them.

    device     name in the catalogue, path of a device file, or a Device
    world      name in the catalogue, a World, a function of a State that returns a wrench (6,), or "FILE.py:NAME"
               (WorldFile), or a SceneFile, reloaded whenever it is saved, with or without clients' force
               (FileWithRemote); None: the default world of the kind of device
    driver     "sim": the simulated device; "serial:PORT" or "i2c:BUS": a real device
    tracker    "pointer": the pose set by `point`; "hall": the field sensors, while the simulated hand follows `point`;
               "osc:PORT", "lsl:NAME", "replay:FILE", "natnet:HOST": a tracker in its own process, see
               `tracker_registry`
    prediction  longest time by which such a tracker's pose is extrapolated with its own velocity [s]
    frame      file of `haptorb frame` (or a TrackerFrame) that transforms such a tracker's poses into those of the tool
               in the stator's frame; None: they are already in it
    rate       of the loop [Hz], 50 to 4000
    record     file to record to (MCAP); None: a temporary one, deleted at exit; False: no recording
    overwrite  whether `record` may replace a file
    seed       of the simulation's noise
    model      controller model, one of the device's `tick_models`; None: the first
    estimator  name of the estimator; None: the device's default
    gains      of a motor's two modes; None: `linkage.MOTOR_GAINS`
    calibration  file of `haptorb calibrate` (or a Calibration) for this device
    render     part of the world's wrench to render, "force", "torque" or "both"; None: the part that the world defines
    torque_arm  length that weights torque against force if both are rendered [m]; None: `whole_wrench.TORQUE_ARM`
    watchdog   False: drive an I²C bus although nothing switches off when this computer stops; do not touch the device
    grip       of the hand for which the coupling of a scene is chosen: "loose", "light", "firm", or
               "MASS,DAMPING,STIFFNESS"
    latency    of the tracker, for the same choice [s]; None: 5 ms (assumed) if it has its own process
    black_box  folder for a recording of the last 100 ticks before every trip; None: they are in `trips` only
    about      what a recording is of: texts by name, kept in its file, such as a study and its session

    Raises UnknownName for an unknown name; InputError for an invalid value, or for a world, tracker or gains that do
    not fit the device; DeviceError for an invalid device file; CalibrationError for a calibration or frame that cannot
    be read or belongs to another device or tracker; PlatformError if this is not Linux.
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
        about: Mapping[str, str] | None = None,
    ) -> None:
        require_linux("haptorb.Servo")
        self.device = device if isinstance(device, Device) else load(device)
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
        # Compiling in the first tick would be a silence at which a real device's firmware switches off.
        chain, practice = (
            partial(
                assemble, self.device, first, through, self.rate, self.seed, self._model,
                estimator=self.estimator, gains=gains, calibration=self.calibration, watchdog=watchdog,
                render=render, torque_arm=torque_arm,
            )
            for through in (self.driver, "sim")
        )  # fmt: skip
        self._ahead = check_prediction(prediction)
        self.frame = read_frame(frame) if isinstance(frame, str | Path) else frame  #: between tracker and stator
        if self.frame is not None:
            check_frame(self.frame, self.device, self.tracker, self.driver)
        self._plan = plans.Plan(
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
        """Start: returns when the loop runs. Raises RecordingError or ServoError, with nothing left running.

        standby: a process that was started early, for this servo; None: start one now.
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
        self.end_loop()
        with hold_signals() as interrupted:
            if self._watcher is not None:
                self._watcher.end()
            if self._children is not None:
                self._children.end(interrupted)
            self._end_hand()
            if self._signals is not None:
                self._signals.close()
            if self._shared is not None:
                self._shared.unlink()
            if self._folder is not None:
                shutil.rmtree(self._folder, ignore_errors=True)
            if self._claim is not None:
                self._claim.close()

    @property
    def _memory_or_none(self) -> SharedMemory | None:
        return self._shared

    def _start(self, descriptor: int | None, tracker: Preparation | None, standby: PrestartedProcess | None) -> None:
        with standby or PrestartedProcess() as process:
            file = process.plan
            try:
                plans.save(self._plan, file)
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
            "seed": str(self.seed),
            "rate_hz": repr(self.rate),
            "first_world": description(self._plan.world),
            **describe_choices(self._gains, self._torque_arm, (self._plan.world, *self.own_worlds.values())),
        }
        return notes(self.device, run) | ({"about": self._about} if self._about else {})
