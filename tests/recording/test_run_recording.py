"""Destination of a run's recording: named, temporary or none; no file is left without a run."""

from __future__ import annotations

import gc
import os
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from haptorb import Servo
from haptorb.errors import InputError, RecordingError
from haptorb.recording.destination import RunRecording


def test_a_named_file_is_kept_and_told(tmp_path: Path) -> None:
    place = RunRecording(tmp_path / "run.mcap", overwrite=False)
    assert place.user_path is None  # not yet
    descriptor = place.open()
    assert descriptor is not None
    os.close(descriptor)
    assert place.user_path == str(tmp_path / "run.mcap")
    assert place.temporary_path is None
    del place
    gc.collect()
    assert (tmp_path / "run.mcap").exists()
    with pytest.raises(RecordingError, match=r"exists; choose another name, .* overwrite=True$") as refused:
        RunRecording(tmp_path / "run.mcap", overwrite=False).open()
    assert refused.value.command_message.endswith("--force")  # as the command line calls it


def test_a_temporary_file_goes_with_its_holder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    place = RunRecording(None, overwrite=False)
    descriptor = place.open()
    assert descriptor is not None
    os.close(descriptor)
    assert place.user_path is None
    assert [place.temporary_path] == list(tmp_path.iterdir())
    del place
    gc.collect()
    assert list(tmp_path.iterdir()) == []


def test_where_nothing_ran_nothing_is_left(tmp_path: Path) -> None:
    place = RunRecording(tmp_path / "run.mcap", overwrite=False)
    descriptor = place.open()
    assert descriptor is not None
    os.close(descriptor)
    place.discard()
    assert list(tmp_path.iterdir()) == []


def test_a_run_that_fails_to_start_costs_no_earlier_recording(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(b"the only one")
    lock = threading.Lock()  # cannot be sent to the servo's process

    def push(state: Any) -> np.ndarray:
        with lock:
            return np.zeros(6)

    with pytest.raises(InputError, match="cannot be sent"):
        Servo("omni", push, record=path, overwrite=True).open()
    assert path.read_bytes() == b"the only one"
    assert list(tmp_path.iterdir()) == [path]


def test_a_run_that_has_started_replaces_it(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(b"the only one")
    place = RunRecording(path, overwrite=True)
    descriptor = place.open()
    assert descriptor is not None
    os.close(descriptor)
    place.keep()
    place.discard()  # an error after the start
    assert list(tmp_path.iterdir()) == []


def test_nowhere_is_no_file_and_nothing_to_read() -> None:
    place = RunRecording(False, overwrite=False)
    assert place.open() is None
    assert place.user_path is place.temporary_path is None
    place.discard()
    with pytest.raises(RecordingError, match="nothing was recorded"):
        place.read()
