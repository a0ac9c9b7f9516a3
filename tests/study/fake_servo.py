"""Servo that stores its commands; its pen reaches every goal at once."""

from __future__ import annotations

from typing import Any

import numpy as np

from haptorb.control.trip_reasons import Trip
from haptorb.devices.loader import load
from haptorb.errors import ServoError
from haptorb.recording.row import RowLayout


class FakeServo:
    """Remembers its calls; its pen is where it was pointed."""

    def __init__(self) -> None:
        self.device = load("omni")
        self.layout = RowLayout.of(self.device)
        self.tracker, self.driver = "pointer", "sim"
        self.calls: list[Any] = []
        self.trips: list[Trip] = []
        self.p = np.array([0.0, 0.0, 0.05])
        self.alive = True
        self.off = False
        self.asked = 0.5  # of the coils, in every world [N]
        self.worlds = 0
        self.stops = 0
        self.recorded: list[bool] = []

    def set_world(self, name: str, values: dict[str, Any] | None = None) -> None:
        self.calls.append((name, (values or {}).get("summit")))
        self.worlds += 1

    @property
    def hand(self) -> Any:
        """It takes the commands to the hand itself."""
        return self

    def point(self, p: np.ndarray, *, keep_alive: float = 0.0) -> None:
        self.p = p

    def check(self) -> None:
        if not self.alive:
            raise ServoError("the servo ended: somebody pulled the plug")

    def pause_recording(self, paused: bool) -> None:
        self.recorded.append(not paused)

    def open(self) -> None:
        self.calls.append("open")

    def close(self) -> None:
        self.calls.append("close")

    def trip(self, reason: Trip) -> None:
        self.off = True
        self.trips.append(reason)

    def stop(self) -> None:
        self.calls.append("stop")
        self.stops += 1
        self.trip(Trip.STOPPED)

    def rows(self, cursor: int = 0) -> tuple[int, np.ndarray]:
        """Two rows per trip: running, then tripped."""
        trips = list(self.trips)  # another thread may stop meanwhile
        rows = np.zeros((2 * len(trips), self.layout.width))
        rows[:, self.layout["guard"]] = 2
        for n, trip in enumerate(trips):
            rows[2 * n + 1, self.layout["guard"]], rows[2 * n + 1, self.layout["trip"]] = 4, trip
        return len(rows), rows[cursor:]

    def engage(self, stops: int | None = None) -> None:
        self.calls.append("engage")
        if stops in (None, self.stops):
            self.off = False

    def latest(self) -> np.ndarray:
        row = np.zeros(self.layout.width)
        row[self.layout["world"]] = self.worlds
        row[self.layout["wrench_commanded"]] = (0.0, 0.0, self.asked, 0.0, 0.0, 0.0)
        row[self.layout["valid"]], row[self.layout["guard"]], row[self.layout["p"]] = 1, 4 if self.off else 2, self.p
        return row
