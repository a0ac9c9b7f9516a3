"""Snap-fit: insertion and pull-out forces, against eqs. (10)–(11), and hooks that cannot work."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from haptorb.beams import TABLE_3, balance_face, compliance
from haptorb.devices.base import State
from haptorb.errors import GeometryError, InputError, UnknownName
from haptorb.worlds import CATALOGUE, SnapFit

FAST = 1e4  # m/s: far above the creep speed, so that friction has all of its size


def at(x: float, y: float = 0.0, vx: float = 0.0, turn: float = 0.0) -> State:
    R = Rotation.from_rotvec([0, 0, turn]).as_matrix()
    return State(0.0, R, np.array([x, y, 0.0]), np.zeros(3), np.array([vx, 0.0, 0.0]))


def test_it_is_in_the_catalogue() -> None:
    assert CATALOGUE["snap_fit"] is SnapFit


def test_insertion_dwelling_snap_and_the_way_back() -> None:
    world = SnapFit()
    x = np.linspace(8e-3, 0.05e-3, 400)
    going_in = np.array([world.wrench(at(place, vx=-FAST))[0] for place in x])
    coming_out = np.array([world.wrench(at(place, vx=FAST))[0] for place in x])
    assert going_in[0] == coming_out[0] == 0.0  # apart
    top = (x > 2.3e-3) & (x < 3e-3)
    front, rear = (x > 4.2e-3) & (x < 6e-3), (x > 0.3e-3) & (x < 1.3e-3)
    assert (going_in[front] > 0).all()  # insertion resists
    assert (going_in[top] > 0).all()  # dwelling drags
    assert (going_in[rear] < 0).all()  # retention pulls it home
    assert going_in.max() == going_in[(x > 3.4e-3) & (x < 5e-3)].max()  # hardest at the front face's end
    assert (coming_out[rear] < 0).all()
    assert (coming_out[top] < 0).all()
    assert coming_out.min() < -2 * np.abs(coming_out[top]).max()  # holds by the rear face, not by friction alone
    faces = [world.contacts(at(place))[0].face for place in (7e-3, 5e-3, 2.8e-3, 0.8e-3, -0.5e-3)]
    assert faces == ["", "front", "top", "rear", ""]


@pytest.mark.parametrize("beam", ["paper", "timoshenko"])
@given(x=st.floats(0.2e-3, 6e-3), y=st.floats(-0.5e-3, 0.5e-3), friction=st.floats(0.01, 0.5))
@settings(deadline=None)
def test_forces_are_those_of_equations_10_and_11(beam: str, x: float, y: float, friction: float) -> None:
    world = SnapFit(beam=beam, friction=friction, hooks=1, seat=0.0, insertion_deg=20.0)
    pushes = {}
    for motion in (-1, 0, 1):
        (contact,) = world.contacts(at(x, y, motion * FAST))
        pushes[motion] = -contact.force
    if contact.deflection < 1e-5 or contact.place > world.hook.tip - 2 * world.edge:
        return
    # (11): friction leans the push by its angle, forwards or backwards, and the face turns a little with it
    angle = {motion: math.atan2(push[0], push[1]) for motion, push in pushes.items()}
    turn = 0.03 if beam == "timoshenko" else 0.1
    assert angle[1] - angle[0] == pytest.approx(math.atan(friction), abs=turn)
    assert angle[0] - angle[-1] == pytest.approx(math.atan(friction), abs=turn)
    # (10): Ω₊ f_y + Ω₋ f_x is E w δ, whichever way it slides
    if min(abs(contact.place - corner) for corner in (world.hook.ramp_end, world.hook.peak)) > 1.5 * world.edge:
        soft = compliance(world.hook, contact.place, beam)
        bent = [(soft.plus * push[1] + soft.minus * push[0]) / world.width for push in pushes.values()]
        assert bent == pytest.approx([world.youngs_modulus * contact.deflection] * 3, rel=2e-3)


def test_the_face_turns_with_the_bending_by_the_slope_of_the_hook() -> None:
    # α' > α and β' < β, as in (11); both forces turn it, by more than the chord δ/x of the paper (erratum E27)
    world = SnapFit(friction=0.0, hooks=1)
    hook = world.hook
    for x, plain in ((4.5e-3, -hook.front), (1.2e-3, hook.rear)):
        (contact,) = world.contacts(at(x))
        turned = plain - math.atan2(-contact.force[0], -contact.force[1])
        by_balance = balance_face(hook, contact.place, contact.deflection, plain, 0.0)
        assert turned == pytest.approx(float(by_balance.turn), rel=0.01)
        assert 1.4 < turned / math.atan(contact.deflection / contact.place) < 1.8


def test_a_pair_centres_the_part_and_rights_it() -> None:
    world = SnapFit(friction=0.0)
    assert world.wrench(at(2.5e-3))[1] == pytest.approx(0.0, abs=1e-12)
    assert world.wrench(at(2.5e-3, y=0.2e-3))[1] < 0
    assert world.wrench(at(2.5e-3, y=-0.2e-3))[1] > 0
    wrench = world.wrench(at(1.0e-3, turn=0.05))
    assert wrench[5] < 0  # turned one way, pushed back the other
    assert world.wrench(at(1.0e-3, turn=-0.05))[5] == pytest.approx(-wrench[5], rel=1e-9)


def test_the_floor_stops_it() -> None:
    assert SnapFit().wrench(at(-1e-3))[0] == pytest.approx(2 * 5e3 * 1e-3)


@given(st.floats(-1e-3, 8e-3), st.floats(-1e-3, 1e-3), st.floats(-0.1, 0.1), st.floats(-0.2, 0.2))
@settings(deadline=None)
def test_a_small_step_is_a_small_step_of_force(x: float, y: float, turn: float, vx: float) -> None:
    world = SnapFit()
    here = world.wrench(at(x, y, vx, turn))
    near = world.wrench(at(x + 1e-9, y + 1e-9, vx + 1e-9, turn + 1e-9))
    assert np.isfinite(here).all()
    assert np.abs(near - here).max() < 1e-3


def test_any_layout_of_the_rotation_matrix_gives_the_same() -> None:
    state = at(1.2e-3, 0.1e-3, 0.02, 0.03)
    turned = State(0.0, np.asfortranarray(state.R_SR), state.p, state.w, state.v)
    assert (SnapFit().wrench(state) == SnapFit().wrench(turned)).all()


def test_a_stiffer_material_is_felt_in_proportion() -> None:
    soft, hard = SnapFit(friction=0.2), SnapFit(friction=0.2, youngs_modulus=4.6e9)
    state = at(1.2e-3, vx=0.1)
    assert hard.wrench(state) == pytest.approx(2 * soft.wrench(state))
    assert soft.replace(youngs_modulus=4.6e9) == hard


def test_hooks_that_cannot_work_say_why() -> None:
    with pytest.raises(GeometryError, match="cannot be pushed in, it jams"):
        SnapFit(beam="paper", insertion_deg=70.0)
    with pytest.raises(GeometryError, match="cannot be pulled out, it locks"):
        SnapFit(retention_deg=80.0, friction=0.3)
    with pytest.raises(GeometryError, match=r"self-locking\): retention_deg 75°"):
        SnapFit(retention_deg=75.0, friction=0.3)  # μ tan β = 1.12
    with pytest.raises(GeometryError, match="too little"):
        SnapFit(retention_deg=15.0)  # a ramp too shallow for its height
    with pytest.raises(InputError, match=r"between 0 and 0\.49"):
        SnapFit(poisson_ratio=0.6)
    with pytest.raises(InputError, match="hooks must be 1 or 2"):
        SnapFit(hooks=3)
    with pytest.raises(UnknownName, match="beam model"):
        SnapFit(beam="plate")  # type: ignore[arg-type]


def test_a_world_of_a_given_hook() -> None:
    world = SnapFit.of(TABLE_3, 0.134, half_width=3e-3)
    assert world.hook.rear == pytest.approx(TABLE_3.rear)
    assert world.hook.peak == TABLE_3.peak
    assert world.half_width == 3e-3
