"""Contract of all trackers: time stamps, no invented poses, and limited prediction."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from trackers import SUBJECTS, FeedSubject, NatNet, Osc, Subject, natnet_frame

from haptorb.control.trip_reasons import GuardState, Trip
from haptorb.devices.loader import load
from haptorb.runtime.assembly import assemble
from haptorb.runtime.config import RunConfig
from haptorb.runtime.trackers.feed_tracker import PREDICTION
from haptorb.worlds import find_world

pytestmark = pytest.mark.realtime

PLACE = (0.01, -0.02, 0.05)


@pytest.fixture(params=SUBJECTS)
def subject(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Subject]:
    one = SUBJECTS[request.param](tmp_path)
    yield one
    one.close()


def test_before_its_first_pose_it_knows_nothing(subject: Subject) -> None:
    pose = subject.tracker.pose(subject.now())
    assert not pose.valid
    if isinstance(subject, FeedSubject):  # the pointer's hand plays its guided motion, a simulated one's business
        assert not np.isfinite(subject.tracker.goal(subject.now()).stamp)


def test_a_pose_has_its_place_its_time_and_its_age(subject: Subject) -> None:
    before = subject.now()
    subject.say(PLACE)
    now = subject.now()
    pose = subject.tracker.pose(now)
    assert pose.valid
    assert pose.p == pytest.approx(PLACE, abs=1e-8)
    assert pytest.approx(np.eye(3), abs=1e-8) == pose.R_SR
    assert before - 0.1 <= pose.t <= now
    goal = subject.tracker.goal(now)
    assert goal.p == pytest.approx(PLACE, abs=1e-8)
    assert goal.held
    assert goal.stamp == pose.t


def test_silence_is_not_refreshed(subject: Subject) -> None:
    subject.say(PLACE)
    first = subject.tracker.pose(subject.now())
    for later in (0.01, 0.06, 1.0, 3600.0):
        pose = subject.tracker.pose(subject.now() + later)
        assert pose.t == first.t
        assert pose.p == pytest.approx(first.p, abs=1e-9)


def test_what_is_lost_is_not_believed_and_not_moved(subject: Subject) -> None:
    subject.say(PLACE)
    subject.tracker.pose(subject.now())
    subject.lose()
    pose = subject.tracker.pose(subject.now())
    assert not pose.valid
    assert not pose.v.any()
    subject.say((0.0, 0.0, 0.06))
    assert subject.tracker.pose(subject.now()).valid
    assert subject.tracker.pose(subject.now()).p == pytest.approx((0.0, 0.0, 0.06), abs=1e-8)


def test_asking_twice_changes_nothing(subject: Subject) -> None:
    subject.say(PLACE)
    now = subject.now()
    one, other = subject.tracker.pose(now), subject.tracker.pose(now)
    assert (one.t, one.valid, one.p.tolist(), one.R_SR.tolist()) == (
        other.t, other.valid, other.p.tolist(), other.R_SR.tolist(),
    )  # fmt: skip


def test_the_last_word_counts_not_the_present_one_time_and_again(subject: Subject) -> None:
    """Poses that it has given out stay as they were: an estimator may keep them."""
    subject.say(PLACE)
    kept = subject.tracker.pose(subject.now())
    subject.say((0.0, 0.0, 0.06))
    subject.tracker.pose(subject.now())
    assert kept.p == pytest.approx(PLACE, abs=1e-8)


@pytest.mark.parametrize("name", [name for name in SUBJECTS if name not in ("pointer", "replay")])
def test_prediction_ends_after_its_time(name: str, tmp_path: Path) -> None:
    subject = SUBJECTS[name](tmp_path)
    for k in range(12):
        subject.say((0.001 * k, 0.0, 0.05))
        time.sleep(0.004)
    last = subject.tracker.pose(subject.now())
    assert 0.02 < last.v[0] < 0.3
    far = subject.tracker.pose(last.t + 100.0)
    assert far.t == last.t
    assert far.p[0] - 0.011 == pytest.approx(PREDICTION * last.v[0], rel=1e-6)
    assert subject.tracker.pose(last.t).p[0] == pytest.approx(0.011, abs=1e-7)
    subject.close()


@pytest.mark.parametrize("name", ["osc", "lsl", "natnet"])
@pytest.mark.parametrize(
    ("p", "q", "why"),
    [
        ((np.nan, 0.0, 0.05), (0, 0, 0, 1), "not_finite"),
        ((0.0, np.inf, 0.05), (0, 0, 0, 1), "not_finite"),
        ((0.0, 0.0, 0.05), (0, 0, np.nan, 1), "not_finite"),
        ((0.0, 0.0, 50.0), (0, 0, 0, 1), "too_far"),
        ((0.0, 0.0, 0.05), (0, 0, 0, 0), "no_rotation"),
        ((0.0, 0.0, 0.05), (0, 0, 3, 4), "no_rotation"),
    ],
)
def test_poses_that_cannot_be_are_refused_and_counted(name: str, p: Any, q: Any, why: str, tmp_path: Path) -> None:
    subject = SUBJECTS[name](tmp_path)
    subject.say(PLACE)
    before = subject.tracker.pose(subject.now())
    subject.say(p, q)
    after = subject.tracker.pose(subject.now())
    assert subject.pose_filter is not None
    assert dict(subject.pose_filter.refused) == {why: 1}
    assert after.t == before.t  # not even a sign of life
    assert after.p == pytest.approx(PLACE, abs=1e-8)
    subject.close()


def test_what_comes_late_is_refused(tmp_path: Path) -> None:
    osc = Osc(tmp_path)
    late = osc.message("/haptorb/pose", 0.0, 0.0, 0.07, 0.0, 0.0, 0.0, 1.0, 1.0)
    osc.send(osc.message("/haptorb/pose", 0.0, 0.0, 0.05, 0.0, 0.0, 0.0, 1.0, 1.001))
    osc.send(late)
    osc.send(late)
    assert osc.pose_filter is not None
    assert osc.pose_filter.refused["out_of_order"] == 2
    assert osc.tracker.pose(osc.now()).p[2] == pytest.approx(0.05)
    osc.close()
    natnet = NatNet(tmp_path)
    natnet.send(natnet_frame((0, 0, 0.05), (0, 0, 0, 1), 5.0))
    natnet.send(natnet_frame((0, 0, 0.07), (0, 0, 0, 1), 4.99))
    assert natnet.pose_filter is not None
    assert natnet.pose_filter.refused["out_of_order"] == 1
    natnet.close()


@pytest.mark.parametrize("name", [name for name in SUBJECTS if name != "replay"])
def test_a_tracker_that_falls_silent_ramps_down_latches_and_waits_for_a_person(name: str, tmp_path: Path) -> None:
    """The contract of the product, through the whole chain, in the loop's own time."""
    subject = SUBJECTS[name](tmp_path)
    omni = load("omni")
    dt = 1e-3
    tick = assemble(RunConfig(device=omni, world=find_world("dome")(), rate=1.0 / dt), subject.tracker)
    layout, row = tick.layout, tick.layout.empty()
    at, slope, took = np.array([0.0, 0.0, 0.049]), [], 0.0
    with tick.driver:
        subject.say(at)
        start = subject.now()
        subject.tracker.origin = start  # the loop's clock begins now, and runs as fast as it is computed
        for n in range(700):
            now = n * dt
            if n % 10 == 0 and n < 500:
                begin = subject.now()
                subject.tracker.origin = begin - now
                subject.say(at)
                took = subject.now() - begin
                subject.tracker.origin = begin + took - now
            tick.step(row, now)
            slope.append((row[layout["guard"]][0], row[layout["gain"]][0], np.abs(row[layout["duty_applied"]]).max()))
        states = np.array(slope)
        assert (states[450:500, 0] == GuardState.RUNNING).all()
        assert states[450:500, 2].min() > 0.0
        tripped = int(np.argmax(states[:, 0] == GuardState.TRIPPED))
        assert 540 - took / dt <= tripped <= 552  # 50 ms after the last word, which took so long to be said
        assert row[layout["trip"]][0] == Trip.POSE_EXPIRED
        down = states[tripped : tripped + 60, 1]
        assert (np.diff(down) <= 0).all()  # ramps
        assert 0.0 < down[25] < 1.0
        assert states[tripped + 60 :, 2].max() == 0.0
        for n in range(700, 800):  # the tracker is back; the coils are not
            now = n * dt
            subject.tracker.origin = subject.now() - now
            if n % 10 == 0:
                subject.say(at)
                subject.tracker.origin = subject.now() - now
            tick.step(row, now)
            assert row[layout["guard"]][0] == GuardState.TRIPPED
            assert not row[layout["duty_applied"]].any()
        assert tick.engage()
        subject.tracker.origin = subject.now() - 0.8
        subject.say(at)
        tick.step(row, 0.8)
        assert row[layout["guard"]][0] == GuardState.RAMPING
    subject.close()
