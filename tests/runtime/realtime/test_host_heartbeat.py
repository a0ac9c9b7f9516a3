"""A host that was stopped is told from one that computes, and from a computer that stood still."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator

import pytest

from haptorb.runtime.realtime.host_heartbeat import LATE, SILENCE, STOPPED, HostHeartbeat, state_of

MS = 1_000_000


def listen(state: Callable[[int], str]) -> tuple[int, str]:
    """After how much silence [ms] the host is taken for dead, and why; `state` gives its state at a time [ms]."""
    now = [0]
    life = HostHeartbeat(lambda: state(now[0]))
    for now[0] in range(int(LATE * 1e3), 1000):
        if why := life.explain_silence(now[0] * MS, now[0] * MS):
            return now[0], why
    raise AssertionError("never")


@pytest.mark.parametrize("state", ["T", "t"])
def test_a_host_that_was_stopped_is_dead_soon(state: str) -> None:
    after, why = listen(lambda at: state)
    assert after == pytest.approx(1e3 * STOPPED, abs=5)
    assert "stopped" in why


@pytest.mark.parametrize("state", ["R", "S", "D", "X", ""])
def test_a_host_that_is_busy_or_waits_has_more_time(state: str) -> None:
    after, why = listen(lambda at: state)
    assert after == pytest.approx(1e3 * SILENCE, abs=2)
    assert "did not respond" in why


def test_a_host_that_is_stopped_while_it_is_late_is_dead_at_once() -> None:
    after, _ = listen(lambda at: "T" if at > 300 else "S")
    assert after == pytest.approx(300, abs=7)


@pytest.fixture
def idler() -> Iterator[subprocess.Popen[bytes]]:
    """A process that wakes every few milliseconds."""
    code = "import time\nwhile True: time.sleep(0.005)"
    with subprocess.Popen([sys.executable, "-c", code]) as process:
        try:
            yield process
        finally:
            process.kill()


def test_the_kernel_knows_whether_a_process_is_stopped(idler: subprocess.Popen[bytes]) -> None:
    state = state_of(idler.pid)
    assert state() in "RSD"
    idler.send_signal(signal.SIGSTOP)
    os.waitid(os.P_PID, idler.pid, os.WSTOPPED)
    assert state() == "T"
    idler.kill()
    idler.wait()
    assert state() == "X"
    assert state_of(idler.pid)() == ""
