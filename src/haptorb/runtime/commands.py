"""Commands of the host to a running loop: stop, engage, another mode, another world; its base has those of the hand."""

from __future__ import annotations

import json
import threading
import traceback
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping
from functools import partial
from itertools import count
from pathlib import Path
from time import monotonic, sleep
from typing import Any, final

from numpy.typing import ArrayLike

from haptorb.control.linkage import MODES
from haptorb.devices.base import FARTHEST, Device
from haptorb.errors import InputError, ServoError, UnknownName, quote
from haptorb.runtime.drivers.registry import is_real
from haptorb.runtime.linux import raise_priority
from haptorb.runtime.plan import pack
from haptorb.runtime.shared_memory import SharedMemory, Word, engage_request
from haptorb.runtime.trackers.registry import has_feed
from haptorb.runtime.world_change import name_of, parse_answer, parse_postponement, request, values_of
from haptorb.simulation.hand import HandPose, PathFunction, SampledPath, check_pose, split_pose
from haptorb.worlds import CATALOGUE
from haptorb.worlds.base import World
from haptorb.worlds.dynamic import split_remote

__all__ = ["BUTTONS", "LARGEST_SCALE", "Commands", "HandCommands", "PoseKeeper"]


# --------------------------------------------------------------------------------------------------
# A thread that says again and again where the hand is, so that its pose does not expire while a program runs.


_EVERY = 0.005  #: between two poses [s]
_PATIENCE = 0.5  #: for a path's function that computes just now [s]
_PACKAGE = str(Path(__file__).parents[1])


@final
class PoseKeeper:
    """Says `motion(t)`, with t [s] from the start, every 5 ms until `end`, or until `motion` raises.

    say         takes this keeper, the place (3,) [m] and the quaternion (4,); it drops what comes after `end`
    expiry      of a pose [s]
    users_code  whether `motion` is a user's: then the thread asks for no priority, because its duration is unknown

    The thread runs in the program that asks for the motion. When that ends, stops or hangs, the pose is no longer
    renewed, it expires, and the guard switches off. The same happens when `motion` raises: `trouble` then holds
    the reason.
    """

    def __init__(
        self,
        motion: Callable[[float], HandPose],
        say: Callable[[PoseKeeper, HandPose], None],
        expiry: float,
        *,
        users_code: bool,
    ) -> None:
        """Raises InputError if there is no first pose."""
        self.trouble: InputError | None = None
        self._motion, self._say, self._users_code = motion, say, users_code
        self._every = min(_EVERY, expiry / 5)
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._keep, name="haptorb-hand", daemon=True)
        self._start_time = 0.0
        self._first = self._motion_at(0.0)

    def start(self) -> None:
        """Say the first pose now, and the others from a thread."""
        self._start_time = monotonic()
        self._say(self, self._first)
        self._thread.start()

    def end(self) -> None:
        """Say no more; returns at once."""
        self._ending.set()

    def join(self) -> None:
        """After `end`: wait until the thread has ended, unless a user's function does not return."""
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join(_PATIENCE)

    def _keep(self) -> None:
        if not self._users_code:
            raise_priority()  # on a busy computer an ordinary thread may wait longer than a pose is good for
        while not self._ending.wait(self._every):
            try:
                pose = self._motion_at(monotonic() - self._start_time)
            except InputError as cause:
                self.trouble = cause
                return
            self._say(self, pose)

    def _motion_at(self, t: float) -> HandPose:
        try:
            return self._motion(t)
        except InputError as cause:
            raise InputError(f"path at {t:.3f} s: {cause}") from cause
        except Exception as cause:  # a user's code
            raise InputError(f"path at {t:.3f} s: {type(cause).__name__}: {cause}{_locate(cause)}") from cause


def _locate(cause: BaseException) -> str:
    """The innermost line of the user's code that raised."""
    frames = [one for one in traceback.extract_tb(cause.__traceback__) if not one.filename.startswith(_PACKAGE)]
    if not frames:
        return ""
    last = frames[-1]
    return f'\n  File "{last.filename}", line {last.lineno}, in {last.name}\n    {last.line}'


# --------------------------------------------------------------------------------------------------
# Commands of the host to the hand: go to a pose, stay there, or follow a path.


_MOST_PATIENT = 1.0  #: a hand without a word for longer is lost, even a simulated one [s]


