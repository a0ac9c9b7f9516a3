"""The tool as a rigid body: fall, spin, bounce, slide. Contact and hand never make energy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from haptorb.simulation.parts.hand import LETTING_GO, Grip, rotation_left
from haptorb.simulation.parts.tool import GRAVITY, Body, DomeSurface, contact, matrix, move

BODY = Body(0.026, 0.0, 4.5e-5, 4.0e-5, 8e-7, 0.02, 0.012)
HEAVY = BODY._replace(weight=BODY.mass * GRAVITY)
DOME = DomeSurface(0.03, 15e3, 12.0, 0.15)
SLICK = DomeSurface(0.03, 15e3, 0.0, 0.0)
INERTIA = np.array([BODY.inertia_x, BODY.inertia_y, BODY.inertia_z])
DT = 2.5e-4
triples = st.tuples(*[st.floats(-1, 1)] * 3)


def state_at(p, turn=(0.0, 0.0, 0.0), v=(0.0, 0.0, 0.0), w=(0.0, 0.0, 0.0)):
    return np.concatenate([p, Rotation.from_rotvec(turn).as_quat(), v, w]).astype(float)


def turned(state):
    R = np.empty((3, 3))
    matrix(state[3:7], R)
    return R


def step(state, body=BODY, dome=DOME, grip=LETTING_GO, goal=(np.zeros(3), np.array([0, 0, 0, 1.0])), dt=DT):
    R, wrench, turn = turned(state), np.zeros(6), np.zeros(3)
    depth = contact(state, R, body, dome, dt, wrench)
    rotation_left(state[3:7], goal[1], turn)
    move(state, R, body, grip, goal[0], turn, wrench, dt)
    return depth


def kinetic(state, body=BODY):
    w = turned(state).T @ state[10:]
    return 0.5 * body.mass * state[7:10] @ state[7:10] + 0.5 * INERTIA @ w**2


def touching(state, dome=DOME):
    """Depth of the shaft's nearest point in the dome, found by brute force."""
    s = np.linspace(-BODY.tip, BODY.tail, 20001)
    return dome.radius - np.linalg.norm(state[:3] + s[:, None] * turned(state)[:, 2], axis=1).min()


@given(triples)
def test_matrix_is_scipys(turn):
    state = state_at((0, 0, 1), turn)
    assert np.allclose(turned(state), Rotation.from_rotvec(turn).as_matrix(), atol=1e-14)


@given(st.tuples(*[st.floats(-2, 2)] * 3), st.tuples(*[st.floats(-2, 2)] * 3), st.sampled_from([-1.0, 1.0]))
def test_rotation_left_is_the_shortest_way(start, goal, sign):
    a, b, out = Rotation.from_rotvec(start), Rotation.from_rotvec(goal), np.empty(3)
    rotation_left(a.as_quat(), sign * b.as_quat(), out)
    assert (Rotation.from_rotvec(out) * a * b.inv()).magnitude() < 1e-7
    assert np.linalg.norm(out) <= np.pi + 1e-9


def test_free_fall():
    state = state_at((0, 0, 2.0), v=(0.3, 0, 0))
    for _ in range(400):
        step(state, HEAVY)
    t = 400 * DT
    assert state[9] == pytest.approx(-GRAVITY * t, rel=1e-12)
    assert state[2] == pytest.approx(2.0 - GRAVITY * t * (t + DT) / 2, rel=1e-9)  # velocity first, then place
    assert state[0] == pytest.approx(0.3 * t)
    assert not state[10:].any()


def test_spinning_freely_keeps_angular_momentum_and_energy():
    state = state_at((0, 0, 2.0), (0.3, 0.1, 0), w=(3.0, 5.0, 40.0))
    momentum = turned(state) @ (INERTIA * (turned(state).T @ state[10:]))
    energy = kinetic(state)
    for _ in range(4000):
        step(state, dt=DT / 10)
    after = turned(state) @ (INERTIA * (turned(state).T @ state[10:]))
    assert np.linalg.norm(after - momentum) < 2e-2 * np.linalg.norm(momentum)
    assert kinetic(state) == pytest.approx(energy, rel=2e-2)
    assert np.linalg.norm(state[3:7]) == pytest.approx(1.0, abs=1e-12)


@settings(max_examples=40)
@given(triples, triples, triples)
def test_contact_without_hand_or_weight_never_makes_energy(turn, v, w):
    state = state_at((0.004, 0.0, 0.051), turn, 0.4 * np.array(v) - (0, 0, 0.3), 5.0 * np.array(w))
    if touching(state) > 0:
        return
    start = kinetic(state)
    for _ in range(400):
        depth = step(state)
        stored = 0.5 * DOME.stiffness * max(depth, 0.0) ** 2
        assert kinetic(state) <= start * 1.02 + 1e-9
        assert np.isfinite(state).all()
        assert stored <= start * 1.05 + 1e-9


def test_an_elastic_dome_gives_the_energy_back():
    state = state_at((0, 0, 0.055), v=(0, 0, -0.5))
    start = kinetic(state)
    for _ in range(200):
        step(state, dome=SLICK)
    assert state[9] > 0.0
    assert kinetic(state) == pytest.approx(start, rel=1e-2)


