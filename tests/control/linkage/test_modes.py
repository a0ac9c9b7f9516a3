"""Two modes and a clutch: mapping of eqs. (5)–(6), power, and switching without a step."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from haptorb.control.linkage import MODES, Gains, ModedLinkage, RenderedWrench
from haptorb.devices.base import State
from haptorb.errors import InputError

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


@dataclass(frozen=True)
class At:
    """The target's world: any wrench of its pose."""

    of: Callable[[State], np.ndarray] = lambda target: np.zeros(6)

    def wrench(self, state: State) -> np.ndarray:
        return self.of(state)


def constant(wrench) -> At:
    return At(lambda target: np.array(wrench, dtype=float))


@dataclass
class Hand:
    """A hand on the rotor of a linkage: where it is now, and what the linkage gave."""

    linkage: ModedLinkage = field(default_factory=ModedLinkage)
    t: float = 0.0
    q: np.ndarray = field(default_factory=lambda: np.zeros(3))
    rates: np.ndarray = field(default_factory=lambda: np.zeros(3))

    def go(self, q, rates=(0.0, 0.0, 0.0), dt: float = 1e-3, world: At = At()) -> RenderedWrench:
        self.t, self.q, self.rates = self.t + dt, np.array(q, dtype=float), np.array(rates, dtype=float)
        return self.linkage.render(world, rotor_at(q, rates, self.t))

    def stay(self, world: At = At(), dt: float = 0.0) -> RenderedWrench:
        """With `dt` zero, what the linkage gives at this very moment: nothing moves on."""
        return self.go(self.q, self.rates, dt, world)

    def torque(self, wrench) -> np.ndarray:
        return self.stay(constant(wrench)).wrench[3:]


def join(gains: Gains | None = None, q=(0.0, 0.0, 0.0), mode: str = "translate", **kwargs) -> Hand:
    """A hand whose clutch is fully engaged at q."""
    hand = Hand(ModedLinkage(gains, **kwargs))
    hand.linkage.set_mode(mode)
    for _ in range(6):
        there = hand.go(q, dt=0.04)
    assert there.share.max() == 1.0
    return hand


def engage_fully(hand: Hand, mode: str) -> Hand:
    """A copy of the hand whose clutch is fully engaged in `mode`, with rotor and target where they are."""
    first, gains = hand.linkage, hand.linkage.gains
    other = Hand(ModedLinkage(gains, arm=first.arm, ramp=first.ramp, gap=first.gap), hand.t, hand.q, hand.rates)
    first.gather_state()
    for name, array in first.state_arrays().items():
        other.linkage.state_arrays()[name][...] = array
    other.linkage.apply_state()
    other.linkage.set_clutch(True)
    other.linkage.set_mode(mode)
    for _ in range(6):
        there = other.stay(dt=0.04)
    assert there.share.max() == 1.0
    return other


def pose(rendered: RenderedWrench) -> np.ndarray:
    return np.concatenate([rendered.object.p, rendered.object.R_SR.ravel()])


@given(SMALL, SMALL, SPIN)
@settings(deadline=None)
def test_the_mapping_is_equations_5a_and_6a(psi: float, lam: float, phi: float) -> None:
    gains = Gains(translate=(0.03, 0.004, 0.01), rotate=(0.3, 0.5, 0.7))
    for mode in MODES:
        hand = join(gains, mode=mode)
        for k in range(1, 21):  # in steps, as it would be moved: the spin is followed past half a turn
            target = hand.go(np.array([psi, lam, phi]) * k / 20).object
        if mode == "translate":
            assert target.p == pytest.approx([0.03 * lam, 0.004 * psi, 0.01 * phi], abs=1e-12)
            assert (np.eye(3) == target.R_SR).all()
        else:
            expected = Rotation.from_euler("XYZ", [0.5 * psi, 0.3 * lam, 0.7 * phi]).as_matrix()
            assert pytest.approx(expected, abs=1e-12) == target.R_SR
            assert (target.p == 0).all()


