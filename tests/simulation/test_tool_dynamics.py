"""The tool as a rigid body: fall, spin, bounce, slide. Contact and hand never generate energy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from haptorb.simulation.surface_contact import contact
from haptorb.simulation.tool_dynamics import GRAVITY, TOOL, fill_remaining_rotation, matrix, move
from oracles.repetitions import repetitions

MASS, TIP, TAIL = 0.026, 0.02, 0.012
WEIGHT = MASS * GRAVITY
RADIUS, STIFFNESS = 0.03, 15e3
INERTIA = np.array([4.5e-5, 4.0e-5, 8e-7])
FINGERS = (0.0, 0.0, 0.5, 5e-3)  # that only keep it upright
SLICK = {"damping": 0.0, "friction": 0.0}
DT = 2.5e-4
triples = st.tuples(*[st.floats(-1, 1)] * 3)


def tool_at(p, turn=(0.0, 0.0, 0.0), v=(0.0, 0.0, 0.0), w=(0.0, 0.0, 0.0), *, grip=(0, 0, 0, 0), dome=None, **others):
    """A TOOL over a dome, held by nobody, without weight, its goal at the centre and upright; `others` are fields."""
    tool = np.zeros(1, TOOL)[0]
    tool["mass"], tool["inertia"], tool["tip"], tool["tail"] = MASS, INERTIA, TIP, TAIL
    for name, value in {
        "radius": RADIUS,
        "stiffness": STIFFNESS,
        "damping": 12.0,
        "friction": 0.15,
        **(dome or {}),
    }.items():
        tool["dome"][name] = value
    tool["grip"], tool["goal_q"] = grip, (0.0, 0.0, 0.0, 1.0)
    tool["p"], tool["q"], tool["v"], tool["w"] = p, Rotation.from_rotvec(turn).as_quat(), v, w
    for name, value in others.items():
        tool[name] = value
    return tool


def turn_with(tool):
    R = np.empty((3, 3))
    matrix(tool["q"], R)
    return R


def step(tool, dt=DT):
    R, wrench, turn = turn_with(tool), np.zeros(6), np.zeros(3)
    depth = contact(tool, R, dt, wrench)
    fill_remaining_rotation(tool["q"], tool["goal_q"], turn)
    move(tool, R, turn, wrench, dt)
    return depth


def kinetic(tool):
    w = turn_with(tool).T @ tool["w"]
    return 0.5 * tool["mass"] * tool["v"] @ tool["v"] + 0.5 * INERTIA @ w**2


def touching(tool):
    """Depth of the shaft's nearest point in the dome."""
    axis = turn_with(tool)[:, 2]
    nearest = min(max(-float(tool["p"] @ axis), -TIP), TAIL)
    return RADIUS - float(np.linalg.norm(tool["p"] + nearest * axis))


@given(triples)
def test_matrix_is_scipys(turn):
    assert np.allclose(turn_with(tool_at((0, 0, 1), turn)), Rotation.from_rotvec(turn).as_matrix(), atol=1e-14)


@given(st.tuples(*[st.floats(-2, 2)] * 3), st.tuples(*[st.floats(-2, 2)] * 3), st.sampled_from([-1.0, 1.0]))
def test_rotation_left_is_the_shortest_way(start, goal, sign):
    a, b, out = Rotation.from_rotvec(start), Rotation.from_rotvec(goal), np.empty(3)
    fill_remaining_rotation(a.as_quat(), sign * b.as_quat(), out)
    assert (Rotation.from_rotvec(out) * a * b.inv()).magnitude() < 1e-7
    assert np.linalg.norm(out) <= np.pi + 1e-9


def test_free_fall():
    tool = tool_at((0, 0, 2.0), v=(0.3, 0, 0), weight=WEIGHT)
    for _ in range(400):
        step(tool)
    t = 400 * DT
    assert tool["v"][2] == pytest.approx(-GRAVITY * t, rel=1e-12)
    assert tool["p"][2] == pytest.approx(2.0 - GRAVITY * t * (t + DT) / 2, rel=1e-9)  # velocity first, then place
    assert tool["p"][0] == pytest.approx(0.3 * t)
    assert not tool["w"].any()


def test_spinning_freely_keeps_angular_momentum_and_energy():
    tool = tool_at((0, 0, 2.0), (0.3, 0.1, 0), w=(3.0, 5.0, 40.0))
    momentum = turn_with(tool) @ (INERTIA * (turn_with(tool).T @ tool["w"]))
    energy = kinetic(tool)
    for _ in range(4000):
        step(tool, dt=DT / 10)
    after = turn_with(tool) @ (INERTIA * (turn_with(tool).T @ tool["w"]))
    assert np.linalg.norm(after - momentum) < 2e-2 * np.linalg.norm(momentum)
    assert kinetic(tool) == pytest.approx(energy, rel=2e-2)
    assert np.linalg.norm(tool["q"]) == pytest.approx(1.0, abs=1e-12)


@settings(max_examples=repetitions(13, 40))
@given(triples, triples, triples)
def test_contact_without_hand_or_weight_never_makes_energy(turn, v, w):
    tool = tool_at((0.004, 0.0, 0.051), turn, 0.4 * np.array(v) - (0, 0, 0.3), 5.0 * np.array(w))
    if touching(tool) > 0:
        return
    start = kinetic(tool)
    for _ in range(400):
        depth = step(tool)
        stored = 0.5 * STIFFNESS * max(depth, 0.0) ** 2
        assert kinetic(tool) <= start * 1.02 + 1e-9
        assert all(np.isfinite(tool[name]).all() for name in "pqvw")
        assert stored <= start * 1.05 + 1e-9


