"""Abstract world with memory: fields, initial memory, and sums of both kinds."""

from dataclasses import dataclass

import numpy as np
import pytest

from haptorb import worlds
from haptorb.devices.base import State
from haptorb.devices.loader import load
from haptorb.errors import InputError, UnknownName
from haptorb.worlds import (
    DynamicSum,
    DynamicWorld,
    Friction,
    MemoryField,
    Nothing,
    RollingBall,
    Shape,
    Wall,
    make_memory,
)
from haptorb.worlds.dynamic import bind_world, count_numbers, find_number
from haptorb.worlds.user_world import try_world

AWAY = State.at((0.0, 0.0, 0.2))
OMNI, HERE = load("omni"), State.at((0.01, 0.0, 0.05), v=(0.0, 0.1, 0.0))


@dataclass(frozen=True)
class OwnMemory(DynamicWorld):
    """Its memory begins as it is told."""

    memory: object = None
    declared: tuple = (MemoryField("n", "1", "number"),)

    @property
    def memory_fields(self):
        return self.declared

    def begin(self):
        return make_memory(self.declared) if self.memory is None else self.memory

    def advance(self, memory, state, dt):
        return np.zeros(6)


@pytest.mark.parametrize(
    ("memory", "words"),
    [
        (np.zeros(3), "structured array of one record"),
        ({"n": 1.0}, "structured array of one record"),
        (np.zeros(2, dtype=[("n", "f8")]), r"one record, shape \(1,\)"),
        (np.zeros(1, dtype=[("n", "i8")]), "must be float64"),
        (np.zeros(1, dtype=[("n", "f8"), ("flag", "?")]), "must be float64"),
        (np.full(1, np.nan, dtype=[("n", "f8")]), "not finite"),
        (np.zeros(1, dtype=[("n", "f8"), ("m", "f8")]), "has 2 numbers, but its memory_fields state 1"),
    ],
)
def test_a_memory_that_cannot_be_one_is_refused_before_it_runs(memory, words):
    with pytest.raises(InputError, match=words):
        try_world(OwnMemory(memory), OMNI)


def test_a_memory_needs_fields_with_names_of_their_own():
    for declared in ((), (MemoryField("n", "1", "a"), MemoryField("n", "1", "b"))):
        with pytest.raises(InputError, match="its own name"):
            try_world(OwnMemory(declared=declared), OMNI)
    with pytest.raises(InputError, match="a name like 'place'"):
        MemoryField("two words", "m", "no")
    for shape in ((0,), (2.5,), 3):
        with pytest.raises(InputError, match="shape must be a tuple"):
            MemoryField("n", "m", "no", shape)


def test_a_world_that_fails_to_begin_is_told_with_its_line():
    class BrokenStart(OwnMemory):
        def begin(self):
            raise ValueError("no such model")

    with pytest.raises(InputError, match=r"(?s)no such model.*in test_a_world.*begin"):
        try_world(BrokenStart(), OMNI)


def test_numbers_are_found_by_field_and_row():
    fields = (MemoryField("a", "m", "a"), MemoryField("b", "m", "b", (4, 3)), MemoryField("c", "1", "c", (2,)))
    assert count_numbers(fields) == 15
    assert [find_number(fields, "a"), find_number(fields, "b", 2), find_number(fields, "c")] == [0, 7, 13]
    for name, row in (("b", 4), ("c", 1), ("d", 0)):
        with pytest.raises(InputError, match=f"'{name}'"):
            find_number(fields, name, row)


def test_both_kinds_add_in_any_order():
    one, other = bind_world(Friction().for_device(OMNI), 1e-3), Wall()
    expected = one.wrench(HERE) + other.wrench(HERE)
    for total in (Friction() + Wall(), Wall() + Friction(), Nothing() + Wall() + Friction()):
        assert isinstance(total, DynamicSum)
        bound = bind_world(total.for_device(OMNI), 1e-3)
        assert np.allclose(bound.wrench(HERE), expected)
    assert not isinstance(Wall() + Nothing(), DynamicSum)


def test_each_part_of_a_sum_has_a_memory_of_its_own():
    total = (RollingBall() + RollingBall(mass=0.2)).for_device(OMNI)
    bound = bind_world(total, 1e-3)
    for _ in range(200):
        bound.wrench(AWAY)
    names = [field.name for field in total.memory_fields]
    assert names == [
        f"{ball}_{field}" for ball in ("ball", "ball_2") for field in ("place", "velocity", "drawn", "energy")
    ]
    assert bound.memory["ball_2"]["energy"] > 3 * bound.memory["ball"]["energy"]
    assert bound.energy == pytest.approx(bound.memory["ball"]["energy"][0] + bound.memory["ball_2"]["energy"][0])
    assert [shape.place for shape in total.shapes] == ["ball_drawn", "ball_2_drawn"]
    assert total.passive
    assert not (RollingBall() + worlds.Dome()).passive
    assert "RollingBall(" in repr(total)


def test_parts_of_a_sum_keep_what_is_theirs():
    before = bind_world((RollingBall() + Wall()).for_device(OMNI), 1e-3)
    for _ in range(300):
        before.wrench(HERE)
    after = bind_world((Friction() + RollingBall(mass=0.1)).for_device(OMNI), 1e-3, before)
    assert (after.memory["ball"]["place"] == before.memory["ball"]["place"]).all()
    assert after.memory["friction"]["placed"] == 0.0
    alone = bind_world(
        (RollingBall() + Friction()).for_device(OMNI), 1e-3, bind_world(RollingBall().for_device(OMNI), 1e-3)
    )
    assert np.isfinite(alone.numbers).all()


def test_shapes_are_checked():
    with pytest.raises(UnknownName, match="sphere"):
        Shape("ball", "spheer", (0.01,), "place")
    for size in ((), (0.01, 0.02), (0.0,), (float("nan"),), (50.0,)):
        with pytest.raises(InputError, match="measures above 0 m"):
            Shape("ball", "sphere", size, "place")
