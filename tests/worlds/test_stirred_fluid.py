"""Stirred fluid: continues to flow, against a matrix exponential, and is passive."""

import numpy as np
import pytest
from scipy.linalg import expm

from haptorb.devices.loader import load
from haptorb.errors import InputError
from haptorb.worlds import StirredFluid
from haptorb.worlds.dynamic import bind_world
from worlds.hands import DT, feel, sum_work, wander

WIDTH = 0.05 / 8
RADII = (np.arange(8) + 0.5) * WIDTH


def circle(seconds, hertz, radius=0.02):
    t = np.arange(round(seconds / DT)) * DT
    w = 2 * np.pi * hertz
    p = np.column_stack([radius * np.cos(w * t), radius * np.sin(w * t), 0 * t + 0.048])
    return p, w * radius * np.column_stack([-np.sin(w * t), np.cos(w * t), 0 * t])


def test_stirred_it_runs_on_and_drags_a_tool_that_rests():
    world = StirredFluid()
    bound = feel(world, *circle(3.0, 1.0))[1]
    still = np.tile([0.02, 0.0, 0.048], (2000, 1))
    forces = feel(None, still, bound=bound)[0]
    assert forces[0, 1] > 0.05  # along the stirring
    assert 0.0 < forces[-1, 1] < 0.7 * forces[0, 1]  # and it fades


def test_it_decays_and_mixes_as_the_matrix_exponential_says():
    """Independent of the kernel: the rates of all rings as a matrix, with the tool where it touches no swirl."""
    world = StirredFluid(drag=0.0, mixing=WIDTH**2 / 3e-4, runs_on=2.0)
    bound = bind_world(world, DT)
    bound.memory["swirl"] = np.random.default_rng(2).normal(size=8)
    before = bound.memory["swirl"][0].copy()
    density = world.mass / (np.pi * 0.05**2)
    inertia = density * 2 * np.pi * RADII * WIDTH * RADII**2
    exchange = np.zeros((8, 8))
    for k in range(7):
        shear = 2 * np.pi * 3e-4 * density * ((k + 1) * WIDTH) ** 3 / WIDTH
        exchange[k : k + 2, k : k + 2] += shear * np.array([[-1, 1], [1, -1]])
    rates = exchange / inertia[:, None] - np.eye(8) / world.runs_on
    feel(None, np.tile([0.0, 0.0, 0.05], (1000, 1)), bound=bound)
    expected = RADII * (expm(rates) @ (before / RADII))
    assert np.abs(bound.memory["swirl"][0] - expected).max() < 5e-3 * np.abs(before).max()


def test_without_the_ground_no_angular_momentum_is_lost():
    world = StirredFluid(drag=0.0, mixing=0.4, runs_on=100.0)
    bound = bind_world(world, DT)
    bound.memory["swirl"] = np.linspace(0.3, -0.2, 8)
    lever = world._facts["mass"][0] * RADII
    before = lever @ bound.memory["swirl"][0]
    feel(None, np.tile([0.0, 0.0, 0.05], (1000, 1)), bound=bound)
    assert lever @ bound.memory["swirl"][0] == pytest.approx(before / (1 + 1e-5) ** 1000, rel=1e-9)


def test_what_the_hand_pushes_the_fluid_gets():
    """Without ground and viscosity the impulse of the drag is the change of momentum."""
    world = StirredFluid(mixing=100.0, runs_on=100.0)
    p, v = circle(0.5, 1.0, radius=RADII[3])
    forces, bound = feel(world, p, v)
    along = v / np.linalg.norm(v, axis=1)[:, None]
    impulse = -(forces * along).sum() * DT
    assert world._facts["mass"][0] @ bound.memory["swirl"][0] == pytest.approx(impulse, rel=1e-2)


@pytest.mark.parametrize("seed", range(3))
def test_no_hand_gets_more_out_of_it_than_it_put_in(seed):
    world = StirredFluid()
    p, v = wander(seed, 4.0, size=0.01)
    forces, bound = feel(world, p, v)
    work = sum_work(forces, p)
    assert work.max() < 1e-5
    assert bound.energy < -work[-1]


def test_the_cork_floats_with_it():
    bound = feel(StirredFluid(), *circle(2.0, 1.0, radius=0.015))[1]
    assert bound.memory["angle"].item() > 0.3
    assert np.linalg.norm(bound.memory["cork"]) == pytest.approx(0.033)


def test_it_belongs_on_a_dome():
    with pytest.raises(InputError, match="'pmsm' has none"):
        StirredFluid().for_device(load("pmsm"))
