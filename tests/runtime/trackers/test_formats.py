"""Poses in the formats of other programs: decoded as intended, from independent senders.

python-osc sends VRChat and VMC; TUIO bundles are written byte by byte after its specification 1.1.
"""

from __future__ import annotations

import math
import socket
import struct
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder
from pythonosc.osc_message_builder import OscMessageBuilder
from pythonosc.udp_client import SimpleUDPClient
from scipy.spatial.transform import Rotation

from haptorb.errors import InputError, UnknownName
from haptorb.runtime.trackers.base import Feed, RawPose, RejectedPose
from haptorb.runtime.trackers.formats import ConvertedFeed
from haptorb.runtime.trackers.pose_filter import PoseFilter
from haptorb.runtime.trackers.registry import check_tracker, feed_of, prepare_tracker


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


class Listener:
    """A tracker that listens, and what arrives at it."""

    def __init__(self, words: str) -> None:
        self.port = free_port()
        name = check_tracker(f"osc:{self.port},{words}")
        preparation = prepare_tracker(name)
        self.feed = feed_of(preparation.spec, preparation.descriptor, lambda: 0.0)
        self.client = SimpleUDPClient("127.0.0.1", self.port)

    def close(self) -> None:
        self.feed.close()
        self.client._sock.close()

    def take(self, count: int = 1) -> list[RawPose | RejectedPose]:
        found: list[RawPose | RejectedPose] = []
        end = time.monotonic() + 10.0
        while len(found) < count and time.monotonic() < end:
            found += self.feed.receive(0.05)
        return found

    def pose(self) -> tuple[np.ndarray, Rotation]:
        """Place and orientation of the only pose."""
        (one,) = [one for one in self.take() if isinstance(one, RawPose)]
        assert one.valid
        assert one.arrival - one.stamp < 5.0
        return np.array(one.p), Rotation.from_quat(one.q)


@pytest.fixture
def listen() -> Iterator[Callable[[str], Listener]]:
    opened: list[Listener] = []

    def start(words: str) -> Listener:
        opened.append(Listener(words))
        return opened[-1]

    yield start
    for one in opened:
        one.close()


def bundle(*messages: tuple[str, list[object]]) -> bytes:
    made = OscBundleBuilder(IMMEDIATELY)
    for address, values in messages:
        one = OscMessageBuilder(address)
        for value in values:
            one.add_arg(value)
        made.add_content(one.build())
    return bytes(made.build().dgram)


def is_near(found: Rotation, wanted: Rotation) -> bool:
    return float((found * wanted.inv()).magnitude()) < 1e-5


# Unity's axes, of VRChat and VMC: x right, y up, z forward, left-handed. Ours: x right, y forward, z up.


@pytest.mark.parametrize(
    ("angles", "wanted"),
    [
        ((0.0, 0.0, 0.0), Rotation.identity()),
        # a left-handed turn of 90° about the vertical, y, takes forward to right: in our axes a turn by −90° about z
        ((0.0, 90.0, 0.0), Rotation.from_euler("z", -90, degrees=True)),
        # about x (right), left-handed: takes up to forward: in our axes z to y, a turn by −90° about x
        ((90.0, 0.0, 0.0), Rotation.from_euler("x", -90, degrees=True)),
        # about z (forward), left-handed: takes right to up: in our axes x to z, a turn by −90° about y
        ((0.0, 0.0, 90.0), Rotation.from_euler("y", -90, degrees=True)),
        # first z, then x, then y, each about the fixed axes
        (
            (20.0, 30.0, 40.0),
            Rotation.from_euler("z", -30, degrees=True)
            * Rotation.from_euler("x", -20, degrees=True)
            * Rotation.from_euler("y", -40, degrees=True),
        ),
    ],
)
def test_vrchat(angles: tuple[float, float, float], wanted: Rotation, listen: Callable[[str], Listener]) -> None:
    listener = listen("vrchat/1")
    client = listener.client
    client.send_message("/tracking/trackers/1/position", [0.01, 0.05, 0.02])
    client.send_message("/tracking/trackers/1/rotation", list(angles))
    p, turn = listener.pose()
    assert p == pytest.approx([0.01, 0.02, 0.05])
    assert is_near(turn, wanted)


