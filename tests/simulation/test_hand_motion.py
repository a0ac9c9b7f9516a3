"""Poses and paths that a program commands for the hand: meaning, and rejection before they reach the loop."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from haptorb.errors import InputError
from haptorb.simulation.hand_motion import SampledPath, check_pose, split_pose

TURNED = (0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5))


@pytest.mark.parametrize("p", [(0, 0, 50), (0, -60.0, 0), (0.8, 0.8, 0.0)])
def test_a_place_that_no_tool_can_have_is_refused_with_the_unit(p: Any) -> None:
    with pytest.raises(InputError, match=r"within 1 m of the device's centre; got .* in metres: 50 mm are 0\.05"):
        check_pose(p)


@pytest.mark.parametrize("p", [(0, 0, np.nan), (0, 0), "here", None, np.zeros((2, 3)), (0, np.inf, 0)])
def test_what_is_no_place_is_refused_with_what_is_wanted(p: Any) -> None:
    with pytest.raises(InputError, match=r"p must be the position of the tool's magnet, 3 finite numbers \[m\]; got"):
        check_pose(p)


@pytest.mark.parametrize("q", [(0, 0, 0, 0), (0, 0, 1), (0, 0, 0, np.inf), "up"])
def test_what_is_no_turn_is_refused_with_what_is_wanted(q: Any) -> None:
    with pytest.raises(InputError, match=r"q must be a quaternion \(x, y, z, w\)"):
        check_pose((0, 0, 0.05), q)


def test_a_turn_has_length_one_and_a_radial_axis_where_none_is_given() -> None:
    assert check_pose((0, 0, 0.05), (0, 0, 3, 3))[1] == pytest.approx(TURNED)
    assert check_pose((0.05, 0, 0))[1] == pytest.approx((0, np.sqrt(0.5), 0, np.sqrt(0.5)))


def test_a_motor_s_handle_may_point_at_anything() -> None:
    assert check_pose((0, 0, 50.0), farthest=np.inf)[0][2] == 50.0


@pytest.mark.parametrize("pose", [((0, 0, 0.05), TURNED), (0, 0, 0.05, *TURNED), np.array([0, 0, 0.05, *TURNED])])
def test_place_and_turn_may_come_as_a_pair_or_in_one_row(pose: Any) -> None:
    p, q = check_pose(*split_pose(pose))
    assert p == pytest.approx((0, 0, 0.05))
    assert q == pytest.approx(TURNED)


def test_a_sampled_path_is_straight_between_its_poses_and_stays_at_the_last() -> None:
    path = SampledPath([(0, 0, 0.05), (0, 0.01, 0.05), (0, 0.01, 0.06)], [0.5, 1.0, 3.0])
    for t, place in ((0.0, (0, 0, 0.05)), (0.75, (0, 0.005, 0.05)), (2.0, (0, 0.01, 0.055)), (9.0, (0, 0.01, 0.06))):
        assert path(t)[0] == pytest.approx(place)


def test_a_sampled_path_turns_the_short_way() -> None:
    half = np.array([0, 0, np.sin(0.1), np.cos(0.1)])
    path = SampledPath([(0, 0, 0.05, 0, 0, 0, 1), (0, 0, 0.05, *(-half))], [0.0, 1.0])
    turn = path(0.5)[1]
    assert np.linalg.norm(turn) == pytest.approx(1.0)
    assert abs(turn @ (0, 0, np.sin(0.05), np.cos(0.05))) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("poses", "times", "says"),
    [
        ([(0, 0, 0.05), (0, 0, 50)], [0, 1], r"pose 1 of the path: p must be within 1 m"),
        ([(0, 0, 0.05, 0, 0, 0, 0)], [0], r"pose 0 of the path: q must be a quaternion"),
        ([(0, 0, 0.05), (0, 0, np.nan)], [0, 1], "finite numbers"),
        ([(0, 0, 0.05), (0, 0, 0.06)], [1, 1], "times must increase"),
        ([(0, 0, 0.05), (0, 0, 0.06)], [-1, 1], "begin at 0 s"),
        ([(0, 0, 0.05), (0, 0, 0.06)], [0, 1, 2], "times must be 2 numbers"),
        ([(0, 0), (0, 1)], [0, 1], r"poses \(n, 3\)"),
        ((0, 0, 0.05), [0], r"poses \(n, 3\)"),
        (np.zeros((0, 3)), [], r"poses \(n, 3\)"),
    ],
)
def test_a_path_that_cannot_be_followed_is_refused_with_what_is_wanted(poses: Any, times: Any, says: str) -> None:
    with pytest.raises(InputError, match=says):
        SampledPath(poses, times)
