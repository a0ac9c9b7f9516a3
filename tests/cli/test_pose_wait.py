"""Terminal messages while a tracker sends no pose."""

from __future__ import annotations

import time
from typing import cast

import pytest

from haptorb.cli import run
from haptorb.runtime.servo import Servo


class WaitingServo:
    """A servo whose pose is missing, as it says."""

    alive = True
    missing_pose = "waiting for a pose on OSC port 9109: none yet"


def lines_of(capsys: pytest.CaptureFixture[str]) -> list[str]:
    return [" ".join(line.split()) for line in capsys.readouterr().err.splitlines()]


def test_it_says_once_what_is_waited_for_and_again_when_counts_change(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(run, "_FIRST_CHECK_S", 0.005)
    monkeypatch.setattr(run, "_REPEAT_INTERVAL_S", 0.005)
    servo = WaitingServo()
    with run.notify_missing_pose(cast("Servo", servo)):
        time.sleep(0.2)
        servo.missing_pose = "waiting for a pose on OSC port 9109: 3 refused"
        time.sleep(0.2)
        servo.missing_pose = ""
        time.sleep(0.1)
    text = " ".join(lines_of(capsys))
    assert text.count("Waiting for a pose on OSC port 9109: none yet") == 1
    assert text.count("Waiting for a pose on OSC port 9109: 3 refused") == 1


def test_a_short_run_with_poses_says_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    servo = WaitingServo()
    servo.missing_pose = ""
    with run.notify_missing_pose(cast("Servo", servo)):
        time.sleep(0.01)
    assert capsys.readouterr().err == ""