def test_vrchat_with_several_trackers_takes_none_until_one_is_named(listen: Callable[[str], Listener]) -> None:
    listener = listen("vrchat")
    client = listener.client
    for _ in range(2):
        for name in ("2", "head"):
            client.send_message(f"/tracking/trackers/{name}/position", [0.0, 0.05, 0.0])
            client.send_message(f"/tracking/trackers/{name}/rotation", [0.0, 0.0, 0.0])
    found = listener.take(4)
    assert [one.valid for one in found if isinstance(one, RawPose)][1:] == [False, False, False]
    assert "'2', 'head'" in listener.feed.remark
    chosen = listen("vrchat/head")
    client = chosen.client
    client.send_message("/tracking/trackers/2/position", [0.0, 1.0, 0.0])
    assert [one.why for one in chosen.take() if isinstance(one, RejectedPose)] == ["other_message"]
    assert "'head'" in chosen.feed.remark


def test_vmc_among_all_its_other_messages(listen: Callable[[str], Listener]) -> None:
    listener = listen("vmc/stylus")
    half = math.sqrt(0.5)
    data = bundle(
        ("/VMC/Ext/OK", [1]),
        ("/VMC/Ext/Bone/Pos", ["Hips", 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]),
        ("/VMC/Ext/Tra/Pos", ["other", 9.0, 9.0, 9.0, 0.0, 0.0, 0.0, 1.0]),
        ("/VMC/Ext/Tra/Pos", ["stylus", 0.01, 0.05, 0.02, 0.0, half, 0.0, half]),
    )
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.sendto(data, ("127.0.0.1", listener.port))
        (pose,) = [one for one in listener.take(4) if isinstance(one, RawPose)]
    assert pose.p == pytest.approx([0.01, 0.02, 0.05])
    assert is_near(Rotation.from_quat(pose.q), Rotation.from_euler("z", -90, degrees=True))


# TUIO 1.1: a bundle of `alive`, `set` and `fseq`; normalized places, angles in radians, y down.


def osc_string(text: str) -> bytes:
    data = text.encode() + b"\0"
    return data + b"\0" * (-len(data) % 4)


def tuio(profile: str, alive: list[int], sets: list[tuple[int, int, list[float]]], frame: int) -> bytes:
    messages = [osc_string(profile) + osc_string(",ss") + osc_string("source") + osc_string("table@127.0.0.1")]
    messages.append(
        osc_string(profile) + osc_string(",s" + "i" * len(alive)) + osc_string("alive")
        + b"".join(struct.pack(">i", one) for one in alive)
    )  # fmt: skip
    for session, kind, numbers in sets:
        messages.append(
            osc_string(profile) + osc_string(",sii" + "f" * len(numbers)) + osc_string("set")
            + struct.pack(">ii", session, kind) + b"".join(struct.pack(">f", one) for one in numbers)
        )  # fmt: skip
    messages.append(osc_string(profile) + osc_string(",si") + osc_string("fseq") + struct.pack(">i", frame))
    return b"#bundle\0" + struct.pack(">Q", 1) + b"".join(struct.pack(">i", len(one)) + one for one in messages)


def test_tuio_object_moves_rests_and_leaves(listen: Callable[[str], Listener], tmp_path: Path) -> None:
    mapping = tmp_path / "table.toml"
    mapping.write_text('format = "tuio"\nobject = "7"\nunit = "400 mm"\n')
    listener = listen(str(mapping))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        target = ("127.0.0.1", listener.port)
        # session 31 is fiducial 7: right of and below the middle, turned clockwise, as seen on a screen, by 90°
        numbers = [0.6, 0.75, math.pi / 2, 0.0, 0.0, 0.0, 0.0, 0.0]
        sender.sendto(tuio("/tuio/2Dobj", [31, 32], [(31, 7, numbers), (32, 8, numbers)], 1), target)
        p, turn = listener.pose()
        assert p == pytest.approx([0.04, -0.1, 0.0], abs=1e-6)
        assert is_near(turn, Rotation.from_euler("z", -90, degrees=True))
        sender.sendto(tuio("/tuio/2Dobj", [31, 32], [(32, 8, numbers)], 2), target)
        again, _ = listener.pose()
        assert again == pytest.approx(p)
        sender.sendto(tuio("/tuio/2Dobj", [32], [], 3), target)
        (gone,) = listener.take()
        assert isinstance(gone, RawPose)
        assert not gone.valid


