"""A sender's clock: delays are detected, invalid time stamps ignored, and no pose is in the future."""

import random
import socket
from time import monotonic
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pythonosc.osc_message_builder import OscMessageBuilder

from haptorb.runtime.shared_memory import WORDS, PoseBlock
from haptorb.runtime.trackers import lsl_feed
from haptorb.runtime.trackers.base import RawPose
from haptorb.runtime.trackers.osc_feed import OscFeed
from haptorb.runtime.trackers.pose_filter import PoseFilter
from haptorb.runtime.trackers.sender_clock import SenderClock


def test_a_senders_clock_shows_what_was_held_up() -> None:
    clock = SenderClock()
    draw = random.Random(3)
    late = []
    for k in range(4000):
        sent = 0.01 * k
        delay = 0.002 + (0.03 if draw.random() < 0.05 else 0.0)
        arrival = 500.0 + sent * (1 + 50e-6) + delay  # a clock that loses 50 µs a second
        late.append((delay - 0.002, arrival - clock.stamp(sent, arrival)))
    true, seen = np.array(late).T
    assert np.abs(seen - true).max() < 1.1e-3
    assert seen.min() >= 0.0
    restarted = clock.stamp(0.0, 541.0)  # the sender began again, its clock at zero
    assert restarted == 541.0


@pytest.mark.parametrize("sent", [1e13, -1e13, 7.2e16, 1e300])
def test_a_number_too_great_to_tell_time_makes_a_pose_as_old_as_its_arrival(sent: float) -> None:
    clock = SenderClock()
    for k in range(50):
        arrival = 100.0 + 1.0003e-2 * k
        assert clock.stamp(sent + 0.01 * k, arrival) == arrival


@pytest.mark.parametrize("origin", [0.0, 1.7e9, 3.9e9, -2.2e9])  # a program's start, 1970, 1900; a clock set back
def test_clocks_that_count_from_long_ago_are_believed(origin: float) -> None:
    clock = SenderClock()
    clock.stamp(origin, 100.0)
    assert clock.stamp(origin + 0.01, 100.03) == pytest.approx(100.01, abs=1e-5)


@given(st.lists(st.tuples(st.floats(-1e12, 1e12), st.floats(0.0, 0.3)), min_size=1, max_size=20))
def test_no_pose_was_measured_after_it_came(sent: list[tuple[float, float]]) -> None:
    clock, arrival = SenderClock(), 1000.0
    for time, gap in sent:
        arrival += gap
        assert clock.stamp(time, arrival) <= arrival


