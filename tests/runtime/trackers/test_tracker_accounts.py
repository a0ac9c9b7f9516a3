"""Attacks on a tracker by another account: on its token, its server's port, its stream."""

from __future__ import annotations

import socket
import time
from contextlib import suppress
from pathlib import Path

import pytest

from contracts.trackers import natnet_frame
from haptorb.errors import DriverError
from haptorb.runtime.servo import Servo
from haptorb.runtime.trackers.base import RejectedPose
from oracles.other_account import as_nobody, needs_root

TOKEN = "a-token-that-nobody-else-may-read"
UPRIGHT = (0.0, 0.0, 0.0, 1.0)


def open_port():
    opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    opened.bind(("127.0.0.1", 0))
    return opened


def find_in_arguments(word):
    """The command lines of this computer's processes with `word` in them: every account can read those."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            line = (process / "cmdline").read_bytes()
            if word.encode() in line:
                found.append(line)
    return found


@pytest.mark.realtime
def test_no_token_stands_in_the_process_list(monkeypatch):
    """With processes that are started, not forked: a forked one has the command line of its parent."""
    monkeypatch.setenv("HAPTORB_TRACKER_TOKEN", TOKEN)
    with open_port() as free:
        port = free.getsockname()[1]
    with Servo("omni", tracker=f"osc:0.0.0.0:{port}", record=False) as servo:
        assert servo.tracker_token == TOKEN
        assert find_in_arguments(TOKEN) == []
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:  # the tracker has it all the same
            end = time.monotonic() + 30.0
            while not servo.report()["tracking"].get("accepted") and time.monotonic() < end:
                sender.sendto(_pose(TOKEN), ("127.0.0.1", port))
                time.sleep(0.05)
        assert servo.report()["tracking"].get("accepted")


def _pose(token):
    from pythonosc.osc_message_builder import OscMessageBuilder

    builder = OscMessageBuilder("/haptorb/pose")
    for value in (token, 0.0, 0.0, 0.055, *UPRIGHT):
        builder.add_arg(value)
    return builder.build().dgram


@needs_root
def test_who_takes_the_port_of_a_natnet_server_says_nothing():
    from haptorb.runtime.trackers.natnet_feed import NatNetFeed

    server, own = open_port(), open_port()
    own.connect(server.getsockname())
    port, feed = server.getsockname()[1], NatNetFeed(own, (3, 1), 7)
    frame = natnet_frame((0.0, 0.0, 0.055), UPRIGHT, 1.0)
    server.sendto(frame, own.getsockname())
    (pose,) = feed.receive(10.0)
    assert not isinstance(pose, RejectedPose)
    target = own.getsockname()
    server.close()

    def send():
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
            taken.bind(("127.0.0.1", port))
            for _ in range(20):
                taken.sendto(frame, target)
                time.sleep(0.02)
            time.sleep(30)

    with as_nobody(send):
        found, end = [], time.monotonic() + 20.0
        while not found and time.monotonic() < end:
            found = list(feed.receive(1.0))
        assert {getattr(one, "why", "") for one in found} == {"another_account"}
    feed.close()


@needs_root
def test_a_stream_of_another_account_is_not_used():
    import pylsl

    from haptorb.runtime.trackers.lsl_feed import THIS_COMPUTER, lsl_stream

    name = f"poses-{time.monotonic_ns()}"
    pylsl.set_config_content(THIS_COMPUTER)

    def publish():
        outlet = pylsl.StreamOutlet(pylsl.StreamInfo(name, "Pose", 7, 100, "double64", "one"))
        while True:
            outlet.push_sample([0.0, 0.0, 0.055, *UPRIGHT])
            time.sleep(0.01)

    with as_nobody(publish), pytest.raises(DriverError, match="another account"):
        lsl_stream(name, 20.0)
    outlet = pylsl.StreamOutlet(pylsl.StreamInfo(name, "Pose", 7, 100, "double64", "one"))
    assert lsl_stream(name, 20.0).name() == name
    del outlet
