"""A process that waits for a processor is distinguished from one that waits for something else."""

from __future__ import annotations

import os
import subprocess
import sys
import time

import pytest

from haptorb.runtime.liveness import HangWatch, StarvedTime

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")


def test_two_that_share_a_processor_wait_for_each_other_and_a_sleeper_does_not() -> None:
    one = min(os.sched_getaffinity(0))
    program = f"import os; os.sched_setaffinity(0, {{{one}}})\nwhile True: pass"
    start = time.monotonic()
    busy = [subprocess.Popen([sys.executable, "-S", "-c", program]) for _ in range(3)]
    sleeper = subprocess.Popen([sys.executable, "-S", "-c", "import time; time.sleep(60)"])
    try:
        time.sleep(0.5)
        starved, idle, hang = StarvedTime(busy[0].pid), StarvedTime(sleeper.pid), HangWatch(busy[0].pid)
        before, resting, begin = starved.read(), idle.read(), time.monotonic()
        while (waited := starved.read() - before) < 0.5 and time.monotonic() < begin + 30.0:
            hung = hang.update()
            time.sleep(0.05)
        # The kernel adds a wait when it is over: a part may have begun before the first look.
        assert 0.5 <= waited < time.monotonic() - start
        assert idle.read() - resting < 0.5 * waited
        assert hung < 1.0
    finally:
        for process in (*busy, sleeper):
            process.kill()
            process.wait()
