"""Fake servo: rows as a real one would publish them, and every state on demand.

The console's own tests need neither a process nor physics, and states that a healthy device does not show.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from haptorb.control.trip_reasons import CoilState, GuardState, Trip
from haptorb.devices.base import State
from haptorb.devices.loader import load
from haptorb.errors import InputError, UnknownName
from haptorb.recording.row import RowLayout
from haptorb.simulation.hand_motion import upright_quaternion
from haptorb.worlds import World, find_world
from haptorb.worlds.base import values as parameter_values

KEPT = 8191


class FakeServo:
    """Keeps a row per millisecond of real time; the stylus gives way to its world's force like a spring."""

    driver = "sim"
    tracker = "pointer"
    modes: tuple[str, ...] = ()
    models: tuple[str, ...] = ("exact", "published")
    model = "exact"
    render = None
    part_remarks: tuple[str, ...] = ()
    rate = 1000.0

    def __init__(self, device: str = "omni", world: str = "dome") -> None:
        self.tracker_refusals: dict[str, int] = {}
        self.connections: list[dict[str, Any]] = []
        self.device = load(device)
        self.layout = RowLayout.of(self.device)
        self.alive = True
        self.recording_trouble = self.warning = self.world_trouble = self.missing_pose = ""
        self.trip_program = ""
        self.own_worlds: Mapping[str, World] = {}
        self.silent = False  #: publish nothing
        self.guard = GuardState.RUNNING
        self.trip = Trip.NONE
        self.coils = CoilState.ON
        self.valid = True
        self.winding = np.array([303.0, 309.0, 298.5])
        self.target = self.at(24.0, -50.0, 0.048)
        self.calls: list[tuple[Any, ...]] = []
        self.refuse: Exception | None = None
        self._world = find_world(world)()
        self._name = world
        self._changes = 0
        self._start = time.monotonic()
        self._rows = np.zeros((KEPT, self.layout.width))  # tick n in row n % KEPT
        self._ticks = 0
        self.most_read = 0  #: rows in one reading

    @staticmethod
    def at(tilt: float, azimuth: float, distance: float) -> np.ndarray:
        """(3,) [m] from angles in degrees."""
        t, a = np.radians([tilt, azimuth])
        return distance * np.array([np.sin(t) * np.cos(a), np.sin(t) * np.sin(a), np.cos(t)])

    @property
    def world(self) -> tuple[str, Mapping[str, Any]]:
        return self._name, parameter_values(self._world)

    def set_world(self, name: str, values: Mapping[str, Any] | None = None) -> None:
        self.calls.append(("world", name, values))
        if self.refuse is not None:
            raise self.refuse
        known = self._world if name == self._name else self.own_worlds.get(name) or find_world(name)()
        self._world = known.replace(**(values or {}))
        self._name = name
        self._changes += 1

    @property
    def hand(self) -> FakeServo:
        """It takes the commands to the hand itself."""
        return self

    def point(self, p: Any, q: Any = None, *, keep_alive: float = 0.0) -> None:
        self.calls.append(("point", tuple(p), q))
        self.keep_alive = keep_alive
        self.target = np.array(p, dtype=float)

    def release(self) -> None:
        self.calls.append(("release",))

    def stop(self) -> None:
        self.calls.append(("stop",))
        self.guard, self.trip = GuardState.TRIPPED, Trip.STOPPED

    def end_loop(self) -> None:
        self.ended = True

    @property
    def stops(self) -> int:
        return self.count("stop")

    def engage(self, stops: int | None = None) -> None:
        self.calls.append(("engage", stops))
        if stops is not None and stops != self.stops:
            return
        self.guard, self.trip = GuardState.RUNNING, Trip.NONE

    def cool(self) -> None:
        self.calls.append(("cool",))

    def press(self, buttons: Any) -> None:
        self.calls.append(("press", tuple(buttons)))

    def set_mode(self, mode: str) -> None:
        self.calls.append(("mode", mode))

    def set_model(self, name: str) -> None:
        self.calls.append(("model", name))
        if name not in self.models:
            raise UnknownName("model of device 'omni'", name, self.models)
        self.model = name

    def clutch(self, engaged: bool) -> None:
        self.calls.append(("clutch", engaged))

    def count(self, kind: str) -> int:
        """How often `kind` was called."""
        return sum(call[0] == kind for call in self.calls)

    def rows(self, cursor: int = 0, most: int | None = None) -> tuple[int, np.ndarray]:
        self._publish()
        first = max(cursor, self._ticks - min(KEPT, KEPT if most is None else most))
        self.most_read = max(self.most_read, self._ticks - first)
        return self._ticks, self._rows[np.arange(first, self._ticks) % KEPT]

    def _publish(self) -> None:
        now = time.monotonic()
        due = int((now - self._start) * 1000)
        n = min(due - self._ticks, KEPT)
        if n <= 0 or self.silent:
            return
        ticks = np.arange(due - n, due)
        places = ticks % KEPT
        self._rows[places] = self._row()
        self._rows[places, self.layout["tick"].start] = ticks
        self._rows[places, self.layout["t"].start] = ticks * 1e-3
        self._rows[places, self.layout["wall"].start] = self._start + ticks * 1e-3
        self._ticks = due

    def _row(self) -> np.ndarray:
        row, at = self.layout.empty(), self.layout
        on = self.guard in (GuardState.RUNNING, GuardState.RAMPING, GuardState.DERATED)
        distance = max(np.linalg.norm(self.target), self.device.contact_distance)
        p = self.target / np.linalg.norm(self.target) * distance
        asked = self._world.for_device(self.device).wrench(State.at(p)) if on else np.zeros(6)
        p = p + 0.002 * asked[:3]
        given = asked
        if self.model == "published":  # the magnet's length, and the core's pull
            given = np.concatenate([1.156 * asked[:3] - 0.053 * p / np.linalg.norm(p), np.zeros(3)])
        for name, value in {
            "lateness": 4e-6,
            "missed": 0.0,
            "stages": 8e-6,
            "guard": self.guard,
            "trip": self.trip,
            "coil_state": self.coils,
            "gain": float(on),
            "world": self._changes,
            "valid": float(self.valid),
            "age": 0.0,
            "p": p,
            "q": upright_quaternion(p),
            "v": 0.0,
            "w": 0.0,
            "hand_goal": self.target,
            "hand_goal_q": upright_quaternion(self.target),
            "wrench_commanded": asked,
            "wrench_model": asked,
            "wrench_actual": given,
            "current_commanded": 9 * asked[:3],
            "current_measured": 9 * asked[:3] + 1e-3,
            "duty_applied": 0.3,
            "resistance": 0.62,
            "boundary": 298.5,
            "winding": self.winding,
            "remaining": 42.0,
            "saturated": 0.0,
            "part": 0.0,
            "model": self.models.index(self.model),
            "field": 0.0,
        }.items():
            row[at[name]] = value
        return row


def refusal() -> InputError:
    """What a real servo says to an impossible world."""
    return InputError("Dome.moment must lie between -4 and 4 A·m²; got 9")
