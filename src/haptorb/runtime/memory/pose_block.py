"""A tracker's last pose in shared memory, never half of it."""

from __future__ import annotations

from typing import NamedTuple, final

import numpy as np

from haptorb.numerics.arrays import Array
from haptorb.runtime.memory.seqlock import SeqlockWords

__all__ = ["WORDS", "PoseBlock", "PoseRecord"]

WORDS = 16  #: sequence, valid, p (3), q (4), v (3), w (3), stamp


class PoseRecord(NamedTuple):
    """What a tracker last said, brought into one form by its own process."""

    valid: bool  #: False: the tracker has lost the tool, or has not found it yet
    p: Array  #: (3,) [m], frame S
    q: Array  #: (4,) quaternion (x, y, z, w) of R_SR, length 1
    v: Array  #: (3,) [m/s]
    w: Array  #: (3,) [rad/s], frame S
    stamp: float  #: the computer's monotonic clock when it was measured [s]


@final
class PoseBlock:
    """Sixteen words at `at`, seen both as integers and as floats."""

    def __init__(self, words: memoryview, floats: memoryview[float], at: int) -> None:
        self._words = SeqlockWords(words, floats, at, WORDS)
        unturned = np.array([0.0, 0.0, 0.0, 1.0])
        self._tracked = PoseRecord(False, np.zeros(3), unturned, np.zeros(3), np.zeros(3), float("-inf"))

    def write(self, pose: PoseRecord) -> None:
        """Say where the tool is; for the one writer."""
        numbers = (*pose.p.tolist(), *pose.q.tolist(), *pose.v.tolist(), *pose.w.tolist(), pose.stamp)
        self._words.write(pose.valid, numbers)

    def read_pose(self) -> PoseRecord:
        """The pose as last written completely; if one is being written just now, the one before. Never waits."""
        latest = self._words.read_new()
        if latest is not None:
            n = np.array(latest[1])
            self._tracked = PoseRecord(latest[0], n[:3], n[3:7], n[7:10], n[10:13], latest[1][13])
        return self._tracked
