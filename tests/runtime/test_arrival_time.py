"""The age of a message includes its time in the socket."""

from __future__ import annotations

import socket
import time

import pytest

from haptorb.runtime import sockets
from haptorb.runtime.sockets import DatagramTimes, StreamTimes

WAIT = 0.3


@pytest.fixture
def opened():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as made:
        made.bind(("127.0.0.1", 0))
        DatagramTimes.watch(made)
        _wait_for_stamps(made)
        yield made


def _wait_for_stamps(made):
    """The kernel begins to stamp some milliseconds after the first socket of the computer asks for it."""
    for _ in range(200):
        made.sendto(b"first", made.getsockname())
        if made.recvmsg(64, DatagramTimes.room)[1]:
            return
        time.sleep(0.005)
    pytest.fail("no datagram is stamped")


def read(opened, times):
    times.begin_batch()
    return times.find(opened.recvmsg(64, DatagramTimes.room)[1])


def test_a_datagram_is_dated_by_its_arrival(opened):
    times = DatagramTimes()
    sent = time.monotonic()
    opened.sendto(b"old", opened.getsockname())
    time.sleep(WAIT)
    assert read(opened, times) == pytest.approx(sent, abs=0.1)
    now = time.monotonic()
    opened.sendto(b"new", opened.getsockname())
    assert read(opened, times) == pytest.approx(now, abs=0.1)


@pytest.mark.parametrize("step", [3600.0, -3600.0, 1.0, -1.0])
def test_a_clock_that_was_set_meanwhile_makes_nothing_new(opened, monkeypatch, step):
    times = DatagramTimes()
    times.begin_batch()
    looked = time.monotonic()
    opened.sendto(b"old", opened.getsockname())
    time.sleep(WAIT)
    real = sockets.time_ns
    monkeypatch.setattr(sockets, "time_ns", lambda: real() + int(step * 1e9))
    assert read(opened, times) <= looked + 0.1


def test_a_stream_that_waited_is_old_until_it_has_been_empty():
    first, second = socket.socketpair()
    with first, second:
        times = StreamTimes()
        first.send(b"0123456789")
        times.wait(5.0)
        second.recv(4)
        assert times.find(second.fileno(), 8.0) == 5.0
        first.send(b"more")  # what the sender had still to send
        second.recv(8)
        times.wait(8.0)
        assert times.find(second.fileno(), 8.1) == 5.0
        second.recv(8)
        assert times.find(second.fileno(), 8.2) == 5.0  # the last of it
        first.send(b"new")
        second.recv(8)
        assert times.find(second.fileno(), 8.3) == 8.3
