"""A host that was stopped is told from one that computes, and from a computer that stood still."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator

import pytest

from haptorb.runtime.host_life import FROZEN, LATE, SILENCE, HostLife, processor_time

MS = 1_000_000


def heard(used: Callable[[int], int], *, every: int = 1, urgent: bool = True) -> tuple[int, str]:
    """After how much silence [ms] the host is taken for dead, and why; `used` gives its processor time at a time [ms].

    Somebody looks `every` so many milliseconds.
    """
    now = [0]
    life = HostLife(lambda: used(now[0]))
    for now[0] in range(int(LATE * 1e3), 1000, every):
        if why := life.trouble(now[0] * MS, now[0] * MS, urgent=urgent):
            return now[0], why
    raise AssertionError("never")


def test_a_host_that_stands_still_is_dead_soon() -> None:
    after, why = heard(lambda at: 5)
    assert after == pytest.approx(1e3 * FROZEN, abs=2)
    assert "stopped" in why


def test_a_host_that_is_gone_is_dead_soon() -> None:
    after, _ = heard(lambda at: -1)
    assert after == pytest.approx(1e3 * FROZEN, abs=2)


def test_a_host_that_computes_has_more_time() -> None:
    after, why = heard(lambda at: at // 20)
    assert after == pytest.approx(1e3 * SILENCE, abs=2)
    assert "no sign of life" in why


def test_where_the_heart_is_not_urgent_it_has_more_time() -> None:
    after, _ = heard(lambda at: 5, urgent=False)
    assert after == pytest.approx(1e3 * SILENCE, abs=2)


def test_who_was_held_up_himself_does_not_accuse_the_host_of_it() -> None:
    after, _ = heard(lambda at: 5, every=70)  # of 70 ms in which nobody looked, 25 ms count
    assert 1e3 * FROZEN + 50 < after < 1e3 * SILENCE


@pytest.fixture
def idler() -> Iterator[subprocess.Popen[bytes]]:
    """A process that wakes every few milliseconds."""
    code = "import time\nwhile True: time.sleep(0.005)"
    with subprocess.Popen([sys.executable, "-c", code]) as process:
        try:
            yield process
        finally:
            process.kill()


def test_the_kernel_counts_a_processs_time_until_it_is_stopped(idler: subprocess.Popen[bytes]) -> None:
    used = processor_time(idler.pid)
    before = used()
    while used() == before:
        pass
    idler.send_signal(signal.SIGSTOP)
    os.waitid(os.P_PID, idler.pid, os.WSTOPPED)
    stopped = used()
    assert stopped > before
    assert {used() for _ in range(1000)} == {stopped}
    idler.kill()
    idler.wait()
    assert used() == -1
