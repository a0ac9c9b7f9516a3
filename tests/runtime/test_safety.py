"""Coils are off after any failure of a process: killed, terminated, stuck, orphaned, or failing in the middle."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from haptorb import Recording
from haptorb.control.trip_reasons import GuardState, Trip
from haptorb.errors import InputError, RecordingError, ServoError
from haptorb.runtime import linux
from haptorb.runtime.process_group import ProcessGroup
from haptorb.worlds import Nothing
from oracles.fork_server import get_fork_server
from oracles.repetitions import repetitions

pytestmark = pytest.mark.realtime


def _is_gone(pid: int) -> bool:
    """Whether a process ended; one that only waits to be collected counts."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"
    except OSError:
        return True


def _until(condition: Any, patience: float = 10.0) -> None:
    end = time.monotonic() + patience
    while not condition():
        assert time.monotonic() < end, "it did not come to pass"
        time.sleep(0.005)


def _duties_off(servo: Any) -> bool:
    last = servo.latest()
    return bool(
        (last[servo.layout["duty_applied"]] == 0.0).all() and (last[servo.layout["current_commanded"]] == 0.0).all()
    )


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGQUIT])
def test_told_to_end_at_any_moment(fake_servo: Any, number: signal.Signals) -> None:
    chance = random.Random(int(number))
    for _ in range(3 if number == signal.SIGTERM else 1):
        made = fake_servo()
        with made.servo as servo:
            servo.run(0.05 + 0.05 * chance.random())
            os.kill(servo._children.servo_pid, number)
            with pytest.raises(ServoError, match=f"ended by {number.name}"):
                servo.run(10)
            assert not servo.alive
            assert servo._children._servo.wait() == 128 + number
        assert made.words() == ["open", "close"]
        assert _duties_off(servo)
        assert servo.latest()[servo.layout["guard"]] == GuardState.OFF
        assert not servo.recording.truncated
        assert (servo.recording["duty_applied"][-1] == 0).all()


