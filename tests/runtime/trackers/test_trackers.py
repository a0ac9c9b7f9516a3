"""Trackers with a process of their own: validated before the start, read by a running servo, fuzzed."""

from __future__ import annotations

import json
import os
import random
import signal
import socket
import struct
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from pythonosc.osc_message_builder import OscMessageBuilder

from haptorb.cli import main
from haptorb.control.trip_reasons import Trip
from haptorb.errors import DriverError, InputError, RecordingError, UnknownName
from haptorb.runtime.servo import Servo
from haptorb.runtime.shared_memory import WORDS, PoseBlock, PoseRecord
from haptorb.runtime.trackers.base import Feed, RawPose, RejectedPose
from haptorb.runtime.trackers.feed_tracker import FeedTracker, check_prediction
from haptorb.runtime.trackers.osc_feed import OscFeed
from haptorb.runtime.trackers.pose_filter import REASONS, PoseFilter, describe_missing_pose, describe_trip
from haptorb.runtime.trackers.registry import TOKEN, check_tracker, prepare_tracker
from haptorb.runtime.trackers.replay import load_poses


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


def message(address: str, *values: Any) -> bytes:
    builder = OscMessageBuilder(address)
    for value in values:
        builder.add_arg(value, "d" if isinstance(value, float) else None)
    data: bytes = builder.build().dgram
    return data


def pose(z: float = 0.05, *time: float) -> bytes:
    return message("/haptorb/pose", 0.0, 0.0, z, 0.0, 0.0, 0.0, 1.0, *time)


@contextmanager
def sending(port: int, every: float = 0.005, make: Any = lambda: pose()) -> Iterator[threading.Event]:
    """A program that sends poses until the event is set."""
    over = threading.Event()

    def send() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
            while not over.wait(every):
                one.sendto(make(), ("127.0.0.1", port))

    thread = threading.Thread(target=send, daemon=True)
    thread.start()
    yield over
    over.set()
    thread.join()


def until(servo: Servo, condition: Any, timeout: float = 20.0) -> None:
    end = time.monotonic() + timeout
    while not condition():
        servo.check()
        assert time.monotonic() < end, "it did not come to pass"
        time.sleep(0.01)


def running(servo: Servo) -> bool:
    """Whether it renders; on a busy computer a first trip is engaged again, as a person would."""
    row, at = servo.latest(), servo.layout
    if row[at["guard"]][0] == 4 and row[at["valid"]][0] == 1.0 and row[at["age"]][0] < 0.05:
        servo.engage()
    return bool(row[at["valid"]][0] == 1.0 and row[at["gain"]][0] > 0.5)


# names


@pytest.mark.parametrize(
    ("name", "error", "told"),
    [
        ("osx:9000", UnknownName, "osc:PORT"),
        ("osc", UnknownName, "osc:PORT"),
        ("osc:", InputError, "from 1 to 65535"),
        ("osc:0", InputError, "from 1 to 65535"),
        ("osc:70000", InputError, "from 1 to 65535"),
        ("osc:there:here", InputError, "from 1 to 65535"),
        ("lsl:", InputError, "name of a stream"),
        ("replay:", InputError, "recording"),
        ("natnet:", InputError, "natnet:HOST"),
        ("natnet:here/hand", InputError, "streaming id"),
        ("natnet:here:x", InputError, "port"),
    ],
)
def test_a_name_that_is_none_says_what_was_expected(name: str, error: type[Exception], told: str) -> None:
    with pytest.raises(error, match=told):
        Servo("omni", tracker=name)


def test_a_replay_never_moves_a_real_device() -> None:
    with pytest.raises(InputError, match="driver sim"):
        check_tracker("replay:run.mcap", "serial:/dev/ttyACM0")
    assert check_tracker("replay:run.mcap") == "replay:run.mcap"


@pytest.mark.parametrize("milliseconds", [-1.0, 20.1, float("nan"), float("inf")])
def test_prediction_has_bounds(milliseconds: float) -> None:
    with pytest.raises(InputError, match="0 to 20 ms"):
        check_prediction(1e-3 * milliseconds)


