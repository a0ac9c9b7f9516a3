"""Pointer as tracker: valid while held, never extrapolated for a script."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from haptorb.runtime.pointer import PointerTracker
from haptorb.runtime.shared_memory import HandGoalSource, HostHandGoal


class Source(HandGoalSource):
    def __init__(self) -> None:
        self.said = HostHandGoal(False, np.zeros(3), np.array([0.0, 0, 0, 1]), 0.0)

    def read_hand_goal(self) -> HostHandGoal:
        return self.said


def test_nobody_holds_it_and_nothing_is_believed() -> None:
    pose = PointerTracker(Source()).pose
    assert not pose(0.0).valid
    assert not pose(1.0).valid


def test_held_it_says_place_turn_time_and_velocity() -> None:
    source = Source()
    pose = PointerTracker(source).pose
    turn = Rotation.from_euler("xyz", [0.2, -0.1, 0.5])
    source.said = HostHandGoal(True, np.array([0.0, 0.0, 0.05]), turn.as_quat(), 1.0)
    first = pose(1.001)
    assert first.valid
    assert first.t == 1.0
    assert pytest.approx(turn.as_matrix()) == first.R_SR
    assert first.v.tolist() == [0, 0, 0]
    source.said = HostHandGoal(True, np.array([0.001, 0.0, 0.05]), turn.as_quat(), 1.01)
    for _ in range(2):  # asked again before the pointer speaks again, it says the same
        assert pose(1.012).v == pytest.approx([0.1, 0, 0])
    source.said = HostHandGoal(True, np.array([1.0, 0.0, 0.05]), turn.as_quat(), 1.02)
    assert pose(1.02).v.tolist() == [0, 0, 0]  # a jump is no motion


def test_a_pointer_that_falls_silent_grows_old() -> None:
    source = Source()
    source.said = HostHandGoal(True, np.array([0.0, 0.0, 0.05]), np.array([0.0, 0, 0, 1]), 1.0, keep_alive=1.0)
    pose = PointerTracker(source).pose
    assert pose(1.2).t == 1.0, "the keep-alive is for simulated hands"
    assert pose(9.0).t == 1.0
