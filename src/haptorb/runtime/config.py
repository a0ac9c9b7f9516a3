"""Configuration of a run (device, world, loop), shared by command line, servo, recording and replay."""

from __future__ import annotations

import json
from base64 import b64decode, b64encode
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Self, final

import numpy as np

from haptorb import worlds
from haptorb.analysis.coupling import CouplingSetting
from haptorb.analysis.stability import check_grip
from haptorb.arrays import Array
from haptorb.control.linkage import Gains, make_linkage
from haptorb.control.registry import make_choice
from haptorb.devices.api import electromagnet
from haptorb.devices.base import Device, State
from haptorb.devices.loader import find_device
from haptorb.errors import InputError, RecordingError, UnknownName, quote
from haptorb.estimation.calibration_file import Calibration, read_calibration, read_frame
from haptorb.estimation.registry import check_estimator, read_learned
from haptorb.estimation.tracker_frame import TrackerFrame
from haptorb.recording.destination import describe_machine, list_versions
from haptorb.runtime.clock import check_rate
from haptorb.runtime.drivers.registry import check_driver, is_real
from haptorb.runtime.hand_file import choose_hand
from haptorb.runtime.trackers.feed_tracker import PREDICTION, check_prediction
from haptorb.runtime.trackers.registry import check_frame, check_tracker, has_feed
from haptorb.runtime.world_requests import description, name_of
from haptorb.simulation.hand_motion import ScriptedMotion
from haptorb.worlds.base import World, WrenchPart, check_part
from haptorb.worlds.dynamic import check_world_period
from haptorb.worlds.scene import SceneFile
from haptorb.worlds.user_world import (
    MAX_NOTE_CHARACTERS,
    FileWithRemote,
    WorldFile,
    fit_world,
    is_world_file,
    make_world,
    note_world,
    parse_world_file,
)

__all__ = ["HAND_STARTS", "RunConfig", "check_seed", "choose_world", "find_number", "read_object"]

HAND_STARTS = ("run", "program")  #: when the motion of a scripted hand begins


