"""Data of a played recording, and messages on missing parts."""

from __future__ import annotations

import json

import numpy as np
import pytest

from haptorb.errors import HaptorbError
from haptorb.recording.mcap import Recorder
from haptorb.recording.row import RowLayout
from haptorb.web.view import PlayedRecording
from haptorb.web.wire import COLUMNS
from oracles.made_recording import RATE, make_recording


def read_frame(frame):
    """(first row, numbers) of a frame of rows."""
    head = np.frombuffer(frame[:16], "<u4")
    t0, tick0, _, first = np.frombuffer(frame[16:48], "<f8")
    rows = np.frombuffer(frame[48:], "<f4").reshape(head[2], head[3]).astype(float)
    rows[:, 0] += t0
    rows[:, 1] += tick0
    return int(first), rows


def test_rows_are_those_of_the_file_in_the_consoles_order(made):
    path, rows = made
    played = PlayedRecording(path)
    layout = RowLayout.of(played.device)
    first, found = read_frame(played.frame(100, 160, 7.0))
    wanted = np.concatenate([rows[100:160, layout[name]] for name in COLUMNS], axis=1)
    assert first == 100
    np.testing.assert_allclose(found, wanted, rtol=1e-6)
    described = played.describe("x")["columns"]
    assert [one["name"] for one in described] == list(COLUMNS)
    assert described[-1]["offset"] + described[-1]["width"] == wanted.shape[1]


@pytest.mark.parametrize("seconds", [0.0, 0.0005, 1.2345, 2.999, 50.0, -3.0])
def test_the_row_of_a_time_is_the_last_that_is_not_later(made, seconds):
    played = PlayedRecording(made[0])
    assert played.find_row(seconds) == min(max(int(np.floor(seconds * RATE + 1e-6)), 0), 2999)


def test_a_question_beyond_the_end_is_answered_with_what_there_is(made):
    played = PlayedRecording(made[0])
    assert len(read_frame(played.frame(2990, 5000, 0.0))[1]) == 10
    assert read_frame(played.frame(10**9, 10**9 + 5, 0.0))[0] == 2999
    assert read_frame(played.frame(-5, -2, 0.0))[0] == 0


def test_worlds_are_shown_with_the_values_of_their_time(made):
    played = PlayedRecording(made[0])
    assert played.describe_world(0, "exact")["values"]["moment"] == 2.0
    assert played.describe_world(1, "exact")["values"]["moment"] == 1.0
    assert played.describe_world(9, "exact")["values"]["moment"] == 1.0  # not noted: the one before it
    assert played.find_world(-1) is None
    assert played.describe_world(-1, "exact")["remarks"]
    told = played.describe("x")
    assert [one["name"] for one in told["worlds"]] == ["dome"]
    assert told["played"]["changes"] == {"0": "dome", "1": "dome"}
    json.dumps(told, allow_nan=False)


def test_a_file_that_was_cut_plays_what_is_there_and_says_so(tmp_path):
    path = tmp_path / "cut.mcap"
    make_recording(path)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    played = PlayedRecording(path)
    assert 100 < len(played) < 3000
    assert any("truncated" in notice for notice in played.notices)


def test_a_newer_version_is_played_with_a_notice(tmp_path):
    path = tmp_path / "new.mcap"
    make_recording(path, 0.2, version="99.1.0")
    (notice,) = PlayedRecording(path).notices
    assert "99.1.0" in notice
    assert "newer" in notice


def test_without_a_note_of_the_device_its_file_name_or_a_person_says_it(tmp_path):
    path = tmp_path / "strange.mcap"
    make_recording(path, 0.1, device=False)
    with pytest.raises(HaptorbError, match="--as"):
        PlayedRecording(path)
    assert PlayedRecording(path, "omni").device.name == "omni"
    named = path.rename(tmp_path / "omni-20260101-120000-1-stopped.mcap")  # as the files of trips are
    played = PlayedRecording(named)
    assert played.device.name == "omni"
    assert any("assumed" in notice for notice in played.notices)
    with pytest.raises(HaptorbError, match="did you mean"):
        PlayedRecording(named, "omnj")


class _OldLayout:
    """Rows of another version: in another order, and without most fields."""

    def __init__(self, names):
        full = {field.name: field for field in RowLayout(3, 9, 0, 32).fields}
        self.fields = [full[name] for name in names]
        self.channels, self.sensors, self.contacts, self.memory = 3, 9, 0, 0
        self.width = sum(field.width for field in self.fields)

    def __getitem__(self, name):
        start = 0
        for field in self.fields:
            if field.name == name:
                return slice(start, start + field.width)
            start += field.width
        raise KeyError(name)


def test_fields_are_found_by_name_and_missing_ones_named(tmp_path):
    path = tmp_path / "omni-old.mcap"
    layout = _OldLayout(["wall", "p", "t", "tick"])
    rows = np.arange(20.0 * layout.width).reshape(20, layout.width)
    rows[:, layout["t"]] = np.arange(20.0)[:, None]
    with path.open("wb") as file:
        recorder = Recorder(file, layout, 1000.0, 10**18)
        recorder.append(rows)
        recorder.finish()
    played = PlayedRecording(path)
    _, found = read_frame(played.frame(3, 4, 0.0))
    at = {one["name"]: one["offset"] for one in played.describe("x")["columns"]}
    np.testing.assert_allclose(found[0, at["p"] : at["p"] + 3], rows[3, 1:4])
    assert np.isnan(found[0, at["wrench_actual"]])
    assert any("wrench_actual" in notice for notice in played.notices)


def test_what_is_no_recording_is_refused(tmp_path):
    path = tmp_path / "foreign.mcap"
    with pytest.raises(HaptorbError, match="No such file"):
        PlayedRecording(path)
    path.write_bytes(b"\x01\x02\x03\x04 something else")
    with pytest.raises(HaptorbError, match="not an MCAP file"):
        PlayedRecording(path)
    make_recording(path, 0.0)
    with pytest.raises(HaptorbError, match=r"no ticks|not a haptorb recording"):
        PlayedRecording(path)
    layout = _OldLayout(["wall", "p"])
    with path.open("wb") as file:
        recorder = Recorder(file, layout, 1000.0, 10**18)
        recorder.append(np.ones((5, layout.width)))
        recorder.finish()
    with pytest.raises(HaptorbError, match="field 't'"):
        PlayedRecording(path)


@pytest.mark.parametrize("times", [[3.0, 2.0], [np.nan, 1.0], [0.0, np.inf]])
def test_times_that_do_not_increase_are_refused(tmp_path, times):
    path = tmp_path / "omni-back.mcap"
    layout = _OldLayout(["wall", "t"])
    with path.open("wb") as file:
        recorder = Recorder(file, layout, 1000.0, 10**18)
        recorder.append(np.column_stack([np.arange(2.0), times]))
        recorder.finish()
    with pytest.raises(HaptorbError, match="times must increase"):
        PlayedRecording(path)
