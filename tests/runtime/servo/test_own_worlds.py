"""A user's own world in a running servo: reloaded when saved, and every bug in it reported."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from haptorb.errors import UnknownName, WorldError
from haptorb.runtime.servo import Servo
from haptorb.worlds.user_world import FunctionWorld

pytestmark = [pytest.mark.realtime, pytest.mark.usefixtures("quick_starts")]

GROOVE = '''
from dataclasses import dataclass
import time
import numpy as np
from haptorb.worlds import World
from haptorb.worlds.base import parameter


@dataclass(frozen=True)
class Groove(World):
    """Pushes to one side."""

    push: float = parameter(0.1, "N", -1, 1, "force along y")

    def wrench(self, state):
        wrench = np.zeros(6)
        wrench[1] = self.push
        return wrench
'''
BEGIN = "wrench = np.zeros(6)"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "groove.py"
    path.write_text(GROOVE)
    return path


def _hold(servo: Servo, until: Any, patience: float = 10.0) -> float:
    """Let the simulated hand move until something is so; the seconds that took."""
    begun = time.monotonic()
    while not until():
        assert time.monotonic() < begun + patience, "it did not come to pass"
        servo.check()
        time.sleep(0.005)
    return time.monotonic() - begun


def _wait(seconds: float) -> Any:
    end = time.monotonic() + seconds
    return lambda: time.monotonic() > end


def test_a_saved_file_is_felt_within_a_second_and_the_force_goes_over_without_a_step(file: Path, capfd: Any) -> None:
    with Servo("omni", f"{file}:Groove", record=False) as servo:
        servo.set_world("groove", {"push": 0.12})
        _hold(servo, _wait(0.8))
        cursor, _ = servo.rows()
        file.write_text(GROOVE.replace("= self.push", "= -self.push"))
        took = _hold(servo, lambda: "reloaded" in capfd.readouterr().err)
        _hold(servo, _wait(0.2))
        _, rows = servo.rows(cursor)
        assert servo.world == ("groove", {"push": 0.12}), "what a person has set stays"
        assert servo.alive
        assert servo.world_trouble == ""
    assert took < 1.0
    asked = rows[:, servo.layout["wrench_commanded"]][:, 1]
    assert asked[0] == pytest.approx(0.12, rel=0.05)
    assert asked[-1] == pytest.approx(-0.12, rel=0.05)
    between = np.flatnonzero((asked < 0.119) & (asked > -0.119))
    t = rows[:, servo.layout["t"].start]
    assert t[between[-1]] - t[between[0]] < 0.05
    assert abs(np.diff(asked)).max() < 0.24 / 5, "the force fades over, in a loop that misses a few ticks as well"


def test_an_error_in_a_saved_file_leaves_the_old_world_running(file: Path, capfd: Any) -> None:
    with Servo("omni", f"{file}:Groove", record=False) as servo:
        _hold(servo, _wait(0.5))
        for bug in ("return wrench[", "return None", "return 1 / 0"):
            cursor, _ = servo.rows()
            file.write_text(GROOVE.replace("return wrench", bug))
            _hold(servo, lambda: servo.world_trouble)
            _hold(servo, _wait(0.2))
            assert "groove.py was saved, but the previous world continues" in servo.world_trouble
            assert 'groove.py", line ' in servo.world_trouble
            assert servo.world_trouble in servo.warning
            _, rows = servo.rows(cursor)
            assert rows[:, servo.layout["wrench_commanded"]][:, 1] == pytest.approx(0.1, rel=0.05)
            assert "line " in capfd.readouterr().err
            file.write_text(GROOVE.replace("0.1,", "0.2,"))
            _hold(servo, lambda: not servo.world_trouble)
            assert servo.world[1] == {"push": 0.2}, "what nobody has set is as the file says"
            file.write_text(GROOVE)
            _hold(servo, lambda: servo.world[1] == {"push": 0.1})
            _hold(servo, lambda: abs(servo.latest()[servo.layout["wrench_commanded"]][1] - 0.1) < 1e-3)


def test_another_world_that_is_felt_stays_and_the_new_code_is_there_when_it_is_chosen(file: Path) -> None:
    with Servo("omni", f"{file}:Groove", record=False) as servo:
        servo.set_world("dome")
        before = servo.own_worlds
        file.write_text(GROOVE.replace("0.1,", "0.3,"))
        _hold(servo, lambda: servo.own_worlds is not before)
        assert servo.world[0] == "dome"
        servo.set_world("groove")
        assert servo.world == ("groove", {"push": 0.3})
        with pytest.raises(UnknownName):
            servo.set_world(f"{file}:Groove")


def test_a_world_that_fails_is_told_everywhere(file: Path) -> None:
    file.write_text(GROOVE.replace(BEGIN, f"{BEGIN}\n        if state.t > 0.5: wrench[9] = 1.0"))
    with Servo("omni", f"{file}:Groove") as servo:
        with pytest.raises(WorldError, match=r"IndexError: [\s\S]*groove\.py\", line \d+, in Groove\.wrench") as caught:
            servo.run(10)
        assert "if state.t > 0.5: wrench[9] = 1.0" in str(caught.value)
        assert servo.alive, "a world that fails switches the coils off; a person may engage again"
        assert "IndexError" in servo.warning
        assert "IndexError" in servo.report()["error"]
        file.write_text(GROOVE)
        _hold(servo, lambda: "groove.py" not in servo.world_trouble or servo.engage())
        servo.run(0.2)
    errors = servo.recording.errors  # one more for each engage before the file was reloaded
    assert errors
    assert all("IndexError" in error["text"] and "line" in error["text"] for error in errors)


def test_a_slow_world_is_told_with_its_time_and_the_tick_s(file: Path) -> None:
    file.write_text(GROOVE.replace(BEGIN, f"time.sleep(0.01); {BEGIN}"))
    with (
        Servo("omni", f"{file}:Groove", record=False) as servo,
        pytest.raises(WorldError, match=r"takes 1[0-9] ms in each tick, and a tick at 1000 Hz has 1 ms"),
    ):
        servo.run(10)


def test_what_a_world_prints_arrives(file: Path, capfd: Any) -> None:
    file.write_text(GROOVE.replace(BEGIN, f'print("felt at", int(1e3 * state.t)) if state.t > 0.1 else 0; {BEGIN}'))
    with Servo("omni", f"{file}:Groove", record=False) as servo:
        servo.run(0.5)
    told = capfd.readouterr().err
    assert told.count("felt at") > 100
    assert "felt at 0\n" not in told, "what it prints while the servo rehearses is nobody's"


def test_a_plain_function_is_a_world() -> None:
    def push(state):
        return np.array([0.0, 0.15, 0.0, 0.0, 0.0, 0.0])

    with Servo("omni", push, record=False) as servo:
        _hold(servo, _wait(0.5))
        assert servo.world == ("push", {})
        assert servo.latest()[servo.layout["wrench_commanded"]][1] == pytest.approx(0.15, rel=0.05)


COUNTER = '''
from dataclasses import dataclass
import numpy as np
from haptorb.worlds import DynamicWorld, MemoryField
from haptorb.worlds.base import parameter


@dataclass(frozen=True)
class Counter(DynamicWorld):
    """Counts its steps."""

    push: float = parameter(0.1, "N", -1, 1, "force along y")

    @property
    def memory_fields(self):
        return (MemoryField("steps", "1", "so far"), MemoryField("many", "m", "unused", (40,)))

    def advance(self, memory, state, dt):
        memory["steps"] += 1
        return np.array([0, self.push, 0, 0, 0, 0])
'''


def test_a_world_with_memory_goes_on_when_its_file_is_saved_and_its_memory_is_recorded(tmp_path: Path) -> None:
    file = tmp_path / "counter.py"
    file.write_text(COUNTER)
    servo = Servo("omni", f"{file}:Counter")
    before_start = servo.layout  # of what a console that is made before the start sends
    with servo:
        assert servo.layout == before_start
        _hold(servo, _wait(0.4))
        assert servo.latest().memory.shape == (41,), "more than rows have room for otherwise"
        before = servo.latest().memory[0]
        file.write_text(COUNTER.replace("0.1,", "0.2,"))
        _hold(servo, lambda: servo.world[1] == {"push": 0.2})
        _hold(servo, _wait(0.1))
        assert servo.latest().memory[0] > before > 100
        file.write_text(COUNTER.replace('"1", "so far"', '"1", "so far", (2,)'))
        _hold(servo, lambda: servo.world[1] == {"push": 0.1})
        _hold(servo, _wait(0.1))
        assert 0 < servo.latest().memory[0] < before, "another memory begins anew"
        servo.set_world("ball")
        _hold(servo, _wait(0.1))
    recording = servo.recording
    steps = recording.memory["counter.steps"]
    assert np.isfinite(steps).any()
    assert np.isnan(steps[-1]).all()
    assert np.linalg.norm(recording.memory["ball.place"][-1]) == pytest.approx(0.05)
    assert recording.memory_units["ball.place"] == "m"


def test_a_memory_that_breaks_in_a_servo_is_told(tmp_path: Path) -> None:
    file = tmp_path / "counter.py"
    file.write_text(COUNTER.replace("+= 1\n", "+= 1 if memory['steps'] < 200 else np.inf\n"))
    with Servo("omni", f"{file}:Counter", record=False) as servo:
        with pytest.raises(
            WorldError, match=r"(?s)memory of world 'counter' is no longer finite in steps.*coils are off"
        ):
            servo.run(seconds=5)
        assert "steps" in servo.world_trouble


def _push(state: Any) -> Any:
    return np.array([0.3, 0.0, 0.0, 0.0, 0.0, 0.0])


def _pull(state: Any) -> Any:
    return np.array([-0.3, 0.0, 0.0, 0.0, 0.0, 0.0])


def test_another_function_is_felt_when_the_force_of_this_one_is_zero() -> None:
    servo = Servo("omni", _push, record=False)
    servo.add_world(FunctionWorld(_pull))
    with servo:
        servo.hand.hold((0.0, 0.0, 0.051))
        servo.run(0.6)
        cursor = servo.rows()[0]
        servo.set_world("_pull")
        servo.run(0.3)
        force = servo.rows(cursor)[1][:, servo.layout["wrench_commanded"].start]
    assert force[0] > 0.1
    assert force[-1] < -0.1
    assert (np.abs(force) < 1e-3).any()
