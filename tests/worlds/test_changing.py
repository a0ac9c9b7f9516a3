"""Several summits in one map, and terrain that changes in time."""

import numpy as np
import pytest

from haptorb import worlds
from haptorb.devices.base import State
from haptorb.devices.loader import load
from haptorb.errors import InputError

OMNI = load("omni")


def test_every_summit_pushes_as_a_dome_of_its_own():
    world = worlds.Summits(count=4, tilt_deg=35, opposite=-0.5).for_device(OMNI)
    assert len(world.domes) == 4
    for n, dome in enumerate(world.domes):
        out = np.array(dome.summit)
        wrench = world.wrench(State.at(0.05 * out))
        assert wrench[:3] @ out == pytest.approx(2 * dome.strength, rel=1e-9)
        assert (wrench[:3] @ out > 0) == (n % 2 == 0)
    assert world.bound == pytest.approx(world.domes[0].bound)
    assert not world.remarks


def test_maps_that_overlap_add_and_say_so():
    world = worlds.Summits(count=6, tilt_deg=20, cut_off_deg=40).for_device(OMNI)
    assert "overlap" in world.remarks[0]
    assert world.bound == pytest.approx(6 * world.domes[0].bound)
    state = State.at((0.003, 0.002, 0.05))
    assert world.wrench(state) == pytest.approx(sum(dome.wrench(state) for dome in world.domes))


@pytest.mark.parametrize("count", [2.5, 0, 9])
def test_summits_are_counted_in_whole_numbers(count):
    with pytest.raises(InputError, match="count"):
        worlds.Summits(count=count)


def test_the_terrain_begins_as_terrain_is_its_opposite_after_half_a_period_and_drifts():
    world = worlds.ChangingTerrain(period=8.0, drift=0.0).for_device(OMNI)
    terrain = worlds.Terrain().for_device(OMNI)
    p = (0.015, 0.01, 0.046)
    assert world.wrench(State.at(p)) == pytest.approx(terrain.wrench(State.at(p)))
    assert world.wrench(State.at(p, t=4.0)) == pytest.approx(-terrain.wrench(State.at(p)))
    assert np.abs(world.wrench(State.at(p, t=2.0))).max() < 1e-12
    drifting = worlds.ChangingTerrain(period=4.0, drift=0.0625).for_device(OMNI)  # a quarter of a turn in 4 s
    turned = (-p[1], p[0], p[2])
    x, y, z = terrain.wrench(State.at(p))[:3]
    assert drifting.wrench(State.at(turned, t=4.0))[:3] == pytest.approx((-y, x, z))


def test_values_reach_the_terrain():
    assert worlds.ChangingTerrain(strength=0.2, half_angle_deg=40).terrain.strength == 0.2
    with pytest.raises(InputError, match="period"):
        worlds.ChangingTerrain(period=0)