class HandCommands(ABC):
    """The pointer of `device`, in memory that the loop reads. The last call of `point`, `hold`, `follow` and
    `release`, from any thread, replaces the others."""

    device: Device
    modes: tuple[str, ...]
    driver: str
    tracker: str

    def __init__(self) -> None:
        self._speaking = threading.Lock()
        self._keeper: PoseKeeper | None = None

    @property
    @abstractmethod
    def _memory_or_none(self) -> SharedMemory | None:
        """What the loop reads; None before the start."""

    @property
    def _memory(self) -> SharedMemory:
        if self._memory_or_none is None:
            raise ServoError("the servo was not started: use `with haptorb.Servo(...) as servo:`")
        return self._memory_or_none

    def point(self, p: ArrayLike, q: ArrayLike | None = None, *, patience: float = 0.0) -> None:
        """Move the simulated hand to a pose, once.

        Repeat the call within the device's `limits.expiry`, else the pose counts as lost; `hold` and `follow` do that
        automatically. For a motor only the orientation is used: `q`, or a position `p` towards which the handle points.

        Parameters
        ----------
        p : array_like, shape (3,)
            Position of the tool's magnet in the stator frame [m].
        q : array_like, shape (4,), optional
            Orientation as a unit quaternion (x, y, z, w) [1]; None: its axis radial, or upright over a plate
            (`Device.is_upright`).
        patience : float
            Time for which a simulated hand stays there longer [s], at most 1 s, for a program that may not get a
            processor. The pose of a real tool expires regardless of it.

        Raises
        ------
        InputError
            For another shape, a number that is not finite, a position more than 1 m from the device's centre, a zero
            quaternion, or a patience outside 0 to 1 s.
        ServoError
            Before the start.
        """
        place, turn = self._check_pose(p, q)
        if not 0.0 <= patience <= _MOST_PATIENT:
            raise InputError(f"patience must be between 0 and {_MOST_PATIENT:g} s; got {patience:g}")
        memory = self._memory
        with self._speaking:
            self._forget_keeper()
            memory.pointer.write(True, place, turn, monotonic(), patience)

    def hold(self, p: ArrayLike, q: ArrayLike | None = None) -> None:
        """Hold the simulated hand at a pose, until `release` or another command.

        A thread of this program repeats the pose every 5 ms: if the program ends, stops or hangs, the coils go off. On
        a busy computer it may be late by a second.

        Parameters
        ----------
        p : array_like, shape (3,)
            Position of the tool's magnet in the stator frame [m].
        q : array_like, shape (4,), optional
            Orientation as a unit quaternion (x, y, z, w) [1]; None: as for `point`.

        Raises
        ------
        InputError
            As `point`; also on a real device, and with a tracker that determines where the hand is.
        ServoError
            Before the start.
        """
        pose = self._check_pose(p, q)
        self._keep(lambda t: pose, users_code=False, patience=_MOST_PATIENT)

    def follow(self, path: PathFunction | ArrayLike, times: ArrayLike | None = None) -> None:
        """Move the simulated hand along a path, until `release` or another command.

        A thread of this program evaluates the path every 5 ms, as for `hold`. A function that raises an exception, or
        returns no valid pose, ends it: the pose expires, the coils go off, and `run` and `check_hand` raise InputError
        with file and line.

        Parameters
        ----------
        path : callable or array_like, shape (n, 3) or (n, 7)
            Function of the time from now [s] that returns a position (3,) [m], (position, quaternion), or both in one
            row (7,); or poses at `times`, with straight lines between them.
        times : array_like, shape (n,), optional
            Increasing times of the poses from now [s]; the hand stays at the last pose.

        Raises
        ------
        InputError
            If times are missing, or not increasing; also as `hold`.
        ServoError
            Before the start.
        """
        if not callable(path):
            if times is None:
                raise InputError("follow needs the times of the poses [s], follow(poses, times), or a function of time")
            self._keep(SampledPath(path, times, self._farthest, upright=self.device.is_upright), users_code=False)
            return
        if times is not None:
            raise InputError("times are for poses; a function receives the time since its start [s]")
        self._keep(lambda t: self._check_pose(*split_pose(path(t))), users_code=True)

    def release(self) -> None:
        """Return the simulated hand to the guided motion."""
        memory = self._memory
        with self._speaking:
            self._forget_keeper()
            pointed = memory.pointer.read_pointer()
            memory.pointer.write(False, pointed.p, pointed.q, pointed.stamp)

    @property
    def hand_trouble(self) -> str:
        """Why the path given to `follow` ended; empty if there is no problem."""
        keeper = self._keeper
        return "" if keeper is None or keeper.trouble is None else str(keeper.trouble)

    def check_hand(self) -> None:
        """Raise InputError if the path given to `follow` failed."""
        if trouble := self.hand_trouble:
            raise InputError(f"{trouble}\nThe hand's pose expires, and the coils go off.")

    @property
    def _farthest(self) -> float:
        """From the centre [m]; a motor's handle points towards a place, however far that is."""
        return float("inf") if self.modes else FARTHEST

    def _check_pose(self, p: ArrayLike, q: ArrayLike | None) -> HandPose:
        return check_pose(p, q, self._farthest, upright=self.device.is_upright)

    def _keep(self, motion: PathFunction, *, users_code: bool, patience: float = 0.0) -> None:
        if is_real(self.driver):  # safety: hold-real
            raise InputError(
                f"hold and follow move a simulated hand, but driver '{self.driver}' acts on a real tool, whose pose "
                "would be unknown: use a tracker that measures the tool (osc:PORT, lsl:NAME, natnet:HOST)"
            )
        if has_feed(self.tracker):
            raise InputError(
                f"tracker '{self.tracker}' determines where the hand is: hold and follow need tracker 'pointer'"
            )
        _ = self._memory  # raises before the start
        say = partial(self._say, patience=patience)
        keeper = PoseKeeper(motion, say, self.device.limits.expiry, users_code=users_code)
        with self._speaking:
            self._forget_keeper()
            self._keeper = keeper
        keeper.start()

    def _say(self, keeper: PoseKeeper, pose: HandPose, patience: float) -> None:
        """The pose of a keeper that still counts."""
        with self._speaking:
            if keeper is self._keeper:
                self._memory.pointer.write(True, *pose, monotonic(), patience)

    def _forget_keeper(self) -> None:
        if self._keeper is not None:
            self._keeper.end()
            self._keeper = None

    def _end_hand(self) -> None:
        """The servo closes: nothing is said any more."""
        keeper = self._keeper
        with self._speaking:
            self._forget_keeper()
        if keeper is not None:
            keeper.join()


