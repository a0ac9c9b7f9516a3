"""Destination of a run's recording: named, temporary or none; no file is left without a run."""

from __future__ import annotations

import gc
import os
from pathlib import Path

import pytest

from haptorb.errors import RecordingError
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


def test_nowhere_is_no_file_and_nothing_to_read() -> None:
    place = RunRecording(False, overwrite=False)
    assert place.open() is None
    assert place.user_path is place.temporary_path is None
    place.discard()
    with pytest.raises(RecordingError, match="nothing was recorded"):
        place.read()
