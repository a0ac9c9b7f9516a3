"""A stopped host is distinguished from a busy one, and from a pause of the whole computer."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator

import pytest

from haptorb.runtime.liveness import (
    HEARTBEAT_TIMEOUT_S,
    LATE_HEARTBEAT_S,
    STARVED_TIMEOUT_S,
    STOPPED_TIMEOUT_S,
    HostHeartbeat,
    ProcessorWait,
    state_of,
)

MS = 1_000_000


def listen(state: Callable[[int], str], starved: Callable[[int], bool] = lambda at: False) -> tuple[int, str]:
    """After how much silence [ms] the host is taken for dead, and why; `state` gives its state at a time [ms], and
    `starved` whether it has waited for a processor then."""
    now = [0]
    life = HostHeartbeat(lambda: state(now[0]), lambda at: starved(at // MS))
    for now[0] in range(int(LATE_HEARTBEAT_S * 1e3), 5000):
        if why := life.explain_silence(now[0] * MS, now[0] * MS):
            return now[0], why
    raise AssertionError("never")


@pytest.mark.parametrize("state", ["T", "t"])
def test_a_host_that_was_stopped_is_dead_soon(state: str) -> None:
    after, why = listen(lambda at: state)
    assert after == pytest.approx(1e3 * STOPPED_TIMEOUT_S, abs=5)
    assert "stopped" in why


@pytest.mark.parametrize("state", ["R", "S", "D", "X", ""])
def test_a_host_that_is_busy_or_waits_has_more_time(state: str) -> None:
    after, why = listen(lambda at: state)
    assert after == pytest.approx(1e3 * HEARTBEAT_TIMEOUT_S, abs=2)
    assert "did not respond" in why


def test_a_host_that_is_stopped_while_it_is_late_is_dead_at_once() -> None:
    after, _ = listen(lambda at: "T" if at > 300 else "S")
    assert after == pytest.approx(300, abs=7)


def test_a_host_that_waits_for_its_turn_has_two_seconds() -> None:
    after, why = listen(lambda at: "R", lambda at: True)
    assert after == pytest.approx(1e3 * STARVED_TIMEOUT_S, abs=2)
    assert "busy" in why


def test_what_a_host_has_waited_for_its_turn_is_added_to_its_time() -> None:
    after, _ = listen(lambda at: "R", lambda at: 200 <= at < 500)
    assert after == pytest.approx(1e3 * HEARTBEAT_TIMEOUT_S + 300, abs=25)
    assert listen(lambda at: "T", lambda at: True)[0] == pytest.approx(1e3 * STOPPED_TIMEOUT_S, abs=5)


def test_every_silence_is_counted_anew() -> None:
    life = HostHeartbeat(lambda: "R", lambda at: at < 800 * MS)
    beats = [0, 700]
    dead = [at for at in range(2000) for beat in [max(one for one in beats if one <= at)]
            if at - beat > 80 and life.explain_silence(at * MS, (at - beat) * MS)]  # fmt: skip
    assert dead[0] == pytest.approx(700 + 1e3 * HEARTBEAT_TIMEOUT_S, abs=45)


def test_the_kernel_knows_who_waits_for_a_processor(idler: subprocess.Popen[bytes]) -> None:
    code = "import os\nos.sched_setaffinity(0, {0})\nprint(flush=True)\nwhile True: pass"
    busy = [subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) for _ in range(5)]
    try:
        for one in busy:
            assert one.stdout is not None
            one.stdout.readline()  # five on one core: each gets a fifth of it
        waits = {one.pid: ProcessorWait(one.pid) for one in (*busy, idler)}
        found: dict[int, list[bool]] = {pid: [] for pid in waits}
        for _ in range(11):
            time.sleep(0.05)
            for pid, wait in waits.items():
                found[pid].append(wait.update(time.monotonic_ns()))
    finally:
        for one in busy:
            one.kill()
            one.communicate()
    assert not any(looks[0] for looks in found.values())
    assert sum(sum(found[one.pid]) for one in busy) > 25, found
    assert sum(found[idler.pid]) < 5, "it sleeps"
    assert not ProcessorWait(busy[0].pid).update(1), "it is gone"


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