def test_an_elastic_dome_gives_the_energy_back():
    tool = tool_at((0, 0, 0.055), v=(0, 0, -0.5), dome=SLICK)
    start = kinetic(tool)
    for _ in range(200):
        step(tool)
    assert tool["v"][2] > 0.0
    assert kinetic(tool) == pytest.approx(start, rel=1e-2)


def test_damping_takes_most_of_a_bounce():
    tool = tool_at((0, 0, 0.055), v=(0, 0, -0.5))
    for _ in range(200):
        step(tool)
    assert 0.0 <= tool["v"][2] < 0.4


def test_weight_rests_on_the_dome_at_the_springs_depth():
    tool = tool_at((0, 0, 0.05), grip=FINGERS, weight=WEIGHT)
    for _ in range(4000):
        depth = step(tool)
    assert depth == pytest.approx(WEIGHT / STIFFNESS, rel=1e-6)
    assert np.abs((tool["v"], tool["w"])).max() < 1e-9


def test_friction_stops_a_slide_and_does_not_turn_it_round():
    tool = tool_at((0, 0, 0.05 - WEIGHT / STIFFNESS), v=(0.03, 0, 0), grip=FINGERS, weight=WEIGHT)
    speeds = []
    for _ in range(1000):
        step(tool)
        tip = tool["v"] + np.cross(tool["w"], -TIP * turn_with(tool)[:, 2])
        speeds.append(tip[0])
    assert speeds[0] > 0.0
    assert np.abs(speeds[-200:]).max() < 2e-3
    assert min(speeds) > -8e-3


@given(st.floats(1e-5, 0.3), st.floats(1e-5, 1e-3), st.floats(0.1, 20.0))
def test_however_rough_friction_only_stops(speed, depth, friction):
    tool, wrench = tool_at((0, 0, 0.05 - depth), v=(speed, 0, 0), dome={"friction": friction}), np.zeros(6)
    contact(tool, turn_with(tool), DT, wrench)
    pushed = np.array([wrench[0], 0, 0]) / MASS, np.array([0, wrench[4] / INERTIA[1], 0])
    tip = speed + DT * (pushed[0] + np.cross(pushed[1], [0, 0, -TIP]))[0]
    assert wrench[0] < 0.0
    assert -1e-12 < tip < speed


def test_the_dome_never_pulls():
    wrench = np.zeros(6)
    contact(tool_at((0, 0, 0.04999), v=(0, 0, 3.0)), np.eye(3), DT, wrench)
    assert not wrench.any()


@given(triples, triples)
def test_the_nearest_point_of_the_shaft_touches(place, turn):
    p = np.array(place) * 0.04 + (0, 0, 0.03)
    tool, wrench = tool_at(p, 3 * np.array(turn), dome=SLICK), np.zeros(6)
    depth = contact(tool, turn_with(tool), DT, wrench)
    expected = max(touching(tool), 0.0)
    assert depth == pytest.approx(expected, abs=2e-8)
    if expected > 1e-6:
        assert np.linalg.norm(wrench[:3]) == pytest.approx(STIFFNESS * depth)
        # the push goes through the centre: without friction it turns nothing about it
        assert np.abs(np.cross(p, wrench[:3]) + wrench[3:]).max() < 1e-9 * STIFFNESS


def test_no_tilt_brings_the_magnet_into_the_dome():
    lying = Rotation.from_rotvec((np.pi / 2, 0, 0)).as_quat()
    tool = tool_at((0, 0, 0.06), grip=(500.0, 10.0, 0.5, 5e-3), goal_q=lying)
    for _ in range(8000):
        step(tool)
    assert np.linalg.norm(tool["p"]) > 0.029


def test_a_hand_is_a_damped_spring():
    stiffness, damping, mass = 100.0, 2.0, 0.126
    tool = tool_at((0, 0, 1.0), grip=(stiffness, damping, 0.15, 2e-3), mass=mass, goal=(0.0, 0.0, 1.01))
    rate = np.sqrt(stiffness / mass - (damping / 2 / mass) ** 2)
    fade = damping / 2 / mass
    for n in range(1, 2001):
        step(tool, dt=5e-5)
        t = n * 5e-5
        left = np.exp(-fade * t) * (np.cos(rate * t) + fade / rate * np.sin(rate * t))
        assert tool["p"][2] - 1.01 == pytest.approx(-0.01 * left, abs=4e-5)


def test_a_hand_turns_the_tool_to_its_goal():
    goal = Rotation.from_rotvec((0.5, -0.4, 1.0)).as_quat()
    tool = tool_at((0, 0, 1.0), grip=(0, 0, 0.15, 2e-3), goal_q=goal)
    for _ in range(4000):
        step(tool)
    assert (Rotation.from_quat(tool["q"]) * Rotation.from_quat(goal).inv()).magnitude() < 1e-6


@pytest.mark.parametrize("grip", [(1e6, 0.0, 1e3, 0.0), (1e6, 1e4, 1e3, 10.0)])
def test_no_grip_is_too_firm_for_the_step(grip):
    tool = tool_at((0, 0, 1.0), (0.4, 0, 0.2), grip=grip, goal=(0, 0, 1.02))
    for _ in range(2000):
        step(tool)
        assert abs(tool["p"][2] - 1.01) < 0.0201
    assert tool["p"][2] == pytest.approx(1.02, abs=1e-6)
