"""Compass: a torque across the axis, towards its direction, from a potential; alone and with a dome."""

import numpy as np
import pytest

from haptorb import worlds
from haptorb.devices.base import State
from haptorb.devices.loader import load
from haptorb.errors import InputError


def axes(n, seed=1):
    found = np.random.default_rng(seed).normal(size=(n, 3))
    return found / np.linalg.norm(found, axis=1, keepdims=True)


def test_the_torque_is_across_the_axis_towards_the_direction_and_within_its_strength():
    world = worlds.Compass(direction=(0.2, -0.3, 0.9), strength=0.006)
    goal = np.array([0.2, -0.3, 0.9]) / np.linalg.norm([0.2, -0.3, 0.9])
    for axis in axes(200):
        wrench = world.wrench(State.at((0, 0, 0.05), axis=axis))
        assert not wrench[:3].any()
        assert abs(wrench[3:] @ axis) < 1e-15
        assert np.cross(wrench[3:], axis) @ goal >= 0  # the axis moves towards the goal
        assert np.linalg.norm(wrench[3:]) <= 0.006


def test_it_is_the_gradient_of_its_potential():
    """T·n dθ is what U = T(√(c² + s²) − s) loses when the axis turns by dθ about n."""
    world, s = worlds.Compass(), np.radians(10.0)
    goal = np.array(world.direction) / np.linalg.norm(world.direction)

    def energy(axis):
        return world.strength * (np.sqrt(np.sum((axis - goal) ** 2) + s * s) - s)

    step = 1e-6
    for axis, about in zip(axes(50, 2), axes(50, 3), strict=True):
        torque = world.wrench(State.at((0, 0, 0.05), axis=axis))[3:]
        turned, back = (axis + sign * step * np.cross(about, axis) for sign in (1, -1))
        slope = (energy(turned / np.linalg.norm(turned)) - energy(back / np.linalg.norm(back))) / (2 * step)
        assert torque @ about == pytest.approx(-slope, abs=1e-9)


def test_the_compass_dome_is_both_of_them():
    omni = load("omni")
    both = worlds.CompassDome(moment=1.5, strength=0.003, half_width_deg=25).for_device(omni)
    dome = worlds.Dome(moment=1.5, half_width_deg=25).for_device(omni)
    state = State.at((0.01, 0.02, 0.045), axis=(0.1, 0, 1))
    assert both.wrench(state) == pytest.approx(dome.wrench(state) + worlds.Compass(strength=0.003).wrench(state))
    assert both.bound == dome.bound


@pytest.mark.parametrize("kind", [worlds.Compass, worlds.CompassDome])
def test_no_direction_is_refused(kind):
    with pytest.raises(InputError, match="direction"):
        kind(direction=(0, 0, 0))
