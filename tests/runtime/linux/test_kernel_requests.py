"""Real-time requests to the kernel are reported as granted, and to the right process."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from haptorb.runtime.linux import raise_priority


def test_another_process_comes_first_and_not_this_one() -> None:
    mine = os.sched_getscheduler(0)
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as other:
        if not raise_priority(other.pid):
            pytest.skip("this computer grants no real-time scheduler")
        assert os.sched_getscheduler(other.pid) & 0xF == os.SCHED_FIFO
        assert os.sched_getscheduler(0) == mine


def test_who_is_not_there_is_refused() -> None:
    with subprocess.Popen([sys.executable, "-c", ""]) as other:
        pass
    assert not raise_priority(other.pid)