def test_forces_come_back_by_6b_and_not_by_the_text_of_phase_1() -> None:
    gains = Gains(translate_torque=(2.0, 3.0, 5.0), rotate_torque=(7.0, 11.0, 13.0))
    hand = join(gains)
    assert hand.torque((1, 0, 0, 0, 0, 0)).tolist() == [0, 3, 0]  # F_X' to T_λ (E6)
    assert hand.torque((0, 1, 0, 0, 0, 0)).tolist() == [2, 0, 0]
    assert hand.torque((0, 0, 1, 1, 1, 1)).tolist() == [0, 0, 5]
    hand = join(gains, mode="rotate")
    assert hand.torque((1, 1, 1, 1, 0, 0)).tolist() == [7, 0, 0]
    assert hand.torque((0, 0, 0, 0, 1, 0)).tolist() == [0, 11, 0]
    assert hand.torque((0, 0, 0, 0, 0, 1)).tolist() == [0, 0, 13]


@st.composite
def hands(draw) -> Hand:
    """A hand on a moving rotor, with a clutch in the middle of engaging, switching or releasing."""
    attitude = (draw(st.floats(-3, 3)), draw(st.floats(-1.3, 1.3)), draw(st.floats(-9, 9)))
    hand = Hand(ModedLinkage(position=draw(st.tuples(*[st.floats(-0.1, 0.1)] * 3)), attitude=attitude))
    q, rates = [draw(SMALL), draw(SMALL), draw(SPIN)], draw(st.tuples(*[st.floats(-10, 10)] * 3))
    for mode in draw(st.permutations(MODES)):  # both shares stand anywhere between 0 and 1
        hand.linkage.set_mode(mode)
        for _ in range(3):
            hand.go(q, dt=draw(st.floats(0.0, 0.05)))
    hand.linkage.set_clutch(draw(st.booleans()))
    hand.go(q, rates, dt=0.0)
    return hand


@given(hands(), FORCE)
@settings(deadline=None)
def test_virtual_work_power_at_the_hand_is_power_at_the_target(hand: Hand, wrench) -> None:
    target, wrench = hand.stay().object, np.array(wrench)
    at_the_hand = hand.torque(wrench) @ rotor_at(hand.q, hand.rates).w
    at_the_target = wrench[:3] @ target.v + wrench[3:] @ target.w
    assert at_the_hand == pytest.approx(at_the_target, rel=1e-9, abs=1e-9)


@given(hands())
@settings(deadline=None)
def test_the_targets_velocity_is_the_change_of_its_pose(hand: Hand) -> None:
    dt = 1e-6
    before = hand.stay().object
    after = hand.go(hand.q + hand.rates * dt, hand.rates, dt).object
    assert (after.p - before.p) / dt == pytest.approx(before.v, abs=1e-6)
    turn = Rotation.from_matrix(after.R_SR @ before.R_SR.T).as_rotvec() / dt
    assert turn == pytest.approx(before.w, abs=1e-3)


@given(hands(), FORCE, st.sampled_from([*MODES, True, False]))
@settings(deadline=None)
def test_at_any_moment_a_command_steps_neither_pose_nor_torque(hand: Hand, wrench, command: str | bool) -> None:
    hand.go(hand.q, dt=0.0)  # at rest
    before = hand.stay(constant(wrench))
    if isinstance(command, bool):
        hand.linkage.set_clutch(command)
    else:
        hand.linkage.set_mode(command)
    at_once = hand.stay(constant(wrench))
    assert (pose(at_once) == pose(before)).all()
    assert (at_once.wrench == before.wrench).all()
    later = hand.stay(constant(wrench), dt=1e-3)  # nothing moves, and torque changes by no more than a tick's share
    assert np.abs(pose(later) - pose(before)).max() <= 1e-12
    assert np.abs(later.share - before.share).max() <= 1e-3 / hand.linkage.ramp + 1e-12
    torques = [np.abs(engage_fully(hand, mode).torque(wrench)).max() for mode in MODES]
    assert np.abs(later.wrench - before.wrench).max() <= 1e-3 / hand.linkage.ramp * sum(torques) + 1e-12


