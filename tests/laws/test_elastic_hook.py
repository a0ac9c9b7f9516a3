"""Elastic hook: forces against an independent beam model, and energy over slow cycles."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from haptorb.beams import balance_face, compliance
from haptorb.devices.base import State
from haptorb.worlds import SnapFit
from oracles.repetitions import repetitions

DEFAULT = {"E": 2.3e9, "nu": 0.35, "base": 15e-3, "peak": 18.5e-3, "h0": 1.5e-3, "hb": 1.5e-3, "w": 6e-3}
REAR, FRONT, FRICTION = math.radians(45.0), math.radians(30.0), 0.3


def beam_force(x: float, slope: float, friction: float) -> tuple[float, float, float]:
    """f_x, f_y [N] and turn of the face [rad] of the default hook touched at `x` [m], bent to the base beam's level.

    Nothing of the package: midpoint sums of a Timoshenko beam that both forces bend, and statics on the turned face.
    """
    E, base, peak, h0, hb, w = (DEFAULT[key] for key in ("E", "base", "peak", "h0", "hb", "w"))
    shear = 1.2 * 2 * (1 + DEFAULT["nu"]) / (E * w)

    def thickness(at: np.ndarray) -> np.ndarray:
        return h0 + np.clip(np.minimum((at - base) * math.tan(REAR), hb - (at - peak) * math.tan(FRONT)), 0.0, hb)

    count = 20000
    s = (np.arange(count) + 0.5) * (x / count)
    h, top, step = thickness(s), float(thickness(np.array([x]))[0]), x / count
    bend = step / (E * w * h**3 / 12)
    by_push, by_pull = (x - s) * bend, (top - h / 2) * bend  # what each force turns every slice
    plus = ((x - s) * by_push).sum() + shear * step * (1 / h).sum()
    minus = ((x - s) * by_pull).sum()
    bent, turn = top - h0, 0.0
    for _ in range(50):
        m = math.tan(slope - turn + math.atan(friction))
        push = bent / (plus + m * minus)
        turn = math.atan(push * (by_push.sum() + 0.5 * shear / top) + m * push * by_pull.sum())
    return m * push, push, turn


def test_the_default_hook_holds_with_8_2_and_goes_in_with_9_6_newtons_if_its_edges_are_sharp() -> None:
    hook = SnapFit().hook
    for place, slope, sign, peak in ((hook.ramp_end, REAR, 1, 8.20), (hook.peak, -FRONT, -1, 9.61)):
        pull, push, turn = beam_force(place, slope, sign * FRICTION)
        found = balance_face(hook, place, hook.height, slope, sign * FRICTION)
        assert (found.pull, found.push, found.turn) == pytest.approx((pull, push, turn), rel=1e-4)
        assert 2 * sign * pull == pytest.approx(peak, rel=3e-3)  # both hooks
        sharp = SnapFit(edge=0.02e-3)
        forces = [-sharp.wrench(straight(x, sign * 1e4))[0] for x in np.linspace(0.0, 6e-3, 2000)]
        assert max(np.multiply(forces, sign)) == pytest.approx(peak, rel=0.02)  # the rounding costs 0.4 % and 1.6 %


def straight(x: float, speed: float) -> State:
    """The part at X' = `x`, moved along X' with `speed`."""
    return State(0.0, np.eye(3), np.array([x, 0.0, 0.0]), np.zeros(3), np.array([speed, 0.0, 0.0]))


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_virtual_work_and_direct_balance_agree_within_half_a_percent(friction: float) -> None:
    world = SnapFit(friction=friction, edge=0.05e-3)
    hook = world.hook
    for speed in (1e4, -1e4):
        for low, high, slope in (
            (hook.base_length, hook.ramp_end, REAR), (hook.ramp_end, hook.peak, 0.0), (hook.peak, hook.tip, -FRONT)
        ):  # fmt: skip
            for x in np.linspace(low - hook.base_length, high - hook.base_length, 9)[1:-1]:
                here = world.contacts(straight(float(x), speed))[0]
                if not low + 0.1e-3 < here.place < high - 0.1e-3:
                    continue  # on a rounded edge
                by_balance = balance_face(hook, here.place, here.deflection, slope, math.copysign(friction, speed))
                size = math.hypot(float(by_balance.pull), float(by_balance.push))
                assert -here.force[0] == pytest.approx(float(by_balance.pull), abs=0.005 * size)
                assert -here.force[1] == pytest.approx(float(by_balance.push), abs=0.005 * size)


@given(
    rear=st.floats(35.0, 70.0), front=st.floats(15.0, 40.0), base=st.floats(8e-3, 25e-3),
    thickness=st.floats(0.8e-3, 2e-3), beam=st.sampled_from(["timoshenko", "paper"]),
)  # fmt: skip
@settings(max_examples=repetitions(3, 12), deadline=None)
def test_without_friction_a_slow_cycle_returns_its_energy(
    rear: float, front: float, base: float, thickness: float, beam: str
) -> None:
    world = SnapFit(
        friction=0.0, retention_deg=rear, insertion_deg=front, base_length=base, peak=base + 3.5e-3,
        thickness=thickness, height=1.2e-3, beam=beam, seat=0.0,
    )  # fmt: skip
    x = np.linspace(-0.3e-3, world.hook.tip - base + 0.5e-3, 2001)  # edges are rounded: it touches before its seat
    pull = np.array([-world.wrench(straight(float(place), 1.0))[0] for place in x])
    done = np.concatenate([[0.0], np.cumsum(0.5 * (pull[1:] + pull[:-1]) * np.diff(x))])
    assert abs(done[-1]) < 1e-3 * done.max()
    # and what the hook holds in the middle of its top is the energy of its compliances
    middle = 0.5 * (world.hook.ramp_end + world.hook.peak) - base
    hook = world.contacts(straight(middle, 1.0))[0]
    soft = compliance(world.hook, hook.place, beam)  # type: ignore[arg-type]
    stored = soft.plus * hook.force[1] ** 2 + 2 * soft.minus * hook.force[1] * hook.force[0]
    held = float(stored + soft.along * hook.force[0] ** 2) / (world.youngs_modulus * world.width)  # ½ fᵀ Ω f, twice
    assert np.interp(middle, x, done) == pytest.approx(held, rel=2e-3)


def test_a_hook_that_springs_over_its_corners_gives_no_energy() -> None:
    # pressed 1 mm aside, the edge jumps from face to face of this hook; work along X' is the change of stored energy
    world = SnapFit(
        base_length=5e-3, peak=8e-3, thickness=0.6e-3, height=2e-3, edge=5e-5, hooks=1, friction=0.0, seat=0.0
    )
    y, x = 1e-3, np.linspace(-1e-3, 9e-3, 20001)
    moved = [np.array([place, y, 0.0]) for place in x]
    hand = [-world.wrench(State(0.0, np.eye(3), p, np.zeros(3), np.zeros(3)))[0] for p in moved]
    assert np.abs(np.diff(hand)).max() > 2.0  # it springs
    first = world.contacts(State(0.0, np.eye(3), moved[0], np.zeros(3), np.zeros(3)))[0]
    soft = compliance(world.hook, first.place)
    pull, push = -first.force[0], -first.force[1]
    stored = soft.plus * push**2 + 2 * soft.minus * push * pull + soft.along * pull**2
    stored = float(stored) / (2 * world.youngs_modulus * world.width)
    assert stored > 1e-4
    assert np.trapezoid(hand, x) == pytest.approx(-stored, abs=1e-3 * np.abs(np.cumsum(hand)).max() * (x[1] - x[0]))
