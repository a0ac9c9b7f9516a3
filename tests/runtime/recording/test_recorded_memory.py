"""What worlds remembered, read from a recording: by name, where they were felt, and nothing of a hostile file."""

import json

import numpy as np
import pytest

from haptorb.errors import RecordingError
from haptorb.runtime.recording.recorded_memory import memory_units, read_memory
from haptorb.runtime.row import Field

PLACE = {"name": "place", "unit": "m", "about": "of the ball", "shape": [3]}
ENERGY = {"name": "energy", "unit": "J", "about": "held", "shape": []}


class Rows:
    """A recording of six ticks with room for four numbers: a ball, nothing, a ball again."""

    fields = (Field("world", 1, "1", ""), Field("memory", 4, "SI", ""))

    def __init__(self, *memory):
        worlds = [
            {"name": "ball", "memory": list(memory)},
            {"name": "nothing"},
            {"name": "ball", "memory": list(memory)},
        ]
        self.worlds = [{"change": str(n), "tick": "0", "world": json.dumps(world)} for n, world in enumerate(worlds)]

    def __getitem__(self, name):
        return np.array([0.0, 0, 1, 1, 2, 2]) if name == "world" else np.arange(24.0).reshape(6, 4)

    def __len__(self):
        return 6


def test_fields_have_their_names_where_the_world_was_felt():
    found = read_memory(Rows(PLACE, ENERGY))
    assert found["ball.place"].shape == (6, 3)
    assert found["ball.place"][4].tolist() == [16.0, 17.0, 18.0]
    assert found["ball.energy"][[0, 1, 4, 5]].tolist() == [3.0, 7.0, 19.0, 23.0]
    assert np.isnan(found["ball.place"][2:4]).all()
    assert memory_units(Rows(PLACE, ENERGY).worlds) == {"ball.place": "m", "ball.energy": "J"}


def test_what_rows_have_no_room_for_is_left_out():
    assert list(read_memory(Rows(PLACE, ENERGY, ENERGY | {"name": "more"}))) == ["ball.place", "ball.energy"]
    assert list(read_memory(Rows(PLACE | {"shape": [60_000]}))) == []


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
    with pytest.raises(RecordingError, match="not one that haptorb wrote"):
        read_memory(Rows(PLACE | field if field else field))


def test_a_recording_of_another_version_has_none():
    rows = Rows(PLACE)
    rows.fields = rows.fields[:1]
    assert read_memory(rows) == {}
