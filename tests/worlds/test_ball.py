"""Ball against an ODE solver, and its energy."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from haptorb.devices.loader import load
from haptorb.errors import InputError
from haptorb.worlds import RollingBall
from haptorb.worlds.dynamic import bind_world
from worlds.hands import DT, feel, sum_work, wander

AWAY = np.array([0.0, 0.0, 0.2])


def test_without_damping_its_energy_stays_for_ten_seconds():
    bound = bind_world(RollingBall(damping=0.0), DT)
    bound.memory["velocity"] = (0.0, 0.15, 0.0)
    energies = []
    for _ in range(100):
        _, bound = feel(None, np.tile(AWAY, (100, 1)), bound=bound)
        energies.append(bound.energy)
    assert np.ptp(energies) < 1e-3 * np.mean(energies)


def test_it_rolls_as_the_equations_of_a_spherical_pendulum_say():
    world = RollingBall(damping=0.05)
    bound = bind_world(world, DT)
    bound.memory["velocity"] = (0.0, 0.15, 0.0)
    start = np.concatenate([bound.memory["place"][0], bound.memory["velocity"][0]])
    ours = np.array([feel(None, AWAY[None], bound=bound)[1].memory["place"][0].copy() for _ in range(2000)])
    pull = (2 * np.pi * world.swings) ** 2 * world.distance

    def rates(t, y):
        q, v = y[:3], y[3:]
        a = np.array([0, 0, pull]) - world.damping / world.mass * v
        return np.concatenate([v, a - (a @ q + v @ v) / (q @ q) * q])

    exact = solve_ivp(rates, (0, 2), start, t_eval=(np.arange(2000) + 1) * DT, rtol=1e-9, atol=1e-12).y[:3].T
    assert np.abs(ours - exact).max() < 5e-5  # [m], of swings of 15 mm: the step of a millisecond


@pytest.mark.parametrize("seed", range(4))
def test_what_a_hand_pushes_in_is_what_the_ball_has(seed):
    """The work of the hand is the change of energy, but for the time step: within 2 % of all that went to and fro."""
    world = RollingBall(damping=0.0)
    p, v = wander(seed, 3.0, size=0.012)
    forces, bound = feel(world, p, v)
    start = bind_world(world, DT)
    work = sum_work(forces, p)
    assert np.abs(np.diff(work)).sum() > 1e-4  # they met
    first = feel(None, p[:1], bound=start)[1].energy
    assert bound.energy - first == pytest.approx(-work[-1], abs=0.02 * np.abs(np.diff(work)).sum())


def test_it_is_pushed_away_and_comes_back():
    world = RollingBall(damping=0.2)
    x = np.concatenate([np.linspace(0.03, 0.0, 500), np.full(4000, 0.2)])
    p = np.column_stack([x, 0 * x, np.sqrt(np.maximum(0.05**2 - x**2, 1e-4))])
    forces, bound = feel(world, p)
    assert forces[:500, 0].max() > 0.02
    assert np.linalg.norm(bound.memory["place"][0] - (0, 0, 0.05)) < 5e-3


def test_other_parameters_leave_it_where_it_is():
    bound = bind_world(RollingBall(), DT)
    feel(None, np.tile(AWAY, (300, 1)), bound=bound)
    after = bind_world(RollingBall(mass=0.2, rim_deg=20), DT, bound)
    assert (after.memory["place"] == bound.memory["place"]).all()


def test_it_belongs_on_a_dome_within_its_rim():
    with pytest.raises(InputError, match="'pmsm' has none"):
        RollingBall().for_device(load("pmsm"))
    with pytest.raises(InputError, match="below the rim"):
        RollingBall(summit=(0, 0, -1)).for_device(load("omni"))
    with pytest.raises(InputError, match="zero vector"):
        RollingBall(summit=(0, 0, 0))
