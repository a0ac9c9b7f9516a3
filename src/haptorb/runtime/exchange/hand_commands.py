"""Commands of the host to the hand: go to a pose, stay there, or follow a path."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from functools import partial
from time import monotonic

from numpy.typing import ArrayLike

from haptorb.devices.device import Device
from haptorb.errors import InputError, ServoError
from haptorb.runtime.drivers.driver_registry import is_real
from haptorb.runtime.exchange.shared_memory import SharedMemory
from haptorb.runtime.pointer.hand_path import FARTHEST, HandPose, PathFunction, SampledPath, check_pose, split_pose
from haptorb.runtime.pointer.pose_keeper import PoseKeeper
from haptorb.runtime.trackers.tracker_registry import has_feed

__all__ = ["HandCommands"]

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
        """Move the hand so that the tool's magnet goes to `p` (3,) [m] with orientation `q` (4,) (x, y, z, w);
        None: its axis radial, upright over a plate (`Device.is_upright`).

        For a motor only the orientation is used: `q`, or a position `p` towards which the handle points.
        Repeat the call within the device's `limits.expiry`, else the pose counts as lost; `hold` and `follow` do
        that automatically. A simulated hand stays there `patience` [s] longer, at most 1 s, for a program that
        may not get a processor. The pose of a real tool expires regardless of the patience.

        Raises InputError for another shape, a number that is not finite, a position more than 1 m from the device's
        centre, a zero quaternion, or a patience outside 0 to 1 s; ServoError before the start.
        """
        place, turn = self._check_pose(p, q)
        if not 0.0 <= patience <= _MOST_PATIENT:
            raise InputError(f"patience must be between 0 and {_MOST_PATIENT:g} s; got {patience:g}")
        memory = self._memory
        with self._speaking:
            self._forget_keeper()
            memory.pointer.write(True, place, turn, monotonic(), patience)

    def hold(self, p: ArrayLike, q: ArrayLike | None = None) -> None:
        """The simulated hand stays at `p` (3,) [m] with orientation `q` (4,), until `release` or another command.

        A thread of this program repeats it every 5 ms: if the program ends, stops or hangs, the coils go off. On a
        busy computer it may be late by a second. Raises as `point` does; InputError also if this program moves no
        simulated hand.
        """
        pose = self._check_pose(p, q)
        self._keep(lambda t: pose, users_code=False, patience=_MOST_PATIENT)

    def follow(self, path: PathFunction | ArrayLike, times: ArrayLike | None = None) -> None:
        """The simulated hand follows `path` from now on, until `release` or another command.

        path    a function of the time from now [s] that returns a position (3,) [m], (position, quaternion), or both
                in one row (7,); or poses (n, 3) or (n, 7) at `times`, with straight lines between them
        times   (n,) [s], increasing; the hand stays at the last pose

        A thread of this program calls it every 5 ms, as for `hold`. A function that raises, or returns no valid
        pose, ends it: the pose expires, the coils go off, and `run` and `check_hand` raise InputError with file and
        line.
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
        """Release the hand: it returns to the guided motion."""
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
