"""Hand of the pointer: a drag continues with its messages, a resting hand with the page's presence."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from haptorb.web.session import PointerRelay, session
from haptorb.web.wire import PointerMessage


def pointer(stamp: float, x: float, held: bool) -> PointerMessage:
    return PointerMessage(stamp, np.array([x, 0.0, 0.05]), None, held)


@pytest.mark.parametrize(("driver", "seconds"), [("serial:/dev/ttyUSB0", 0.15), ("i2c:1", 0.15), ("sim", 1.0)])
def test_a_held_pointer_is_kept_through_a_stutter_only(
    servo, driver, seconds, monkeypatch: pytest.MonkeyPatch, check_limit: Callable[[str, float, float, str], None]
):
    now = [100.0]
    servo.driver = driver
    monkeypatch.setattr("haptorb.web.session.time.monotonic", lambda: now[0])
    hand = PointerRelay(servo)
    hand.point(pointer(1.0, 0.01, held=True))
    for _ in range(300):
        now[0] += 0.01
        hand.refresh()
    assert 100 * seconds - 1 <= servo.count("point"), "a stutter takes no mover"
    check_limit(f"{driver}: a page that hangs holds the mover for", 0.01 * (servo.count("point") - 1), seconds, "s")
    assert servo.count("release") == (driver == "sim"), "a simulated hand lets go instead"
    hand.point(pointer(2.0, 0.02, held=True))
    assert hand.held, "a page that comes back holds it still"


@pytest.mark.parametrize(("driver", "simulated"), [("serial:/dev/ttyUSB0", False), ("sim", True)])
def test_only_a_simulated_hand_bridges_a_server_without_processor(servo, driver, simulated):
    servo.driver = driver
    hand = PointerRelay(servo)
    for say in (lambda: hand.point(pointer(1.0, 0.01, held=True)), hand.refresh):
        servo.keep_alive = math.nan
        say()
        assert (0.1 < servo.keep_alive < 0.5) if simulated else servo.keep_alive == 0.0


def test_a_page_waits_longer_only_where_nothing_is_powered(servo):
    assert session(servo, "now")["heartbeat_timeout"] == 1.0
    servo.driver = "serial:/dev/ttyUSB0"
    assert session(servo, "now")["heartbeat_timeout"] == 0.25


@pytest.mark.parametrize("driver", ["serial:/dev/ttyUSB0", "sim"])
def test_a_dropped_drag_is_over_and_a_resting_hand_stays(servo, driver):
    servo.driver = driver
    hand = PointerRelay(servo)
    hand.point(pointer(1.0, 0.01, held=True))
    hand.drop()
    hand.refresh()
    assert servo.count("point") == 1
    assert servo.count("release") == (driver == "sim")
    assert not hand.held
    hand.point(pointer(2.0, 0.01, held=False))
    hand.drop()
    hand.refresh()
    assert servo.count("point") == 3
    assert servo.count("release") == (driver == "sim")


def test_a_resting_hand_is_kept_fresh_and_goes_home_with_the_page(servo, monkeypatch: pytest.MonkeyPatch):
    now = [100.0]
    monkeypatch.setattr("haptorb.web.session.time.monotonic", lambda: now[0])
    hand = PointerRelay(servo)
    hand.point(pointer(1.0, 0.01, held=False))
    for _ in range(5):
        hand.refresh()
    assert servo.count("point") == 6
    now[0] += 1.0
    hand.release()
    hand.refresh()
    assert servo.count("point") == 6
    assert servo.count("release") == 1


def test_a_page_that_goes_in_the_middle_of_a_drag_lets_the_pose_expire(servo):
    hand = PointerRelay(servo)
    hand.point(pointer(1.0, 0.01, held=True))
    hand.release()
    hand.refresh()
    assert servo.count("point") == 1
    assert servo.count("release") == 0


def test_letting_go_with_the_last_breath_is_no_rest(servo):
    hand = PointerRelay(servo)
    hand.point(pointer(1.0, 0.01, held=True))
    hand.point(pointer(2.0, 0.01, held=False))
    hand.release()
    hand.refresh()
    assert servo.count("release") == 0
    assert servo.count("point") == 2


def test_before_engaging_an_expired_drag_is_let_go(servo):
    hand = PointerRelay(servo)
    hand.point(pointer(1.0, 0.01, held=True))
    hand.release()
    hand.end_expired_drag()
    assert servo.count("release") == 1


def test_echo_is_the_newest_pointer_that_a_row_answers(servo):
    hand = PointerRelay(servo)
    assert not hand.waiting
    for stamp, x in ((10.0, 0.001), (11.0, 0.002), (12.0, 0.003)):
        hand.point(pointer(stamp, x, held=True))
    hand.point(pointer(math.nan, 0.003, held=True))  # a refresh
    assert hand.waiting
    assert math.isnan(hand.echo(np.array([[0.0, 0.0, 0.05]])))
    assert hand.echo(np.array([[0.001, 0.0, 0.05], [0.002, 0.0, 0.05]])) == 11.0
    assert hand.echo(np.array([[0.003, 0.0, 0.05]])) == 12.0
    assert not hand.waiting
    assert math.isnan(hand.echo(np.empty((0, 3))))


def test_what_is_never_answered_is_forgotten(servo, monkeypatch: pytest.MonkeyPatch):
    now = [100.0]
    monkeypatch.setattr("haptorb.web.session.time.monotonic", lambda: now[0])
    hand = PointerRelay(servo)
    hand.point(pointer(10.0, 0.001, held=True))
    assert hand.waiting
    now[0] += 1.0
    assert not hand.waiting
