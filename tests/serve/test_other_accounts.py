"""Another account of this computer, on loopback: it moves no coil, reads no pose, and sends no tracker pose."""

from __future__ import annotations

import json
import os
import socket
import threading
import time
from contextlib import ExitStack, suppress
from pathlib import Path

import pytest
from pythonosc.osc_message_builder import OscMessageBuilder
from websockets.sync.client import connect

from haptorb.runtime.trackers.osc_feed import OscFeed
from haptorb.serve import foxglove
from haptorb.serve.osc import OscSession
from haptorb.worlds import Dome, Remote
from oracles.other_account import as_nobody, needs_root
from serve.published_loop import PublishedLoop

PUSH = json.dumps({"inverse3": [{"device_id": "0", "commands": {"set_cursor_force": {"vector": {"x": 0.4}}}}]})


def message(address, *values):
    builder = OscMessageBuilder(address)
    for value in values:
        builder.add_arg(value)
    return builder.build().dgram


def report(path, deed):
    """For a process of another account: what `deed` returned, or why not, into the file."""

    def run():
        try:
            text = f"got {deed()!r}"
        except BaseException as cause:
            text = f"failed {cause!r}"
        Path(path).write_text(text)

    return run


@pytest.fixture
def said():
    """A file that another account may write."""
    folder = Path("/tmp") / f"haptorb-nobody-{os.getpid()}-{time.monotonic_ns()}"
    folder.mkdir(mode=0o777)
    folder.chmod(0o777)
    yield folder / "said"
    for one in folder.iterdir():
        one.unlink()
    folder.rmdir()


def await_text(path):
    end = time.monotonic() + 60.0
    while not (path.exists() and path.read_text()) and time.monotonic() < end:
        time.sleep(0.02)
    return path.read_text()


@needs_root
def test_haply_commands_nothing_and_shows_nothing(bench, port, said):
    def push():
        with connect(f"ws://127.0.0.1:{port}") as client:
            client.send(PUSH)
            return client.recv()

    with as_nobody(report(said, push)):
        assert "403" in await_text(said)
    assert bench.read_client()["session"] == 0
    with connect(f"ws://127.0.0.1:{port}") as client:  # this account does
        client.recv()
        client.send(PUSH)
        client.recv()
    assert bench.read_client()["session"] != 0


@needs_root
def test_a_haply_client_of_another_account_that_has_the_token_may(bench, said, monkeypatch):
    from haptorb.serve.haply import prepare, serve

    monkeypatch.setenv("HAPTORB_SERVE_TOKEN", "a-token-for-another-account")
    preparation = prepare("0:0")
    number = int(preparation.address.split(",")[0].rpartition(":")[2])
    thread = threading.Thread(target=serve, args=(preparation.spec, list(preparation.descriptors), bench.served))
    thread.start()
    try:

        def look():
            with connect(f"ws://127.0.0.1:{number}/?token=a-token-for-another-account") as client:
                return "inverse3" in client.recv()

        with as_nobody(report(said, look)):
            assert await_text(said) == "got True"
    finally:
        bench.served.ending = True
        thread.join(10.0)


@needs_root
def test_osc_commands_nothing_and_a_port_that_passed_to_another_account_reads_nothing(said):
    with PublishedLoop(Dome() + Remote()) as loop:
        opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        opened.bind(("127.0.0.1", 0))
        session, address = OscSession(opened, loop.served), opened.getsockname()

        def push():
            sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            sender.settimeout(20.0)
            sender.sendto(message("/haptorb/force", 1.0, 0.0, 0.0), address)
            sender.sendto(message("/haptorb/subscribe"), address)
            return sender.recv(4096)

        with as_nobody(report(said, push)):
            end = time.monotonic() + 60.0
            while not said.exists() and time.monotonic() < end:
                session.read_messages()
                loop.publish(10)
                session.send(loop.served.read_rows())
                time.sleep(0.01)
            assert "/haptorb/error" in await_text(said)
            assert loop.receive()[1] == 0
        said.unlink()

        own = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        own.bind(("127.0.0.1", 0))
        own.settimeout(10.0)
        port = own.getsockname()[1]
        own.sendto(message("/haptorb/subscribe"), address)
        session.read_messages()
        assert own.recv(4096)
        loop.publish(100)
        session.send(loop.served.read_rows())
        assert own.recv(4096).startswith(b"#bundle")
        own.close()

        def read():
            taken = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            taken.bind(("127.0.0.1", port))
            taken.settimeout(1.0)
            return taken.recv(4096)

        with as_nobody(report(said, read)):
            end = time.monotonic() + 60.0
            while not said.exists() and time.monotonic() < end:
                loop.publish(100)
                session.send(loop.served.read_rows())
                time.sleep(0.01)
            assert "imeout" in await_text(said)
        session.close()