def test_what_is_not_there_is_told_before_anything_starts(tmp_path: Path) -> None:
    record = tmp_path / "run.mcap"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        with pytest.raises(DriverError, match=rf"UDP port {port}: .*in use.*another port"):
            Servo("omni", tracker=f"osc:{port}", record=record).open()
    with pytest.raises(DriverError, match="no host"):
        prepare_tracker("osc:no.such.host.invalid:9000")
    with pytest.raises(DriverError, match="address of this computer"):
        prepare_tracker("osc:192.0.2.7:9000")
    with pytest.raises(RecordingError, match="No such file"):
        Servo("omni", tracker=f"replay:{tmp_path / 'none.mcap'}", record=record).open()
    (tmp_path / "text.mcap").write_text("no recording")
    with pytest.raises(RecordingError, match="not an MCAP file"):
        prepare_tracker(f"replay:{tmp_path / 'text.mcap'}")
    with pytest.raises(DriverError, match="no NatNet server"):
        prepare_tracker(f"natnet:127.0.0.1:{free_port()}")
    assert not record.exists()


def test_a_stream_that_is_not_there_is_told() -> None:
    from haptorb.runtime.trackers.lsl_feed import lsl_stream

    with pytest.raises(DriverError, match=r"no stream 'nobody'.*start its program"):
        lsl_stream("nobody", 0.3)


def test_the_command_says_it_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "--headless", "--duration", "1", "--tracker", "replay:nowhere.mcap"]) == 2
    said = capsys.readouterr().err
    assert "haptorb: recording nowhere.mcap: cannot be read" in said
    assert "Traceback" not in said


def test_a_package_that_is_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "pythonosc", None)
    with pytest.raises(DriverError, match=r"haptorb\[trackers\]"):
        prepare_tracker("osc:9000")


def test_beyond_this_computer_only_with_a_token(monkeypatch: pytest.MonkeyPatch) -> None:
    here = prepare_tracker(f"osc:{free_port()}")
    assert here.token == ""
    with socket.socket(fileno=os.dup(here.descriptor)) as bound:
        assert bound.getsockname()[0] == "127.0.0.1"
    here.close()
    there = prepare_tracker(f"osc:0.0.0.0:{free_port()}")
    other = prepare_tracker(f"osc:0.0.0.0:{free_port()}")
    assert len(there.token) >= 16
    assert there.token != other.token
    there.close()
    other.close()
    monkeypatch.setenv(TOKEN, "short")
    with pytest.raises(InputError, match="at least 16"):
        prepare_tracker(f"osc:0.0.0.0:{free_port()}")
    monkeypatch.setenv(TOKEN, "a word of one's own")
    chosen = prepare_tracker(f"osc:0.0.0.0:{free_port()}")
    assert chosen.token == "a word of one's own"
    chosen.close()


# what is heard


_FEEDS: list[OscFeed] = []


def feed(token: str = "") -> OscFeed:
    _FEEDS.append(OscFeed(socket.socket(socket.AF_INET, socket.SOCK_DGRAM), token))
    return _FEEDS[-1]


@pytest.fixture(autouse=True)
def closed() -> Iterator[None]:
    """Every feed of a test is closed, also when the test fails."""
    yield
    while _FEEDS:
        _FEEDS.pop().close()


