"""The last hundred ticks before every trip, in memory and in files for other tools."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from haptorb import Recording, Servo
from haptorb.control.trip_reasons import GuardState, Trip
from haptorb.recording.row import RowLayout
from haptorb.replay.replay import Replay
from haptorb.runtime.black_box import STORED_TICKS, BlackBox
from haptorb.runtime.shared_memory import SharedMemory

pytestmark = [pytest.mark.realtime, pytest.mark.usefixtures("quick_starts")]


@pytest.fixture
def shared() -> Any:
    made = SharedMemory.create(RowLayout(channels=3, sensors=0))
    yield made
    made.unlink()


def ticks(shared: SharedMemory, first: int, count: int) -> None:
    row = np.zeros(shared.layout.width)
    for tick in range(first, first + count):
        row[shared.layout["tick"]], row[shared.layout["t"]] = tick, tick * 1e-3
        shared.ring.publish(row)


def test_the_ticks_up_to_the_trip_are_kept_and_none_after_it(shared: SharedMemory) -> None:
    box = BlackBox(shared, "omni", 1000.0, None)
    ticks(shared, 0, 300)
    shared.announce_trip(0.299, Trip.OVERCURRENT)
    ticks(shared, 300, 50)  # the heartbeat looks late
    box.collect()
    (tripped,) = box.trips
    assert tripped.trip is Trip.OVERCURRENT
    assert repr(tripped) == "<TripRecord at 0.299 s: overcurrent, 100 ticks>"
    assert tripped.rows[:, shared.layout["tick"]].ravel().tolist() == list(range(200, 300))


def test_a_trip_right_after_the_start_has_fewer(shared: SharedMemory) -> None:
    box = BlackBox(shared, "omni", 1000.0, None)
    ticks(shared, 0, 7)
    shared.announce_trip(0.006, Trip.WORLD_FAILED)
    box.collect()
    box.collect()
    assert [len(tripped.rows) for tripped in box.trips] == [7]


def test_files_are_recordings_and_the_oldest_go(
    shared: SharedMemory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("haptorb.runtime.black_box._MAX_FILES", 2)
    box = BlackBox(shared, "omni", 1000.0, tmp_path / "trips")
    for n in range(4):
        ticks(shared, 200 * n, 200)
        shared.announce_trip((200 * n + 199) * 1e-3, Trip.STOPPED)
        box.finish()
    files = sorted((tmp_path / "trips").iterdir())
    assert len(files) == 2
    recording = Recording(box.files[-1] or "")
    assert not recording.truncated
    assert recording.metadata["trip"]["code"] == "STOPPED"
    assert (recording.rows == box.trips[-1].rows).all()


def test_a_persons_own_recordings_in_the_folder_stay(
    shared: SharedMemory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("haptorb.runtime.black_box._MAX_FILES", 1)
    (tmp_path / "elsewhere").mkdir()
    own = [tmp_path / name for name in ("session-3.mcap", "omni-20260101-120000-1-mine.mcap", "elsewhere/a.mcap")]
    for path in own:
        path.write_text("precious")
    own.append(tmp_path / "omni-20260101-120000-1-stopped.mcap")
    own[-1].symlink_to(own[0])
    box = BlackBox(shared, "omni", 1000.0, tmp_path)
    for n in range(3):
        ticks(shared, 200 * n, 200)
        shared.announce_trip((200 * n + 199) * 1e-3, Trip.STOPPED)
        box.finish()
    assert all(path.read_text() == "precious" for path in own)
    assert len(list(tmp_path.glob("*.mcap"))) == len(own) - 1 + 1


def test_a_folder_that_cannot_be_costs_nothing(shared: SharedMemory, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    box = BlackBox(shared, "omni", 1000.0, tmp_path / "file" / "trips")
    ticks(shared, 0, 5)
    shared.announce_trip(0.004, Trip.STOPPED)
    box.finish()
    assert box.files == [None]
    assert len(box.trips) == 1


def test_a_running_servo_keeps_what_led_to_a_stop(tmp_path: Path) -> None:
    with Servo("omni", "dome", record=False, black_box=tmp_path) as servo:
        servo.run(0.5)
        servo.stop()
        end = time.monotonic() + 10
        while not servo.trips and time.monotonic() < end:
            time.sleep(0.01)
        (tripped,) = servo.trips
    guard = tripped.rows[:, servo.layout["guard"]].ravel()
    assert len(guard) == STORED_TICKS
    assert guard[-1] == GuardState.TRIPPED
    assert (guard[:-1] != GuardState.TRIPPED).all()
    (file,) = servo.trip_files
    recording = Recording(file)
    assert STORED_TICKS <= len(recording) < 400
    assert np.array_equal(recording.rows[-STORED_TICKS:], tripped.rows, equal_nan=True)
    replay = Replay(recording)
    assert replay.run().identical, replay.comparison.first
    assert not replay.approximate