@needs_root
def test_the_port_of_osc_is_never_another_accounts(said):
    with PublishedLoop(Dome() + Remote()) as loop:
        opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        opened.bind(("127.0.0.1", 0))
        session, address = OscSession(opened, loop.served), opened.getsockname()
        ways = [(socket.SO_REUSEADDR,), (socket.SO_REUSEPORT,), (socket.SO_REUSEADDR, socket.SO_REUSEPORT)]

        def take():
            said.with_name("begun").touch()
            for n in range(20_000):
                with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as thief:
                    for option in ways[n % 3]:
                        thief.setsockopt(socket.SOL_SOCKET, option, 1)
                    with suppress(OSError):
                        thief.bind((("127.0.0.1", "0.0.0.0")[n % 2], address[1]))
                        return "the port"
            return "nothing"

        with ExitStack() as stack, as_nobody(report(said, take)):
            while not said.with_name("begun").exists():
                time.sleep(0.001)
            for _ in range(25):
                program = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
                program.sendto(message("/haptorb/subscribe"), address)
                session.read_messages()
                time.sleep(0.002)
            assert await_text(said) == "got 'nothing'"
            assert len(session.sockets) == 26
        session.close()


@needs_root
def test_a_tracker_believes_no_other_account():
    opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    opened.bind(("127.0.0.1", 0))
    feed, address = OscFeed(opened), opened.getsockname()
    pose = message("/haptorb/pose", 0.0, 0.0, 0.05, 0.0, 0.0, 0.0, 1.0)

    def send():
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            for _ in range(50):
                sender.sendto(pose, address)
                time.sleep(0.01)
            time.sleep(30)

    with as_nobody(send):
        found = list(feed.receive(20.0))
        assert found
        assert {one.why for one in found} == {"another_account"}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        list(feed.receive(0.0))
        sender.sendto(pose, address)
        assert [one.p for one in feed.receive(10.0)] == [pytest.approx((0.0, 0.0, 0.05))]
        sender.sendto(pose, address)
    assert [one.why for one in feed.receive(10.0)] == ["another_account"]  # its port is nobody's
    feed.close()


@needs_root
def test_who_shares_a_port_and_is_gone_before_anybody_looks_says_not_where_the_tool_is():
    """A program of this account that lets others bind its port (SO_REUSEADDR) does not vouch for what came from it."""
    opened, mine = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    opened.bind(("127.0.0.1", 0))
    mine.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    mine.bind(("127.0.0.1", 0))
    feed, address, port = OscFeed(opened), opened.getsockname(), mine.getsockname()[1]
    pose = message("/haptorb/pose", 0.0, 0.0, 0.05, 0.0, 0.0, 0.0, 1.0)

    def send():
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
            other.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            other.bind(("127.0.0.1", port))
            other.sendto(pose, address)

    with mine, as_nobody(send) as number:
        os.waitid(os.P_PID, number, os.WEXITED | os.WNOWAIT)
        assert [getattr(one, "why", "a pose") for one in feed.receive(10.0)] == ["another_account"]
    feed.close()


@needs_root
def test_foxglove_shows_nothing(said):
    with PublishedLoop(Dome()) as loop:
        _look_at_foxglove(said, loop)


def _look_at_foxglove(said, loop):
    prepared = foxglove.prepare("0")
    number = int(prepared.address.rpartition(":")[2])
    thread = threading.Thread(target=foxglove.serve, args=(prepared.spec, list(prepared.descriptors), loop.served))
    thread.start()
    try:

        def look():
            with connect(f"ws://127.0.0.1:{number}", subprotocols=["foxglove.sdk.v1"]) as client:
                return client.recv()

        assert "serverInfo" in look()
        with as_nobody(report(said, look)):
            assert "403" in await_text(said)
    finally:
        loop.served.ending = True
        thread.join(10.0)


@pytest.mark.parametrize("opening", [1, 2])
def test_a_pose_that_waited_is_as_old_as_its_waiting(opening):
    # The kernel begins to date datagrams when the first program of the computer asks for it; it is asked anew.
    time.sleep(0.1)
    opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    opened.bind(("127.0.0.1", 0))
    feed = OscFeed(opened)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sent = time.monotonic()
        sender.sendto(message("/haptorb/pose", 0.0, 0.0, 0.05, 0.0, 0.0, 0.0, 1.0), opened.getsockname())
        delivered = time.monotonic()  # on loopback a datagram is there when it is sent
        time.sleep(0.1)
        (found,) = feed.receive(1.0)
    assert sent - 2e-3 < found.stamp < delivered + 2e-3
    feed.close()
