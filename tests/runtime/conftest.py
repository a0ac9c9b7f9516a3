"""A chain without a device: fills rows, logs driver events to a file, and misbehaves on demand."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cloudpickle
import numpy as np
import pytest

import haptorb
from haptorb.control.trip_reasons import GuardState, Trip
from haptorb.recording.row import RowLayout
from haptorb.runtime import servo as servo_module
from haptorb.runtime.config import RunConfig
from haptorb.runtime.drivers.base import Driver
from haptorb.runtime.servo import Servo
from haptorb.worlds.dynamic import make_client_force

cloudpickle.register_pickle_by_value(sys.modules[__name__])  # the servo's process cannot import a conftest


class FakeDriver(Driver):
    """Writes 'open' and 'close' into a file: what a coil would feel."""

    name = "fake"
    simulated = True

    def __init__(self, log: Path, fails: str = "") -> None:
        self._log, self._fails, self._closed = log, fails, True

    def _say(self, word: str) -> None:
        with self._log.open("a") as file:
            file.write(f"{word} {os.getpid()}\n")

    def open(self) -> None:
        if self._fails == "open":
            raise haptorb.errors.DriverError("nobody at the other end")
        self._closed = False
        self._say("open")

    def close(self) -> None:
        if not self._closed:
            self._closed = True
            self._say("close")

    def read(self, now: float) -> Any:
        raise NotImplementedError

    def write(self, duties: Any) -> Any:
        raise NotImplementedError

    def wrench_actual(self) -> Any:
        raise NotImplementedError


class FakeChain:
    """Half of full duty on all coils, until tripped. `behaviour`: seconds of work, tick at which to raise or hang."""

    def __init__(self, layout: RowLayout, world: Any, log: Path, tracker: Any, **behaviour: Any) -> None:
        self.driver = FakeDriver(log, behaviour.get("fails", ""))
        self.guard = self
        self.error = self.remark = ""
        self.client = make_client_force()
        self.world = world
        self._layout, self._behaviour, self._tracker = layout, behaviour, tracker
        self._trip = Trip.NONE
        self._changes = 0
        self._ticks = 0

    def trip(self, reason: Trip) -> None:
        if self._trip is Trip.NONE:
            self._trip = reason

    def stop(self) -> None:
        self.trip(Trip.STOPPED)

    def engage(self) -> bool:
        self._trip = Trip.NONE
        return True

    def change_world(self, world: Any) -> None:
        self.world = world
        self._changes += 1

    def change_model(self, number: int) -> None:
        self.model = number

    def prepare(self, now: float) -> None:
        pass

    def exclude_next_lateness(self) -> None:
        pass

    def step(self, row: Any, now: float) -> None:
        at, wants = self._layout, self._behaviour
        if self._ticks == wants.get("raise_at"):
            raise ZeroDivisionError("a fault that nobody foresaw")
        if self._ticks == wants.get("hang_at"):
            while True:
                pass
        if self._ticks == wants.get("act_at"):
            wants["act"]()
        if self._ticks == wants.get("kill_at"):
            os.kill(os.getpid(), signal.SIGKILL)
        if wants.get("slow_at", 1 << 60) <= self._ticks < wants.get("slow_until", 1 << 60):
            time.sleep(wants["slow"])
        row[:] = 0.0
        row[at["t"]] = now
        row[at["guard"]] = GuardState.RUNNING if self._trip is Trip.NONE else GuardState.TRIPPED
        row[at["trip"]] = self._trip
        row[at["gain"]] = self._trip is Trip.NONE
        row[at["world"]] = self._changes
        row[at["duty_applied"]] = 0.5 if self._trip is Trip.NONE else 0.0
        row[at["current_commanded"]] = 3.0 if self._trip is Trip.NONE else 0.0
        row[at["wrench_commanded"]] = row[at["wrench_actual"]] = row[at["wrench_model"]] = (
            0.0,
            0.3,
            0.4,
            0.0,
            0.0,
            0.0,
        )
        goal = self._tracker.goal(now)
        row[at["hand_goal"]], row[at["hand_goal_q"]] = goal.p, goal.q
        row[at["age"]] = now - goal.stamp
        row[at["stages"]] = 1e-6 * np.arange(1, 8)
        self._ticks += 1


def open_log(log: Path) -> list[str]:
    """What the driver of the real run said; the rehearsal's open and close are the first two words."""
    words = [line.split()[0] for line in log.read_text().splitlines()] if log.exists() else []
    return words[2:]


@contextmanager
def _making(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Any]]:
    made: list[Servo] = []
    device = haptorb.load("omni")
    layout = RowLayout.of(device)

    def make(behaviour: dict[str, Any] | None = None, **arguments: Any) -> Any:
        log = folder / f"driver{len(made)}.log"
        wants = dict(behaviour or {})

        def assemble(config: RunConfig, tracker: Any) -> FakeChain:
            return FakeChain(layout, config.world, log, tracker, **wants)

        monkeypatch.setattr(servo_module, "assemble", assemble)
        servo = Servo(device, arguments.pop("world", "nothing"), **arguments)
        made.append(servo)
        return SimpleNamespace(servo=servo, words=lambda: open_log(log), log=log)

    try:
        yield make
    finally:
        for servo in made:
            servo.close()


@pytest.fixture
def fake_servo(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, quick_starts: None) -> Iterator[Callable[..., Any]]:
    """A function that makes a Servo over a `FakeChain` with the given behaviour; all are closed at the end."""
    with _making(tmp_path, monkeypatch) as make:
        yield make


@pytest.fixture(scope="module")
def servos(tmp_path_factory: pytest.TempPathFactory, quick_starts: None) -> Iterator[Callable[[], Servo]]:
    """A function that starts such a Servo, whose world is a dome."""
    with ExitStack() as stack:

        def start() -> Servo:
            with pytest.MonkeyPatch.context() as patch:
                make = stack.enter_context(_making(tmp_path_factory.mktemp("running"), patch))
                servo: Servo = make(world="dome", record=False).servo
                servo.open()
            return servo

        yield start


@pytest.fixture(scope="module")
def alive() -> list[Servo]:
    """The servo of `running`, if there is one."""
    return []


@pytest.fixture
def running(servos: Callable[[], Servo], alive: list[Servo]) -> Servo:
    """One such Servo for all tests of a file that leave it running; another one where it has ended."""
    if not alive or not alive[0].alive:
        alive[:] = [servos()]
    return alive[0]


@pytest.fixture(scope="module")
def ended(tmp_path_factory: pytest.TempPathFactory, quick_starts: None) -> Iterator[SimpleNamespace]:
    """A servo that ran for half a second at 500 Hz and has ended: the `ticks` that were read meanwhile, a `row` of it,
    whether it was `alive`, and the `words` of its driver."""
    with pytest.MonkeyPatch.context() as patch, _making(tmp_path_factory.mktemp("ended"), patch) as make:
        made = make(rate=500.0)
        with made.servo as servo:
            patch.undo()  # it has started
            cursor, made.ticks = 0, []
            end = time.monotonic() + 0.5
            while time.monotonic() < end:
                cursor, rows = servo.rows(cursor)
                made.ticks.extend(rows[:, 0].tolist())
                time.sleep(0.01)
            made.row, made.alive = servo.latest(), servo.alive
        yield made
