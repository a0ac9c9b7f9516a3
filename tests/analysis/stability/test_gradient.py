"""Maximum stiffness of a world, against worlds with known slopes."""

import numpy as np
import pytest

from haptorb import worlds
from haptorb.analysis.stability import steepest
from haptorb.devices.base import State

RNG = np.random.default_rng(2)
PLACES = RNG.uniform(-0.03, 0.03, (60, 3))


def is_within(p):
    return bool(np.abs(p).max() <= 0.03)


def field(world):
    return lambda p, v, t: world.wrench(State(t, np.eye(3), p, np.zeros(3), v))[:3]


def test_a_wall_is_as_stiff_and_as_damped_as_it_says():
    found = steepest(field(worlds.Wall(stiffness=700.0, damping=3.0, greatest=20.0)), PLACES, is_within)
    assert found.stiffness == pytest.approx(700.0, rel=1e-6)
    assert found.damping == pytest.approx(3.0, rel=1e-6)
    assert found.away == pytest.approx(0.0, abs=1e-9)
    assert found.jump == 0.0


def test_a_narrow_magnet_is_found_between_the_places():
    """Steepest in its middle: F/(s e^−½) per metre; pushing, it is as steep the other way."""
    magnet = worlds.Magnet(place=(0.0101, -0.0052, 0.0033), width=0.002, strength=0.25)
    slope = 0.25 / (0.002 * np.exp(-0.5))
    assert steepest(field(magnet), PLACES, is_within).stiffness == pytest.approx(slope, rel=0.01)
    pushing = steepest(field(magnet.replace(strength=-0.25)), PLACES, is_within)
    assert pushing.away == pytest.approx(slope, rel=0.01)
    assert pushing.stiffness == pytest.approx(2 * np.exp(-1.5) * slope, rel=0.01)  # the slope outside, at √3 widths


def test_a_texture_is_as_steep_as_its_sine():
    found = steepest(field(worlds.Texture(wavelength=0.01, amplitude=0.1)), PLACES, is_within)
    assert found.stiffness == pytest.approx(0.1 * 2 * np.pi / 0.01, rel=1e-3)
    assert found.away == pytest.approx(found.stiffness, rel=1e-3)


def test_a_jump_is_measured_and_is_no_slope():
    def cliff(p, v, t):
        return np.array([-0.3 if p[0] > 0.0041 else 0.0, 0.0, -20.0 * p[2]])

    found = steepest(cliff, PLACES, is_within)
    assert found.jump == pytest.approx(0.3)
    assert found.stiffness == pytest.approx(20.0, rel=1e-6)


def test_friction_that_falls_with_speed_counts_as_pushing_damping():
    found = steepest(field(worlds.StickSlip()), PLACES[:10], is_within)
    assert found.damping == pytest.approx(0.25 / 0.005, rel=0.01)
    assert min(one.damping for one in found.candidates) < -0.5


def test_a_field_that_turns_has_a_complex_stiffness():
    found = steepest(lambda p, v, t: np.array([-5 * p[0] - 8 * p[1], 8 * p[0] - 5 * p[1], 0.0]), PLACES[:10], is_within)
    assert any(abs(one.stiffness - (5 + 8j)) < 1e-6 for one in found.candidates)


def test_the_climb_stays_inside():
    found = steepest(lambda p, v, t: np.array([-(p[0] ** 3) * 1e6, 0, 0]), PLACES, is_within)
    assert 0.9 * 2700 < found.stiffness <= 2700 * (1 + 1e-3)


def test_nothing_is_flat():
    found = steepest(field(worlds.Nothing()), PLACES[:10], is_within)
    assert (found.candidates, found.away, found.jump, found.stiffness, found.damping) == ((), 0.0, 0.0, 0.0, 0.0)
