"""Contract of all worlds; a new one is tested by being listed in `worlds.CATALOGUE`."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from haptorb import worlds
from haptorb.devices.base import State
from haptorb.devices.loader import catalogue, load
from haptorb.errors import HaptorbError, InputError
from haptorb.worlds.base import parameters, values
from oracles.repetitions import repetitions

HOMES = {name: load(name) for name in catalogue() if name in ("omni", "pmsm")}


@cache
def at_home(name):
    """The world as a device renders it: the first device that can."""
    for device in HOMES.values():
        try:
            return worlds.find_world(name)().for_device(device), device
        except HaptorbError:
            continue
    pytest.fail(f"no device renders the world '{name}'")


places = st.tuples(*[st.floats(-0.1, 0.1)] * 3).filter(lambda p: np.linalg.norm(p) > 1e-3)
speeds = st.tuples(*[st.floats(-2, 2)] * 3)


@pytest.mark.parametrize("name", worlds.CATALOGUE)
@settings(max_examples=repetitions(25, 60), deadline=None)
@given(p=places, v=speeds, w=speeds)
def test_every_wrench_is_six_finite_numbers(name, p, v, w):
    world, _ = at_home(name)
    wrench = world.wrench(State.at(p, v=v, w=w))
    assert wrench.shape == (6,)
    assert wrench.dtype == np.float64
    assert np.isfinite(wrench).all()


@pytest.mark.parametrize("name", worlds.CATALOGUE)
@settings(max_examples=repetitions(10, 20), deadline=None)
@given(p=places, v=speeds)
def test_it_has_no_memory(name, p, v):
    world, _ = at_home(name)
    state = State.at(p, v=v)
    assert (world.wrench(state) == world.wrench(state)).all()


@pytest.mark.parametrize("name", worlds.CATALOGUE)
def test_it_says_what_it_is_and_every_parameter_too(name):
    world = worlds.find_world(name)
    assert (world.__doc__ or "").splitlines()[0].endswith(".")
    for item in parameters(world).values():
        assert item.about
        assert item.unit == item.unit.strip()
        assert item.low < item.high


@pytest.mark.parametrize("name", worlds.CATALOGUE)
def test_every_parameter_is_checked(name):
    world = worlds.find_world(name)()
    for item in parameters(type(world)).values():
        for bad in (item.high + 1e9, item.low - 1e9, float("nan"), "a lot"):
            with pytest.raises(InputError, match=item.name):
                world.replace(**{item.name: (bad,) * item.size if item.size > 1 else bad})


@pytest.mark.parametrize("name", worlds.CATALOGUE)
def test_changing_to_its_own_values_changes_nothing(name):
    world = worlds.find_world(name)()
    assert world.replace(**values(world)) == world


@pytest.mark.parametrize("name", worlds.CATALOGUE)
def test_worlds_add(name):
    world, device = at_home(name)
    state = State.at((0.0, 0.01, 0.051))
    twice = (world + worlds.Nothing() + world).for_device(device)
    assert np.allclose(twice.wrench(state), 2 * world.wrench(state))


def loop(rng, steps=4000):
    """A smooth closed path (steps + 1, 3) over the dome and its velocity: three harmonics about a place."""
    s = np.linspace(0, 1, steps + 1)
    centre = rng.normal(size=3)
    centre[2] = abs(centre[2]) + 0.5
    centre *= 0.058 / np.linalg.norm(centre)
    waves = [rng.normal(size=(2, 3)) * 0.002 / k for k in (1, 2, 3)]
    p = centre + sum(np.outer(np.sin(2 * np.pi * (k + 1) * s), w[0]) for k, w in enumerate(waves))
    p = p + sum(np.outer(np.cos(2 * np.pi * (k + 1) * s), w[1]) for k, w in enumerate(waves))
    return p, np.diff(p, axis=0) * steps


PLUGS = ["outlet", "outlet-published", "snap_fit"]  # metal on metal, tens of newtons: modes scale them for the hand
OMNI_WORLDS = [name for name in worlds.CATALOGUE if name not in PLUGS]


@pytest.mark.parametrize("name", [name for name in OMNI_WORLDS if worlds.find_world(name).passive])
def test_no_closed_path_takes_energy_out_of_a_passive_world(name):
    """Midpoint rule, 4 000 steps a loop: the sum errs by less than a thousandth of the work that goes to and fro."""
    world, _ = at_home(name)
    rng = np.random.default_rng(7)
    for _ in range(repetitions(2, 6)):
        p, v = loop(rng)
        middle, step = (p[1:] + p[:-1]) / 2, np.diff(p, axis=0)
        work = [world.wrench(State.at(m, v=u))[:3] @ d for m, u, d in zip(middle, v, step, strict=True)]
        assert sum(work) <= 1e-3 * np.abs(work).sum() + 1e-12


def test_a_world_of_version_0_1_that_needs_a_motor_still_does():
    with pytest.warns(FutureWarning, match="needs_object"):

        class Plug(worlds.Nothing):
            needs_target = True

    with pytest.raises(InputError, match="moves in two modes"):
        Plug().for_device(HOMES["omni"])


@pytest.mark.parametrize("name", worlds.CATALOGUE)
def test_a_world_of_an_object_is_for_devices_that_move_one(name):
    """A plug's frame is not that of a tool over a dome: there it would ask for newtons wherever the tool is."""
    world = worlds.find_world(name)()
    assert world.needs_object == (name in PLUGS)
    if world.needs_object:
        assert world.for_device(HOMES["pmsm"]) is world
        with pytest.raises(InputError, match=f"world {type(world).__name__} .* moves in two modes; device 'omni'"):
            world.for_device(HOMES["omni"])
        with pytest.raises(InputError, match="'omni'"):
            (world + worlds.Nothing()).for_device(HOMES["omni"])
    else:
        world.for_device(at_home(name)[1])


@pytest.mark.parametrize("name", OMNI_WORLDS)
def test_it_keeps_its_bound(name):
    world, _ = at_home(name)
    assert np.isfinite(world.bound)
    rng = np.random.default_rng(3)
    for _ in range(repetitions(200, 1500)):
        p = rng.normal(size=3)
        p *= rng.uniform(0.045, 0.075) / np.linalg.norm(p)
        state = State.at(p, v=rng.normal(size=3) * 0.5, t=float(rng.uniform(0, 10)))
        assert np.linalg.norm(world.wrench(state)[:3]) <= world.bound * (1 + 1e-9)


@pytest.mark.parametrize("name", [name for name in OMNI_WORLDS if worlds.find_world(name).continuous])
def test_a_continuous_world_has_no_jumps(name):
    """Halving the step halves the greatest change, on paths through the whole shell."""
    world, _ = at_home(name)
    rng = np.random.default_rng(5)
    for _ in range(repetitions(2, 10)):
        a, b = rng.normal(size=(2, 3))
        a, b = (0.055 * x / np.linalg.norm(x) * (1 if x[2] > 0 else -1) for x in (a, b))
        angle = np.arccos(np.clip(a @ b / 0.055**2, -1, 1))
        jumps = []
        for steps in (800, 3200):
            s = np.linspace(0, 1, steps)[:, None]
            path = (np.sin((1 - s) * angle) * a + np.sin(s * angle) * b) / np.sin(angle)
            forces = np.array([world.wrench(State.at(p))[:3] for p in path])
            jumps.append(np.abs(np.diff(forces, axis=0)).max())
        assert jumps[1] <= 0.5 * jumps[0] + 1e-12