def test_the_token_comes_first_or_nothing_is_heard() -> None:
    one = feed("a word of one's own")
    good = message("/haptorb/pose", "a word of one's own", 0.0, 0.0, 0.05, 0.0, 0.0, 0.0, 1.0)
    assert isinstance(next(one.read(good, 1.0)), RawPose)
    for bad in (
        pose(),
        message("/haptorb/lost"),
        message("/haptorb/pose", "another word", 0.0, 0.0, 0.05, 0.0, 0.0, 0.0, 1.0),
        message("/haptorb/pose", 0.0, "a word of one's own", 0.0, 0.05, 0.0, 0.0, 0.0, 1.0),
    ):
        assert list(one.read(bad, 1.0)) == [RejectedPose("stranger")]
    one.close()


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"hello",
        b"\0" * 2000,
        message("/other", 1.0),
        message("/haptorb/pose"),
        message("/haptorb/pose", 1.0, 2.0),
        message("/haptorb/pose", *([0.0] * 9)),
        message("/haptorb/pose", "0", "0", "0", "0", "0", "0", "1"),
        message("/haptorb/pose", 0.0, 0.0, 0.05, 0.0, 0.0, 0.0, True),
        message("/haptorb/lost", "why"),
    ],
)
def test_what_has_not_the_layout_is_garbage(data: bytes) -> None:
    one = feed()
    assert list(one.read(data, 1.0)) == [RejectedPose("garbage")]
    one.close()


def test_integers_floats_and_bundles_are_understood() -> None:
    from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder

    bundle = OscBundleBuilder(IMMEDIATELY)
    for z in (0.05, 0.06):
        builder = OscMessageBuilder("/haptorb/pose")
        for value, kind in ((0, "i"), (0, "h"), (z, "f"), (0, "i"), (0, "i"), (0, "i"), (1.0, "d")):
            builder.add_arg(value, kind)
        bundle.add_content(builder.build())
    one = feed()
    heard = list(one.read(bundle.build().dgram, 1.0))
    assert [round(h.p[2], 6) for h in heard if isinstance(h, RawPose)] == [0.05, 0.06]
    one.close()


class ScriptFeed(Feed):
    """A feed that says what the test wants."""

    def __init__(self) -> None:
        self.next: list[RawPose | RejectedPose] = []

    def receive(self, timeout: float) -> Iterator[RawPose | RejectedPose]:
        while self.next:
            yield self.next.pop(0)

    def close(self) -> None:
        return


def open_reception(feed: Feed) -> tuple[PoseFilter, PoseBlock]:
    memory = memoryview(bytearray(8 * WORDS))
    block = PoseBlock(memory.cast("q"), memory.cast("d"), 0)
    return PoseFilter(feed, block), block


def sound(told: PoseRecord) -> bool:
    """What may reach the loop at all."""
    numbers = np.concatenate([told.p, told.q, told.v, told.w])
    return bool(
        np.isfinite(numbers).all()
        and np.linalg.norm(told.p) <= 5.0
        and abs(np.linalg.norm(told.q) - 1.0) < 1e-9
        and np.linalg.norm(told.v) <= 3.0 + 1e-9
        and np.linalg.norm(told.w) <= 30.0 + 1e-9
    )


NUMBERS = st.floats(width=64) | st.floats(-0.1, 0.1) | st.sampled_from([0.0, 1.0, -1.0, 1e308, 5e-324])


@given(st.lists(st.lists(NUMBERS, min_size=7, max_size=8), max_size=20), st.lists(st.floats(0, 0.3), min_size=20))
@example([[0.0] * 6 + [1.0, 7.2e16]], [0.0] * 20)
def test_whatever_numbers_are_sent_only_poses_reach_the_loop(sent: list[list[float]], gaps: list[float]) -> None:
    one, arrival = feed(), 1000.0
    told = ScriptFeed()
    pose_filter, block = open_reception(told)
    last = float("-inf")
    for numbers, gap in zip(sent, gaps, strict=False):
        arrival += gap
        told.next = list(one.read(message("/haptorb/pose", *numbers), arrival))
        pose_filter.listen(0.0)
        now = block.read_pose()
        assert sound(now)
        assert now.stamp <= arrival
        assert now.stamp >= last or gap > 0.25
        last = now.stamp
    assert pose_filter.accepted + sum(pose_filter.refused.values()) == min(len(sent), len(gaps))
    assert set(pose_filter.refused) <= set(REASONS)
    one.close()


@given(st.binary(max_size=200))
def test_whatever_bytes_are_sent_nothing_breaks(data: bytes) -> None:
    one = feed()
    for found in one.read(data, 1.0):
        assert isinstance(found, RejectedPose)
    one.close()


