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
from haptorb.analysis.stability import HandGrip, check_grip
from haptorb.arrays import Array, whole_number
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
from haptorb.runtime.trackers.registry import check_frame, check_tracker, has_feed, is_tracker_name
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
    recording, `from_notes` reads it from there, but for what the recording does not contain: see there.

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
        """Read the description of a run from a recording: what `notes` writes.

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
            Every field as recorded, and its default where the text is missing or another program's, with two
            exceptions, which have their defaults: `hand`, whose recorded text is only its name and digest, and
            `world_file`, which is not recorded, because no file is loaded because of a recording.

        Raises
        ------
        CalibrationError
            If the recorded calibration or frame cannot be read.
        RecordingError
            If the gains or the coupling are a JSON object that haptorb did not write, or the part to render is none.

        Notes
        -----
        Nothing is opened, connected or run, and nothing is checked against this computer: estimator and model may be
        unknown to this version, and driver and tracker name ports and addresses of the computer that recorded. Check
        these two and `watchdog` before you start a servo with a description from somebody else's recording;
        `simulated` returns one that drives no device.
        """
        origin = _Origin(device, source)
        read = {note.field: note.read(run.get(note.key) or "", origin) for note in _NOTES}
        return cls(device=device, world=world, **{name: value for name, value in read.items() if value is not None})

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
        device = self.device
        made = {name_of(one): note_world(one) for one in (self.world, *own_worlds)}
        run = {note.key: note.write(self) for note in _NOTES} | {
            "models": " ".join(device.models),
            "first_world": description(self.world),
            "worlds": json.dumps({one: text for one, text in made.items() if len(text) <= MAX_NOTE_CHARACTERS}),
        }
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
# Texts of the "run" in the metadata of a recording, which may come from strangers.


def read_object(run: Mapping[str, str], key: str) -> dict[str, Any]:
    """Parse the JSON object in the text `key` of `run`; empty if there is none."""
    return _parse_object(run.get(key) or "")


def find_number(run: Mapping[str, str], key: str) -> float | None:
    """Parse the positive number in the text `key` of `run`; None if there is none."""
    return _parse_positive(run.get(key) or "")


@dataclass(frozen=True)
class _Origin:
    """Where the texts of a run come from: a recording of `device`, and its name for messages."""

    device: Device
    source: str

    def refuse(self, what: str, got: object, cause: Exception) -> RecordingError:
        """Make the error for a text that haptorb did not write."""
        reason = f"{cause.args[0]} is missing" if isinstance(cause, KeyError) else quote(str(cause), 200)[1:-1]
        return RecordingError(
            f"the description of the run in {self.source} cannot be read: its {what} are {quote(got)} ({reason})"
        )


@dataclass(frozen=True)
class _Note:
    """Text of a recording for a field of `RunConfig`.

    field  name of the field
    key    of the text in the metadata record "run"
    write  makes the text of a run; empty: none
    read   makes the value of a text from a recording of _Origin; None for the default: no text, or a foreign one
    """

    field: str
    key: str
    write: Callable[[RunConfig], str]
    read: Callable[[str, _Origin], Any]


def _parse_object(text: str) -> dict[str, Any]:
    try:
        found = json.loads(text or "{}")
    except (ValueError, RecursionError):
        found = {}
    return found if isinstance(found, dict) else {}


def _parse_number(text: str) -> float | None:
    """Parse a finite number; None if it is none."""
    try:
        number = float(text)
    except ValueError:
        return None
    return number if np.isfinite(number) else None


def _write_number(number: float | None) -> str:
    return "" if number is None else repr(float(number))


def _parse_positive(text: str) -> float | None:
    number = _parse_number(text)
    return number if number is not None and number > 0.0 else None


_MAX_NAME_CHARACTERS = 4096  #: of a driver, tracker, estimator or model: names may contain a path


def _read_name(text: str, _: _Origin) -> str | None:
    return text if text and len(text) <= _MAX_NAME_CHARACTERS and text.isprintable() else None


def _read_driver(text: str, origin: _Origin) -> str | None:
    try:
        return check_driver(_read_name(text, origin) or "sim")
    except UnknownName:
        return None


def _read_tracker(text: str, origin: _Origin) -> str | None:
    name = _read_name(text, origin)
    return name if name is not None and is_tracker_name(name) else None


def _read_checked(check: Callable[[float], float]) -> Callable[[str, _Origin], float | None]:
    """Make the reader of a number that `check` accepts; it raises InputError for others, which give the default."""

    def read(text: str, _: _Origin) -> float | None:
        number = _parse_number(text)
        try:
            return None if number is None else check(number)
        except InputError:
            return None

    return read


