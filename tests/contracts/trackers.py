"""All trackers with a simulated hand: test tools to send a pose and to lose it."""

from __future__ import annotations

import socket
import struct
import time
from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from haptorb.devices.loader import load
from haptorb.recording.mcap import Recorder
from haptorb.recording.row import RowLayout
from haptorb.runtime.pointer import PointerTracker
from haptorb.runtime.shared_memory import WORDS, HandGoalSource, HostHandGoal, PoseBlock
from haptorb.runtime.trackers.base import Feed, Tracker
from haptorb.runtime.trackers.feed_tracker import FeedTracker
from haptorb.runtime.trackers.pose_filter import PoseFilter

UPRIGHT = (0.0, 0.0, 0.0, 1.0)


def block() -> PoseBlock:
    memory = memoryview(bytearray(8 * WORDS))
    return PoseBlock(memory.cast("q"), memory.cast("d"), 0)


class Subject(ABC):
    """A tracker and its hand. `say` returns when the tracker has had the chance to hear."""

    tracker: Tracker
    pose_filter: PoseFilter | None = None

    @abstractmethod
    def say(self, p: Sequence[float], q: Sequence[float] = UPRIGHT) -> None:
        """The tool is there now."""

    @abstractmethod
    def lose(self) -> None:
        """The tracker no longer sees it."""

    def close(self) -> None:
        """Nothing is left open."""
        return

    def now(self) -> float:
        return time.monotonic()


class Pointer(Subject, HandGoalSource):
    """The console's pointer."""

    def __init__(self, tmp_path: Path) -> None:
        self._pointed = HostHandGoal(False, np.zeros(3), np.array(UPRIGHT), 0.0)
        self.tracker = PointerTracker(self)

    def read_hand_goal(self) -> HostHandGoal:
        return self._pointed

    def say(self, p: Sequence[float], q: Sequence[float] = UPRIGHT) -> None:
        self._pointed = HostHandGoal(True, np.array(p, dtype=float), np.array(q, dtype=float), time.monotonic())

    def lose(self) -> None:
        self._pointed = self._pointed._replace(held=False)


class FeedSubject(Subject):
    """A feed in this process, with its pose filter and its block."""

    def __init__(self, feed: Feed) -> None:
        self._feed, self._block = feed, block()
        self.pose_filter = PoseFilter(feed, self._block)
        self.tracker = FeedTracker(self._block)

    def listen(self, before: int, patience: float = 5.0) -> None:
        """Until one more message was taken or refused."""
        pose_filter = self.pose_filter
        assert pose_filter is not None
        end = time.monotonic() + patience
        while self.message_count() == before and time.monotonic() < end:
            pose_filter.listen(0.02)
        assert self.message_count() > before, "nothing was heard"

    def message_count(self) -> int:
        pose_filter = self.pose_filter
        assert pose_filter is not None
        return pose_filter.accepted + pose_filter.lost + sum(pose_filter.refused.values())

    def close(self) -> None:
        self._feed.close()
        self._feed.close()


class Osc(FeedSubject):
    """A program on this computer that sends OSC."""

    def __init__(self, tmp_path: Path, token: str = "") -> None:
        from pythonosc.osc_message_builder import OscMessageBuilder

        from haptorb.runtime.trackers.osc_feed import OscFeed

        self._builder = OscMessageBuilder
        receiving = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        receiving.bind(("127.0.0.1", 0))
        self._sending = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._sending.connect(receiving.getsockname())
        super().__init__(OscFeed(receiving, token))

    def message(self, address: str, *values: Any) -> bytes:
        builder = self._builder(address)
        for value in values:
            builder.add_arg(value, "d" if isinstance(value, float) else None)
        return builder.build().dgram

    def send(self, data: bytes) -> None:
        before = self.message_count()
        self._sending.send(data)
        self.listen(before)

    def say(self, p: Sequence[float], q: Sequence[float] = UPRIGHT) -> None:
        self.send(self.message("/haptorb/pose", *map(float, p), *map(float, q), time.monotonic() - 100.0))

    def lose(self) -> None:
        self.send(self.message("/haptorb/lost", time.monotonic() - 100.0))

    def close(self) -> None:
        self._sending.close()
        super().close()


class Lsl(FeedSubject):
    """A stream of the lab streaming layer, from this very process."""

    def __init__(self, tmp_path: Path, channels: int = 8) -> None:
        from haptorb.runtime.trackers.lsl_feed import LslFeed, _library

        pylsl = _library()
        name = f"haptorb-test-{time.monotonic_ns()}"
        self._outlet = pylsl.StreamOutlet(
            pylsl.StreamInfo(name, "Pose", channels, pylsl.IRREGULAR_RATE, "double64", name)
        )
        super().__init__(LslFeed(name))
        # the stream is joined by the first pull; what was sent before is not for us
        end = time.monotonic() + 10.0
        while not self._outlet.have_consumers() and time.monotonic() < end:
            list(self._feed.receive(0.05))

    def push(self, values: Sequence[float], stamp: float = 0.0) -> None:
        before = self.message_count()
        self._outlet.push_sample([float(x) for x in values], stamp)
        self.listen(before)

    def say(self, p: Sequence[float], q: Sequence[float] = UPRIGHT) -> None:
        self.push([*p, *q, 1.0])

    def lose(self) -> None:
        self.push([0.0] * 8)


