"""A servo records its run; what cannot be recorded is reported before the start."""

from __future__ import annotations

import json
import os
import signal
import time
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from haptorb import Recording
from haptorb.errors import RecordingError


@pytest.mark.realtime
@pytest.mark.usefixtures("quick_starts")
def test_servo_refuses_before_it_starts(fake_servo: Any, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_text("precious")
    made = fake_servo(record=path)
    with pytest.raises(RecordingError, match="overwrite=True"):
        made.servo.open()
    assert path.read_text() == "precious"
    assert made.servo._children is None
    with fake_servo(record=path, overwrite=True).servo as servo:
        servo.run(0.1)
    assert len(Recording(path)) > 10
    assert path.stat().st_mode & 0o200


@pytest.mark.realtime
@pytest.mark.usefixtures("quick_starts")
def test_servo_records_what_ran(fake_servo: Any, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with fake_servo(record=path, world="dome", seed=7).servo as servo:
        servo.run(0.3)
        assert servo.recording.truncated  # readable while it is being written
        ring = servo.rows(0)[1]
    recording = Recording(path)
    assert recording.rows[: len(ring)].tobytes() == ring.tobytes()
    assert recording.lost == 0
    run = recording.metadata["run"]
    assert run["seed"] == "7"
    assert json.loads(run["first_world"])["values"]["half_width_deg"] == 18.0
    device = recording.metadata["device"]
    assert device["digest"] == servo.device.digest
    assert tomllib.loads(device["file"])["kind"] == "spherical-electromagnet"
    assert recording.metadata["end"]["lost"] == "0"


@pytest.mark.realtime
@pytest.mark.usefixtures("quick_starts")
def test_servo_without_recording(fake_servo: Any) -> None:
    with fake_servo(record=False).servo as servo:
        servo.run(0.1)
    with pytest.raises(RecordingError, match="recording was off"):
        _ = servo.recording


@pytest.mark.realtime
@pytest.mark.usefixtures("quick_starts")
def test_ring_overrun_is_told(fake_servo: Any, tmp_path: Path) -> None:
    """A recorder that was held up for longer than the ring is long loses rows, says so, and goes on."""
    path = tmp_path / "a.mcap"
    with fake_servo(record=path, rate=4000.0).servo as servo:
        servo.run(0.1)
        os.kill(servo._children.recorder_pid, signal.SIGSTOP)
        try:
            start = servo.report()["ticks"]
            while servo.report()["ticks"] < start + 10_000:
                time.sleep(0.05)
        finally:
            os.kill(servo._children.recorder_pid, signal.SIGCONT)
        servo.run(0.2)
    recording = Recording(path)
    assert recording.lost > 0
    jumps = np.diff(recording["tick"]) - 1
    assert jumps.sum() == recording.lost
    assert int(recording.metadata["end"]["lost"]) == recording.lost
    assert servo.report()["recorded"]["lost"] == recording.lost