def test_told_to_end_while_starting(fake_servo: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Before the driver is open there is nothing to switch off; at every moment the process ends."""
    monkeypatch.setattr(linux, "subprocess", subprocess)  # a start that takes its time
    chance = random.Random(3)
    wait = ProcessGroup.wait_until_running

    def wait_and_end(children: ProcessGroup) -> None:
        time.sleep(0.6 * chance.random())
        os.kill(children.servo_pid, signal.SIGTERM)
        wait(children)

    def live(servo: Any) -> None:
        with servo:
            servo.run(10)

    monkeypatch.setattr(ProcessGroup, "wait_until_running", wait_and_end)
    for _ in range(repetitions(3, 6)):
        made = fake_servo()
        servo = made.servo
        with pytest.raises(ServoError):
            live(servo)
        assert made.words() in ([], ["open", "close"])
        assert _is_gone(servo._children.servo_pid)


def test_servo_killed(fake_servo: Any) -> None:
    with fake_servo().servo as servo:
        servo.run(0.3)
        os.kill(servo._children.servo_pid, signal.SIGKILL)
        with pytest.raises(ServoError, match="SIGKILL"):
            servo.run(10)
        assert not servo.alive
        published = servo.rows(0)[0]
    recording = servo.recording
    assert len(recording) == published  # the recorder drained the ring and closed the file
    assert not recording.truncated


def test_recorder_killed(fake_servo: Any, tmp_path: Path) -> None:
    lost = []
    for i in range(3):
        path = tmp_path / f"{i}.mcap"
        with fake_servo(record=path).servo as servo:
            servo.run(0.3 + 0.017 * i)
            os.kill(servo._children.recorder_pid, signal.SIGKILL)
            published = servo.rows(0)[0]
            with pytest.raises(RecordingError, match="SIGKILL"):
                servo.run(10)
            assert servo.alive  # what is felt does not depend on what is written
            assert "SIGKILL" in servo.recording_trouble
        recording = Recording(path)
        assert recording.truncated
        assert recording["tick"].tolist() == list(range(len(recording)))
        lost.append(published - len(recording))
        assert path.stat().st_mode & 0o222 == 0  # what was cut short is protected
    assert sorted(lost)[1] <= 100  # a tenth of a second


def test_tick_fails(fake_servo: Any) -> None:
    made = fake_servo({"raise_at": 1000})  # late enough for a slow host to have opened it
    with made.servo as servo, pytest.raises(ServoError, match="ZeroDivisionError: a fault that nobody foresaw"):
        servo.run(10)
    assert made.words() == ["open", "close"]
    assert _duties_off(servo)
    assert servo.latest()[servo.layout["guard"]] == GuardState.TRIPPED
    assert [trip["code"] for trip in servo.report()["trips"]] == [Trip.LOOP_FAILED.name]
    assert "ZeroDivisionError" in servo.recording.metadata["end"]["reason"]


def test_tick_hangs(fake_servo: Any) -> None:
    made = fake_servo({"hang_at": 1000})
    with made.servo as servo, pytest.raises(ServoError, match="took longer than a second"):
        servo.run(10)
    assert made.words() == ["open", "close"]
    assert _duties_off(servo)


def test_host_silent(fake_servo: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ProcessGroup, "_beat", lambda children: None)
    made = fake_servo()
    with pytest.raises(ServoError, match="did not respond"), made.servo as servo:
        servo.run(10)
    servo = made.servo
    assert made.words() in ([], ["open", "close"])
    assert _duties_off(servo)
    assert servo.report()["trips"][-1]["code"] == "HOST_SILENT"


def test_driver_does_not_open(fake_servo: Any, tmp_path: Path) -> None:
    servo = fake_servo({"fails": "open"}, record=tmp_path / "a.mcap").servo
    with pytest.raises(ServoError, match="nobody at the other end"):
        servo.open()
    assert not (tmp_path / "a.mcap").exists()
    assert not servo._shared.path.exists()
    assert not servo._folder.exists()


def test_world_that_cannot_travel(fake_servo: Any, tmp_path: Path) -> None:
    class Holding(Nothing):
        held = threading.Lock()

    made = fake_servo(world=Holding(), record=tmp_path / "a.mcap")
    with pytest.raises(InputError, match="cannot be sent"):
        made.servo.open()
    assert not (tmp_path / "a.mcap").exists()


_SCRIPT = """
import sys, time
from dataclasses import dataclass
import numpy as np
import haptorb
from haptorb.worlds import World

@dataclass(frozen=True)
class Mine(World):  # written in a user's script, no __main__ guard anywhere
    def wrench(self, state):
        return np.array([0, 0, 0.1, 0, 0, 0])

servo = haptorb.Servo("omni", Mine(), record=sys.argv[1] if sys.argv[1] else None)
with servo:
    pids = servo._children.servo_pid, servo._children.recorder_pid
    print(*pids, servo._shared.path, servo._recording._path, servo._folder, flush=True)
    servo.run(60)
"""


def _script(
    tmp_path: Path, record: str, *, copied: bool = True
) -> tuple[subprocess.Popen[str], int, int, Path, Path, Path]:
    """A program with a servo, which runs: a copy of a process that has loaded its packages, or started as a person
    starts it."""
    file = tmp_path / "script.py"
    file.write_text(_SCRIPT)
    pipes = dict.fromkeys(("stdout", "stderr"), subprocess.PIPE)
    process: subprocess.Popen[str] = (
        get_fork_server().start_program(str(file), record, text=True, **pipes)
        if copied
        else subprocess.Popen([sys.executable, str(file), record], text=True, **pipes)
    )
    assert process.stdout is not None
    line = process.stdout.readline().split()
    assert line, process.communicate()[1]
    time.sleep(0.2)
    return process, int(line[0]), int(line[1]), Path(line[2]), Path(line[3]), Path(line[4])


def test_parent_killed(tmp_path: Path) -> None:
    process, servo, recorder, shared, path, _ = _script(tmp_path, str(tmp_path / "a.mcap"), copied=False)
    process.kill()
    process.communicate()
    _until(lambda: _is_gone(servo) and _is_gone(recorder))
    assert not shared.exists()
    recording = Recording(path)
    assert not recording.truncated
    assert (recording["duty_applied"][-1] == 0).all()
    assert (recording["duty_applied"] != 0).any()
    assert recording["guard"][-1] in (GuardState.OFF, GuardState.TRIPPED)


def test_parent_killed_leaves_no_temporary_files(tmp_path: Path) -> None:
    process, servo, recorder, *left = _script(tmp_path, "")
    process.kill()
    process.communicate()
    _until(lambda: _is_gone(servo) and _is_gone(recorder))
    assert not any(path.exists() for path in left)


def test_parent_stopped_then_gone_on(tmp_path: Path) -> None:
    process, servo, _, _, path, _ = _script(tmp_path, str(tmp_path / "a.mcap"))
    process.send_signal(signal.SIGSTOP)
    try:
        _until(lambda: _is_gone(servo))
    finally:
        process.send_signal(signal.SIGCONT)
    _, errors = process.communicate(timeout=30)
    assert "was stopped and did not respond" in errors
    assert process.returncode != 0
    assert (Recording(path)["duty_applied"][-1] == 0).all()


def test_interrupted_from_the_keyboard(tmp_path: Path) -> None:
    process, servo, recorder, shared, path, _ = _script(tmp_path, str(tmp_path / "a.mcap"), copied=False)
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=30)
    assert _is_gone(servo)
    assert _is_gone(recorder)
    assert not shared.exists()
    recording = Recording(path)
    assert not recording.truncated
    assert (recording["duty_applied"][-1] == 0).all()
    assert np.isfinite(recording["t"]).all()


def test_thread_that_started_it_may_end(fake_servo: Any) -> None:
    """The kernel's parent-death signal comes when the starting *thread* ends; that alone must not end the servo."""
    servo = fake_servo().servo
    starter = threading.Thread(target=servo.open)
    starter.start()
    starter.join()
    servo.run(0.5)
    assert servo.alive
    servo.close()
