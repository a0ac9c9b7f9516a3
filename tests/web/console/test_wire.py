"""Binary frames: content, and rejection of anything that is not a pointer."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from haptorb.errors import InputError
from haptorb.recording.row import RowLayout
from haptorb.web import wire

LAYOUT = RowLayout(channels=3, sensors=9, memory=8)


def test_columns_lie_where_they_are_said_to():
    columns = wire.Columns(LAYOUT)
    index, described = columns.index, columns.describe()
    assert [column["name"] for column in described] == list(wire.COLUMNS)
    heads = {head for column in described for head in column["heads"]}
    assert {"t [s]", "tick", "p[2] [m]", "wrench_commanded[5] [N·m]", "current_measured[2] [A]"} <= heads
    for column in described:
        assert len(column["heads"]) == column["width"]
        first = index[column["offset"]]
        assert slice(first, first + column["width"]) == LAYOUT[column["name"]]


def test_an_hour_of_milliseconds_survives_float32():
    rows = np.zeros((3, LAYOUT.width))
    rows[:, LAYOUT["t"].start] = 7200 + np.array([0.0, 0.001, 0.002])
    rows[:, LAYOUT["tick"].start] = 20_000_001 + np.arange(3)
    index = wire.Columns(LAYOUT).index
    frame = wire.rows_frame(rows, index, LAYOUT["t"].start, LAYOUT["tick"].start, math.nan, 5)
    magic, kind, version, count, width, t0, tick0, echo, dropped = struct.unpack("<IHHIIdddd", frame[:48])
    assert (magic, kind, version, count, width) == (0x484F5242, wire.ROWS, wire.VERSION, 3, len(index))
    assert (t0, tick0, dropped) == (7200.0, 20_000_001.0, 5.0)
    assert math.isnan(echo)
    data = np.frombuffer(frame[48:], "<f4").reshape(3, -1)
    assert data[:, 0] == pytest.approx([0, 0.001, 0.002])
    assert data[:, 1].tolist() == [0, 1, 2]
    assert rows[0, LAYOUT["t"].start] == 7200.0, "the caller's rows must stay as they are"


def message(*numbers: float) -> bytes:
    return struct.pack("<9d", *numbers)


def test_pointer_with_and_without_orientation():
    told = wire.pointer(message(12.5, 0.0, 0.01, 0.05, *[math.nan] * 4, 1.0))
    assert (told.stamp, told.held, told.q) == (12.5, True, None)
    assert told.p.tolist() == [0.0, 0.01, 0.05]
    turned = wire.pointer(message(math.nan, 0.0, 0.0, 0.05, 0.0, 0.6, 0.0, 0.8, 0.0))
    assert turned.q.tolist() == [0.0, 0.6, 0.0, 0.8]
    assert not turned.held


@pytest.mark.parametrize(
    "numbers",
    [
        (0.0, math.nan, 0.0, 0.05, *[math.nan] * 4, 1.0),
        (0.0, math.inf, 0.0, 0.05, *[math.nan] * 4, 1.0),
        (0.0, 5.0, 0.0, 0.05, *[math.nan] * 4, 1.0),
        (0.0, 0.0, 0.0, 0.05, 0.0, 0.0, 0.0, 2.0, 1.0),
        (0.0, 0.0, 0.0, 0.05, 0.0, math.nan, 0.0, 1.0, 1.0),
        (math.inf, 0.0, 0.0, 0.05, *[math.nan] * 4, 1.0),
    ],
)
def test_impossible_pointers_are_refused(numbers):
    with pytest.raises(InputError):
        wire.pointer(message(*numbers))


@given(st.binary(max_size=200))
def test_no_bytes_do_more_than_be_refused(data):
    try:
        told = wire.pointer(data)
    except InputError:
        return
    assert np.isfinite(told.p).all()
    assert np.linalg.norm(told.p) <= wire.MAX_DISTANCE_M


def test_felt_frame_keeps_every_vertex():
    frame = wire.encode_force_frame(np.array([0.5, -0.25]), np.array([False, True]), 7)
    assert struct.unpack("<IHHIIdddd", frame[:48])[1:6] == (wire.FORCE_MAP, wire.VERSION, 2, 0, 7.0)
    assert np.frombuffer(frame[48:56], "<f4").tolist() == [0.5, -0.25]
    assert list(frame[56:]) == [0, 1]
