"""Hand on a motor's handle: realistic motion, within the workspace, at the commanded pose."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from haptorb.runtime.pointer import PointerTracker
from haptorb.runtime.shared_memory import HandGoalSource, HostHandGoal
from haptorb.simulation.hand_motion import HandleMotion, handle_quaternion


def test_the_quaternion_is_that_of_tilt_then_spin():
    rng = np.random.default_rng(2)
    for angles in rng.uniform(-1, 1, (50, 3)):
        ours, theirs = handle_quaternion(*angles), Rotation.from_euler("XYZ", angles).as_quat()
        assert abs(ours @ theirs) == pytest.approx(1.0)


def test_it_is_a_hands_motion_within_the_workspace():
    h = 2e-3
    t = np.arange(0.0, 16.0, h)
    q = np.array([HandleMotion().at(s)[1] for s in t])
    R = Rotation.from_quat(q)
    tilt = np.degrees(np.arccos(R.as_matrix()[:, 2, 2]))
    assert tilt.max() < 22.5
    angles = R.as_euler("XYZ", degrees=True)
    assert np.ptp(angles[:, 1]) == pytest.approx(40.0, abs=1e-6)  # the plug's whole way
    assert angles[:, 1].argmax() < len(t) / 2  # out first
    speed = np.gradient(angles, h, axis=0)
    assert np.abs(speed).max() < 30.0
    assert np.abs(np.gradient(speed, h, axis=0)).max() < 60.0
    assert (q[t >= HandleMotion.duration] == q[-1]).all()


class Hand(HandGoalSource):
    def __init__(self):
        self.now = HostHandGoal(False, np.zeros(3), np.array([0.0, 0, 0, 1.0]), 0.0)

    def read_hand_goal(self):
        return self.now


def test_held_then_back_the_short_way():
    hand = Hand()
    tracker = PointerTracker(hand, guide=HandleMotion())
    assert (tracker.goal(0.5).q == HandleMotion().at(0.5)[1]).all()
    q = -handle_quaternion(0.2, -0.1, 0.3)  # the same turn, the other sign
    hand.now = HostHandGoal(True, np.zeros(3), q, 0.0)
    assert tracker.goal(1.0).held
    hand.now = HostHandGoal(False, np.zeros(3), q, 0.0)
    back = [tracker.goal(1.0 + s) for s in np.linspace(0, 2, 100)]
    assert not back[0].held
    assert abs(back[0].q @ q) == pytest.approx(1.0)
    assert back[-1].q == pytest.approx(HandleMotion().at(20.0)[1])
    steps = [abs(a.q @ b.q) for a, b in pairwise(back)]
    assert min(steps) > np.cos(np.radians(2.0))


def test_the_exactly_opposite_turn_has_a_way_too():
    rest = HandleMotion().at(20.0)[1]
    opposite = np.array([rest[3], rest[2], -rest[1], -rest[0]])
    assert abs(opposite @ rest) < 1e-12
    for share in np.linspace(0, 1, 11):
        assert np.linalg.norm(HandleMotion().pose_on_return(np.zeros(3), opposite, share)[1]) == pytest.approx(1.0)
