"""A thread that says again and again where the hand is, so that its pose does not expire while a program runs."""

from __future__ import annotations

import threading
import traceback
from collections.abc import Callable
from pathlib import Path
from time import monotonic
from typing import final

from haptorb.errors import InputError
from haptorb.runtime.pointer.hand_path import HandPose
from haptorb.runtime.realtime.kernel_requests import raise_priority

__all__ = ["PoseKeeper"]

_EVERY = 0.005  #: between two poses [s]
_PATIENCE = 0.5  #: for a path's function that computes just now [s]
_PACKAGE = str(Path(__file__).parents[2])


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