def natnet_frame(p: Sequence[float], q: Sequence[float], stamp: float, tracked: bool = True, body: int = 7) -> bytes:
    """One frame of NatNet 3.1 with one rigid body, as its specification orders the bytes."""
    content = struct.pack("<I", 1) + struct.pack("<I", 0) + struct.pack("<I", 0)  # number, marker sets, markers
    content += struct.pack("<I", 1) + struct.pack("<I3f4ffH", body, *p, *q, 1e-4, int(tracked))
    content += struct.pack("<I", 0) * 4  # skeletons, labelled markers, force plates, devices
    content += struct.pack("<IId3QH", 0, 0, stamp, 0, 0, 0, 0)
    return struct.pack("<HH", 7, len(content)) + content


class NatNet(FeedSubject):
    """A server that knows one rigid body."""

    def __init__(self, tmp_path: Path) -> None:
        import threading

        from haptorb.runtime.trackers.natnet_feed import NatNetFeed, natnet_socket

        self._server = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._server.bind(("127.0.0.1", 0))
        self._server.settimeout(5.0)

        def answer() -> None:
            data, self._client = self._server.recvfrom(1024)
            assert data[:2] == b"\0\0"
            info = b"Motive".ljust(256, b"\0") + bytes((2, 0, 0, 0)) + bytes((3, 1, 0, 0))
            self._server.sendto(struct.pack("<HH", 1, len(info)) + info, self._client)

        thread = threading.Thread(target=answer)
        thread.start()
        connected, version = natnet_socket("127.0.0.1", self._server.getsockname()[1])
        thread.join()
        assert version == (3, 1, 0, 0)
        super().__init__(NatNetFeed(connected, version, 7))

    def send(self, data: bytes) -> None:
        before = self.message_count()
        self._server.sendto(data, self._client)
        self.listen(before)

    def say(self, p: Sequence[float], q: Sequence[float] = UPRIGHT) -> None:
        self.send(natnet_frame(p, q, time.monotonic()))

    def lose(self) -> None:
        self.send(natnet_frame((0, 0, 0), UPRIGHT, time.monotonic(), tracked=False))

    def close(self) -> None:
        self._server.close()
        super().close()


def recording(path: Path, told: Sequence[tuple[float, float, Sequence[float], bool]]) -> Path:
    """A recording of the Omni whose ticks are `told`: time, age, place of the hand's wish, valid."""
    layout = RowLayout.of(load("omni"))
    with path.open("wb") as file:
        recorder = Recorder(file, layout, 1000.0, 0)
        rows = np.zeros((len(told), layout.width))
        for row, (t, age, p, valid) in zip(rows, told, strict=True):
            row[layout["t"]], row[layout["wall"]], row[layout["age"]], row[layout["valid"]] = t, t, age, valid
            row[layout["hand_goal"]], row[layout["hand_goal_q"]] = p, UPRIGHT
        recorder.append(rows)
        recorder.finish()
    return path


class Replay(FeedSubject):
    """A recording that is written first: its first tenth of a second has no pose; then every word is one tick."""

    def __init__(self, tmp_path: Path) -> None:
        self._path, self._told = tmp_path / "replayed.mcap", [(0.0, 0.0, (0.0, 0.0, 0.05), True)]
        from haptorb.runtime.trackers.replay import ReplayFeed, load_poses

        self._made, self._played = ReplayFeed, load_poses
        super().__init__(ReplayFeed(np.empty((0, 10)), 0.0))

    def _tell(self, p: Sequence[float], valid: bool) -> None:
        recording(self._path, [(0.0, 0.0, (0.0, 0.0, 0.05), True), (0.5, 0.0, p, valid)])
        self._feed = self._made(self._played(self._path)[1:], time.monotonic() - 0.5)
        pose_filter = self.pose_filter
        assert pose_filter is not None
        pose_filter._feed = self._feed
        before = self.message_count()
        self.listen(before)

    def say(self, p: Sequence[float], q: Sequence[float] = UPRIGHT) -> None:
        self._tell(p, True)

    def lose(self) -> None:
        self._tell((0.0, 0.0, 0.0), False)


SUBJECTS: dict[str, type[Subject]] = {
    "pointer": Pointer, "osc": Osc, "lsl": Lsl, "natnet": NatNet, "replay": Replay,
}  # fmt: skip