def test_tuio_in_three_dimensions_and_several_objects(listen: Callable[[str], Listener]) -> None:
    listener = listen("tuio")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        target = ("127.0.0.1", listener.port)
        numbers = [0.5, 0.5, 0.05, 0.0, 0.0, math.pi / 2, *[0.0] * 8]
        sender.sendto(tuio("/tuio/3Dobj", [1], [(1, 5, numbers)], 1), target)
        p, turn = listener.pose()
        assert p == pytest.approx([0.0, 0.0, 0.05], abs=1e-6)
        assert is_near(turn, Rotation.from_euler("z", -90, degrees=True))
        sender.sendto(tuio("/tuio/3Dobj", [1, 2], [(2, 6, numbers)], 2), target)
        (none,) = listener.take()
        assert isinstance(none, RawPose)
        assert not none.valid
        assert "5, 6" in listener.feed.remark


@pytest.mark.parametrize(
    ("order", "sent"),
    [
        ("ZYX", (30.0, 20.0, 10.0)),
        ("zyx", (30.0, 20.0, 10.0)),
        ("xyz", (10.0, 20.0, 30.0)),
        ("YXZ", (20.0, 10.0, 30.0)),
    ],
)
def test_euler_angles(order: str, sent: tuple[float, ...], listen: Callable[[str], Listener]) -> None:
    listener = listen(f"euler-{order}")
    listener.client.send_message("/haptorb/pose", [0.0, 0.01, 0.05, *sent])
    p, turn = listener.pose()
    assert p == pytest.approx([0.0, 0.01, 0.05])
    single = {"x": 10.0, "y": 20.0, "z": 30.0}
    parts = [Rotation.from_euler(axis, single[axis], degrees=True) for axis in order.lower()]
    # about fixed axes a later turn stands left, about the body's axes right
    wanted = parts[2] * parts[1] * parts[0] if order.islower() else parts[0] * parts[1] * parts[2]
    assert is_near(turn, wanted)


def test_w_first_and_y_up(listen: Callable[[str], Listener]) -> None:
    listener = listen("w-first,y-up")
    half = math.sqrt(0.5)  # 90° about their vertical, y
    listener.client.send_message("/haptorb/pose", [0.01, 0.05, 0.02, half, 0.0, half, 0.0])
    p, turn = listener.pose()
    assert p == pytest.approx([0.01, -0.02, 0.05])
    assert is_near(turn, Rotation.from_euler("z", 90, degrees=True))