@pytest.mark.parametrize(
    ("origin", "used"), [(1.7e9, False), (10 * 86400.0, False), (86400.0, False), (60.0, True)]
)  # Unix time, ten days and a day of uptime, a program that has just begun
def test_a_time_of_four_bytes_is_a_clock_only_while_it_tells_a_tenth_of_a_millisecond(
    origin: float, used: bool
) -> None:
    feed = OscFeed(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
    memory = memoryview(bytearray(8 * WORDS))
    pose_filter = PoseFilter(feed, PoseBlock(memory.cast("q"), memory.cast("d"), 0))
    with feed._socket:
        for k in range(250):
            builder = OscMessageBuilder("/haptorb/pose")
            for value in (1e-5 * k, 0.0, 0.052, 0.0, 0.0, 0.0, 1.0, origin + 0.004 * k):
                builder.add_arg(value, "f")
            for one in feed.read(builder.build().dgram, 1000.0 + 0.004 * k):
                assert isinstance(one, RawPose)
                pose_filter._accept(one)
    assert pose_filter.accepted == 250
    assert ("time of arrival" in pose_filter.facts()["remark"]) is not used


def test_different_poses_with_one_time_have_none() -> None:
    """A stamp that is rounded to 10 ms, at 250 Hz: none of the poses is older than the one before."""
    clock, stamps = SenderClock(), []
    for k in range(100):
        stamps.append(clock.stamp(round(0.004 * k, 2), 100.0 + 0.004 * k, changed=True))
    assert stamps[10:] == [100.0 + 0.004 * k for k in range(10, 100)]
    assert "same time" in clock.remark
    assert clock.stamp(0.0, 200.0, changed=True) == 200.0  # after a silence it is another sender's
    assert clock.remark == ""


def test_a_pose_that_is_sent_twice_leaves_the_clock_as_it_is() -> None:
    clock = SenderClock()
    for k in range(100):
        for copy in range(3):
            clock.stamp(0.01 * k, 100.0 + 0.01 * k + 0.001 * copy, changed=copy == 0)
    assert clock.remark == ""


class Inlet:
    """A stream of the layer on a clock that is moved by hand; `samples`: when each arrives, and its sender's time."""

    def __init__(self) -> None:
        self.now, self.samples, self.k = 1000.0, list[tuple[float, float]](), 0
        self.stopped = 0.0  #: how long the next read is stopped

    def pull_sample(self, timeout: float) -> tuple[list[float] | None, float]:
        arrival = self.samples[0][0] if self.samples else float("inf")
        ready = arrival <= self.now + timeout
        self.now = (max(self.now, arrival) if ready else self.now + timeout) + self.stopped + 1e-5
        self.stopped = 0.0
        if not ready:
            return None, 0.0
        self.k += 1
        return [1e-6 * self.k, 0.0, 0.05, 0.0, 0.0, 0.0, 1.0], self.samples.pop(0)[1]

    def close_stream(self) -> None:
        pass


@pytest.mark.parametrize("where", ["between reads", "in a read", "before the layer has taken the first"])
@pytest.mark.parametrize("clock", ["rounded", "of this computer", "another"])
def test_what_waited_in_a_stream_is_never_newer_than_it_is(
    monkeypatch: pytest.MonkeyPatch, clock: str, where: str
) -> None:
    inlet = Inlet()
    monkeypatch.setattr(lsl_feed, "monotonic", lambda: inlet.now)
    monkeypatch.setattr(lsl_feed, "lsl_stream", lambda name: None)
    monkeypatch.setattr(lsl_feed, "_open_inlet", lambda stream: inlet)
    monkeypatch.setattr(lsl_feed, "StreamWatch", lambda name: SimpleNamespace(poll=list))
    feed = lsl_feed.LslFeed("poses")

    def add(at: float, least: float = 0.0) -> None:
        inlet.samples.append((max(at, least), {"rounded": round(at, 1), "another": at - 700.0}.get(clock, at)))

    def read(end: float) -> list[RawPose]:
        found: list[RawPose] = []
        while inlet.now < end:
            found += [one for one in feed.receive(0.05) if isinstance(one, RawPose)]
        return found

    for k in range(100):
        add(inlet.now + 0.004 * k)
    assert all(one.stamp <= one.arrival <= inlet.now for one in read(1000.5))
    stopped, resumed = inlet.now, inlet.now + 1.6
    queued = [stopped + 0.005 + 0.03 * k for k in range(50)]
    for at in queued:
        add(at, resumed + 0.005 if where == "before the layer has taken the first" else 0.0)
    if where == "between reads":
        inlet.now = resumed
    else:
        inlet.stopped = 1.6
    found = read(resumed + 0.1)
    assert len(found) == len(queued)
    for one, at in zip(found, queued, strict=True):
        assert one.stamp <= at + 1e-4
        assert one.stamp <= one.arrival <= inlet.now
        assert one.stamp == pytest.approx(at if clock == "of this computer" else stopped, abs=0.03)
    for k in range(20):
        add(inlet.now + 0.004 * k)
    fresh = read(inlet.now + 0.2)
    assert [one.arrival - one.stamp for one in fresh] == pytest.approx([0.0] * 20, abs=0.06)  # rounded to 0.1 s


def test_a_stream_on_another_clock_is_compared_and_said(monkeypatch: pytest.MonkeyPatch) -> None:
    inlet = SimpleNamespace(samples=[], close_stream=lambda: None)
    inlet.pull_sample = lambda timeout: inlet.samples.pop(0) if inlet.samples else (None, None)
    monkeypatch.setattr(lsl_feed, "lsl_stream", lambda name: None)
    monkeypatch.setattr(lsl_feed, "_open_inlet", lambda stream: inlet)
    monkeypatch.setattr(lsl_feed, "StreamWatch", lambda name: SimpleNamespace(poll=list))
    feed = lsl_feed.LslFeed("poses")
    for offset, said in ((0.0, ""), (-2400.0, "2400.0 s")):
        inlet.samples.append(([0.0, 0.0, 0.05, 0.0, 0.0, 0.0, 1.0], monotonic() + offset))
        (one,) = feed.receive(0.0)
        assert isinstance(one, RawPose)
        assert 0.0 <= one.arrival - one.stamp < 0.05
        assert (said in feed.remark) if said else feed.remark == ""
