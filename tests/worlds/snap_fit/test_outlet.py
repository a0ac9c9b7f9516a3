"""Outlet: pulling, tilting, releasing; against eqs. (14)–(18) where they apply."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from haptorb.beams import TABLE_3, appendix_b, compliance
from haptorb.devices.base import State
from haptorb.errors import GeometryError, InputError, UnknownName
from haptorb.worlds import CATALOGUE, Outlet, PublishedOutlet

FAST = 1e4  # m/s: far above the creep speed


def at(x: float, y: float = 0.0, vx: float = 0.0, turn: float = 0.0, z: float = 0.0) -> State:
    R = Rotation.from_rotvec([0, 0, turn]).as_matrix()
    return State(0.0, R, np.array([x, y, z]), np.zeros(3), np.array([vx, 0.0, 0.0]))


def test_they_are_in_the_catalogue() -> None:
    assert CATALOGUE["outlet"] is Outlet
    assert CATALOGUE["outlet-published"] is PublishedOutlet


@pytest.mark.parametrize("beam", ["paper", "timoshenko"])
def test_a_straight_pull_is_equation_17(beam: str) -> None:
    soft = appendix_b(TABLE_3) if beam == "paper" else compliance(TABLE_3, TABLE_3.peak)
    plus, minus = float(soft.plus), float(soft.minus)
    pull = 113e9 * 8e-3 * 0.134 * 1.5e-3 / (plus + 0.134 * minus)
    push = 113e9 * 8e-3 * 0.134 * 1.5e-3 / (plus - 0.134 * minus)  # (10): s turns with the motion
    for x in (0.5e-3, 5e-3, 11e-3):
        assert Outlet(beam=beam).wrench(at(x, vx=FAST)) == pytest.approx([-pull, 0, 0, 0, 0, 0], rel=1e-6, abs=1e-9)
        assert Outlet(beam=beam).wrench(at(x, vx=-FAST))[0] == pytest.approx(push, rel=1e-6)
        assert PublishedOutlet(beam=beam).wrench(at(x, vx=FAST))[0] == pytest.approx(-pull, rel=1e-6)


def test_the_two_beams_differ_by_more_than_a_hand_can_miss() -> None:
    pulls = {beam: -Outlet(beam=beam).wrench(at(1e-3, vx=FAST))[0] for beam in ("paper", "timoshenko")}
    assert pulls["paper"] == pytest.approx(49.6, abs=0.05)
    assert pulls["timoshenko"] == pytest.approx(11.5, abs=0.05)


@given(x=st.floats(0.2e-3, 11e-3), y=st.floats(-0.2e-3, 0.2e-3), tilt=st.floats(-0.015, 0.015))
@settings(deadline=None)
def test_bending_is_equation_16(x: float, y: float, tilt: float) -> None:
    contacts = Outlet(seat=0.0).contacts(at(x, y, turn=-tilt))  # ε_z counts clockwise
    c = 16e-3 - x
    for contact, sign in zip(contacts, (1, -1), strict=True):
        bent = 3.15e-3 / math.cos(tilt) - sign * c * math.tan(tilt) - 2.4e-3 + sign * y
        assert contact.deflection == pytest.approx(max(bent, 0.0), abs=1e-12)
        if contact.deflection > 0:
            assert contact.point[0] == pytest.approx(16e-3, abs=1e-12)


@given(x=st.floats(0.5e-3, 10.9e-3), y=st.floats(-0.2e-3, 0.2e-3), tilt=st.floats(-0.015, 0.015))  # before the bevel
@settings(deadline=None)
def test_against_the_published_forces_only_what_energy_demands_is_new(x: float, y: float, tilt: float) -> None:
    state = at(x, y, FAST, -tilt)
    felt, printed = Outlet(beam="paper", seat=0.0).wrench(state), PublishedOutlet().wrench(state)
    normal = Outlet(beam="paper", seat=0.0, friction=0.0).wrench(state)  # what the tilted faces push without friction
    size = 113e9 * 8e-3 / 3246 * 1.5e-3
    assert felt[1] == pytest.approx(printed[1], abs=0.01 * size)
    assert felt[0] - printed[0] == pytest.approx(printed[1] * math.tan(tilt), abs=0.005 * size)
    assert normal[0] == pytest.approx(normal[1] * math.tan(tilt), abs=1e-9 * size)
    # friction's couple and the widening by tilt are all that the torque has more
    assert felt[5] - printed[5] == pytest.approx(0.0, abs=0.02 * size * 16e-3)


@given(st.floats(0.5e-3, 11e-3), st.floats(0.002, 0.04))
@settings(deadline=None)
def test_a_tilted_or_shifted_plug_is_pushed_back(x: float, turn: float) -> None:
    for world in (Outlet(), PublishedOutlet()):
        assert world.wrench(at(x, turn=turn))[5] < 0
        assert world.wrench(at(x, turn=-turn))[5] > 0
        assert world.wrench(at(x, y=0.1e-3))[1] < 0


def test_it_lets_go_at_the_end_and_can_be_put_back() -> None:
    world = Outlet()
    assert (world.wrench(at(17e-3, vx=0.1)) == 0).all()
    assert world.wrench(at(14.5e-3))[0] > 0  # past the bevel the hooks push it out
    assert world.wrench(at(14.5e-3, vx=-FAST))[0] > 0  # and resist putting in
    assert np.isfinite([world.wrench(at(x, vx=-0.1)) for x in np.linspace(20e-3, -1e-3, 300)]).all()


def test_the_floor_holds_the_tilted_plug_off_by_x0() -> None:
    tilt = math.radians(2.0)
    x0 = 0.5 * (6.3e-3 - 2 * 0.85e-3) * math.sin(tilt)  # the corner of the bevelled end
    world = Outlet(friction=0.0)
    elastic = world.replace(seat=0.0)
    for x, touches in ((x0 + 1e-6, False), (x0 - 1e-6, True)):
        gap = world.wrench(at(x, turn=tilt))[0] - elastic.wrench(at(x, turn=tilt))[0]
        assert bool(gap > 0) is touches


@given(st.floats(-1e-3, 17e-3), st.floats(-1e-3, 1e-3), st.floats(-0.1, 0.1), st.floats(-0.2, 0.2))
@settings(deadline=None)
def test_a_small_step_is_a_small_step_of_force(x: float, y: float, turn: float, vx: float) -> None:
    world = Outlet()
    here = world.wrench(at(x, y, vx, turn))
    near = world.wrench(at(x + 1e-9, y + 1e-9, vx + 1e-9, turn + 1e-9))
    assert np.isfinite(here).all()
    assert np.abs(near - here).max() < 1e-2


@given(st.integers(0, 10**6))
@settings(deadline=None)
def test_any_pose_has_a_finite_answer(seed: int) -> None:
    random = np.random.default_rng(seed)
    state = State(0.0, Rotation.random(random_state=seed).as_matrix(), *random.normal(size=(3, 3)) * 0.05)
    for world in (Outlet(), PublishedOutlet()):
        assert np.isfinite(world.wrench(state)).all()


def test_outlets_that_cannot_work_say_why() -> None:
    with pytest.raises(GeometryError, match="not wider than the opening"):
        Outlet(plug_width=4e-3)
    with pytest.raises(GeometryError, match="before it is fully inserted"):
        Outlet(lead_in=6e-3, arm=5e-3)
    with pytest.raises(GeometryError, match="this hook jams"):
        Outlet(friction=1.0, height=4e-3, retention_deg=60, beam="paper")
    with pytest.raises(GeometryError, match="no room"):
        Outlet(peak=5e-3)
    with pytest.raises(UnknownName, match="beam model"):
        Outlet(beam="plate")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="surface_height"):
        PublishedOutlet(surface_height="both")  # type: ignore[arg-type]
