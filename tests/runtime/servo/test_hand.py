"""The hand moved by programs: a held pose, a followed path, and their ends."""

from __future__ import annotations

import threading
import time
from contextlib import nullcontext
from typing import Any

import numpy as np
import pytest

from haptorb.errors import InputError, ServoError
from haptorb.runtime.servo import Servo

pytestmark = [pytest.mark.realtime, pytest.mark.usefixtures("quick_starts")]

HERE, THERE = (0.0, 0.03, 0.04), (0.0, -0.03, 0.04)


def _until(servo: Servo, condition: Any, patience: float = 20.0) -> None:
    end = time.monotonic() + patience
    while not condition():
        servo.check()
        assert time.monotonic() < end, "it did not come to pass"
        time.sleep(0.005)


def _is_at(servo: Servo, place: Any) -> bool:
    return bool(np.allclose(servo.latest().hand_goal, place, atol=1e-9))


def _is_old(servo: Servo) -> bool:
    """Whether the pose has expired by far."""
    return bool(servo.latest().age > 4 * servo.device.limits.expiry)


@pytest.fixture
def servo(running: Servo) -> Servo:
    """A servo that runs, and whose hand nobody holds."""
    running.hand.release()
    _until(running, lambda: running.latest().age == 0.0)  # the guided motion
    return running


def test_a_pose_is_held_until_something_else_is_said(servo: Servo) -> None:
    servo.hand.hold(HERE)
    _until(servo, lambda: _is_at(servo, HERE))
    cursor, _ = servo.rows()
    _until(servo, lambda: servo.rows()[0] > cursor + 500)
    _, rows = servo.rows(cursor)
    assert (rows[:, servo.layout["hand_goal"]] == HERE).all()
    assert np.median(rows[:, servo.layout["age"]]) < servo.device.limits.expiry / 2
    servo.hand.point(THERE)  # once: the pose that was held is not said again
    _until(servo, lambda: _is_at(servo, THERE))
    _until(servo, lambda: _is_old(servo))
    assert _is_at(servo, THERE)
    servo.hand.hold(HERE)
    servo.hand.release()
    _until(servo, lambda: servo.latest().age == 0.0)  # the guided motion


@pytest.mark.parametrize("name", ["keep_alive", "patience"])
def test_a_keep_alive_keeps_the_pose_fresh(servo: Servo, name: str) -> None:
    expiry, longer = servo.device.limits.expiry, 0.4
    for wrong in (-0.1, 1.5, float("nan")):
        with pytest.raises(InputError, match="keep_alive"):
            servo.hand.point(HERE, keep_alive=wrong)
    cursor, _ = servo.rows()
    with pytest.warns(FutureWarning, match="keep_alive") if name == "patience" else nullcontext():
        servo.hand.point(HERE, **{name: longer})
    _until(servo, lambda: _is_old(servo))
    _, rows = servo.rows(cursor)
    rows = rows[(rows[:, servo.layout["hand_goal"]] == HERE).all(axis=1)]
    fresh = rows[rows[:, servo.layout["age"].start] <= expiry]
    held = float(np.ptp(fresh[:, servo.layout["t"].start]))
    assert longer - 0.05 < held < longer + expiry + 0.05


def test_a_path_is_followed_to_its_last_pose(servo: Servo) -> None:
    cursor, _ = servo.rows()
    servo.hand.follow([HERE, THERE], [0.0, 0.3])
    _until(servo, lambda: _is_at(servo, THERE))
    _, rows = servo.rows(cursor)
    y = rows[:, servo.layout["hand_goal"]][:, 1]
    assert len(np.unique(y[np.abs(y) < 0.0299])) > 5, "it goes there, it does not jump"
    cursor, _ = servo.rows()
    _until(servo, lambda: servo.rows()[0] > cursor + 300)
    assert not _is_old(servo)
    servo.hand.follow(lambda t: (0.0, 0.0, 0.05 + 0.001 * min(t, 1e-3)))
    _until(servo, lambda: _is_at(servo, (0.0, 0.0, 0.050001)))


def test_a_path_that_fails_is_told_with_its_line_and_its_pose_expires(servo: Servo) -> None:
    def path(t: float) -> Any:
        return HERE if t < 0.1 else THERE[:2]

    def buggy(t: float) -> Any:
        return HERE if t < 0.1 else 1 / 0

    servo.hand.follow(path)
    with pytest.raises(InputError, match=r"path at 0\.\d+ s: p must be the position of the tool's magnet, 3 finite"):
        servo.run(20)
    servo.hand.follow(buggy)
    assert servo.hand.trouble == ""
    with pytest.raises(InputError, match=r"ZeroDivisionError[\s\S]*test_hand\.py\", line \d+, in buggy\n +return"):
        servo.run(20)
    assert "ZeroDivisionError" in servo.warning
    _until(servo, lambda: _is_old(servo))
    servo.hand.hold(HERE)
    servo.run(0.05)


def test_a_path_that_hangs_keeps_no_pose_alive(servo: Servo) -> None:
    hangs, go_on = threading.Event(), threading.Event()

    def path(t: float) -> Any:
        if t > 0.05:
            hangs.set()
            go_on.wait(20)
        return HERE

    servo.hand.follow(path)
    assert hangs.wait(20)
    _until(servo, lambda: _is_old(servo))
    servo.hand.point(THERE)
    _until(servo, lambda: _is_at(servo, THERE))
    go_on.set()
    _until(servo, lambda: _is_old(servo))
    assert _is_at(servo, THERE), "what comes late from a path that is over is not said"


def _hands() -> set[threading.Thread]:
    return {thread for thread in threading.enumerate() if thread.name == "haptorb-hand"}


@pytest.mark.parametrize(
    ("follow", "says"),
    [
        (lambda servo: servo.hand.hold((0, 0, 50)), "50 mm are 0.05"),
        (lambda servo: servo.hand.follow([HERE]), "needs the times"),
        (lambda servo: servo.hand.follow(lambda t: HERE, [0.0]), "times are for poses"),
        (lambda servo: servo.hand.follow(lambda t: None), r"path at 0.000 s: .*got None"),
        (lambda servo: servo.hand.follow(lambda: HERE), r"path at 0.000 s: TypeError"),
    ],
)
def test_what_cannot_be_followed_is_refused_and_the_hand_stays(running: Servo, follow: Any, says: str) -> None:
    running.hand.hold(HERE)
    with pytest.raises(InputError, match=says):
        follow(running)
    _until(running, lambda: _is_at(running, HERE))
    assert running.hand.trouble == ""


def test_nothing_is_held_before_the_start_and_after_the_end(fake_servo: Any) -> None:
    servo, before = fake_servo(record=False).servo, _hands()
    with pytest.raises(ServoError, match="not started"):
        servo.hand.hold(HERE)
    with servo:
        servo.hand.hold(HERE)
        assert _hands() > before
    assert _hands() == before


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"driver": "serial:/dev/ttyACM0"}, "real tool, whose pose would be unknown"),
        ({"driver": "i2c:1", "tracker": "hall"}, "real tool, whose pose would be unknown"),
        ({"tracker": "osc:9000"}, "tracker 'osc:9000' determines where the hand is"),
    ],
)
def test_no_pose_is_held_that_a_tracker_should_measure(arguments: Any, says: str) -> None:
    servo = Servo("omni", **arguments)
    for say in (lambda: servo.hand.hold(HERE), lambda: servo.hand.follow([HERE], [0.0])):
        with pytest.raises(InputError, match=says):
            say()