def _read_frame(text: str, origin: _Origin) -> TrackerFrame | None:
    return TrackerFrame.parse(text, f"the frame in {origin.source}") if text else None


def _read_seed(text: str, _: _Origin) -> int | None:
    return whole_number(text, 1000)


def _write_gains(run: RunConfig) -> str:
    return "" if run.gains is None else json.dumps(asdict(run.gains))


def _read_gains(text: str, origin: _Origin) -> Gains | None:
    gains = _parse_object(text)
    if not gains:
        return None
    try:
        given: dict[str, Any] = {name: None if value is None else tuple(value) for name, value in gains.items()}
        return Gains(**given)
    except (TypeError, ValueError) as cause:  # another program may have written it
        raise origin.refuse("gains", gains, cause) from cause


def _read_calibration(text: str, origin: _Origin) -> Calibration | None:
    return Calibration.parse(text, f"the calibration in {origin.source}") if text else None


def _read_part(text: str, origin: _Origin) -> WrenchPart | None:
    try:
        return check_part(text) if text else None
    except UnknownName as cause:
        raise RecordingError(f"{origin.source} cannot be replayed: {cause}") from cause


def _write_learned(run: RunConfig) -> str:
    learned = run.learned or read_learned(run.device, run.estimator or check_estimator(run.device, None))
    return b64encode(learned).decode()


def _read_learned(text: str, _: _Origin) -> bytes:
    try:
        return b64decode(text, validate=True)
    except ValueError:
        return b""


def _write_coupling(run: RunConfig) -> str:
    if (setting := run.coupling) is None:
        return ""
    hand = setting.hand
    return json.dumps(
        {
            "rate_hz": float(setting.rate),
            "mass_kg": float(hand.mass),
            "damping_n_s_per_m": float(hand.damping),
            "stiffness_n_per_m": float(hand.stiffness),
            "estimator": setting.estimator,
            "fed": setting.fed,
            "latency_s": None if setting.latency is None else float(setting.latency),
        }
    )


def _read_coupling(text: str, origin: _Origin) -> CouplingSetting | None:
    noted = _parse_object(text)
    if not noted:
        return None
    try:
        hand = HandGrip(*(float(noted[key]) for key in ("mass_kg", "damping_n_s_per_m", "stiffness_n_per_m")))
        estimator, fed, latency = noted["estimator"], noted["fed"], noted["latency_s"]
        if not isinstance(fed, bool) or not isinstance(estimator, str) or _read_name(estimator, origin) is None:
            raise TypeError("estimator must be a name, and fed true or false")
        late = None if latency is None else float(latency)
        return CouplingSetting(origin.device, check_rate(noted["rate_hz"]), hand, estimator, fed, late)
    except (KeyError, TypeError, ValueError, OverflowError) as cause:  # another program may have written it
        raise origin.refuse("conditions of the coupling", noted, cause) from cause


#: Every field but `device` and `world`, which have records of their own, and `world_file`, which is not recorded.
_NOTES = (
    _Note("driver", "driver", lambda run: run.driver, _read_driver),
    _Note("tracker", "tracker", lambda run: run.tracker, _read_tracker),
    _Note("prediction", "prediction_s", lambda run: _write_number(run.prediction), _read_checked(check_prediction)),
    _Note("frame", "frame", lambda run: "" if run.frame is None else run.frame.text(), _read_frame),
    _Note("rate", "rate_hz", lambda run: _write_number(run.rate), _read_checked(check_rate)),
    _Note("seed", "seed", lambda run: str(run.seed), _read_seed),
    _Note("model", "model", lambda run: run.model or run.device.tick_models[0], _read_name),
    _Note("estimator", "estimator", lambda run: check_estimator(run.device, run.estimator), _read_name),
    _Note("gains", "gains", _write_gains, _read_gains),
    _Note(
        "calibration", "calibration", lambda run: "" if run.calibration is None else run.calibration.text(),
        _read_calibration,
    ),
    _Note(
        "watchdog", "watchdog", lambda run: "yes" if run.watchdog else "no",
        lambda text, _: {"yes": True, "no": False}.get(text),
    ),
    _Note("render", "render", lambda run: run.render or "", _read_part),
    _Note(
        "torque_arm", "torque_arm_m", lambda run: _write_number(run.torque_arm), lambda text, _: _parse_positive(text)
    ),
    _Note("learned", "learned", _write_learned, _read_learned),
    _Note("coupling", "coupling", _write_coupling, _read_coupling),
    _Note(
        "hand", "hand", lambda run: "" if run.hand is None else f"{run.hand.name} {run.hand.digest}".strip(),
        lambda text, _: None,
    ),
    _Note(
        "hand_start", "hand_start", lambda run: run.hand_start, lambda text, _: text if text in HAND_STARTS else None
    ),
)  # fmt: skip