@final
@dataclass(frozen=True, kw_only=True)
class RunConfig:
    """Description of a run: everything from which the loop is built, and that a recording states.

    `of` makes one from names and files, checked; `replace` of `dataclasses` changes one. `notes` writes it into a
    recording, `from_notes` reads it from there.

    Parameters
    ----------
    device : Device
        The device.
    world : World
        The world at the start, coupled to the mover if it is a scene.
    driver : str
        "sim", "serial:PORT" or "i2c:BUS".
    tracker : str
        Source of the pose: "pointer", "hall", "osc:PORT", "lsl:NAME", "natnet:HOST" or "replay:FILE".
    prediction : float
        Longest time by which a pose of a tracker with its own process is extrapolated [s].
    frame : TrackerFrame, optional
        Transform between such a tracker's frame and the stator frame.
    rate : float
        Rate of the loop [Hz].
    seed : int
        Seed of the simulated device: it chooses its deviations and its noise.
    model : str, optional
        Controller model; None: the first of the device.
    estimator : str, optional
        Name of the estimator; None: the default of the device.
    gains : Gains, optional
        Gains of a motor's two modes; None: the default.
    calibration : Calibration, optional
        Calibration that the controller uses beside the device file.
    watchdog : bool
        False: an I²C bus may be driven without a monostable.
    render : str, optional
        Part of the wrench to render, "force", "torque" or "both"; None: the part that the world defines.
    torque_arm : float, optional
        Length that weights torque against force if both are rendered [m].
    learned : bytes
        Trained data of the estimator, such as networks; empty: that of this computer.
    coupling : CouplingSetting, optional
        Loop and hand for which the coupling of a scene is chosen, also of one that is loaded again.
    world_file : WorldFile or SceneFile, optional
        File of the world, which is loaded again when it is saved.
    hand : ScriptedMotion, optional
        Motion of the simulated hand; None: the guided motion of the kind of device.
    hand_start : str
        When that motion begins: "run": with the loop; "program": when a program of `--serve native` opens the device.
    """

    device: Device
    world: World
    driver: str = "sim"
    tracker: str = "pointer"
    prediction: float = PREDICTION
    frame: TrackerFrame | None = None
    rate: float = 1000.0
    seed: int = 0
    model: str | None = None
    estimator: str | None = None
    gains: Gains | None = None
    calibration: Calibration | None = None
    watchdog: bool = True
    render: WrenchPart | None = None
    torque_arm: float | None = None
    learned: bytes = b""
    coupling: CouplingSetting | None = None
    world_file: WorldFile | SceneFile | None = None
    hand: ScriptedMotion | None = None
    hand_start: str = "run"

    @classmethod
    def of(
        cls,
        device: str | Path | Device,
        world: str | World | WorldFile | SceneFile | FileWithRemote | Callable[[State], Array] | None = None,
        *,
        driver: str = "sim",
        tracker: str = "pointer",
        prediction: float = PREDICTION,
        frame: str | Path | TrackerFrame | None = None,
        rate: float = 1000.0,
        seed: int = 0,
        model: str | None = None,
        estimator: str | None = None,
        gains: Gains | None = None,
        calibration: str | Path | Calibration | None = None,
        watchdog: bool = True,
        render: str | None = None,
        torque_arm: float | None = None,
        grip: str = "light",
        latency: float | None = None,
        hand: str | Path | ScriptedMotion | None = None,
        hand_start: str = "run",
    ) -> Self:
        """Make the description of a run from names and files, and check it.

        Parameters
        ----------
        device : str, Path or Device
            Device, or its name in the catalogue, or path of its file.
        world : str, World, WorldFile, SceneFile, FileWithRemote, callable or None
            World, its name, its file, or a function that returns a wrench, shape (6,) [N, N·m]; None: the default
            world of the kind of device.
        driver, tracker : str
            As the fields of that name.
        prediction : float
            As the field [s].
        frame : str, Path or TrackerFrame, optional
            Frame, or path of its file.
        rate : float
            As the field [Hz].
        seed : int
            As the field.
        model, estimator : str, optional
            As the fields.
        gains : Gains, optional
            As the field.
        calibration : str, Path or Calibration, optional
            Calibration, or path of its file.
        watchdog : bool
            As the field.
        render : str, optional
            As the field.
        torque_arm : float, optional
            As the field [m].
        grip : str
            Hand for which the coupling of a scene is chosen: "loose", "light", "firm", or "MASS,DAMPING,STIFFNESS".
        latency : float, optional
            Latency of the tracker for the same choice [s].
        hand : str, Path or ScriptedMotion, optional
            Motion of the simulated hand, or its file: CSV, script or recording.
        hand_start : str
            As the field.

        Returns
        -------
        RunConfig
            With names resolved: model and estimator are never None.

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
        """
        known = find_device(device)
        driver = check_driver(driver)
        if hand_start not in HAND_STARTS:
            raise UnknownName("start of the hand's motion", hand_start, HAND_STARTS)
        tracker = check_tracker(tracker, driver)
        rate = check_rate(rate)
        seed = check_seed(seed)
        estimator = check_estimator(known, "hall" if tracker == "hall" and estimator is None else estimator)
        model = known.check_tick_model(model or known.tick_models[0])
        measured = read_calibration(calibration) if isinstance(calibration, str | Path) else calibration
        if measured is not None:
            measured.apply(electromagnet(known, "a calibration"))  # raises for a calibration of another device
        if gains is not None:
            make_linkage(known, gains)  # raises if they do not fit the device
        part = None if render is None else check_part(render)
        make_choice(known, part, torque_arm)  # raises if they do not fit the device
        first, file = choose_world(known.kind.world if world is None else world)
        coupling = CouplingSetting(known, rate, check_grip(grip), estimator, has_feed(tracker), latency)
        first = coupling.couple(first)
        check_world_period(fit_world(first, known), 1.0 / rate)  # raises if the device cannot render the world
        prediction = check_prediction(prediction)
        transform = read_frame(frame) if isinstance(frame, str | Path) else frame
        if transform is not None:
            check_frame(transform, known, tracker, driver)
        return cls(
            device=known, world=first, driver=driver, tracker=tracker, prediction=prediction, frame=transform,
            rate=rate, seed=seed, model=model, estimator=estimator, gains=gains, calibration=measured,
            watchdog=watchdog, render=part, torque_arm=torque_arm, coupling=coupling, world_file=file,
            hand=choose_hand(hand, known, driver, tracker), hand_start=hand_start,
        )  # fmt: skip

    @classmethod
    def from_notes(cls, device: Device, world: World, run: Mapping[str, str], source: str) -> Self:
        """Read the description of a run from a recording.

        Parameters
        ----------
        device : Device
            Device of the recording.
        world : World
            World to begin with.
        run : Mapping
            Texts of the recording's "run", as `notes` writes them; every one may be missing.
        source : str
            Name of the recording, for messages.

        Returns
        -------
        RunConfig
            Without tracker, frame and file of the world, which a replay does not need. Nothing is checked: estimator
            and model may be unknown to this version.

        Raises
        ------
        CalibrationError
            If the recorded calibration cannot be read.
        RecordingError
            If haptorb did not write the gains.
        """
        text, part = run.get("calibration", ""), run.get("render") or None
        try:
            learned = b64decode(run.get("learned", ""), validate=True)
        except ValueError:
            learned = b""
        return cls(
            device=device,
            world=world,
            driver=run.get("driver") or "sim",
            rate=find_number(run, "rate_hz") or 1000.0,
            model=run.get("model") or None,
            estimator=run.get("estimator") or None,
            gains=_read_gains(run, source),
            calibration=Calibration.parse(text, f"the calibration in {source}") if text else None,
            render=None if part is None else check_part(part),
            torque_arm=find_number(run, "torque_arm_m"),
            learned=learned,
        )

    @property
    def is_real(self) -> bool:
        """Whether a real device is driven. Its field sensors are multiplexed."""
        return is_real(self.driver)

    @property
    def has_feed(self) -> bool:
        """Whether the pose comes from a tracker in a separate process."""
        return has_feed(self.tracker)

    def simulated(self) -> RunConfig:
        """The same run on the simulated device."""
        return replace(self, driver="sim")

    def notes(self, own_worlds: Iterable[World] = ()) -> dict[str, dict[str, str]]:
        """Metadata of a recording of this run: texts of device, run, software and computer.

        own_worlds: worlds that the run may change to, other than the first one and the catalogue's.
        """
        device, name = self.device, check_estimator(self.device, self.estimator)
        made = {name_of(one): note_world(one) for one in (self.world, *own_worlds)}
        run = {
            "driver": self.driver,
            "tracker": self.tracker,
            "prediction_s": repr(self.prediction) if self.has_feed else "",
            "frame": "" if self.frame is None else self.frame.text(),
            "estimator": name,
            "model": self.model or device.tick_models[0],
            "models": " ".join(device.models),
            "render": self.render or "",
            "calibration": "" if self.calibration is None else self.calibration.text(),
            "hand": "" if self.hand is None else f"{self.hand.name} {self.hand.digest}".strip(),
            "hand_start": "" if self.hand is None else self.hand_start,
            "seed": str(self.seed),
            "rate_hz": repr(self.rate),
            "first_world": description(self.world),
            "gains": "" if self.gains is None else json.dumps(asdict(self.gains)),
            "torque_arm_m": "" if self.torque_arm is None else repr(self.torque_arm),
            "worlds": json.dumps({one: text for one, text in made.items() if len(text) <= MAX_NOTE_CHARACTERS}),
        }
        if learned := self.learned or read_learned(device, name):
            run["learned"] = b64encode(learned).decode()
        return {
            "device": {
                "name": device.name,
                "digest": device.digest,
                "title": device.title,
                "source": device.source,
                **(device.text.as_note() if device.text else {"file": ""}),
                "coils": json.dumps(device.coils.names),
            },
            "run": run,
            "versions": list_versions(),
            "machine": describe_machine(),
        }