BUTTONS = ("a", "b", "c")  #: of the tool, as programs that are connected see them
LARGEST_SCALE = 100.0  #: of a motor's torques

_ANSWER = 2.0  #: longest wait for the servo's answer [s]
_LOADED = 30.0  #: where it loads a world, which may be compiled there [s]
_COMPILED = 150.0  #: where that waits for code that another process compiles [s]


class Commands(HandCommands):
    """Commands for `device` with its `modes` and `models`, written into memory that the loop reads in every tick.

    `first` is the first world.
    """

    models: tuple[str, ...]
    _model: str  # that is inverted until another is set

    def __init__(self, first: World) -> None:
        HandCommands.__init__(self)
        self._first = first
        name, (plain, _) = name_of(first), split_remote(first)
        #: worlds beside the catalogue's that `set_world` knows, by name: the first one, if it is none of those
        self.own_worlds = {} if type(plain) is CATALOGUE.get(name) else {name: plain}
        self._requests = 0
        self._requesting = threading.Lock()
        self.world_ahead = ""  #: world that was chosen, and whose code is being compiled, once on this computer
        self._stop_numbers = count(1)
        self._stopped = 0  # number of the last stop

    @abstractmethod
    def check(self) -> None:
        """Raise ServoError if the loop no longer runs."""

    @abstractmethod
    def _compile_world(self, name: str) -> None:
        """Have the code of the catalogue's world `name` compiled next, beside the loop."""

    @abstractmethod
    def _check_compiler(self) -> None:
        """Raise ServoError if what compiles beside the loop hangs."""

    @property
    def stops(self) -> int:
        """Number of calls of `stop`. Read it when a person requests to engage, and pass it to `engage`."""
        shared = self._memory_or_none
        return self._stopped if shared is None else int(shared.words[Word.STOP])

    def stop(self) -> None:
        """Switch the coils off within a tick, until `engage`. May be called from any thread.

        Before or during the start, it takes effect from the first tick.
        """
        # Every stop has a number of its own: two threads that stop at once cannot hide one's behind the other's.
        self._stopped = number = next(self._stop_numbers)
        shared = self._memory_or_none
        if shared is not None:
            shared.words[Word.STOP] = number

    def _carry_stops(self, shared: SharedMemory) -> None:
        """Tell a loop that is about to start of the earlier stops; `_memory_or_none` is `shared` already."""
        if self._stopped:
            shared.words[Word.STOP] = self._stopped

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
        """Change the mode of a motor, without a step of the target's pose or of torque.

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

        The motion does not change, so the wrench on the target feels weaker or stronger.

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
        if isinstance(scale, bool) or not isinstance(scale, int | float) or not 1e-6 <= scale <= LARGEST_SCALE:
            raise InputError(f"torque scale must be above 0 and at most {LARGEST_SCALE:g}; got {quote(scale)}")
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
        shared = self._memory_or_none
        number = 0 if shared is None else int(shared.words[Word.MODEL])
        return self.device.models[number - 1] if number else self._model

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
        shared = self._memory_or_none
        if shared is None or not (known := shared.words[Word.WORLD]):
            return name_of(self._first), dict(values_of(self._first))
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
        if self._memory_or_none is not None:
            raise ServoError("call add_world before the start: the servo's process receives all worlds at once")
        self.own_worlds[name or world.name] = world

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
                self._await_answer(shared, name, _ANSWER if file is None else _LOADED)
            finally:
                self.world_ahead = ""

    def _await_answer(self, shared: SharedMemory, name: str, longest: float) -> None:
        """Return when the request for the world `name` is fulfilled, after at most `longest` [s]."""
        patience = monotonic() + longest
        while True:
            text = shared.answer.read()[1]
            number, error = parse_answer(text)
            if number == self._requests:
                if error is not None:
                    raise error
                return
            if not self.world_ahead and parse_postponement(text) == self._requests:
                self.world_ahead, longest = name, _COMPILED
                patience = monotonic() + longest
                self._compile_world(name)
            self.check()
            if self.world_ahead:
                self._check_compiler()
            if monotonic() > patience:
                raise ServoError(f"the servo did not respond within {longest:g} s; close other programs, and try again")
            sleep(0.0005)
