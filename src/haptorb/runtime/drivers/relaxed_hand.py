"""A simulated hand at rest yields: left alone, it does not load the device permanently.

A resting hand creeps to where the device pushes the tool, as a relaxed arm does, so that the force asked of the coils
fades and the coils stay cool. It gives way around the device, not away from it, where the same force would cost more
current, and no further than a hand can without moving its arm. Where giving way does not help, as in a stream, it
goes back, and tries again after a while.
"""

from __future__ import annotations

from math import acos, exp
from typing import final

import numpy as np

from haptorb.numerics.arrays import Array

__all__ = ["RelaxedHand"]

_YIELD = 1.0  #: time constant with which the hand gives way [s]
_REACH = 0.03  #: farthest from where it rested [m]
_TURN = np.radians(40.0)  #: farthest from how it rested [rad]
_ARM = 0.05  #: length by which a turn counts as a way [m]
_PACE = 0.02  #: time between two looks at the tool [s]
_SETTLE = 1.0  #: of rest until the hand gives way; how far it is pushed by then is what must fade [s]
_TRY = 12.0  #: in which that must fade to a half [s]
_AGAIN = 120.0  #: until it tries again [s]


@final
class RelaxedHand:
    """Where a hand that rests wants the mover, after it gave way."""

    def __init__(self) -> None:
        self._place = np.zeros(7)
        self._rest = np.full(7, np.nan)
        self._start = self._next = 0.0
        self._pushed = 0.0  # when it began to give way, as a length [m]
        self._helps = True

    def rest_at(self, rest: Array, now: float) -> Array:
        """(7,) [m], quaternion (x, y, z, w): where a hand is that rests at `rest` (7,), at `now` [s]; if it has rested
        there before, after it gave way."""
        if not np.array_equal(rest, self._rest):
            self._rest[:] = self._place[:] = rest
            self._start = self._next = now
        return self._place

    def is_due(self, now: float) -> bool:
        """Whether `yield_to` has anything to do at `now` [s]."""
        return now >= self._next

    def yield_to(self, tool: Array, now: float) -> None:
        """Creep towards the mover at `tool` (7,) [m], quaternion (x, y, z, w), at `now` [s], or back to rest."""
        self._next = now + _PACE
        pushed = _distance(tool, self._place)
        if now - self._start >= _AGAIN:
            self._start = now
        since = now - self._start
        if since < _SETTLE:
            self._pushed, self._helps = pushed, True
            return
        if since >= _TRY and pushed > 0.5 * self._pushed:
            self._helps = False
        place = _approach(self._place, tool if self._helps else self._rest, 1.0 - exp(-_PACE / _YIELD))
        far, length = float(np.linalg.norm(self._rest[:3])), float(np.linalg.norm(place[:3]))
        place[:3] *= far / length if length > 0.5 * far > 0.0 else 0.0
        if float(np.linalg.norm(place[:3] - self._rest[:3])) <= _REACH and _turn(place, self._rest) <= _TURN:
            self._place[:] = place


def _approach(place: Array, goal: Array, share: float) -> Array:
    """(7,) `place` after `share` of the way to `goal`, both (7,)."""
    found = place + share * (goal - place)
    turned = goal[3:] if float(goal[3:] @ place[3:]) >= 0.0 else -goal[3:]
    found[3:] = place[3:] + share * (turned - place[3:])
    found[3:] /= float(found[3:] @ found[3:]) ** 0.5
    return found


def _turn(a: Array, b: Array) -> float:
    return 2.0 * acos(min(1.0, abs(float(a[3:] @ b[3:]))))


def _distance(a: Array, b: Array) -> float:
    return float(np.linalg.norm(a[:3] - b[:3])) + _ARM * _turn(a, b)