def check_seed(seed: int) -> int:
    """Return `seed`; raise InputError unless it is a non-negative integer."""
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise InputError(f"seed must be a whole number, 0 or more; got {seed!r}")
    return seed


def choose_world(
    given: str | World | WorldFile | SceneFile | FileWithRemote | Callable[[State], Array],
) -> tuple[World, WorldFile | SceneFile | None]:
    """Resolve the world `given` by name or object; return it, and its file if it comes from one.

    A function as a world returns (6,) [N, N·m]. Raises UnknownName or InputError as `find_world`, `make_world` and
    `WorldFile.load` do.
    """
    if isinstance(given, str) and is_world_file(given):
        given = parse_world_file(given)
    if isinstance(given, WorldFile | SceneFile | FileWithRemote):
        return given.load(), given.file if isinstance(given, FileWithRemote) else given
    return (worlds.find_world(given)() if isinstance(given, str) else make_world(given)), None


# --------------------------------------------------------------------------------------------------
# Parsing of the metadata of a recording.


def read_object(run: Mapping[str, str], key: str) -> dict[str, Any]:
    """Parse the JSON object in the text `key` of `run`; empty if there is none."""
    try:
        found = json.loads(run.get(key) or "{}")
    except (ValueError, RecursionError):
        found = {}
    return found if isinstance(found, dict) else {}


def _read_gains(run: Mapping[str, str], source: str) -> Gains | None:
    """Parse the gains of `run`; None if it has none. Raises RecordingError for what are no gains."""
    gains = read_object(run, "gains")
    if not gains:
        return None
    try:
        given: dict[str, Any] = {name: None if value is None else tuple(value) for name, value in gains.items()}
        return Gains(**given)
    except (TypeError, ValueError) as cause:  # another program may have written it
        raise RecordingError(
            f"{source} cannot be replayed: its gains are {quote(gains)} ({quote(str(cause), 200)[1:-1]})"
        ) from cause


def find_number(run: Mapping[str, str], key: str) -> float | None:
    """Parse the positive number in the text `key` of `run`; None if there is none."""
    try:
        number = float(run.get(key, ""))
    except ValueError:
        return None
    return number if np.isfinite(number) and number > 0.0 else None
