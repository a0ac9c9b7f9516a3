"""Servo API: start, point, stop, change of the world, end; with a chain without a device."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest

from haptorb.errors import InputError, ServoError, UnknownName
from haptorb.runtime.servo import Servo

pytestmark = [pytest.mark.realtime, pytest.mark.usefixtures("quick_starts")]


def _until(servo: Servo, condition: Any, patience: float = 20.0) -> None:
    end = time.monotonic() + patience
    while not condition():
        servo.check()
        assert time.monotonic() < end, "it did not come to pass"
        time.sleep(0.005)


def test_it_ran_and_left_the_coils_off(ended: Any) -> None:
    servo = ended.servo
    assert ended.alive
    assert (ended.row[servo.layout["duty_applied"]] == 0.5).all()
    assert ended.words() == ["open", "close"]
    assert not servo.alive
    last = servo.latest()
    assert (last[servo.layout["duty_applied"]] == 0.0).all()
    assert servo.report()["trips"] == []
    with pytest.raises(ServoError, match="create a new one"):
        servo.open()


def test_report_adds_up(ended: Any) -> None:
    servo = ended.servo
    report = servo.report()
    rows = servo.recording.rows
    assert report["ticks"] == len(rows) - 1  # and the closing row
    assert report["missed"] == rows[:, servo.layout["missed"]].sum()
    assert 0 < report["success_rate"] <= 1
    assert report["peak_force_n"] == pytest.approx(0.5)
    assert set(report["lateness_us"]) == {"p50", "p99", "p999"}
    assert list(report["stage_us"].values()) == [1, 2, 3, 4, 5, 6, 7]
    assert report["scheduler"]["policy"] in ("SCHED_FIFO", "SCHED_OTHER")


def test_rows_are_all_there_and_in_order(ended: Any) -> None:
    assert ended.ticks == list(range(len(ended.ticks)))
    assert len(ended.ticks) > 100


def test_time_is_that_of_the_deadlines(ended: Any) -> None:
    rows, at = ended.servo.recording.rows[:-1], ended.servo.layout
    deadlines = np.cumsum(rows[:, at["missed"]][:, 0] + 1) - 1
    assert np.allclose(rows[:, at["t"]][:, 0], deadlines / 500, atol=1e-9)


def test_pointer_reaches_the_loop_and_grows_old(running: Servo) -> None:
    at = running.layout
    running.hand.point((0.0, 0.03, 0.04))
    _until(running, lambda: (running.latest()[at["hand_goal"]] == (0.0, 0.03, 0.04)).all())
    young = running.latest()[at["age"]][0]
    time.sleep(0.2)
    assert 0 <= young < running.latest()[at["age"]][0]
    assert running.latest()[at["age"]][0] > 0.15
    running.hand.release()
    _until(running, lambda: running.latest()[at["age"]][0] == 0.0)


def test_stop_and_engage(fake_servo: Any) -> None:
    with fake_servo(record=False).servo as servo:
        at = servo.layout
        servo.stop()
        _until(servo, lambda: (servo.latest()[at["duty_applied"]] == 0).all())
        servo.engage()
        _until(servo, lambda: (servo.latest()[at["duty_applied"]] == 0.5).all())
    trips = servo.report()["trips"]
    assert [trip["code"] for trip in trips] == ["STOPPED"]
    assert "Re-engage" in trips[0]["reason"]


def test_a_stop_that_is_given_before_or_while_the_servo_starts_holds(fake_servo: Any) -> None:
    servo = fake_servo(record=False).servo
    servo.stop()
    with servo:
        asked = servo.stops
        servo.run(0.2)
        _, rows = servo.rows(0)
        assert (rows[:, servo.layout["duty_applied"]] == 0).all()
        assert len(rows) > 10
        servo.stop()
        servo.engage(asked)  # asked for before the last stop
        servo.run(0.1)
        assert (servo.latest()[servo.layout["duty_applied"]] == 0).all()
        servo.engage(servo.stops)
        _until(servo, lambda: (servo.latest()[servo.layout["duty_applied"]] == 0.5).all())


def test_every_stop_has_a_number_of_its_own(fake_servo: Any) -> None:
    servo = fake_servo().servo
    seen = {servo.stops}
    for _ in range(3):
        servo.stop()
        seen.add(servo.stops)
    assert len(seen) == 4


def test_world_changes_between_ticks(fake_servo: Any) -> None:
    with fake_servo(world="dome").servo as servo:
        assert servo.world[0] == "dome"
        servo.set_world("dome", {"half_width_deg": 25.0})
        servo.set_world("dome", {"moment": 1.5})
        assert servo.world[1]["half_width_deg"] == 25.0
        assert servo.world[1]["moment"] == 1.5
        servo.set_world("nothing")
        assert servo.world == ("nothing", {})
        servo.set_world("dome", {"summit": np.array([0.0, 1.0, 0.0])})
        assert servo.world[1]["half_width_deg"] == 18.0
        _until(servo, lambda: servo.latest()[servo.layout["world"]] == 4)
    worlds = servo.recording.worlds
    assert [note["change"] for note in worlds] == ["0", "1", "2", "3", "4"]


@pytest.mark.parametrize(
    ("name", "values", "kind", "says"),
    [
        ("dme", {}, UnknownName, "did you mean 'dome'"),
        ("dome", {"half_wdth_deg": 3}, UnknownName, "half_width_deg"),
        ("dome", {"half_width_deg": -3}, InputError, "between 5 and 90"),
        ("dome", {"half_width_deg": float("nan")}, InputError, "finite"),
        ("dome", {"half_width_deg": "wide"}, InputError, "finite number"),
        ("dome", {"half_width_deg": object()}, InputError, "numbers"),
        ("dome", {"half_width_deg": [1.0] * 5000}, InputError, "too long"),
    ],
)
def test_refused_world_changes_nothing(running: Servo, name: str, values: Any, kind: Any, says: str) -> None:
    before = running.world
    with pytest.raises(kind, match=says):
        running.set_world(name, values)
    assert running.world == before
    running.set_world("dome", {"moment": 1.0})
    assert running.alive


@pytest.mark.parametrize("rate", [0, 49.9, 4001, float("nan"), float("inf"), -1000, "fast", True])
def test_rate_out_of_range(rate: Any) -> None:
    with pytest.raises(InputError, match="rate"):
        Servo("omni", rate=rate)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"device": "omny"}, "did you mean 'omni'"),
        ({"world": "dme"}, "did you mean 'dome'"),
        ({"driver": "sym"}, "did you mean 'sim'"),
        ({"tracker": "pointr"}, "did you mean 'pointer'"),
        ({"model": "publishd"}, "did you mean 'published'"),
    ],
)
def test_unknown_names(arguments: dict[str, Any], says: str) -> None:
    with pytest.raises(UnknownName, match=says):
        Servo(**{"device": "omni", **arguments})


@pytest.mark.parametrize("seed", [-1, 1.5, "x", True])
def test_seed_must_be_a_whole_number(seed: Any) -> None:
    with pytest.raises(InputError, match="seed"):
        Servo("omni", seed=seed)


@pytest.mark.parametrize("p", [(0, 0), (0, 0, np.nan), "here", np.zeros((2, 3))])
def test_point_refuses_what_is_no_place(running: Servo, p: Any) -> None:
    with pytest.raises(InputError):
        running.hand.point(p)
    running.check()


@pytest.mark.parametrize("q", [(0, 0, 0, 0), (0, 0, 1), (0, 0, 0, np.inf)])
def test_point_refuses_what_is_no_turn(running: Servo, q: Any) -> None:
    with pytest.raises(InputError):
        running.hand.point((0, 0, 0.05), q)
    running.check()


@pytest.mark.parametrize("seconds", [-1.0, float("nan"), "long"])
def test_run_refuses_what_is_no_time(running: Servo, seconds: Any) -> None:
    with pytest.raises(InputError):
        running.run(seconds)
    running.check()


def test_it_says_in_one_line_what_it_is_and_what_it_does(fake_servo: Any) -> None:
    servo = fake_servo(world="dome", record=False).servo
    who = "<Servo of omni, world 'dome', driver sim, tracker pointer, 1000 Hz: "
    assert repr(servo) == f"{who}not started>"
    with servo:
        assert repr(servo) == f"{who}running, actual force (0, 300, 400) mN>"
        servo.stop()
        _until(servo, lambda: servo.latest().guard == 4)
        assert repr(servo) == f"{who}running, coils off. Stopped by hand. Re-engage when you are ready.>"
    assert repr(servo) == f"{who}the servo ended: on command>"


def test_nothing_works_before_the_start(fake_servo: Any) -> None:
    servo = fake_servo().servo
    assert not servo.alive
    for use in (
        lambda: servo.run(1),
        servo.engage,
        servo.report,
        lambda: servo.hand.point((0, 0, 1)),
        lambda: servo.rows(0),
        servo.latest,
    ):
        with pytest.raises(ServoError, match="not started"):
            use()


def test_interrupt_in_run_closes(fake_servo: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    made = fake_servo(record=False)
    made.servo.open()

    def interrupt(seconds: float) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("haptorb.runtime.servo.sleep", interrupt)
    with pytest.raises(KeyboardInterrupt):
        made.servo.run(1.0)
    monkeypatch.undo()
    assert made.words() == ["open", "close"]
    assert not made.servo.alive