def test_twenty_thousand_mutated_messages() -> None:
    """Bytes flipped, cut and doubled in messages of the right layout: counted, never believed when they cannot be."""
    draw, one, told = random.Random(7), feed(), ScriptFeed()
    pose_filter, block = open_reception(told)
    good = pose(0.05, 1.0)
    count = 20_000
    for k in range(count):
        data = bytearray(good)
        for _ in range(draw.randint(1, 4)):
            what = draw.random()
            at = draw.randrange(len(data)) if data else 0
            if what < 0.6 and data:
                data[at] = draw.randrange(256)
            elif what < 0.8:
                del data[at:]
            else:
                data += data[: draw.randrange(40)]
        told.next = list(one.read(bytes(data), 1000.0 + 1e-3 * k))
        pose_filter.listen(0.0)
        assert sound(block.read_pose())
    assert pose_filter.accepted > 100  # it was listening all the time
    assert sum(pose_filter.refused.values()) > 1000
    one.close()


def test_frames_of_natnet_that_are_cut_or_flipped_are_garbage() -> None:
    import sys

    sys.path.insert(0, str(Path(__file__).parents[2] / "contracts"))
    from trackers import natnet_frame

    from haptorb.runtime.trackers.natnet_feed import NatNetFeed

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as nobody:
        one = NatNetFeed(nobody, (3, 1), 7)
        good = natnet_frame((0, 0, 0.05), (0, 0, 0, 1), 1.0)
        assert isinstance(one.read(good, 1.0), RawPose)
        for length in range(4, len(good) - 1):
            found = one.read(good[:length], 1.0)
            assert isinstance(found, RejectedPose) or not found.valid or length >= len(good) - 2
        other = one.read(natnet_frame((0, 0, 0.05), (0, 0, 0, 1), 2.0, body=3), 2.0)
        assert isinstance(other, RawPose)
        assert not other.valid  # another body is not the tool
        assert one.remark == "the server has no rigid body 7; it streams 3"
        one.read(natnet_frame((0, 0, 0.05), (0, 0, 0, 1), 3.0, tracked=False), 3.0)
        assert one.remark == "rigid body 7 is not tracked now"
        one.read(good, 4.0)
        assert one.remark == ""


def test_what_came_instead_of_poses_is_said() -> None:
    one = feed()
    pose_filter, _ = open_reception(one)
    for n in range(3):
        for told in one.read(message("/tracking/trackers/1/position", 0.1 * n, 0.0, 0.05), 100.0 + n):
            assert isinstance(told, RejectedPose)
            pose_filter.refused[told.why] += 1
    said = describe_trip(Trip.POSE_EXPIRED, "osc:9109", pose_filter.facts())
    assert "3 refused" in said
    assert "/tracking/trackers/1/position" in said
    assert "/haptorb/pose" in said
    assert "/haptorb/pose" in describe_missing_pose("osc:9109", pose_filter.facts())


def test_velocity_is_that_of_the_poses_and_a_jump_has_none() -> None:
    told = ScriptFeed()
    pose_filter, block = open_reception(told)

    def say(t: float, x: float, angle: float = 0.0) -> PoseRecord:
        q = (0.0, 0.0, float(np.sin(angle / 2)), float(np.cos(angle / 2)))
        told.next = [RawPose((x, 0.0, 0.05), q, t, t)]
        pose_filter.listen(0.0)
        return block.read_pose()

    for k in range(40):
        last = say(0.005 * k, 0.0005 * k, 0.01 * k)
    assert last.v == pytest.approx([0.1, 0, 0], rel=1e-3)
    assert last.w == pytest.approx([0, 0, 2.0], rel=1e-3)
    assert say(0.4, 0.05).v.tolist() == [0, 0, 0]  # after a gap nobody knows
    assert pose_filter.facts()["gaps"] == 1
    assert pose_filter.facts()["refused"] == {}


