"""Where the hand wants the tool: held by a pointer (mouse, pen, finger) on the console, else guided by a script."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np

from haptorb.physics.arrays import Array
from haptorb.runtime.guided import DURATION, guided_position, upright

__all__ = ["Goal", "Pointed", "PointerSource", "PointerTracker"]

_RELEASE = 1.5  #: time in which a released hand returns to rest [s]


class Pointed(NamedTuple):
    """What the host last said about its pointer."""

    held: bool
    p: Array  #: (3,) [m], frame S
    q: Array  #: (4,) quaternion (x, y, z, w) of R_SR
    stamp: float  #: the computer's monotonic clock when it was said [s]


class PointerSource(ABC):
    """Whoever knows the host's pointer: shared memory in a running servo."""

    @abstractmethod
    def pointed(self) -> Pointed:
        """The pointer as last written; never waits."""


@dataclass(frozen=True, slots=True)
class Goal:
    """Where the hand wants the tool, and since when that is known.

    p      (3,) tool's magnet centre [m], frame S
    q      (4,) quaternion (x, y, z, w) of R_SR
    stamp  time of this wish on the loop's clock [s]: a pointer that is no longer refreshed grows old
    held   a person holds the pointer; False: the guided motion
    """

    p: Array
    q: Array
    stamp: float
    held: bool


@final
class PointerTracker:
    """Follows the host's pointer while it is held; plays the guided motion until it is held for the first time.

    After a release the hand goes back to the guided motion's resting place by the smoothest way.
    `origin` is the computer's monotonic time [s] at which the loop's clock showed zero.
    """

    def __init__(self, source: PointerSource | None = None, origin: float = 0.0) -> None:
        self._source = source
        self.origin = origin
        self._last: Array | None = None  # where a held pointer was last
        self._released = 0.0
        self._rest = guided_position(DURATION)
        self._rest_q = upright(self._rest)

    def goal(self, now: float) -> Goal:
        """The goal at `now` [s] on the loop's clock."""
        if self._source is not None:
            pointed = self._source.pointed()
            if pointed.held:
                self._last, self._released = pointed.p, now
                return Goal(pointed.p, pointed.q, pointed.stamp - self.origin, True)
        if now - self._released >= (DURATION if self._last is None else _RELEASE):
            return Goal(self._rest, self._rest_q, now, False)
        p = guided_position(now) if self._last is None else self._returning(self._last, now - self._released)
        return Goal(p, upright(p), now, False)

    def _returning(self, start: Array, since: float) -> Array:
        """(3,) [m] on the way from `start` to the resting place: along the sphere, not through the device."""
        s = min(since / _RELEASE, 1.0)
        s = s * s * s * (10.0 + s * (6.0 * s - 15.0))
        rest = self._rest
        r0, r1 = float(np.linalg.norm(start)), float(np.linalg.norm(rest))
        # A hand inside the device has no direction; from there it goes straight.
        direction = rest / r1 if r0 < 1e-6 else (1 - s) * start / r0 + s * rest / r1
        length = float(np.linalg.norm(direction))
        if length < 1e-6:  # exactly opposite: no way is the shortest
            direction, length = rest / r1, 1.0
        p: Array = direction / length * ((1 - s) * r0 + s * r1)
        return p