def test_indexing_reaches_beyond_the_workspace() -> None:
    hand, reached = join(), 0.0
    for _ in range(5):
        for phase in ("pull", "release", "back", "hold"):
            if phase in ("release", "hold"):
                hand.linkage.set_clutch(phase == "hold")
            for k in range(1, 201):
                lam = {"pull": 0.35 * k / 200, "release": 0.35, "back": 0.35 * (1 - k / 200), "hold": 0.0}[phase]
                before, reached = reached, hand.go((0, lam, 0)).object.p[0]
                assert phase in ("pull", "release") or reached == before  # released, or at rest
    assert reached == pytest.approx(5 * 0.02 * 0.35, abs=1e-12)
    assert reached > 0.02 * math.radians(22.5) * 4
    hand.linkage.restart()
    assert hand.go((0, 0.35, 0)).object.p.tolist() == [0.0, 0.0, 0.0]


def test_gains_that_break_power_are_reported_and_do_break_it() -> None:
    assert Gains().verdict == "power-consistent"
    assert Gains().scale(0.2).verdict == "scaled"
    assert Gains().scale(0.0).verdict == "scaled"
    assert Gains(translate_torque=(0.02, 0.004, 0.01)).verdict == "active"  # as the text of phase 1 has it (E6)
    assert Gains(rotate_torque=(0.5, 0.5, 0.5)).verdict == "active"  # one factor, but another one than translation
    assert Gains(translate=(0.0, 0.004, 0.01), translate_torque=(0.004, 1.0, 0.01)).verdict == "active"
    assert Gains(translate_torque=(-0.004, -0.02, -0.01), rotate_torque=(-0.25,) * 3).verdict == "active"
    assert Gains(rotate=(0.3, 0.5, 0.7)).rotate_torque == (0.5, 0.3, 0.7)  # printed order: η₁ is of ψ, ζ₁ of λ


def test_a_gap_in_the_poses_releases_and_does_not_throw_the_target() -> None:
    hand = join()
    place = hand.stay().object.p
    jumped = hand.go((0.3, -0.3, 2.0), dt=0.2)
    assert (jumped.object.p == place).all()
    assert (jumped.share == 0).all()
    later = hand.stay(dt=1e-3)
    assert (later.object.p == place).all()
    assert 0 < later.share[0] < 0.01


def test_the_target_stops_short_of_the_pole_of_its_angles() -> None:
    hand = join(Gains(rotate=(10.0, 1.0, 1.0)), mode="rotate")
    for k in range(300):
        target = hand.go((0, 0.3 * (k + 1) / 300, 0), (0, 1.0, 0)).object
    assert math.sin(math.radians(79)) < target.R_SR[0, 2] < math.sin(math.radians(82))
    assert hand.torque((0, 0, 0, 0, 1, 0)).tolist() == [0, 0, 0]
    hand.go(hand.q, (0, -1.0, 0))
    assert hand.torque((0, 0, 0, 0, 1, 0))[1] > 0


def test_a_spinning_rotor_is_followed_over_full_turns() -> None:
    hand = join()
    for k in range(1, 121):
        target = hand.go((0.1, 0.2, 2 * math.pi * k / 40)).object
    assert target.p[2] == pytest.approx(0.01 * 3 * 2 * math.pi, abs=1e-9)


@pytest.mark.parametrize(
    ("make", "expected"),
    [
        (lambda: ModedLinkage(ramp=0.0), "ramp must be a time greater than zero"),
        (lambda: ModedLinkage(gap=math.nan), "gap must be a time greater than zero"),
        (lambda: ModedLinkage(attitude=(0, 2.0, 0)), "attitude: λ' must stay within ±80°"),
        (lambda: ModedLinkage(position=(0, math.nan, 0)), "position must be finite"),
        (lambda: Gains(rotate=(1.0, 2.0)), r"gains\.rotate must be three numbers"),  # type: ignore[arg-type]
        (lambda: Gains(translate=(1.0, math.nan, 0.0)), r"gains\.translate must be finite"),
        (lambda: Gains().scale(-1.0), "factor must not be negative"),
        (lambda: join().go((0, 1.5, 0)), "tilted beyond λ"),
        (lambda: join().linkage.render(At(), replace(rotor_at((0, 0, 0)), R_SR=np.full((3, 3), np.nan))), "is unknown"),
        (lambda: join().torque((1, 2, 3)), r"shape \(6,\)"),
        (lambda: ModedLinkage().set_mode("rotat"), "did you mean 'rotate'"),  # type: ignore[arg-type]
    ],
)
def test_bad_input(make: Callable[[], object], expected: str) -> None:
    with pytest.raises(InputError, match=expected):
        make()