def path(pose_filter: PoseFilter, told: ScriptFeed, block: PoseBlock, poses: Any) -> list[bool]:
    """Whether the tool is known after each of (time, x, angle about z, time of arrival if it is another)."""
    known = []
    for t, x, angle, *arrival in poses:
        told.next = [
            RawPose(
                (x, 0.0, 0.05), (0.0, 0.0, float(np.sin(angle / 2)), float(np.cos(angle / 2))), t, *(arrival or [t])
            )
        ]
        pose_filter.listen(0.0)
        known.append(block.read_pose().valid)
    return known


def quietly(begin: float, n: int, x: float = 0.0, angle: float = 0.0) -> list[tuple[float, float, float]]:
    return [(begin + 0.01 * k, x, angle) for k in range(n)]


@pytest.mark.parametrize("jump", [{"x": 0.05}, {"x": -1.0}, {"angle": 0.5}, {"angle": 3.1}])
def test_a_jump_counts_as_lost_until_the_poses_agree(jump: dict[str, float]) -> None:
    told = ScriptFeed()
    pose_filter, block = open_reception(told)
    assert path(pose_filter, told, block, quietly(10.0, 10)) == [True] * 10
    known = path(pose_filter, told, block, quietly(10.1, 10, **jump))
    assert known == [False] * 5 + [True] * 5, "five poses, 50 ms apart from first to last, agree with each other"
    assert pose_filter.refused == {"jump": 5}
    assert pose_filter.lost == 1
    assert not block.read_pose().v.any()
    assert block.read_pose().p[0] == jump.get("x", 0.0)


def test_one_wrong_pose_loses_the_tool_and_is_never_believed() -> None:
    told = ScriptFeed()
    pose_filter, block = open_reception(told)
    assert all(path(pose_filter, told, block, quietly(10.0, 10)))
    assert path(pose_filter, told, block, [(10.1, 0.2, 0.0)]) == [False]
    assert block.read_pose().p[0] == 0.0
    assert path(pose_filter, told, block, quietly(10.11, 7)) == [False] * 5 + [True] * 2


def test_two_tools_in_turns_are_none() -> None:
    told = ScriptFeed()
    pose_filter, block = open_reception(told)
    mixed = [(10.0 + 0.005 * k, 0.04 * (k % 2), 0.0) for k in range(200)]
    assert path(pose_filter, told, block, mixed) == [True] + [False] * 199
    assert pose_filter.accepted == 1


def test_a_quick_hand_a_burst_and_a_pause_are_no_jumps() -> None:
    told = ScriptFeed()
    pose_filter, block = open_reception(told)
    quick = [(10.0 + 0.01 * k, 0.028 * k, 0.28 * k) for k in range(50)]  # 2.8 m/s, 28 rad/s
    waited = [(11.0 + 1e-5 * k, 1.372 + 0.02 * k, 13.72) for k in range(4)]  # 2 m/s at 100 Hz, held up on the way
    later = [(12.0, 0.2, 0.0)]
    stamped = [(12.0 + 0.01 * k, 0.2 + 0.02 * k, 0.0, 12.2 + 1e-5 * k) for k in range(1, 5)]
    assert all(path(pose_filter, told, block, [*quick, *waited, *later, *stamped]))
    assert pose_filter.refused == {}


def test_a_tool_that_was_lost_may_be_found_anywhere() -> None:
    told = ScriptFeed()
    pose_filter, block = open_reception(told)
    assert all(path(pose_filter, told, block, quietly(10.0, 5)))
    told.next = [RawPose((), (), 10.05, 10.05, False)]
    pose_filter.listen(0.0)
    assert not block.read_pose().valid
    assert path(pose_filter, told, block, quietly(10.06, 3, x=1.0)) == [True] * 3


