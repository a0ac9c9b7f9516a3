"""Contract of all catalogue worlds with memory, in addition to that of all worlds."""

import tracemalloc

import numpy as np
import pytest

from haptorb import worlds
from haptorb.devices.base import State
from haptorb.devices.loader import load
from haptorb.errors import InputError
from haptorb.recording.row import MEMORY_ROOM
from haptorb.worlds.base import parameters
from haptorb.worlds.dynamic import bind_world, count_numbers, find_number

DT, OMNI = 1e-3, load("omni")
NAMES = [name for name, kind in worlds.CATALOGUE.items() if kind.remembers]


def states(seed, count=400, jumps=0.02):
    """A hand that wanders about the dome, and is now and then somewhere else at once."""
    rng = np.random.default_rng(seed)
    p, v = np.array([0.01, 0.0, 0.05]), np.zeros(3)
    for n in range(count):
        v = 0.98 * v + 0.02 * rng.normal(size=3)
        p = rng.normal(size=3) * 0.04 if rng.random() < jumps else p + DT * v
        yield State(n * DT, np.eye(3), p.copy(), np.zeros(3), v.copy())


def bound_of(name, **values):
    return bind_world(worlds.find_world(name)(**values).for_device(OMNI), DT)


@pytest.mark.parametrize("name", NAMES)
def test_the_same_hand_gives_the_same_memory_to_the_bit(name):
    runs = []
    for _ in range(2):
        bound = bound_of(name)
        forces = [bound.wrench(state).tobytes() for state in states(3)]
        runs.append((forces, bound.numbers.tobytes()))
    assert runs[0] == runs[1]


@pytest.mark.parametrize("name", NAMES)
def test_it_goes_on_from_a_copy_of_its_memory(name):
    """Nothing but the memory remembers: another run that begins with a copy of it goes the same way."""
    one, other = bound_of(name), bound_of(name)
    walk = list(states(4))
    for state in walk[:200]:
        one.wrench(state)
    other.memory[:] = one.memory
    for state in walk[200:]:
        assert (one.wrench(state) == other.wrench(state)).all()


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("extreme", ["low", "high"])
def test_it_stays_finite_with_every_parameter_at_its_end_and_a_hand_that_jumps(name, extreme):
    kind = worlds.find_world(name)
    for item in parameters(kind).values():
        if item.size > 1:
            continue
        try:
            bound = bound_of(name, **{item.name: getattr(item, extreme)})
        except InputError:
            continue  # it contradicts another one
        for state in states(5, 200, jumps=0.1):
            assert np.isfinite(bound.wrench(state)).all()
            assert np.abs(bound.numbers).max() < 1e3


@pytest.mark.parametrize("name", NAMES)
def test_its_memory_fits_into_every_row_and_its_bodies_into_its_memory(name):
    world = worlds.find_world(name)()
    fields = world.memory_fields
    assert count_numbers(fields) <= MEMORY_ROOM
    assert fields == world.for_device(OMNI).memory_fields
    for field in fields:
        assert field.about
        assert field.unit
    for shape in world.shapes:
        assert shape.at or find_number(fields, shape.place, shape.row) >= 0  # or it stands still


@pytest.mark.parametrize("name", NAMES)
def test_nothing_grows(name):
    bound, walk = bound_of(name), list(states(6))
    for state in walk:
        bound.wrench(state)
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        for _ in range(5):
            for state in walk:
                bound.wrench(state)
        grown = tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()
    assert grown < 2000  # [bytes] in 2000 ticks


@pytest.mark.parametrize("name", NAMES)
def test_changing_to_its_own_values_changes_nothing_of_its_memory(name):
    bound = bound_of(name)
    for state in states(7):
        bound.wrench(state)
    after = bind_world(worlds.find_world(name)().for_device(OMNI), DT, bound)
    for state in states(8, 3):
        assert np.allclose(after.wrench(state), bound.wrench(state))
