"""LuGre friction against its publication, against an ODE solver, and in the hand."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from haptorb.devices.state import State
from haptorb.errors import InputError
from haptorb.worlds import Friction
from haptorb.worlds.bound_world import bind_world
from worlds.dynamic.hands import feel, sum_work, wander

#: values of the simulations in Canudas de Wit et al. 1995, for a mass of 1 kg
PAPER = {"stiffness": 1e5, "damping": 1e5**0.5, "viscous": 0.4, "sliding": 1.0, "breakaway": 1.5, "fading": 0.001}


def drag(world, load, seconds, dt, mass=1.0, spring=0.0):
    """A mass under `load(t)` [N] (with a spring: `load(t)` [m] is its far end); t, x, v, bristle z."""
    bound, x, v, out = bind_world(world, dt), 0.0, 0.0, []
    for n in range(round(seconds / dt)):
        push = spring * (load(n * dt) - x) if spring else load(n * dt)
        force = bound.wrench(State(n * dt, np.eye(3), np.array([x, 0, 0]), np.zeros(3), np.array([v, 0, 0])))[0]
        v += dt / mass * (push + force)
        x += dt * v
        out.append((n * dt, x, v, bound.memory["bristle"][0, 0]))
    return np.array(out).T


def solve(load, seconds, times, mass=1.0):
    """The published equations by an implicit solver of ordinary differential equations: x, v, z."""

    def rates(t, y):
        _, v, z = y
        g = PAPER["sliding"] + (PAPER["breakaway"] - PAPER["sliding"]) * np.exp(-((v / PAPER["fading"]) ** 2))
        dz = v - PAPER["stiffness"] * abs(v) / g * z
        force = PAPER["stiffness"] * z + PAPER["damping"] * dz + PAPER["viscous"] * v
        return [v, (load(t) - force) / mass, dz]

    found = solve_ivp(rates, (0, seconds), [0, 0, 0], "Radau", times, rtol=1e-7, atol=1e-12, max_step=0.01)
    return found.y


def test_presliding_and_its_hysteresis_are_the_published_ones():
    """Presliding displacement: the load goes to 95 % of breakaway, back to minus that, and again; nothing breaks
    away."""

    def load(t):
        return 1.425 * np.interp(t, [0, 4, 5, 13, 14, 22], [0, 1, 1, -1, -1, 1])

    t, x, _, z = drag(Friction(**PAPER, elastic=0.0), load, 22.0, 2e-4)
    chosen = np.arange(0, len(t), 200)
    expected = solve(load, 22.0, t[chosen])
    size = np.abs(expected[0]).max()
    assert 1.5e-5 < size < 1e-4  # F_s/σ0 = 15 µm
    assert np.abs(x[chosen] - expected[0]).max() < 0.02 * size
    assert np.abs(z[chosen] - expected[2]).max() < 0.02 * 1.5e-5
    unloaded = x[np.argmin(np.abs(t - 9.0))]
    assert 0.5 < unloaded / x[t < 5].max() < 0.8  # with the load gone it does not come all the way back


def test_it_breaks_away_at_the_breakaway_force_if_the_load_rises_slowly():
    """Break-away force: near F_s for slow rates, and less the faster the load rises."""
    forces = []
    for rate, seconds in ((2.0, 0.9), (20.0, 0.12)):
        t, _, v, _ = drag(Friction(**PAPER, elastic=0.0), lambda t, rate=rate: rate * t, seconds, 5e-5)
        forces.append(rate * t[np.argmax(v > 0.01)])
    assert forces[0] == pytest.approx(1.5, rel=0.03)


def test_a_spring_that_is_pulled_slowly_sticks_and_slips():
    """Stick-slip motion: 1 kg on 2 N/m, pulled at 0.1 m/s: the first slip when the spring holds F_s."""
    t, _, v, _ = drag(Friction(**PAPER, elastic=0.0), lambda t: 0.1 * t, 12.0, 2e-4, spring=2.0)
    slips = np.flatnonzero(np.diff((v > 0.02).astype(int)) == 1)
    assert t[slips[0]] == pytest.approx(7.5, abs=0.15)
    assert (v[(t > 1) & (t < 7.2)] < 1e-3).all()
    assert v.max() > 0.15  # it overtakes
    after = (t > 10.8) & (t < 11.8)
    assert np.abs(v[after]).max() < 1e-3  # and sticks again


@pytest.mark.parametrize(("elastic", "creeps"), [(0.8, False), (0.0, True)])
def test_below_breakaway_it_creeps_less_than_a_micrometre_a_second(elastic, creeps):
    """0.15 N of 0.25 N, and a tremor of 3 µm at 20 Hz as no hand is without; as published in 1995 it would creep."""
    world = Friction(elastic=elastic)
    t, x, *_ = drag(world, lambda t: 0.15 + 2e-3 * np.sin(2 * np.pi * 20 * t), 6.0, 1e-3, mass=0.1)
    late = t > 2.0
    creep = np.polyfit(t[late], x[late], 1)[0]
    assert bool(abs(creep) > 1e-6) is creeps


def test_without_a_tremor_it_does_not_creep_at_all_even_as_published():
    t, x, *_ = drag(Friction(elastic=0.0), lambda t: min(0.2, 0.2 * t), 9.0, 1e-3, mass=0.1)
    assert np.ptp(x[t > 8.0]) < 1e-9


@pytest.mark.parametrize("elastic", [0.0, 0.8])
@pytest.mark.parametrize("seed", range(3))
def test_no_hand_gets_energy_out_of_it(elastic, seed):
    world = Friction(elastic=elastic)
    assert world.passive
    p, v = wander(seed, 3.0)
    forces, bound = feel(world, p, v)
    assert sum_work(forces, p).max() < 1e-6
    assert sum_work(forces, p)[-1] < -1e-3  # it brakes
    assert 0.0 <= bound.energy <= 0.5 * 0.25**2 / world.stiffness * 1.001


def test_a_jump_of_the_pose_is_bounded_by_breakaway():
    bound = bind_world(Friction(), 1e-3)
    bound.wrench(State.at((0, 0, 0.05)))
    jumped = bound.wrench(State.at((0.03, 0, 0.05)))
    assert np.linalg.norm(jumped) <= 0.25 * 1.001


def test_parameters_that_contradict_each_other_are_refused_or_told():
    with pytest.raises(InputError, match="breakaway"):
        Friction(sliding=0.3, breakaway=0.2)
    assert not Friction(damping=2.0, viscous=0.1).passive
