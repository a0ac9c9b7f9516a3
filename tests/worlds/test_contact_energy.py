"""Snap-fit and outlet over closed paths: passive, and without friction conservative."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from haptorb.devices.base import State
from haptorb.worlds import Outlet, PublishedOutlet, SnapFit, World
from oracles.repetitions import repetitions

WORLDS = {
    "snap_fit": SnapFit(),
    "snap_fit, paper": SnapFit(beam="paper"),
    "snap_fit, one hook, steep": SnapFit(hooks=1, insertion_deg=50.0, retention_deg=60.0, friction=0.2),
    "outlet": Outlet(),
    "outlet, paper": Outlet(beam="paper"),
}


def path(seed: int, count: int, seconds: float) -> list[State]:
    """A smooth closed path of 6-DOF poses through the region where the parts touch, by random Fourier terms."""
    random = np.random.default_rng(seed)
    theta = np.arange(count) * (2 * np.pi / count)
    waves = np.array([1, 1, 2, 2, 3, 3])
    phase = random.uniform(0, 2 * np.pi, (6, 6))
    size = random.normal(size=(6, 6)) / waves
    scale = np.array([4e-3, 0.5e-3, 1e-3, 0.05, 0.05, 0.05])
    middle = np.array([random.uniform(0, 14e-3), 0, 0, 0, 0, 0])
    rate = 2 * np.pi / seconds

    def pose(at: np.ndarray) -> np.ndarray:
        return middle + scale * (size[None] * np.sin(at[:, None, None] * waves + phase)).sum(axis=-1)

    velocity = rate * scale * (size[None] * waves * np.cos(theta[:, None, None] * waves + phase)).sum(axis=-1)
    q, h = pose(theta), 1e-5
    R = Rotation.from_rotvec(q[:, 3:])
    step = Rotation.from_rotvec(pose(theta + h)[:, 3:]) * Rotation.from_rotvec(pose(theta - h)[:, 3:]).inv()
    w = step.as_rotvec() * rate / (2 * h)
    return [
        State(0.0, matrix, place, turn, speed)
        for matrix, place, turn, speed in zip(R.as_matrix(), q[:, :3], w, velocity[:, :3], strict=True)
    ]


def work_by_hand(world: World, seed: int, seconds: float, count: int) -> tuple[float, float]:
    """Energy the hand has put in after one round, and the greatest it had put in on the way [J]."""
    power = np.array(
        [-(s := world.wrench(state))[:3] @ state.v - s[3:] @ state.w for state in path(seed, count, seconds)]
    )
    spent = np.cumsum(power) * seconds / count
    return float(spent[-1]), float(np.abs(spent).max())


@pytest.mark.parametrize("name", WORLDS)
@given(seed=st.integers(0, 10**6), seconds=st.sampled_from([0.05, 1.0, 20.0]))
@settings(max_examples=repetitions(4, 12), deadline=None)
def test_no_closed_path_gives_energy(name: str, seed: int, seconds: float) -> None:
    world = WORLDS[name]
    coarse, _ = work_by_hand(world, seed, seconds, 3000)
    fine, passing = work_by_hand(world, seed, seconds, 6000)
    error = abs(fine - coarse) + 1e-6 * passing + 1e-12  # of the sum over 6000 steps
    assert fine >= -error


@pytest.mark.parametrize("name", WORLDS)
@given(seed=st.integers(0, 10**6))
@settings(max_examples=repetitions(3, 8), deadline=None)
def test_without_friction_every_closed_path_costs_nothing(name: str, seed: int) -> None:
    world = WORLDS[name].replace(friction=0.0)
    spent, passing = work_by_hand(world, seed, 1.0, 12000)
    assert abs(spent) <= 2e-4 * passing + 1e-12  # the sum over 12000 steps of a force with kinks


@pytest.mark.parametrize("name", WORLDS)
@given(seed=st.integers(0, 10**6))
@settings(max_examples=repetitions(5, 10), deadline=None)
def test_power_that_friction_takes_is_never_negative(name: str, seed: int) -> None:
    # at one pose: power with friction less power without it, for any velocity
    world, smooth = WORLDS[name], WORLDS[name].replace(friction=0.0)
    for state in path(seed, 50, 0.3):
        rubbing, free = world.wrench(state), smooth.wrench(state)
        taken = -(rubbing - free)[:3] @ state.v - (rubbing - free)[3:] @ state.w
        assert taken >= -1e-9 * (1.0 + np.abs(free).max() * np.abs(state.v).max())


def stirring(world: World, radius: float, slope: float) -> float:
    """Work by the hand on a loop that bends the hooks while sliding out slowly and lets go while sliding in."""
    count, seconds = 4000, 0.2
    theta = np.arange(count) * (2 * np.pi / count)
    rate = 2 * np.pi / seconds
    total = 0.0
    for angle in theta:
        y, vy = radius * np.sin(angle), rate * radius * np.cos(angle)
        # out while |y| grows, in while it falls: x follows sin² y
        x, vx = slope * np.sin(angle) ** 2 * radius, slope * rate * radius * np.sin(2 * angle)
        state = State(0.0, np.eye(3), np.array([3e-3 + x, y, 0.0]), np.zeros(3), np.array([vx, vy, 0.0]))
        total -= world.wrench(state)[:3] @ state.v * seconds / count
    return total


def test_the_published_outlet_can_give_energy_and_says_so() -> None:
    published, felt = PublishedOutlet(creep=1e-3), Outlet(beam="paper", creep=1e-3)
    lost = min(stirring(published, 1.5e-3, slope) for slope in (0.03, 0.1, 0.3))
    assert lost < -1e-3  # more than a millijoule to the hand on every round
    assert min(stirring(felt, 1.5e-3, slope) for slope in (0.03, 0.1, 0.3)) > 0
    assert not published.passive
    assert felt.passive
