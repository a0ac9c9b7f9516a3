"""Memory of worlds in a recording: by name, per world, and safe with malicious files."""

import json

import numpy as np
import pytest

from haptorb.errors import RecordingError
from haptorb.recording.recording import memory_columns, memory_units, split_memory

PLACE = {"name": "place", "unit": "m", "about": "of the ball", "shape": [3]}
ENERGY = {"name": "energy", "unit": "J", "about": "held", "shape": []}


CHANGES, NUMBERS = np.array([0.0, 0, 1, 1, 2, 2]), np.arange(24.0).reshape(6, 4)


def note_worlds(*memory):
    """The notes of a ball, of nothing, and of a ball again."""
    worlds = [
        {"name": "ball", "memory": list(memory)},
        {"name": "nothing"},
        {"name": "ball", "memory": list(memory)},
    ]
    return [{"change": str(n), "tick": "0", "world": json.dumps(world)} for n, world in enumerate(worlds)]


def split(*memory):
    """What six ticks with room for four numbers have of these fields."""
    return split_memory(NUMBERS, CHANGES, note_worlds(*memory))


def test_fields_have_their_names_where_the_world_was_felt():
    found = split(PLACE, ENERGY)
    assert found["ball.place"].shape == (6, 3)
    assert found["ball.place"][4].tolist() == [16.0, 17.0, 18.0]
    assert found["ball.energy"][[0, 1, 4, 5]].tolist() == [3.0, 7.0, 19.0, 23.0]
    assert np.isnan(found["ball.place"][2:4]).all()
    assert memory_units(note_worlds(PLACE, ENERGY)) == {"ball.place": "m", "ball.energy": "J"}


def test_what_rows_have_no_room_for_is_left_out():
    assert list(split(PLACE, ENERGY, ENERGY | {"name": "more"})) == ["ball.place", "ball.energy"]
    assert list(split(PLACE | {"shape": [60_000]})) == []


@pytest.mark.parametrize(
    "field",
    [
        {},
        {"name": 3},
        {"shape": "ab"},
        {"shape": [-1]},
        {"shape": [2.5]},
        {"shape": [9] * 9},
        {"shape": [65536, 9]},
        {"unit": None},
    ],
)
def test_a_note_that_haptorb_did_not_write_is_refused(field):
    with pytest.raises(RecordingError, match="not written by haptorb"):
        split(PLACE | field if field else field)


def test_columns_are_those_that_there_are():
    columns = memory_columns(note_worlds(PLACE, ENERGY), 4)
    assert [(one.name, one.width, one.unit) for one in columns] == [("ball.place", 3, "m"), ("ball.energy", 1, "J")]
    assert memory_columns(note_worlds(PLACE, ENERGY), 3) == columns[:1]
    assert memory_columns([], 4) == ()
