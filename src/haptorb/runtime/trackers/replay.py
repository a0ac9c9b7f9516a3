"""Replays the poses of a recording, each at its own time on the loop's clock.

From a simulated device it plays the recorded goal of the hand; from a real one, the poses of its tracker. A pose that
was measured once and repeated in many ticks is played once; a loss is played as a loss.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from time import monotonic, sleep
from typing import final

import numpy as np

from haptorb.arrays import Array
from haptorb.errors import DriverError
from haptorb.recording.recording import Recording
from haptorb.runtime.trackers.base import Feed, RawPose, RejectedPose

__all__ = ["ReplayFeed", "load_poses"]

_STAMP_TOLERANCE_S = 1e-6  #: largest difference of the timestamps of the same pose in two ticks


def load_poses(path: str | Path) -> Array:
    """Load poses (n, 10): time of arrival on the loop's clock, timestamp [s], p (3), q (4), valid.

    Raises RecordingError if the file is not of this version, DriverError if it contains no pose.
    """
    recording = Recording(path)
    recording.require("t", "age", "valid", "hand_goal", "hand_goal_q", "p", "q")
    t, age, valid = recording.t, recording["age"], recording["valid"] == 1.0
    wanted, turned = recording["hand_goal"], recording["hand_goal_q"]
    if not np.isfinite(wanted).any():
        wanted, turned = recording["p"], recording["q"]
    whole = np.isfinite(np.column_stack([wanted, turned])).all(axis=1) & np.isfinite(age) & np.isfinite(t)
    known = valid & whole
    measured = np.where(known, t - np.where(whole, age, 0.0), t)
    new = np.ones(len(t), dtype=bool)
    new[1:] = (np.abs(np.diff(measured)) > _STAMP_TOLERANCE_S) & (known[1:] | known[:-1]) | (known[1:] != known[:-1])
    new &= np.isfinite(t)
    if not (known & new).any():
        raise DriverError(f"tracker replay: {path} holds no valid pose; record one with --record")
    return np.column_stack([t, measured, np.where(whole[:, None], np.column_stack([wanted, turned]), 0.0), known])[new]


@final
class ReplayFeed(Feed):
    """Plays `rows` of `load_poses` from `origin` on, the monotonic time [s] at zero of the loop's clock."""

    one_tool = False

    def __init__(self, rows: Array, origin: float) -> None:
        self._rows, self._origin, self._at = rows, origin, 0

    def receive(self, timeout: float) -> Iterator[RawPose | RejectedPose]:
        """Yield the poses that are due; wait for the next for at most `timeout` [s]."""
        rows = self._rows
        if self._at >= len(rows):
            sleep(timeout)
            return
        sleep(min(max(self._origin + float(rows[self._at, 0]) - monotonic(), 0.0), timeout))
        while self._at < len(rows) and self._origin + rows[self._at, 0] <= (now := monotonic()):
            _, measured, *pose, valid = rows[self._at].tolist()
            self._at += 1
            yield RawPose(tuple(pose[:3]), tuple(pose[3:]), min(self._origin + measured, now), now, bool(valid))

    def close(self) -> None:
        """Nothing to close."""
