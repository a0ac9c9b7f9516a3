"""Summits that move in time."""

import numpy as np
import pytest

from haptorb import worlds
from haptorb.devices.base import State
from haptorb.devices.loader import load

OMNI = load("omni")


def test_the_wandering_summit_stays_within_its_tilt_goes_everywhere_and_never_repeats():
    world = worlds.Wander(tilt_deg=40, pace=0.2)
    path = np.array([world.summit(t) for t in np.arange(0, 600, 0.5)])
    assert np.linalg.norm(path, axis=1) == pytest.approx(1)
    tilt = np.degrees(np.arccos(path[:, 2]))
    assert tilt.max() <= 40 + 1e-9
    assert tilt.max() > 35
    assert tilt.min() < 5
    assert all(((path[:, 0] * sx > 0.1) & (path[:, 1] * sy > 0.1)).any() for sx in (1, -1) for sy in (1, -1))
    near = np.linalg.norm(path[20:] - path[0], axis=1).min()
    assert near > 1e-6


def test_it_moves_smoothly_and_stands_still_without_pace():
    world = worlds.Wander(pace=0.2)
    steps = np.diff([world.summit(t) for t in np.arange(0, 60, 0.01)], axis=0)
    assert np.linalg.norm(steps, axis=1).max() < 0.05
    still = worlds.Wander(pace=0.0)
    assert still.summit(0.0) == still.summit(100.0)


def test_its_force_is_that_of_a_dome_at_its_summit():
    world = worlds.Wander(moment=1.5).for_device(OMNI)
    t = 3.7
    there = worlds.Dome(summit=world.summit(t), moment=1.5).for_device(OMNI)
    state = State.at((0.01, 0.0, 0.05), t=t)
    assert world.wrench(state) == pytest.approx(there.wrench(state))
