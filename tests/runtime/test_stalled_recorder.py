"""A stalled recorder is reported, its lost rows are counted, and the loop is unaffected."""

from __future__ import annotations

import os
import resource
import signal
import time
from collections.abc import Callable
from typing import Any

import pytest

from haptorb.devices.loader import load
from haptorb.errors import RecordingError
from haptorb.recording.row import RowLayout
from haptorb.runtime.report import count_recorded
from haptorb.runtime.shared_memory import CAPACITY, SharedMemory, Word

pytestmark = pytest.mark.realtime(retry=False)


def _until(servo: Any, condition: Any, patience: float = 20.0) -> None:
    end = time.monotonic() + patience
    while not condition():
        assert time.monotonic() < end, "it did not come to pass"
        time.sleep(0.01)


def test_it_is_reported_until_it_continues(
    fake_servo: Any, check_limit: Callable[[str, float, float, str], None]
) -> None:
    with fake_servo(rate=200.0).servo as servo:
        recorder = servo._children.recorder_pid
        assert servo.recording_trouble == ""
        os.kill(recorder, signal.SIGSTOP)
        stopped = time.monotonic()
        try:
            _until(servo, lambda: "has not written" in servo.recording_trouble)
            check_limit("stopped recorder: reported after", time.monotonic() - stopped, 1.2, "s")
            assert "has not written" in servo.report()["recording_trouble"]
            before = servo.report()["ticks"]
            _until(servo, lambda: servo.report()["ticks"] > before)
            servo.check()  # the loop goes on
        finally:
            os.kill(recorder, signal.SIGCONT)
        _until(servo, lambda: servo.recording_trouble == "")
    report = servo.report()
    assert report["recorded"] == {"rows": len(servo.recording), "lost": 0}
    assert len(servo.recording) == report["ticks"] + 1  # and the closing row


def test_a_file_that_may_not_become_larger_is_named_as_the_cause(fake_servo: Any) -> None:
    """`ulimit -f` in the shell that starts a run: more than shared memory needs, less than the recording."""
    with fake_servo().servo as servo:
        recorder = servo._children.recorder_pid
        _until(servo, lambda: servo.report()["recorded"]["rows"] > 0)
        most = os.stat(servo._recording.path).st_size // 1024 + 50
        resource.prlimit(recorder, resource.RLIMIT_FSIZE, (most * 1024, most * 1024))
        _until(servo, lambda: servo.recording_trouble != "")
        assert f"no file may be larger than {most} KiB in this shell (ulimit -f)" in servo.recording_trouble
        with pytest.raises(RecordingError, match=r"the recording ended: File too large; .* \(ulimit -f\)"):
            servo.check()
        before = servo.report()["ticks"]
        _until(servo, lambda: servo.report()["ticks"] > before)  # the loop goes on
    report = servo.report()
    recorded = report["recorded"]
    # The rows that are called recorded are in the file; of the batch that did not fit, some may be, too.
    assert 0 < recorded["rows"] <= len(servo.recording) < report["ticks"]
    assert recorded["lost"] == servo.rows(0)[0] - recorded["rows"]


def test_rows_that_a_killed_recorder_never_wrote_are_lost(fake_servo: Any) -> None:
    with fake_servo().servo as servo:
        servo.run(0.3)
        os.kill(servo._children.recorder_pid, signal.SIGKILL)
        _until(servo, lambda: "SIGKILL" in servo.recording_trouble)
        time.sleep(0.2)
    kept = len(servo.recording)
    assert servo.report()["recorded"] == {"rows": kept, "lost": servo.rows(0)[0] - kept}


@pytest.mark.parametrize(
    ("published", "taken", "written", "lost", "over", "told"),
    [
        (5000, 4990, 4900, 0, False, (4900, 0)),
        (5000, 100, 80, 0, False, (80, 0)),  # it stands still, and what it missed is still there
        (CAPACITY + 600, 100, 80, 0, False, (80, 501)),  # 501 rows are overwritten
        (CAPACITY + 600, 100, 80, 7, False, (80, 508)),
        (CAPACITY + 600, 100, 80, 7, True, (80, CAPACITY + 520)),
        (900, 900, 900, 0, True, (900, 0)),
    ],
)
def test_lost_rows(published: int, taken: int, written: int, lost: int, over: bool, told: tuple[int, int]) -> None:
    shared = SharedMemory.create(RowLayout.of(load("omni")))
    shared.unlink()
    words = shared.words
    words[Word.ROWS], words[Word.TAKEN], words[Word.WRITTEN], words[Word.LOST] = published, taken, written, lost
    words[Word.RECORDER_LOOKS] = 9
    assert count_recorded(shared, over=over) == dict(zip(("rows", "lost"), told, strict=True))
