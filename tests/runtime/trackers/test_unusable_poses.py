"""Undocumented behaviour of senders: unusable poses and times are counted, named, or harmless."""

from __future__ import annotations

import socket
import struct
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from pythonosc.osc_message_builder import OscMessageBuilder

from haptorb.control.trip_reasons import Trip
from haptorb.runtime.trackers.base import Feed, RawPose
from haptorb.runtime.trackers.natnet_feed import NatNetFeed
from haptorb.runtime.trackers.osc_feed import OscFeed
from haptorb.runtime.trackers.pose_filter import PoseFilter, describe_missing_pose, describe_trip

sys.path.insert(0, str(Path(__file__).parents[2] / "contracts"))
from trackers import SUBJECTS, UPRIGHT, FeedSubject, block

COUNT = 100


def receive(feed: Feed, packets: Sequence[bytes], read: Callable[[bytes, float], list[object]]) -> PoseFilter:
    """What becomes of `packets`, 4 ms apart."""
    pose_filter = PoseFilter(feed, block())
    for k, packet in enumerate(packets):
        for one in read(packet, 1000.0 + 0.004 * k):
            if isinstance(one, RawPose):
                pose_filter._accept(one)
            else:
                pose_filter.refused[one.why] += 1  # type: ignore[attr-defined]
    feed.close()
    return pose_filter


