"""Commands to the hand of a running servo: go to a pose, hold it, follow a path; repeated so that no pose expires."""

from __future__ import annotations

import threading
import traceback
from collections.abc import Callable
from functools import partial
from pathlib import Path
from time import monotonic
from typing import final

from numpy.typing import ArrayLike

from haptorb.devices.base import MAX_DISTANCE_M
from haptorb.earlier_names import warn_earlier
from haptorb.errors import InputError
from haptorb.runtime.config import RunConfig
from haptorb.runtime.linux import raise_priority
from haptorb.runtime.shared_memory import SharedMemory
from haptorb.simulation.hand_motion import HandPose, PathFunction, SampledPath, check_pose, split_pose

__all__ = ["HandCommands", "PoseRepeater"]


# --------------------------------------------------------------------------------------------------
# Repeater thread: renews the pose of the hand periodically, so that it does not expire while a program runs.


_PERIOD_S = 0.005  #: between two poses
_JOIN_TIMEOUT_S = 0.5  #: for a call of a path's function in progress
_PACKAGE = str(Path(__file__).parents[1])


@final
class PoseRepeater:
    """Writes the pose `motion(t)`, with t [s] from the start, every 5 ms until `end`, or until `motion` raises.

    write       called with this repeater, the position (3,) [m] and the quaternion (4,); drops calls after `end`
    expiry      of a pose [s]
    users_code  whether `motion` is user code: then the thread requests no priority, because its duration is unknown

    The thread runs in the program that commands the motion. When that ends, stops or hangs, the pose is no longer
    renewed, it expires, and the guard switches off. The same happens when `motion` raises: `trouble` then states
    the reason.
    """

    def __init__(
        self,
        motion: Callable[[float], HandPose],
        write: Callable[[PoseRepeater, HandPose], None],
        expiry: float,
        *,
        users_code: bool,
    ) -> None:
        """Raises InputError if there is no first pose."""
        self.trouble: InputError | None = None
        self._motion, self._write, self._users_code = motion, write, users_code
        self._every = min(_PERIOD_S, expiry / 5)
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._repeat, name="haptorb-hand", daemon=True)
        self._start_time = 0.0
        self._first = self._motion_at(0.0)

    def start(self) -> None:
        """Write the first pose now, and the following ones in a thread."""
        self._start_time = monotonic()
        self._write(self, self._first)
        self._thread.start()

    def end(self) -> None:
        """Write no more; returns at once."""
        self._ending.set()

    def join(self) -> None:
        """After `end`: wait until the thread has ended, at most for the join timeout if user code does not return."""
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join(_JOIN_TIMEOUT_S)

    def _repeat(self) -> None:
        if not self._users_code:
            raise_priority()  # on a busy computer an ordinary thread may wait longer than the expiry of a pose
        while not self._ending.wait(self._every):
            try:
                pose = self._motion_at(monotonic() - self._start_time)
            except InputError as cause:
                self.trouble = cause
                return
            self._write(self, pose)

    def _motion_at(self, t: float) -> HandPose:
        try:
            return self._motion(t)
        except InputError as cause:
            raise InputError(f"path at {t:.3f} s: {cause}") from cause
        except Exception as cause:  # user code
            raise InputError(f"path at {t:.3f} s: {type(cause).__name__}: {cause}{_locate(cause)}") from cause


def _locate(cause: BaseException) -> str:
    """Describe the innermost line of user code that raised."""
    frames = [one for one in traceback.extract_tb(cause.__traceback__) if not one.filename.startswith(_PACKAGE)]
    if not frames:
        return ""
    last = frames[-1]
    return f'\n  File "{last.filename}", line {last.lineno}, in {last.name}\n    {last.line}'


# --------------------------------------------------------------------------------------------------
# Commands of the host to the hand.


_MAX_KEEP_ALIVE_S = 1.0  #: maximum keep-alive of a simulated hand without a new pose


