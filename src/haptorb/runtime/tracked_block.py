"""A tracker's last pose in shared memory, guarded by a sequence number that is odd while it is being written."""

from __future__ import annotations

from typing import NamedTuple, final

import numpy as np

from haptorb.physics.arrays import Array

__all__ = ["WORDS", "Tracked", "TrackedBlock"]

WORDS = 16  #: sequence, valid, p (3), q (4), v (3), w (3), stamp

_TRIES = 8  #: more would let a slow writer hold up the loop


class Tracked(NamedTuple):
    """What a tracker last said, brought into one form by its own process."""

    valid: bool  #: False: the tracker has lost the tool, or has not found it yet
    p: Array  #: (3,) [m], frame S
    q: Array  #: (4,) quaternion (x, y, z, w) of R_SR, length 1
    v: Array  #: (3,) [m/s]
    w: Array  #: (3,) [rad/s], frame S
    stamp: float  #: the computer's monotonic clock when it was measured [s]


@final
class TrackedBlock:
    """Sixteen words at `at`, seen both as integers and as floats."""

    def __init__(self, words: memoryview, floats: memoryview[float], at: int) -> None:
        self._words, self._floats, self._at = words, floats, at
        self._known = 0
        unturned = np.array([0.0, 0.0, 0.0, 1.0])
        self._tracked = Tracked(False, np.zeros(3), unturned, np.zeros(3), np.zeros(3), float("-inf"))

    def write(self, told: Tracked) -> None:
        """Say where the tool is; for the one writer."""
        words, floats, at = self._words, self._floats, self._at
        sequence = words[at] | 1
        words[at] = sequence
        words[at + 1] = told.valid
        numbers = (*told.p.tolist(), *told.q.tolist(), *told.v.tolist(), *told.w.tolist(), told.stamp)
        for i, value in enumerate(numbers, start=at + 2):
            floats[i] = value
        words[at] = sequence + 1

    def tracked(self) -> Tracked:
        """The pose as last written completely; if one is being written just now, the one before. Never waits."""
        words, at = self._words, self._at
        for _ in range(_TRIES):
            sequence = words[at]
            if sequence == self._known:
                break
            if sequence & 1:
                continue
            valid = bool(words[at + 1])
            numbers = np.array(self._floats[at + 2 : at + WORDS].tolist())
            if words[at] == sequence:
                self._known = sequence
                self._tracked = Tracked(
                    valid, numbers[:3], numbers[3:7], numbers[7:10], numbers[10:13], float(numbers[13])
                )
                break
        return self._tracked
