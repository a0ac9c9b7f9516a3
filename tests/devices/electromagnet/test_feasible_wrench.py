"""Polytopes of force and torque: corners and interior are feasible, the outside is not."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from haptorb.control.allocation import force_allocator
from haptorb.devices.base import State
from haptorb.devices.feasible_wrench import feasible_wrench
from haptorb.devices.loader import load
from haptorb.errors import GeometryError
from oracles.repetitions import repetitions

OMNI = load("omni")
STRONG = replace(OMNI, supply=replace(OMNI.supply, power=np.inf))
angle = st.floats(-0.9, 0.9)


def pose(a, b, distance, c, d):
    u = np.array([np.sin(a), np.sin(b), 1.0])
    u /= np.linalg.norm(u)
    return State.at(distance * u, u + 0.5 * np.cross(u, (c, d, 1.0)))


poses = st.builds(pose, angle, angle, st.floats(0.05, 0.07), angle, angle)


@settings(max_examples=repetitions(13, 40), deadline=None)
@given(poses, st.integers(0, 1000))
def test_every_wrench_within_the_currents_lies_inside(state, seed):
    able, known = feasible_wrench(STRONG, state), OMNI.wrench_map(state, "exact")
    hull = ConvexHull(able.force)
    currents = np.random.default_rng(seed).uniform(-1, 1, (200, 3)) * OMNI.coils.current_limit
    wrenches = currents @ known.matrix.T + known.passive
    beyond = hull.equations[:, :3] @ wrenches[:, :3].T + hull.equations[:, 3:]
    assert beyond.max() < 1e-9
    assert hull.volume == pytest.approx(abs(np.linalg.det(known.force * 2 * OMNI.coils.current_limit)))
    # torques lie in the polygon's plane and inside it
    assert np.abs((wrenches[:, 3:] - known.passive[3:]) @ able.unreachable).max() < 1e-6 * np.abs(wrenches[:, 3:]).max()
    plane = np.linalg.svd(able.unreachable[None])[2][1:]
    flat = ConvexHull(able.torque @ plane.T)
    assert len(flat.vertices) == len(able.torque) == 6
    assert (flat.equations[:, :2] @ (wrenches[:, 3:] @ plane.T).T + flat.equations[:, 2:]).max() < 1e-9


@settings(max_examples=repetitions(13, 40), deadline=None)
@given(poses, st.integers(0, 1000))
def test_the_guaranteed_force_is_given_everywhere_and_no_more(state, seed):
    device = OMNI if seed % 2 else STRONG
    able, known = feasible_wrench(device, state), OMNI.wrench_map(state, "exact")
    allocator = force_allocator(device)
    ways = np.random.default_rng(seed).normal(size=(30, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    for way in ways:
        allocation = allocator.allocate(known, np.concatenate([0.999 * able.guaranteed_force * way, np.zeros(3)]))
        assert not allocation.saturated
    hull = ConvexHull(able.force)
    inscribed = -hull.equations[:, 3].max()
    if device is STRONG:
        assert inscribed == pytest.approx(able.guaranteed_force, rel=1e-9)
        return
    assert inscribed <= able.guaranteed_force * (1 + 1e-9) <= 1.01 * inscribed
    # no more: the tangent plane of the weakest face touches the set where a little more is refused
    weakest = hull.equations[hull.equations[:, 3].argmax(), :3]
    near = weakest + np.random.default_rng(seed).normal(0.0, 0.1, (300, 3))
    near /= np.linalg.norm(near, axis=1)[:, None]
    asked = 1.003 * able.guaranteed_force
    wrenches = (np.concatenate([asked * way, np.zeros(3)]) for way in near)
    assert any(allocator.allocate(known, wrench).saturated for wrench in wrenches)


@settings(max_examples=5, deadline=None)
@example(pose(0.0, 0.0, 0.0625, 0.0, 0.0), 589)  # where a coarser grid of the currents' box left 1.5 % out
@given(poses, st.integers(0, 1000))
def test_a_weak_supply_takes_corners_off_and_hardly_more(state, seed):
    """Currents within the box and 360 W lie inside the polytope but for 1 %; it needs no current beyond either."""
    able, known = feasible_wrench(OMNI, state), OMNI.wrench_map(state, "exact")
    hot = OMNI.coils.resistance_at(np.full(3, OMNI.coils.heat.stop))
    assert ((able.currents**2 @ hot) <= 360.0 * (1 + 1e-9)).all()
    assert (np.abs(able.currents) <= OMNI.coils.current_limit * (1 + 1e-9)).all()
    currents = np.random.default_rng(seed).uniform(-20, 20, (500, 3))
    currents = currents[currents**2 @ hot <= 360.0]
    hull = ConvexHull(able.force - known.passive[:3])
    force = 0.99 * currents @ known.force.T
    assert (hull.equations[:, :3] @ force.T + hull.equations[:, 3:]).max() < 1e-9
    assert hull.volume < 0.75 * abs(np.linalg.det(known.force * 40.0))


def test_no_torque_about_the_tools_own_axis():
    state = State.at((0.02, 0.01, 0.05), (0.3, 0.0, 1.0))
    able = feasible_wrench(OMNI, state)
    assert able.unreachable == pytest.approx(state.axis, abs=1e-6)
    assert able.guaranteed_torque > 0


def test_the_published_peak_lies_between_the_levels_corners():
    """959 mN at 20 A in one coil (erratum E15): z alone at the summit, dipole model."""
    able = feasible_wrench(OMNI, State.at((0, 0, 0.05)), "published")
    up = able.force[np.argmax(able.force[:, 2])]
    assert up[2] == pytest.approx(0.959, rel=0.08)  # coil z is 5 % stronger than the mean of the three
    assert able.force.sum(axis=0) == pytest.approx(np.zeros(3), abs=1e-12)


def test_inside_the_core_nothing_is_told():
    with pytest.raises(GeometryError, match="inside"):
        feasible_wrench(OMNI, State.at((0, 0, 0.02)))


@pytest.mark.parametrize("name", ["omni", "omni-small-core"])
@pytest.mark.parametrize("power", [40.0, 120.0])
def test_a_very_weak_supply_takes_no_direction_away(name, power):
    """Straight ahead of a coil the others give nothing; a guarantee of nothing was once told for that."""
    device = load(name)
    device = replace(device, supply=replace(device.supply, power=power))
    known = device.wrench_map(state := State.at((0.0, 0.0, 0.05)), "exact")
    hot = device.greatest_resistance
    currents = np.random.default_rng(1).normal(size=(20_000, 3)) * np.sqrt(power / hot)
    currents /= np.maximum(np.abs(currents / device.coils.current_limit).max(axis=1), 1.0)[:, None]
    currents *= np.minimum(1.0, np.sqrt(power / (currents**2 @ hot)))[:, None]
    inscribed = -ConvexHull(currents @ known.force.T + known.passive[:3]).equations[:, 3].max()
    able = feasible_wrench(device, state)
    assert 0.0 < inscribed <= able.guaranteed_force * (1 + 1e-9) <= 1.01 * inscribed
