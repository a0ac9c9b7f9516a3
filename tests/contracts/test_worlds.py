"""What every world promises; a new one is tested by being listed in `worlds.CATALOGUE`."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from haptorb import worlds
from haptorb.devices.loader import catalogue, load
from haptorb.devices.state import State
from haptorb.errors import HaptorbError, InputError
from haptorb.worlds.parameter import parameters, values

HOMES = {name: load(name) for name in catalogue() if name in ("omni", "pmsm")}


def at_home(name):
    """The world as a device renders it: the first device that can."""
    for device in HOMES.values():
        try:
            return worlds.named(name)().for_device(device), device
        except HaptorbError:
            continue
    pytest.fail(f"no device renders the world '{name}'")


places = st.tuples(*[st.floats(-0.1, 0.1)] * 3).filter(lambda p: np.linalg.norm(p) > 1e-3)
speeds = st.tuples(*[st.floats(-2, 2)] * 3)


@pytest.mark.parametrize("name", worlds.CATALOGUE)
@settings(max_examples=60, deadline=None)
@given(p=places, v=speeds, w=speeds)
def test_every_wrench_is_six_finite_numbers(name, p, v, w):
    world, _ = at_home(name)
    wrench = world.wrench(State.at(p, v=v, w=w))
    assert wrench.shape == (6,)
    assert wrench.dtype == np.float64
    assert np.isfinite(wrench).all()


@pytest.mark.parametrize("name", worlds.CATALOGUE)
@settings(max_examples=20, deadline=None)
@given(p=places, v=speeds)
def test_it_has_no_memory(name, p, v):
    world, _ = at_home(name)
    state = State.at(p, v=v)
    assert (world.wrench(state) == world.wrench(state)).all()


@pytest.mark.parametrize("name", worlds.CATALOGUE)
def test_it_says_what_it_is_and_every_parameter_too(name):
    world = worlds.named(name)
    assert (world.__doc__ or "").splitlines()[0].endswith(".")
    for item in parameters(world).values():
        assert item.about
        assert item.unit == item.unit.strip()
        assert item.low < item.high


@pytest.mark.parametrize("name", worlds.CATALOGUE)
def test_every_parameter_is_checked(name):
    world = worlds.named(name)()
    for item in parameters(type(world)).values():
        for bad in (item.high + 1e9, item.low - 1e9, float("nan"), "a lot"):
            with pytest.raises(InputError, match=item.name):
                world.changed(**{item.name: (bad,) * item.size if item.size > 1 else bad})


@pytest.mark.parametrize("name", worlds.CATALOGUE)
def test_changing_to_its_own_values_changes_nothing(name):
    world = worlds.named(name)()
    assert world.changed(**values(world)) == world


@pytest.mark.parametrize("name", worlds.CATALOGUE)
def test_worlds_add(name):
    world, device = at_home(name)
    state = State.at((0.0, 0.01, 0.051))
    twice = (world + worlds.Nothing() + world).for_device(device)
    assert np.allclose(twice.wrench(state), 2 * world.wrench(state))