def receive_osc(messages: Sequence[Sequence[tuple[float, str]]]) -> PoseFilter:
    packets = []
    for message in messages:
        builder = OscMessageBuilder("/haptorb/pose")
        for value, kind in message:
            builder.add_arg(value, kind)
        packets.append(builder.build().dgram)
    feed = OscFeed(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
    return receive(feed, packets, lambda packet, arrival: list(feed.read(packet, arrival)))


@pytest.mark.parametrize(
    ("place", "turn", "said"),
    [
        ((0.0, 0.0, 52.0), (0.0, 0.0, 0.0, 1.0), "millimetres instead of metres?"),
        ((0.0, 0.0, 0.052), (0.0, 0.0, 0.0, 0.0), "a quaternion whose length is not 1"),
        ((float("nan"), 0.0, 0.052), (0.0, 0.0, 0.0, 1.0), "not finite"),
    ],
)
def test_poses_that_are_all_refused_are_counted_with_the_reason(
    place: tuple[float, ...], turn: tuple[float, ...], said: str
) -> None:
    facts = receive_osc([[(value, "f") for value in (*place, *turn)]] * COUNT).facts()
    for text in (describe_missing_pose("osc:9109", facts), describe_trip(Trip.POSE_EXPIRED, "osc:9109", facts)):
        assert f"{COUNT} refused" in text
        assert said in text


@pytest.mark.parametrize(
    ("number", "kind"),
    [
        (lambda k: int(1.7e9 + 0.004 * k), "i"),  # whole seconds
        (lambda k: int(1e3 * (1.7e9 + 0.004 * k)), "h"),  # milliseconds
        (lambda k: int(1e6 * (1.7e9 + 0.004 * k)), "h"),  # microseconds
        (lambda k: 1e3 * (60.0 + 0.004 * k), "d"),
        (lambda k: k, "i"),  # a counter
        (lambda k: 0.0, "d"),
    ],
)
def test_a_number_that_is_no_time_in_seconds_costs_no_pose_and_makes_none_old(
    number: Callable[[int], float], kind: str
) -> None:
    messages = [
        [*((value, "f") for value in (1e-5 * k, 0.0, 0.052, 0.0, 0.0, 0.0, 1.0)), (number(k), kind)]
        for k in range(COUNT)
    ]
    received = receive_osc(messages)
    assert received.accepted >= COUNT - 2
    assert received._block.read_pose().stamp == pytest.approx(1000.0 + 0.004 * (COUNT - 1), abs=1e-9)


def compose_frame(version: tuple[int, int], bodies: Sequence[int], stamp: float, *, tracked: bool = True) -> bytes:
    """A frame of NatNet 2.6 to 3.1, as its specification orders the bytes."""
    content = struct.pack("<3I", 1, 0, 0)  # number, marker sets, markers
    content += struct.pack("<I", len(bodies))
    for body in bodies:
        content += struct.pack("<I3f4f", body, 1e-5 * stamp, 0.0, 0.05, *UPRIGHT)
        content += (b"" if version >= (3, 0) else struct.pack("<I", 0)) + struct.pack("<fH", 1e-4, int(tracked))
    content += struct.pack("<2I", 0, 0)  # skeletons, labelled markers
    content += bytes(4 * (version >= (2, 9))) + bytes(4 * (version >= (2, 11)))  # force plates, devices
    content += b"" if version >= (3, 0) else struct.pack("<f", 0.008)  # latency
    content += struct.pack("<2I", 0, 0) + struct.pack("<d" if version >= (2, 7) else "<f", stamp)
    content += (struct.pack("<3Q", 0, 0, 0) if version >= (3, 0) else b"") + struct.pack("<HI", 0, 0)  # end
    return struct.pack("<HH", 7, len(content)) + content


def receive_frames(frames: Sequence[bytes], version: tuple[int, int], body: int = 0) -> PoseFilter:
    feed = NatNetFeed(socket.socket(socket.AF_INET, socket.SOCK_DGRAM), version, body)
    return receive(feed, frames, lambda packet, arrival: [feed.read(packet, arrival)])


@pytest.mark.parametrize(
    ("bodies", "body", "tracked", "said"),
    [
        ((3, 8), 0, True, "several rigid bodies, 3, 8: name one"),
        ((), 0, True, "no rigid body"),
        ((3, 8), 5, True, "no rigid body 5; it streams 3, 8"),
        ((3, 8), 8, False, "rigid body 8 is not tracked"),
    ],
)
def test_why_a_server_gives_no_pose_is_said(bodies: Sequence[int], body: int, tracked: bool, said: str) -> None:
    frames = [compose_frame((3, 1), bodies, 0.004 * k, tracked=tracked) for k in range(COUNT)]
    received = receive_frames(frames, (3, 1), body)
    assert received.accepted == 0
    assert said in describe_missing_pose("natnet:192.0.2.1", received.facts())


@pytest.mark.parametrize(
    ("version", "since", "used"),
    [((2, 6), 60.0, True), ((2, 6), 4 * 3600.0, False), ((2, 10), 4 * 3600.0, True), ((3, 1), 4 * 3600.0, True)],
)
def test_a_server_before_2_7_tells_no_time_after_some_hours(version: tuple[int, int], since: float, used: bool) -> None:
    received = receive_frames([compose_frame(version, (7,), since + 0.004 * k) for k in range(COUNT)], version)
    assert received.accepted == COUNT
    assert ("time of arrival" in received.facts()["remark"]) is not used
    # without a delay, the measurement is as old as the fastest arrival
    assert received._block.read_pose().stamp == pytest.approx(1000.0 + 0.004 * (COUNT - 1), abs=1e-4)


@pytest.mark.parametrize("name", ["osc", "lsl", "natnet"])
def test_receiving_waits_no_longer_than_asked(name: str, tmp_path: Path) -> None:
    """Also while nobody sends, and when the sender has gone: the expiry of a pose is some ten milliseconds."""
    subject = SUBJECTS[name](tmp_path)
    assert isinstance(subject, FeedSubject)
    feed = subject._feed

    def measure() -> float:
        begin = time.monotonic()
        list(feed.receive(0.005))
        return time.monotonic() - begin

    try:
        subject.say((0.0, 0.0, 0.05))
        assert min(measure() for _ in range(5)) < 0.03  # the least of five: others use the processor too
        if name == "lsl":
            del subject._outlet  # type: ignore[attr-defined]
            assert min(measure() for _ in range(5)) < 0.03
    finally:
        subject.close()
