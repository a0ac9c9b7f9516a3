"""Minimum-power wrench within limits, against a general solver; published range of the planar array."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from haptorb.control.array_allocation import ArrayAllocator, array_choice
from haptorb.control.saturation import Saturation
from haptorb.devices.base import State, WrenchMap
from haptorb.devices.loader import load
from haptorb.errors import InputError

SIZE = np.array([0.1, 0.1, 0.1, 3e-3, 3e-3, 3e-3])


@pytest.mark.parametrize("channels", [4, 16, 100])
@pytest.mark.parametrize("part", ["torque", "both"])
def test_it_is_the_optimum_of_the_weighted_problem(channels, part):
    rng = np.random.default_rng(channels)
    for _ in range(12):
        matrix = rng.normal(size=(6, channels)) * SIZE[:, None]
        matrix[5] = 0.0  # about the magnet's own axis
        resistance, limit = rng.uniform(1, 2, (2, channels))
        asked = rng.normal(size=6) * 10 * SIZE * rng.uniform(0.01, 0.6) * channels / 16
        given = ArrayAllocator(limit, resistance, part).allocate(WrenchMap(matrix, np.zeros(6)), asked)
        weights = np.array([0.0 if part == "torque" else 1.0] * 3 + [1 / 0.0435428571428] * 3)
        q = weights[:, None] * matrix / np.sqrt(resistance)
        rho = 1e6 / (q**2).sum()
        whole = np.vstack([np.sqrt(rho) * q, np.eye(channels)])
        right = np.concatenate([np.sqrt(rho) * weights * asked, np.zeros(channels)])
        box = limit * np.sqrt(resistance)
        best = lsq_linear(whole, right, (-box, box), tol=1e-13, max_iter=1000).x
        cost = [float(((whole @ y - right) ** 2).sum()) for y in (given.currents * np.sqrt(resistance), best)]
        assert (np.abs(given.currents) <= limit).all()
        assert cost[0] <= cost[1] * (1 + 1e-6) + 1e-12
        assert given.residual == pytest.approx(asked - matrix @ given.currents, abs=1e-12)


def test_a_force_beyond_the_limits_keeps_its_direction():
    planar = load("planar")
    there = planar.wrench_map(State.at((0.0, 0.01, 0.03), axis=(0, 0, 1)), "exact")
    free = ArrayAllocator(planar.coils.current_limit, planar.coils.resistance)
    asked = np.array([30.0, -10.0, 50.0, 0, 0, 0])
    given = free.allocate(there, asked)
    force = there.wrench(given.currents)[:3]
    assert given.scale < 1
    assert given.saturated is Saturation.CURRENT
    assert force == pytest.approx(given.scale * asked[:3], abs=1e-6)


def test_what_comes_along_is_limited():
    planar = load("planar")
    there = planar.wrench_map(State.at((0.0, 0.01, 0.03), axis=(0, 0, 1)), "exact")
    choice = array_choice(planar)
    for part, asked in (
        ("force", (2.0, 0, 0, 0, 0, 0)),
        ("torque", (0, 0, 0, 0.1, 0, 0)),
        ("both", (9, 9, 9, 1, 1, 1)),
    ):
        given = there.wrench(choice.allocators[part].allocate(there, asked).currents)
        assert np.linalg.norm(given[:3]) <= planar.limits.force * (1 + 1e-9)
        assert np.linalg.norm(given[3:]) <= planar.limits.torque * (1 + 1e-9)


def test_five_components_are_given_and_the_sixth_is_told():
    planar = load("planar")
    there = planar.wrench_map(State.at((0.005, 0.01, 0.03), axis=(0.1, 0, 1)), "exact")
    both = array_choice(planar).allocators["both"]
    asked = np.array([0.3, -0.2, 0.5, 2e-3, -1e-3, 1e-4])  # about the axis: as far as the five allow
    asked[3:] -= (asked[3:] @ (n := np.array([0.1, 0, 1]) / np.hypot(0.1, 1))) * n
    assert there.wrench(both.allocate(there, asked).currents) == pytest.approx(asked, abs=1e-4)
    about_axis = np.concatenate([np.zeros(3), 5e-3 * n])
    assert both.allocate(there, about_axis).saturated is not Saturation.NONE


def test_what_is_not_finite_is_refused():
    bad = WrenchMap(np.full((6, 4), np.nan), np.zeros(6))
    for part in ("force", "torque", "both"):
        with pytest.raises(InputError):
            ArrayAllocator([1.0] * 4, [1.0] * 4, part).allocate(bad, np.ones(6))


@pytest.mark.parametrize(("up", "x"), [(0.0, 60e-3), (20e-3, 60e-3), (30e-3, 55e-3)])
def test_the_planar_array_carries_its_magnet_through_the_published_range(up, x):
    """Berkelman and Dzadovsky 2010: a single magnet over 16 coils, up to 30 × 90 × 120 mm. The sizes are assumed."""
    planar = load("planar")
    magnet = planar.tool.magnets[0]
    weight = 7500 * np.pi * magnet.outer_radius**2 * magnet.length * 9.80665
    both = ArrayAllocator(planar.coils.current_limit, planar.coils.resistance, "both")
    z = planar.contact_height + up
    for place in ((0.0, 0.0, z), (x, 0.0, z), (0.0, 45e-3, z), (x / 2, -22e-3, z)):
        there = planar.wrench_map(State.at(place, axis=(0, 0, 1)), "exact")
        given = there.wrench(both.allocate(there, (0, 0, weight, 0, 0, 0)).currents)
        assert given[:3] == pytest.approx([0, 0, weight], abs=2e-3 * weight)
        assert given[3:] == pytest.approx(np.zeros(3), abs=1e-4)