def test_a_mapping_file_for_another_program(listen: Callable[[str], Listener], tmp_path: Path) -> None:
    mapping = tmp_path / "mine.toml"
    mapping.write_text("""
lost = "/rig/lost"
object = "pen"
unit = "mm"
axes = ["-y", "x", "z"]
origin = [100.0, 0.0, 0.0]

[[messages]]
address = "/rig/{object}"
values = ["time", "skip", "x", "y", "z", "qw", "qx", "qy", "qz", "valid"]
""")
    listener = listen(str(mapping))
    client = listener.client
    client.send_message("/rig/pen", [1.5, "frame", 110.0, 20.0, 50.0, 1.0, 0.0, 0.0, 0.0, True])
    p, turn = listener.pose()
    assert p == pytest.approx([-0.02, 0.01, 0.05])
    assert is_near(turn, Rotation.identity())
    client.send_message("/rig/pen", [1.6, "frame", 110.0, 20.0, 50.0, 1.0, 0.0, 0.0, 0.0, False])
    client.send_message("/rig/lost", [])
    assert [one.valid for one in listener.take(2) if isinstance(one, RawPose)] == [False, False]
    client.send_message("/rig/pen", [1.5, 2.0])
    assert [one.why for one in listener.take() if isinstance(one, RejectedPose)] == ["garbage"]
    assert "expected 10" in listener.feed.remark


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "messages"),
        ('axes = ["x", "x", "y"]\nformat = "vmc"', "axes"),
        ('unit = "kg"\nformat = "vmc"', "unit"),
        ('[[messages]]\naddress = "/a"\nvalues = ["x", "y", "z"]', "no orientation"),
        ('[[messages]]\naddress = "/a"\nvalues = ["x", "y", "qx", "qy", "qz", "qw"]', "z is in no message"),
        ('[[messages]]\naddress = "/a"\nvalues = ["x", "x", "y", "z", "rx", "ry", "rz"]', "x comes twice"),
        ('[[messages]]\naddress = "/a"\nvalues = ["x", "y", "z", "roll"]', "roll"),
        ("oops", "not a TOML file"),
    ],
)
def test_mistakes_in_a_mapping_file_are_named(text: str, says: str, tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(text)
    with pytest.raises(InputError, match=says):
        check_tracker(f"osc:9000,{tmp_path / 'mine.toml'}")


def test_a_format_of_osc_is_refused_elsewhere_and_an_unknown_order_named() -> None:
    with pytest.raises(InputError, match="osc:PORT,vrchat"):
        check_tracker("lsl:stylus,vrchat")
    with pytest.raises(InputError, match="order of angles"):
        check_tracker("osc:9000,euler-xxy")
    assert check_tracker("natnet:127.0.0.1/1,y-up")


class Sent(Feed):
    """Poses given beforehand."""

    def __init__(self, p: tuple[float, ...], q: tuple[float, ...], seconds: float) -> None:
        self._poses = [RawPose(p, q, 100.0 + 0.01 * n, 100.0 + 0.01 * n) for n in range(int(100 * seconds))]

    def receive(self, timeout: float) -> Iterator[RawPose | RejectedPose]:
        yield from self._poses

    def close(self) -> None:
        pass


class Block:
    def write(self, pose: object) -> None:
        pass


@pytest.mark.parametrize(
    ("p", "q", "conversions", "says"),
    [
        ((0.0, 0.0, 0.05), (0.0, 0.0, 0.0, 1.0), (), ""),
        ((0.0, 0.0, 0.05), (1.0, 0.0, 0.0, 0.0), (), "w-first"),
        ((0.0, 0.0, 0.05), (1.0, 0.0, 0.0, 0.0), ("w-first",), ""),
        ((0.0, 0.05, 0.0), (0.0, 0.0, 0.0, 1.0), (), "y-up"),
        ((0.0, 0.05, 0.0), (0.0, 0.0, 0.0, 1.0), ("y-up",), ""),
    ],
)
def test_another_convention_taken_for_ours_is_noticed_after_a_second(
    p: tuple[float, ...], q: tuple[float, ...], conversions: tuple[str, ...], says: str
) -> None:
    for seconds in (0.9, 1.2):
        pose_filter = PoseFilter(ConvertedFeed(Sent(p, q, seconds), conversions), Block())  # type: ignore[arg-type]
        pose_filter.listen(0.0)
        remark = str(pose_filter.facts()["remark"])
        assert (says in remark) if says and seconds > 1.0 else remark == ""
        assert pose_filter.accepted == int(100 * seconds)


@pytest.mark.parametrize(
    ("tracker", "word", "near"),
    [
        ("osc:9000,vrchats", "vrchats", "vrchat"),
        ("osc:9000,y-up,w_first", "w_first", "w-first"),
        ("natnet:a,zup", "zup", "y-up"),
    ],
)
def test_a_format_that_is_none_is_named_with_the_nearest(tracker: str, word: str, near: str) -> None:
    with pytest.raises(UnknownName, match=f"'{word}'; did you mean '{near}'"):
        check_tracker(tracker)
    assert check_tracker("lsl:pen, left") == "lsl:pen, left"  # a comma may be in the name of a stream