def test_damping_takes_most_of_a_bounce():
    state = state_at((0, 0, 0.055), v=(0, 0, -0.5))
    for _ in range(200):
        step(state)
    assert 0.0 <= state[9] < 0.4


def test_weight_rests_on_the_dome_at_the_springs_depth():
    state = state_at((0, 0, 0.05))
    grip = Grip(0.0, 0.0, 0.5, 5e-3)  # fingers that only keep it upright
    for _ in range(4000):
        depth = step(state, HEAVY, grip=grip)
    assert depth == pytest.approx(HEAVY.weight / DOME.stiffness, rel=1e-6)
    assert np.abs(state[7:]).max() < 1e-9


def test_friction_stops_a_slide_and_does_not_turn_it_round():
    state = state_at((0, 0, 0.05 - HEAVY.weight / DOME.stiffness), v=(0.03, 0, 0))
    grip = Grip(0.0, 0.0, 0.5, 5e-3)
    speeds = []
    for _ in range(1000):
        step(state, HEAVY, grip=grip)
        R = turned(state)
        tip = state[7:10] + np.cross(state[10:], -BODY.tip * R[:, 2])
        speeds.append(tip[0])
    assert speeds[0] > 0.0
    assert np.abs(speeds[-200:]).max() < 2e-3
    assert min(speeds) > -8e-3


@given(st.floats(1e-5, 0.3), st.floats(1e-5, 1e-3), st.floats(0.1, 20.0))
def test_however_rough_friction_only_stops(speed, depth, friction):
    state, wrench = state_at((0, 0, 0.05 - depth), v=(speed, 0, 0)), np.zeros(6)
    contact(state, turned(state), BODY, DOME._replace(friction=friction), DT, wrench)
    pushed = np.array([wrench[0], 0, 0]) / BODY.mass, np.array([0, wrench[4] / BODY.inertia_y, 0])
    tip = speed + DT * (pushed[0] + np.cross(pushed[1], [0, 0, -BODY.tip]))[0]
    assert wrench[0] < 0.0
    assert -1e-12 < tip < speed


def test_the_dome_never_pulls():
    R, wrench = np.eye(3), np.zeros(6)
    leaving = state_at((0, 0, 0.04999), v=(0, 0, 3.0))
    contact(leaving, R, BODY, DOME, DT, wrench)
    assert not wrench.any()


@given(triples, triples)
def test_the_nearest_point_of_the_shaft_touches(place, turn):
    p = np.array(place) * 0.04 + (0, 0, 0.03)
    state, wrench = state_at(p, 3 * np.array(turn)), np.zeros(6)
    depth = contact(state, turned(state), BODY, SLICK, DT, wrench)
    expected = max(touching(state), 0.0)
    assert depth == pytest.approx(expected, abs=2e-8)
    if expected > 1e-6:
        assert np.linalg.norm(wrench[:3]) == pytest.approx(SLICK.stiffness * depth)
        # the push goes through the centre: without friction it turns nothing about it
        assert np.abs(np.cross(p, wrench[:3]) + wrench[3:]).max() < 1e-9 * SLICK.stiffness


def test_no_tilt_brings_the_magnet_into_the_dome():
    grip, state = Grip(500.0, 10.0, 0.5, 5e-3), state_at((0, 0, 0.06))
    goal = (np.zeros(3), Rotation.from_rotvec((np.pi / 2, 0, 0)).as_quat())
    for _ in range(8000):
        step(state, grip=grip, goal=goal)
    assert np.linalg.norm(state[:3]) > 0.029


def test_a_hand_is_a_damped_spring():
    grip, body = Grip(100.0, 2.0, 0.15, 2e-3), BODY._replace(mass=0.126)
    state, goal = state_at((0, 0, 1.0)), (np.array([0.0, 0.0, 1.01]), np.array([0, 0, 0, 1.0]))
    rate = np.sqrt(grip.stiffness / body.mass - (grip.damping / 2 / body.mass) ** 2)
    fade = grip.damping / 2 / body.mass
    for n in range(1, 2001):
        step(state, body, grip=grip, goal=goal, dt=5e-5)
        t = n * 5e-5
        left = np.exp(-fade * t) * (np.cos(rate * t) + fade / rate * np.sin(rate * t))
        assert state[2] - 1.01 == pytest.approx(-0.01 * left, abs=4e-5)


def test_a_hand_turns_the_tool_to_its_goal():
    grip, goal = Grip(0, 0, 0.15, 2e-3), Rotation.from_rotvec((0.5, -0.4, 1.0)).as_quat()
    state = state_at((0, 0, 1.0))
    for _ in range(4000):
        step(state, grip=grip, goal=(np.zeros(3), goal))
    assert (Rotation.from_quat(state[3:7]) * Rotation.from_quat(goal).inv()).magnitude() < 1e-6


@pytest.mark.parametrize("grip", [Grip(1e6, 0.0, 1e3, 0.0), Grip(1e6, 1e4, 1e3, 10.0)])
def test_no_grip_is_too_firm_for_the_step(grip):
    state, goal = state_at((0, 0, 1.0), (0.4, 0, 0.2)), (np.array([0, 0, 1.02]), np.array([0, 0, 0, 1.0]))
    for _ in range(2000):
        step(state, grip=grip, goal=goal)
        assert abs(state[2] - 1.01) < 0.0201
    assert state[2] == pytest.approx(1.02, abs=1e-6)