def test_another_sender_is_not_heard() -> None:
    one, told = feed(), ScriptFeed()
    pose_filter, block = open_reception(told)

    def say(sender: object, z: float, t: float, *sent: float) -> PoseRecord:
        told.next = list(one.read(pose(z, *sent), t, sender))
        pose_filter.listen(0.0)
        return block.read_pose()

    assert say(("127.0.0.1", 5), 0.05, 10.0, 1.0).valid
    for k in range(1, 100):
        assert say(("127.0.0.1", 6), 0.052, 10.0 + 0.01 * k, 900.0 + k).p[2] == pytest.approx(0.05)
        mine = say(("127.0.0.1", 5), 0.05, 10.002 + 0.01 * k, 1.002 + 0.01 * k)
        assert mine.valid
        assert mine.stamp == pytest.approx(10.002 + 0.01 * k), "a stranger's clock is not compared, either"
    assert pose_filter.refused == {"another_sender": 99}
    # It is silent for two seconds: then another may take its place, but only through a loss that the guard sees.
    assert say(("127.0.0.1", 6), 0.052, 12.9).p[2] == pytest.approx(0.05)
    assert not say(("127.0.0.1", 6), 0.052, 13.1).valid
    assert not say(("127.0.0.1", 6), 0.052, 13.14).valid
    assert say(("127.0.0.1", 6), 0.052, 13.16).p[2] == pytest.approx(0.052)
    assert say(("127.0.0.1", 6), 0.052, 13.17).valid
    assert say(("127.0.0.1", 5), 0.05, 13.18).p[2] == pytest.approx(0.052)


def test_whose_words_make_no_sense_takes_nobodys_place() -> None:
    one = feed("a word of one's own")
    assert list(one.read(pose(), 1.0, "stranger")) == [RejectedPose("stranger")]
    assert list(one.read(b"hello", 1.0, "hello")) == [RejectedPose("garbage")]
    mine = message("/haptorb/pose", "a word of one's own", 0.0, 0.0, 0.05, 0.0, 0.0, 0.0, 1.0)
    assert isinstance(next(one.read(mine, 1.1, "me")), RawPose)


def test_a_damaged_block_is_not_waited_for() -> None:
    memory = memoryview(bytearray(8 * WORDS))
    words = memory.cast("q")
    block = PoseBlock(words, memory.cast("d"), 0)
    block.write(PoseRecord(True, np.array([0, 0, 0.05]), np.array([0, 0, 0, 1.0]), np.zeros(3), np.zeros(3), 1.0))
    assert block.read_pose().p[2] == 0.05
    words[0] |= 1  # its writer died in the middle
    words[5] = -1
    assert block.read_pose().p[2] == 0.05
    tracker = FeedTracker(block)
    assert tracker.pose(2.0).t == 1.0  # and grows old


# a recording played again