@final
class HandCommands:
    """Commands to the hand of a running servo, `servo.hand`.

    The last call of `point`, `hold`, `follow` and `release`, from any thread, replaces the others.

    Parameters
    ----------
    config : RunConfig
        Description of the run.
    memory : callable
        Returns the memory that the loop reads. Raises ServoError before the start.
    """

    def __init__(self, config: RunConfig, memory: Callable[[], SharedMemory]) -> None:
        self._config, self._memory = config, memory
        self._writing = threading.Lock()
        self._repeater: PoseRepeater | None = None

    def point(
        self, p: ArrayLike, q: ArrayLike | None = None, *, keep_alive: float = 0.0, patience: float | None = None
    ) -> None:
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
        keep_alive : float
            Time for which a simulated hand stays there longer [s], at most 1 s, for a program that may not get a
            processor. The pose of a real tool expires regardless of it.
        patience : float, optional
            Earlier name of `keep_alive`.

        Raises
        ------
        InputError
            For another shape, a number that is not finite, a position more than 1 m from the device's centre, a zero
            quaternion, or a keep-alive outside 0 to 1 s.
        ServoError
            Before the start.
        """
        place, turn = self._check_pose(p, q)
        if patience is not None:
            warn_earlier("point(patience=...) is now point(keep_alive=...)")
            keep_alive = patience
        if not 0.0 <= keep_alive <= _MAX_KEEP_ALIVE_S:
            raise InputError(f"keep_alive must be between 0 and {_MAX_KEEP_ALIVE_S:g} s; got {keep_alive:g}")
        memory = self._memory()
        with self._writing:
            self._end_repeater()
            memory.pointer.write(True, place, turn, monotonic(), keep_alive)

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
            As `point`; also on a real device, and with a tracker that determines the hand's pose.
        ServoError
            Before the start.
        """
        pose = self._check_pose(p, q)
        self._repeat(lambda t: pose, users_code=False, keep_alive=_MAX_KEEP_ALIVE_S)

    def follow(self, path: PathFunction | ArrayLike, times: ArrayLike | None = None) -> None:
        """Move the simulated hand along a path, until `release` or another command.

        A thread of this program evaluates the path every 5 ms, as for `hold`. A function that raises an exception, or
        returns no valid pose, ends it: the pose expires, the coils go off, and `run` and `check` raise InputError
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
            path_of_poses = SampledPath(path, times, self._farthest, upright=self._config.device.is_upright)
            self._repeat(path_of_poses, users_code=False)
            return
        if times is not None:
            raise InputError("times are for poses; a function receives the time since its start [s]")
        self._repeat(lambda t: self._check_pose(*split_pose(path(t))), users_code=True)

    def release(self) -> None:
        """Return the simulated hand to the guided motion."""
        memory = self._memory()
        with self._writing:
            self._end_repeater()
            pointed = memory.pointer.read_hand_goal()
            memory.pointer.write(False, pointed.p, pointed.q, pointed.stamp)

    @property
    def trouble(self) -> str:
        """Why the path given to `follow` ended; empty if there is no problem."""
        repeater = self._repeater
        return "" if repeater is None or repeater.trouble is None else str(repeater.trouble)

    def check(self) -> None:
        """Raise InputError if the path given to `follow` failed."""
        if trouble := self.trouble:
            raise InputError(f"{trouble}\nThe hand's pose expires, and the coils go off.")

    @property
    def _farthest(self) -> float:
        """Largest valid distance from the centre [m]; unlimited for a motor, whose handle only points towards `p`."""
        return float("inf") if self._config.device.kind.modes else MAX_DISTANCE_M

    def _check_pose(self, p: ArrayLike, q: ArrayLike | None) -> HandPose:
        return check_pose(p, q, self._farthest, upright=self._config.device.is_upright)

    def _repeat(self, motion: PathFunction, *, users_code: bool, keep_alive: float = 0.0) -> None:
        if self._config.is_real:  # safety: hold-real
            raise InputError(
                f"hold and follow move a simulated hand, but driver '{self._config.driver}' acts on a real tool, whose "
                "pose would be unknown: use a tracker that measures the tool (osc:PORT, lsl:NAME, natnet:HOST)"
            )
        if self._config.has_feed:
            raise InputError(
                f"tracker '{self._config.tracker}' determines where the hand is: hold and follow need tracker 'pointer'"
            )
        self._memory()  # raises before the start
        write = partial(self._write, keep_alive=keep_alive)
        repeater = PoseRepeater(motion, write, self._config.device.limits.expiry, users_code=users_code)
        with self._writing:
            self._end_repeater()
            self._repeater = repeater
        repeater.start()

    def _write(self, repeater: PoseRepeater, pose: HandPose, keep_alive: float) -> None:
        """Write the pose of the active repeater; drop that of any other."""
        with self._writing:
            if repeater is self._repeater:
                self._memory().pointer.write(True, *pose, monotonic(), keep_alive)

    def _end_repeater(self) -> None:
        if self._repeater is not None:
            self._repeater.end()
            self._repeater = None

    def end(self) -> None:
        """Stop writing poses, when the servo closes."""
        repeater = self._repeater
        with self._writing:
            self._end_repeater()
        if repeater is not None:
            repeater.join()
