"""How well the loop keeps its time, over the last seconds, and what is amiss: what the page's header says."""

from __future__ import annotations

from collections import deque
from typing import Any, final

import numpy as np

from haptorb.apps.console.running_servo import RunningServo
from haptorb.numerics.arrays import Array

__all__ = ["Health", "describe_troubles"]

#: seconds of the past that count
WINDOW = 5.0


def describe_troubles(servo: RunningServo) -> dict[str, Any]:
    """Whether the loop runs, texts that are empty while all is well, and which programs are connected."""
    return {
        "alive": servo.alive,
        "recording_trouble": servo.recording_trouble,
        "warning": servo.warning,
        "world_trouble": servo.world_trouble,
        "missing_pose": servo.missing_pose,
        "connections": servo.connections,
    }


@final
class Health:
    """Looks at every row twice a second and keeps five seconds of it."""

    def __init__(self, servo: RunningServo) -> None:
        self._servo = servo
        layout = servo.layout
        self._t, self._missed, self._lateness = (layout[name].start for name in ("t", "missed", "lateness"))
        self._valid, self._age = layout["valid"].start, layout["age"].start
        self._stages = layout["stages"]
        self._cursor = 0
        self._window: deque[Array] = deque()  # each (n, 5): t, missed, lateness, compute time, age of the pose

    def look(self) -> dict[str, float | None]:
        """Rate [Hz], share of deadlines met, 50th and 99th percentile of lateness and median compute time [µs], 99th
        percentile of the age of valid poses [ms]."""
        self._cursor, rows = self._servo.rows(self._cursor)
        if len(rows):
            compute = rows[:, self._stages].sum(axis=1)
            self._window.append(
                np.column_stack(
                    [
                        rows[:, self._t],
                        rows[:, self._missed],
                        rows[:, self._lateness],
                        compute,
                        np.where(rows[:, self._valid] == 1.0, rows[:, self._age], np.nan),
                    ]
                )
            )
            newest = float(rows[-1, self._t])
            while len(self._window) > 1 and float(self._window[0][-1, 0]) < newest - WINDOW:
                self._window.popleft()
        else:
            self._window.clear()
        if not self._window:
            return {
                "rate_hz": None,
                "success": None,
                "lateness_p50_us": None,
                "lateness_p99_us": None,
                "compute_us": None,
                "pose_age_ms": None,
            }
        window = np.concatenate(list(self._window))
        span = float(window[-1, 0] - window[0, 0])
        missed = float(np.nansum(window[1:, 1]))
        late = window[:, 2][np.isfinite(window[:, 2])]
        spent = window[:, 3][np.isfinite(window[:, 3])]
        ages = window[:, 4][np.isfinite(window[:, 4])]
        return {
            "rate_hz": (len(window) - 1) / span if span > 0 else None,
            "success": (len(window) - 1) / (len(window) - 1 + missed) if len(window) > 1 else None,
            "lateness_p50_us": float(np.percentile(late, 50)) * 1e6 if len(late) else None,
            "lateness_p99_us": float(np.percentile(late, 99)) * 1e6 if len(late) else None,
            "compute_us": float(np.median(spent)) * 1e6 if len(spent) else None,
            "pose_age_ms": float(np.percentile(ages, 99)) * 1e3 if len(ages) else None,
        }
