"""Two modes and a clutch: the mapping of eqs. (5)–(6), power, and switching without a jump."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from haptorb.control.clutch.modes import MODES, Clutch, Gains, TwoModes
from haptorb.devices.state import State
from haptorb.errors import InputError, UnknownName

SMALL = st.floats(-0.39, 0.39)
SPIN = st.floats(-20.0, 20.0)
FORCE = st.tuples(*[st.floats(-100, 100)] * 3, *[st.floats(-2, 2)] * 3)


def rotor_at(q, rates=(0.0, 0.0, 0.0), t: float = 0.0) -> State:
    """A rotor at Euler angles ψ, λ, φ with their rates; angular velocity written out independently."""
    psi, lam, phi = (float(angle) for angle in q)
    a, b, c, d, e, f = (*map(math.cos, (psi, lam, phi)), *map(math.sin, (psi, lam, phi)))
    R = [
        [b * c, -b * f, e],
        [a * f + d * e * c, a * c - d * e * f, -d * b],
        [d * f - a * e * c, d * c + a * e * f, a * b],
    ]
    x, y, z = np.array([1.0, 0, 0]), np.array([0, a, d]), np.array([e, -d * b, a * b])
    return State(t, np.array(R), np.zeros(3), rates[0] * x + rates[1] * y + rates[2] * z, np.zeros(3))


def rotation_vector(R) -> np.ndarray:
    """(3,) [rad] of a turn below 90°."""
    v = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine = math.sqrt(v @ v)
    return v * (math.asin(sine) / sine) if sine > 1e-9 else v


def test_the_rotor_of_these_tests_is_scipys() -> None:
    q, rates = np.array([0.3, -0.2, 9.0]), np.array([0.5, -0.7, 2.0])
    first, second = Rotation.from_euler("x", q[0]), Rotation.from_euler("XY", q[:2])
    w = np.array([rates[0], 0, 0]) + first.apply([0, rates[1], 0]) + second.apply([0, 0, rates[2]])
    there, small = Rotation.from_euler("XYZ", q), Rotation.from_euler("XYZ", [0.3, -0.2, 0.4])
    assert pytest.approx(there.as_matrix(), abs=1e-15) == rotor_at(q, rates).R_SR
    assert rotor_at(q, rates).w == pytest.approx(w, abs=1e-15)
    assert rotation_vector(small.as_matrix()) == pytest.approx(small.as_rotvec(), abs=1e-15)


def join(modes: TwoModes, q=(0.0, 0.0, 0.0), mode: str = "translate", **kwargs) -> Clutch:
    """A clutch that has fully taken hold at q."""
    clutch = modes.start(rotor_at(q), mode=mode, **kwargs)
    for k in range(1, 6):
        clutch = modes.advance(clutch, rotor_at(q, t=k * 0.04))
    assert clutch.share.max() == 1.0
    return clutch


def pose(modes: TwoModes, clutch: Clutch) -> np.ndarray:
    target = modes.target(clutch)
    return np.concatenate([target.p, target.R_SR.ravel()])


@given(SMALL, SMALL, SPIN)
@settings(deadline=None)
def test_the_mapping_is_equations_5a_and_6a(psi: float, lam: float, phi: float) -> None:
    gains = Gains(translate=(0.03, 0.004, 0.01), rotate=(0.3, 0.5, 0.7))
    modes = TwoModes(gains)
    for mode in MODES:
        clutch = join(modes, mode=mode)
        for k in range(1, 21):  # in steps, as it would be moved: the spin is followed past half a turn
            q = np.array([psi, lam, phi]) * k / 20
            clutch = modes.advance(clutch, rotor_at(q, t=0.2 + k * 1e-3))
        target = modes.target(clutch)
        if mode == "translate":
            assert target.p == pytest.approx([0.03 * lam, 0.004 * psi, 0.01 * phi], abs=1e-12)
            assert (np.eye(3) == target.R_SR).all()
        else:
            expected = Rotation.from_euler("XYZ", [0.5 * psi, 0.3 * lam, 0.7 * phi]).as_matrix()
            assert pytest.approx(expected, abs=1e-12) == target.R_SR
            assert (target.p == 0).all()


def test_forces_come_back_by_6b_and_not_by_the_text_of_phase_1() -> None:
    modes = TwoModes(Gains(translate_torque=(2.0, 3.0, 5.0), rotate_torque=(7.0, 11.0, 13.0)))
    clutch = join(modes)
    assert modes.torque(clutch, (1, 0, 0, 0, 0, 0)).tolist() == [0, 3, 0]  # F_X' to T_λ (E6)
    assert modes.torque(clutch, (0, 1, 0, 0, 0, 0)).tolist() == [2, 0, 0]
    assert modes.torque(clutch, (0, 0, 1, 1, 1, 1)).tolist() == [0, 0, 5]
    clutch = join(modes, mode="rotate")
    assert modes.torque(clutch, (1, 1, 1, 1, 0, 0)).tolist() == [7, 0, 0]
    assert modes.torque(clutch, (0, 0, 0, 0, 1, 0)).tolist() == [0, 11, 0]
    assert modes.torque(clutch, (0, 0, 0, 0, 0, 1)).tolist() == [0, 0, 13]


@st.composite
def clutches(draw) -> Clutch:
    """Any clutch that can occur, caught in the middle of taking hold or letting go."""
    q = np.array([draw(SMALL), draw(SMALL), draw(SPIN)])
    rates = np.array(draw(st.tuples(*[st.floats(-10, 10)] * 3)))
    attitude = np.array([draw(st.floats(-3, 3)), draw(st.floats(-1.3, 1.3)), draw(st.floats(-9, 9))])
    share = np.array(draw(st.tuples(*[st.floats(0, 1)] * 2)))
    position = np.array(draw(st.tuples(*[st.floats(-0.1, 0.1)] * 3)))
    return Clutch(
        0.0, draw(st.sampled_from(MODES)), draw(st.booleans()), share, q, rates, position, attitude
    )  # fmt: skip


def rotor_of(clutch: Clutch) -> State:
    return rotor_at(clutch.angles, clutch.rates, clutch.t)


@given(clutches(), FORCE)
@settings(deadline=None)
def test_virtual_work_power_at_the_hand_is_power_at_the_target(clutch: Clutch, wrench) -> None:
    modes = TwoModes()
    target = modes.target(clutch)
    wrench = np.array(wrench)
    at_the_hand = modes.torque(clutch, wrench) @ rotor_of(clutch).w
    at_the_target = wrench[:3] @ target.v + wrench[3:] @ target.w
    assert at_the_hand == pytest.approx(at_the_target, rel=1e-9, abs=1e-9)


@given(clutches())
@settings(deadline=None)
def test_the_targets_velocity_is_the_change_of_its_pose(clutch: Clutch) -> None:
    modes = TwoModes()
    dt = 1e-6
    later = modes.advance(clutch, rotor_at(clutch.angles + clutch.rates * dt, clutch.rates, dt))
    before, after = modes.target(clutch), modes.target(later)
    assert (after.p - before.p) / dt == pytest.approx(before.v, abs=1e-6)
    turn = Rotation.from_matrix(after.R_SR @ before.R_SR.T).as_rotvec() / dt
    assert turn == pytest.approx(before.w, abs=1e-3)


@given(clutches(), FORCE, st.sampled_from(["switch", "release", "engage"]))
@settings(deadline=None)
def test_at_any_moment_switching_steps_neither_pose_nor_torque(clutch: Clutch, wrench, act: str) -> None:
    modes = TwoModes()
    other = MODES[1 - MODES.index(clutch.mode)]
    after = {
        "switch": lambda: modes.switch(clutch, other),
        "release": lambda: modes.release(clutch),
        "engage": lambda: modes.engage(clutch),
    }[act]()
    assert np.abs(pose(modes, after) - pose(modes, clutch)).max() <= 1e-12
    assert (modes.torque(after, wrench) == modes.torque(clutch, wrench)).all()
    # and in the next tick with a rotor at rest: nothing moves, torque changes by no more than a tick's share
    still = replace(after, rates=np.zeros(3))
    dt = 1e-3
    later = modes.advance(still, rotor_at(clutch.angles, t=dt))
    assert np.abs(pose(modes, later) - pose(modes, clutch)).max() <= 1e-12
    alone = [modes.torque(replace(still, share=np.array(s)), wrench) for s in ((1.0, 0.0), (0.0, 1.0))]
    bound = dt / modes.ramp * sum(np.abs(part).max() for part in alone)
    assert np.abs(modes.torque(later, wrench) - modes.torque(still, wrench)).max() <= bound + 1e-12


def test_indexing_reaches_beyond_the_workspace() -> None:
    modes = TwoModes()
    clutch = join(modes)
    t = clutch.t
    for _ in range(5):
        for phase in ("pull", "release", "back", "hold"):
            if phase == "release":
                clutch = modes.release(clutch)
            if phase == "hold":
                clutch = modes.engage(clutch)
            for k in range(1, 201):
                lam = {"pull": 0.35 * k / 200, "release": 0.35, "back": 0.35 * (1 - k / 200), "hold": 0.0}[phase]
                t += 1e-3
                before = clutch.position[0]
                clutch = modes.advance(clutch, rotor_at((0, lam, 0), t=t))
                if phase in ("back", "hold"):
                    assert clutch.position[0] == before  # let go, or at rest
    assert clutch.position[0] == pytest.approx(5 * 0.02 * 0.35, abs=1e-12)
    assert clutch.position[0] > 0.02 * math.radians(22.5) * 4


@given(st.integers(0, 10**6))
@settings(deadline=None, max_examples=8)
def test_no_closed_walk_through_both_modes_gives_energy(seed: int) -> None:
    # a stiff spring as target, a hand that turns, switches, lets go and takes hold at random, and comes back
    random = np.random.default_rng(seed)
    modes = TwoModes(Gains().scale(0.4), ramp=0.02)
    clutch, q, t = join(modes), np.zeros(3), 0.2

    def spring(target: State) -> np.ndarray:
        turn = rotation_vector(target.R_SR)
        return np.concatenate([-5e3 * target.p, -20.0 * turn])

    def energy(target: State) -> float:
        turn = rotation_vector(target.R_SR)
        return 0.4 * (2.5e3 * target.p @ target.p + 10.0 * turn @ turn)

    given_back = 0.0
    goal = np.zeros(3)
    for step in range(1800):
        if step % 150 == 0:
            goal = random.uniform(-0.35, 0.35, 3)
            act = random.integers(4)
            clutch = (
                modes.switch(clutch, MODES[random.integers(2)])
                if act < 2
                else modes.release(clutch)
                if act == 2
                else modes.engage(clutch)
            )
        new = q + (goal - q) * 0.02
        rates = (new - q) / 1e-3
        mid = replace(clutch, angles=0.5 * (q + new), rates=rates)  # torque in the middle of the step
        half = modes.advance(replace(clutch, rates=rates), rotor_at(mid.angles, rates, t + 0.5e-3))
        torque = modes.torque(
            replace(half, share=clutch.share), spring(modes.target(replace(half, share=clutch.share)))
        )
        given_back += torque @ rotor_at(mid.angles, rates).w * 1e-3
        t += 1e-3
        clutch = modes.advance(replace(clutch, rates=rates), rotor_at(new, rates, t))
        q = new
    stored = energy(modes.target(clutch))
    assert given_back <= -stored + 1e-3 * (abs(given_back) + stored) + 1e-6  # midpoint rule, 1800 steps


def test_gains_that_break_power_are_reported_and_do_break_it() -> None:
    assert Gains().verdict == "power-consistent"
    assert Gains().scale(0.2).verdict == "scaled"
    assert Gains().scale(0.0).verdict == "scaled"
    assert Gains(translate_torque=(0.02, 0.004, 0.01)).verdict == "active"  # as the text of phase 1 has it (E6)
    assert Gains(rotate_torque=(0.5, 0.5, 0.5)).verdict == "active"  # one factor, but another one than translation
    assert Gains(translate=(0.0, 0.004, 0.01), translate_torque=(0.004, 1.0, 0.01)).verdict == "active"
    assert Gains(translate_torque=(-0.004, -0.02, -0.01), rotate_torque=(-0.25,) * 3).verdict == "active"
    assert Gains(rotate=(0.3, 0.5, 0.7)).rotate_torque == (0.5, 0.3, 0.7)  # printed order: η₁ is of ψ, ζ₁ of λ


def test_a_gap_in_the_poses_lets_go_and_does_not_throw_the_target() -> None:
    modes = TwoModes()
    clutch = join(modes)
    jumped = modes.advance(clutch, rotor_at((0.3, -0.3, 2.0), t=clutch.t + 0.2))
    assert (jumped.position == clutch.position).all()
    assert (jumped.share == 0).all()
    later = modes.advance(jumped, rotor_at((0.3, -0.3, 2.0), t=jumped.t + 1e-3))
    assert (later.position == clutch.position).all()
    assert 0 < later.share[0] < 0.01


def test_the_target_stops_short_of_the_pole_of_its_angles() -> None:
    modes = TwoModes(Gains(rotate=(10.0, 1.0, 1.0)))
    clutch = join(modes, mode="rotate")
    t = clutch.t
    for k in range(300):
        lam = 0.3 * (k + 1) / 300
        t += 1e-3
        clutch = modes.advance(clutch, rotor_at((0, lam, 0), (0, 1.0, 0), t))
    assert math.radians(79) < clutch.attitude[1] < math.radians(82)
    assert modes.torque(clutch, (0, 0, 0, 0, 1, 0)).tolist() == [0, 0, 0]
    back = modes.advance(clutch, rotor_at((0, lam, 0), (0, -1.0, 0), t + 1e-3))
    assert modes.torque(back, (0, 0, 0, 0, 1, 0))[1] > 0


def test_bad_input() -> None:
    modes = TwoModes()
    clutch = join(modes)
    with pytest.raises(InputError, match="tilted beyond λ"):
        modes.advance(clutch, rotor_at((0, 1.5, 0), t=1))
    with pytest.raises(InputError, match="orientation is unknown"):
        modes.advance(clutch, State(1.0, np.full((3, 3), np.nan), np.zeros(3), np.zeros(3), np.zeros(3)))
    with pytest.raises(InputError, match=r"wrench must have shape \(6,\)"):
        modes.torque(clutch, (1, 2, 3))
    with pytest.raises(UnknownName, match="did you mean 'rotate'"):
        modes.switch(clutch, "rotat")  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"gains\.rotate must be three numbers"):
        Gains(rotate=(1.0, 2.0))  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"gains\.translate must be finite"):
        Gains(translate=(1.0, math.nan, 0.0))
    with pytest.raises(InputError, match="factor must not be negative"):
        Gains().scale(-1.0)
    with pytest.raises(InputError, match="ramp must be a time greater than zero"):
        TwoModes(ramp=0.0)
    with pytest.raises(InputError, match="attitude"):
        modes.start(rotor_at((0, 0, 0)), attitude=(0, 1.5, 0))


@given(clutches(), FORCE)
@settings(deadline=None)
def test_a_spinning_rotor_is_followed_over_full_turns(clutch: Clutch, wrench) -> None:
    modes = TwoModes()
    start, t = clutch, 0.0
    for k in range(1, 41):
        t += 1e-3
        q = start.angles + np.array([0, 0, 2 * math.pi * k / 40])
        clutch = modes.advance(clutch, rotor_at(q, t=t))
    assert clutch.angles[2] - start.angles[2] == pytest.approx(2 * math.pi, abs=1e-9)