def test_a_recording_is_played_pose_by_pose(tmp_path: Path) -> None:
    import sys

    sys.path.insert(0, str(Path(__file__).parents[2] / "contracts"))
    from trackers import recording

    ticks = []
    for n in range(300):
        t = 1e-3 * n
        measured = 1e-3 * (n - n % 10)  # a tracker of 100 Hz
        valid = not 150 <= n < 170
        ticks.append((t, t - measured, (1e-4 * (n // 10), 0.0, 0.05), valid))
    rows = load_poses(recording(tmp_path / "a.mcap", ticks))
    assert len(rows) == 15 + 1 + 13  # poses, the loss, poses
    valid = rows[rows[:, 9] == 1.0]
    assert valid[:, 1] == pytest.approx(1e-3 * np.r_[0:150:10, 170:300:10])
    assert (valid[:, 0] >= valid[:, 1]).all()
    assert rows[15, 9] == 0.0
    nothing = [(1e-3 * n, 0.0, (0.0, 0.0, 0.05), False) for n in range(30)]
    with pytest.raises(DriverError, match="no valid pose"):
        load_poses(recording(tmp_path / "b.mcap", nothing))


# through a running servo


@pytest.mark.realtime
@pytest.mark.usefixtures("quick_starts")
def test_osc_through_a_running_servo(tmp_path: Path) -> None:
    port = free_port()
    with sending(port) as over, Servo("omni", tracker=f"osc:{port}", record=tmp_path / "run.mcap") as servo:
        at = servo.layout
        until(servo, lambda: running(servo))
        assert servo.latest()[at["hand_goal"]] == pytest.approx([0, 0, 0.05], abs=1e-6)
        servo.run(1.5)
        poses = servo.report()["tracking"]
        assert poses["accepted"] > 20
        assert poses["rate_hz"] > 10
        assert 0 <= poses["latency_ms"]["p50"] <= poses["latency_ms"]["p99"]
        assert 0 <= poses["age_ms"]["p50"] <= poses["age_ms"]["p99"]
        assert poses["jitter_ms"] >= 0
        json.dumps(servo.report())
        over.set()
        until(servo, lambda: servo.latest()[at["guard"]][0] == 4)
        until(servo, lambda: not servo.latest()[at["duty_applied"]].any())
    assert servo.report()["trips"][-1]["code"] == "POSE_EXPIRED"
    # and what was recorded is a tracker again
    with Servo("omni", tracker=f"replay:{tmp_path / 'run.mcap'}", record=False) as again:
        until(again, lambda: running(again))
        assert again.latest()[at["hand_goal"]] == pytest.approx([0, 0, 0.05], abs=1e-6)
        assert again.report()["tracking"]["poses_hz"] > 10


@pytest.mark.realtime
@pytest.mark.usefixtures("quick_starts")
def test_a_trackers_process_that_dies_is_a_lost_tracker_with_a_reason() -> None:
    port = free_port()
    with sending(port), Servo("omni", tracker=f"osc:{port}", record=False) as servo:
        at = servo.layout
        until(servo, lambda: running(servo))
        tracker = servo._children._tracker
        os.kill(tracker.pid, signal.SIGKILL)
        until(servo, lambda: servo.latest()[at["guard"]][0] == 4 and not servo.latest()[at["duty_applied"]].any())
        until(servo, lambda: "tracker_trouble" in servo.report())
        assert "SIGKILL" in servo.report()["tracker_trouble"]
        assert servo.alive


@pytest.mark.realtime
@pytest.mark.usefixtures("quick_starts")
def test_a_flood_of_messages_takes_neither_the_loop_nor_the_computer() -> None:
    port = free_port()
    with Servo("omni", tracker=f"osc:{port}", record=False) as servo:
        tracker = servo._children._tracker
        end = time.monotonic() + 1.5
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
            data = message("/haptorb/pose", 1.0)  # no pose: garbage
            while time.monotonic() < end:
                one.sendto(data, ("127.0.0.1", port))
        until(servo, lambda: servo.report()["tracking"].get("refused", {}).get("garbage", 0) > 1000)
        assert os.sched_getscheduler(tracker.pid) & 0xF == os.SCHED_OTHER
        assert servo.alive
        assert servo.report()["tracking"]["accepted"] == 0
        before = servo.report()["ticks"]
        until(servo, lambda: servo.report()["ticks"] > before + 50)


@pytest.mark.realtime
@pytest.mark.usefixtures("quick_starts")
def test_the_trackers_process_ends_with_the_servo() -> None:
    port = free_port()
    servo = Servo("omni", tracker=f"osc:{port}", record=False)
    servo.open()
    tracker = servo._children._tracker
    servo.close()
    assert tracker.poll() == 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as again:
        again.bind(("127.0.0.1", port))  # and its port is free


def test_struct_is_the_layout_of_the_document(root: Path) -> None:
    """The example bytes in the guide are what the feed understands."""
    data = b"/haptorb/pose\0\0\0,fffffff\0\0\0\0" + struct.pack(">7f", 0, 0, 0.05, 0, 0, 0, 1)
    one = feed()
    (heard,) = one.read(data, 2.0)
    assert isinstance(heard, RawPose)
    assert heard.stamp == 2.0
    one.close()
    guide = (root / "docs/how-to/tracker.md").read_text()
    assert "/haptorb/pose" in guide
    assert "/haptorb/lost" in guide
    for reason in REASONS:
        assert reason.replace("_", " ") in guide
