"""Poses out of a recording, each at its own time on the loop's clock: the same hand once more.

Of a simulated device the recording knows where the hand wanted the tool, and that is played; of a real one, where the
tracker saw it. Poses that were measured once and repeated in many ticks are played once; a loss is played as a loss.
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

_SAME = 1e-6  #: two ticks whose poses were measured within this saw the same pose [s]


def load_poses(path: str | Path) -> Array:
    """(n, 10): time on the loop's clock at which the pose came, when it was measured [s], p (3), q (4), valid.

    Raises RecordingError if the file is none of this version, DriverError if it holds no pose.
    """
    recording = Recording(path)
    recording.require("t", "age", "valid", "target", "target_q", "p", "q")
    t, age, valid = recording.t, recording["age"], recording["valid"] == 1.0
    wanted, turned = recording["target"], recording["target_q"]
    if not np.isfinite(wanted).any():
        wanted, turned = recording["p"], recording["q"]
    whole = np.isfinite(np.column_stack([wanted, turned])).all(axis=1) & np.isfinite(age) & np.isfinite(t)
    known = valid & whole
    measured = np.where(known, t - np.where(whole, age, 0.0), t)
    new = np.ones(len(t), dtype=bool)
    new[1:] = (np.abs(np.diff(measured)) > _SAME) & (known[1:] | known[:-1]) | (known[1:] != known[:-1])
    new &= np.isfinite(t)
    if not (known & new).any():
        raise DriverError(f"tracker replay: {path} holds no valid pose; record one with --record")
    return np.column_stack([t, measured, np.where(whole[:, None], np.column_stack([wanted, turned]), 0.0), known])[new]


@final
class ReplayFeed(Feed):
    """Plays `rows` of `load_poses` from `origin` on: the monotonic clock [s] at which the loop's clock shows zero."""

    one_tool = False

    def __init__(self, rows: Array, origin: float) -> None:
        self._rows, self._origin, self._at = rows, origin, 0

    def receive(self, patience: float) -> Iterator[RawPose | RejectedPose]:
        """What is due; if nothing is, waits until something is, at most `patience` [s]."""
        rows = self._rows
        if self._at >= len(rows):
            sleep(patience)
            return
        sleep(min(max(self._origin + float(rows[self._at, 0]) - monotonic(), 0.0), patience))
        while self._at < len(rows) and self._origin + rows[self._at, 0] <= (now := monotonic()):
            _, measured, *pose, valid = rows[self._at].tolist()
            self._at += 1
            yield RawPose(tuple(pose[:3]), tuple(pose[3:]), min(self._origin + measured, now), now, bool(valid))

    def close(self) -> None:
        """Nothing to close."""
