"""The hand behind the page's pointer: held by a person, or at rest where it was released.

While a person drags, their own messages keep the pose fresh: if the page freezes or goes away in the middle of a drag
it is not renewed, it expires, and the guard releases. A browser on a busy computer stutters, though: as long as its
socket is open, a pause is bridged. A hand at rest has no such person behind it, so the server keeps it fresh for as
long as the page stays connected.

Two limits, `Patience`, bound how long a force may last that no person holds: what the page's main thread may be silent
before the page's own worker drops the pose, and what the worker may be silent before this end does. A real device
allows a quarter of a second at most; then the pose expires (`limits.expiry`), the guard fades the force out within
50 ms and trips. A simulated one cannot hurt anyone, and no tracker has failed: it allows a second, and then the
simulated hand releases the pointer and is back at rest within 1.5 s, without a trip. A page that goes away in the
middle of a drag lets
the pose expire with either. This process too may wait for a processor: the simulated hand stays where it is for 0.3 s
without a word from here.
"""

from __future__ import annotations

import math
import time
from collections import deque
from typing import NamedTuple, final

import numpy as np

from haptorb.apps.console.running_servo import RunningServo
from haptorb.apps.console.wire import Pointer
from haptorb.numerics.arrays import Array

__all__ = ["PATIENCE", "PATIENCE_SIMULATED", "Patience", "PointerRelay", "patience_for"]


class Patience(NamedTuple):
    """How long a held pointer stays valid without renewal [s]."""

    page: float  #: from the page's main thread to its worker
    worker: float  #: from the worker to the server


PATIENCE = Patience(page=0.25, worker=0.15)
PATIENCE_SIMULATED = Patience(page=1.0, worker=1.0)

_STARVATION = 0.3  #: what a simulated hand bridges while this process has no processor [s]
#: how close the row's goal must be to the page's to be its answer [m]: float32 on the way
_SAME = 1e-6
#: this long after its release a hand is at rest [s]
SETTLED = 0.5
#: an answer that has not come by then will not come [s]
_PATIENCE = 0.5


def patience_for(driver: str) -> Patience:
    """What `driver` allows: more where nothing is powered."""
    return PATIENCE_SIMULATED if driver == "sim" else PATIENCE


@final
class PointerRelay:
    """Passes the controlling page's pointer to the servo, and finds the row that answers it."""

    def __init__(self, servo: RunningServo) -> None:
        self._servo = servo
        self._simulated, self._grace = servo.driver == "sim", patience_for(servo.driver).worker
        self._patience = _STARVATION if self._simulated else 0.0
        self._last: tuple[Array, Array | None, float] | None = None  # what is held, and when it was last said
        self._rested = 0.0  # when it was released
        self._resting: tuple[Array, Array | None] | None = None
        # the page's stamp, our time, position, orientation
        self._pending: deque[tuple[float, float, Array, Array | None]] = deque(maxlen=64)
        self.held = False

    def point(self, pointer: Pointer) -> None:
        """The page's pointer moved, or was released at `pointer.p`."""
        self._servo.point(pointer.p, pointer.q, patience=self._patience)
        self.held = pointer.held
        self._resting = None if pointer.held else (pointer.p, pointer.q)
        if not pointer.held:
            self._rested = time.monotonic()
        self._last = (pointer.p, pointer.q, time.monotonic()) if pointer.held else None
        if math.isfinite(pointer.stamp):
            self._pending.append((pointer.stamp, time.monotonic(), pointer.p, pointer.q))

    def keep(self) -> None:
        """Refresh a hand at rest, or one whose page stutters; to be called well within the device's expiry."""
        if self._resting is not None:
            self._servo.point(*self._resting, patience=self._patience)
        elif self._last is not None:
            if time.monotonic() - self._last[2] < self._grace:  # safety: pointer-bridged
                self._servo.point(self._last[0], self._last[1], patience=self._patience)
            else:
                self.drop()

    def release(self) -> None:
        """The page went away: a hand at rest goes home, a drag is left to expire.

        A browser that closes a page in the middle of a drag first sends that the pointer was released; that is no rest.
        """
        if self._resting is not None and time.monotonic() - self._rested > SETTLED:
            self._servo.release()
        self._forget()

    def drop(self) -> None:
        """The page is hidden or hangs: a drag is over. A simulated hand releases the tool; a real device's pose is left
        to expire."""
        if self._last is None:
            return
        if self._simulated:
            self._servo.release()
        self._forget()

    def let_go(self) -> None:
        """Release the tool at once."""
        self._servo.release()
        self._forget()

    def end_expired_drag(self) -> None:
        """Before engaging: a drag that was left to expire is over, the hand goes home."""
        if not self.held and self._resting is None:
            self._servo.release()

    def _forget(self) -> None:
        self._resting = self._last = None
        self._pending.clear()
        self.held = False

    @property
    def waiting(self) -> bool:
        """Whether a pointer has been passed on and no row has answered it yet."""
        while self._pending and time.monotonic() - self._pending[0][1] > _PATIENCE:
            self._pending.popleft()
        return bool(self._pending)

    def echo(self, targets: Array, turns: Array | None = None) -> float:
        """The page's time stamp [ms] of the newest pointer that one of the goals answers, else NaN.

        targets   (n, 3) positions
        turns     (n, 4) orientations; a rotor's pointers differ in nothing else. None: they do not matter
        """
        for place in range(len(self._pending) - 1, -1, -1):
            stamp, _, p, q = self._pending[place]
            if not len(targets):
                break
            same = np.abs(targets - p).max(axis=1) < _SAME
            if q is not None and turns is not None:
                same &= np.abs(turns - q / np.linalg.norm(q)).max(axis=1) < _SAME
            if same.any():
                for _ in range(place + 1):
                    self._pending.popleft()
                return stamp
        return math.nan
