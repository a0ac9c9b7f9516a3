"""The hand: guided, held, released."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from haptorb.arrays import Array
from haptorb.devices.base import rotation_to_axis
from haptorb.runtime.pointer import PointerTracker
from haptorb.runtime.shared_memory import BINS, HandGoalSource, Histogram, HostHandGoal
from haptorb.simulation.hand_motion import DURATION_S, position_on_path, upright_quaternion

Z = np.array([0.0, 0.0, 1.0])


class Hand(HandGoalSource):
    """A pointer that the test moves."""

    def __init__(self) -> None:
        self.now = HostHandGoal(False, np.zeros(3), np.array([0.0, 0, 0, 1]), 0.0)

    def read_hand_goal(self) -> HostHandGoal:
        return self.now


def _tilt(p: Array) -> float:
    return float(np.degrees(np.arccos(p[2] / np.linalg.norm(p))))


def _matrix(q: Array) -> Array:
    x, y, z, w = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def test_the_guided_motion_shows_what_it_should() -> None:
    t = np.arange(0.0, 22.0, 0.001)
    path = np.array([position_on_path(s) for s in t])
    d = np.linalg.norm(path, axis=1)
    tilt = np.array([_tilt(p) for p in path])
    assert d[0] > 0.055  # begins in the air
    touch = int(np.argmax(d < 0.050))
    assert tilt[touch] == pytest.approx(30, abs=0.5)
    assert d[(t > 1.5) & (t < 16)] == pytest.approx(0.048)  # then leans on the dome, 2 mm below contact
    assert tilt.min() < 0.1  # passes the summit
    circling = (t > 6) & (t < 9.5)
    assert tilt[circling] == pytest.approx(18)
    bearing = np.unwrap(np.arctan2(path[:, 1], path[:, 0])[(t > 5) & (t < 10.5)])
    assert abs(bearing[-1] - bearing[0]) == pytest.approx(2 * np.pi, abs=0.01)  # around it
    assert tilt[(t >= 12) & (t <= 16)] == pytest.approx(10)
    assert tilt[t >= DURATION_S] == pytest.approx(58)  # and rests at the edge, beyond the dome's force
    assert d[t >= DURATION_S] == pytest.approx(0.0505)
    assert np.ptp(path[t >= DURATION_S], axis=0) == pytest.approx(0)


def test_the_guided_motion_is_a_hands() -> None:
    """No jumps in position, velocity or acceleration."""
    h = 1e-4
    path = np.array([position_on_path(s) for s in np.arange(0.0, 21.0, h)])
    v = np.diff(path, axis=0) / h
    a = np.diff(v, axis=0) / h
    assert np.linalg.norm(v, axis=1).max() < 0.06
    assert np.linalg.norm(a, axis=1).max() < 0.3
    assert np.abs(np.diff(a, axis=0)).max() < 2e-3  # a jerk of 20 m/s³ at most


@given(st.lists(st.floats(-1, 1), min_size=3, max_size=3).map(np.array).filter(lambda p: np.linalg.norm(p) > 1e-3))
def test_upright_is_the_shortest_turn(p: Array) -> None:
    q = upright_quaternion(p)
    assert np.linalg.norm(q) == pytest.approx(1)
    assert _matrix(q) @ Z == pytest.approx(p / np.linalg.norm(p), abs=2e-6)
    if p[2] > -0.99 * np.linalg.norm(p):
        assert _matrix(q) == pytest.approx(rotation_to_axis(p), abs=1e-9)


def test_upright_where_no_way_is_the_shortest() -> None:
    for p in (np.zeros(3), np.array([0.0, 0.0, -0.05])):
        assert np.linalg.norm(upright_quaternion(p)) == 1.0
    assert _matrix(upright_quaternion(-Z)) @ Z == pytest.approx(-Z)


def test_guided_until_held_then_back_to_rest() -> None:
    hand = Hand()
    tracker = PointerTracker(hand, origin=100.0)
    goal = tracker.goal(3.0)
    assert not goal.held
    assert goal.stamp == 3.0
    assert (goal.p == position_on_path(3.0)).all()

    hand.now = HostHandGoal(True, np.array([0.05, 0.0, 0.0]), np.array([0.0, 0, 0, 1]), 104.0)
    held = tracker.goal(4.2)
    assert held.held
    assert held.stamp == 4.0  # as old as the pointer, on the loop's clock
    assert (held.p == (0.05, 0, 0)).all()
    assert tracker.goal(9.0).stamp == 4.0

    hand.now = hand.now._replace(held=False)
    times = np.arange(9.0, 12.0, 0.001)
    goals = [tracker.goal(t) for t in times]
    path = np.array([goal.p for goal in goals])
    assert all(goal.stamp == t and not goal.held for goal, t in zip(goals, times, strict=True))
    assert np.linalg.norm(np.diff(path, axis=0), axis=1).max() < 3e-4  # no jump
    assert np.linalg.norm(path[0] - held.p) < 1e-4
    assert np.linalg.norm(path, axis=1).min() > 0.0479  # around the device, not through it
    assert path[-1] == pytest.approx(position_on_path(DURATION_S))


def test_a_simulated_hand_is_as_patient_as_its_word() -> None:
    hand = Hand()
    tracker = PointerTracker(hand)
    hand.now = HostHandGoal(True, np.array([0.05, 0.0, 0.0]), np.array([0.0, 0, 0, 1]), 4.0, keep_alive=0.3)
    assert [tracker.goal(t).stamp for t in (4.0, 4.2, 4.3, 9.0)] == [4.0, 4.2, 4.3, 4.3]
    assert tracker.goal(3.9).stamp == 4.0, "said after the tick began"


@given(st.lists(st.floats(-0.2, 0.2), min_size=3, max_size=3).map(np.array))
def test_released_anywhere(p: Array) -> None:
    hand = Hand()
    tracker = PointerTracker(hand)
    for place in (p, -position_on_path(DURATION_S), np.zeros(3)):
        hand.now = HostHandGoal(True, place, upright_quaternion(place), 0.0)
        tracker.goal(0.0)
        hand.now = hand.now._replace(held=False)
        for t in np.linspace(0.0, 2.0, 50):
            goal = tracker.goal(t)
            assert np.isfinite(goal.p).all()
            assert np.linalg.norm(goal.q) == pytest.approx(1)
        assert goal.p == pytest.approx(position_on_path(DURATION_S))


def test_the_same_twice() -> None:
    first, second = ([PointerTracker().goal(t).p.tobytes() for t in np.linspace(0, 21, 500)] for _ in range(2))
    assert first == second


@given(st.lists(st.integers(-100, 19_999_999), min_size=1, max_size=300), st.floats(0.1, 100))
def test_percentiles_are_right_to_a_microsecond(durations: list[int], percent: float) -> None:
    histogram = Histogram()
    for duration in durations:
        histogram.add(duration)
    exact = np.percentile(np.maximum(durations, 0) / 1000, percent, method="inverted_cdf")
    assert histogram.count == len(durations)
    assert exact <= histogram.percentile(percent) + 1e-9 <= exact + 1 + 2e-9


def test_histogram_at_its_ends() -> None:
    histogram = Histogram()
    assert np.isnan(histogram.percentile(50))
    histogram.add(10**15)
    assert histogram.percentile(50) == BINS


def test_a_host_compiles_nothing_when_it_points():
    """Compiling holds up all threads of a program for seconds, its heart among them: the servo takes it for dead."""
    program = """
import numpy as np
from numba.core import event
from haptorb.runtime.servo import Servo
from haptorb.runtime.shared_memory import SharedMemory

servo = Servo("omni", record=False)
servo._shared = SharedMemory.create(servo.layout)
with event.install_recorder("numba:compile") as compiled:
    servo.hand.point((0.0, 0.01, 0.05))
servo._shared.unlink()
print(len(compiled.buffer))
"""
    told = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=240, check=True)
    assert told.stdout.strip() == "0"
