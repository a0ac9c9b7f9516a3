"""A core that stays awake for the servo, and nobody who pays for it."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from haptorb.runtime.servo import Servo

POLICY = 41 - 1  #: field of /proc/PID/stat, counted from 0


def policies(pid: int) -> list[int]:
    """The scheduling policy of every thread of `pid`."""
    stats = [(task / "stat").read_text() for task in Path(f"/proc/{pid}/task").iterdir()]
    return [int(stat.rpartition(")")[2].split()[POLICY - 2]) for stat in stats]


def test_the_loops_core_is_kept_awake_by_a_thread_behind_all_others() -> None:
    with Servo("omni", "nothing", record=False) as servo:
        servo.run(0.2)
        facts = servo.report()["scheduler"]
        if facts["core"] == -1:
            pytest.skip("this computer grants no real-time scheduler or has one core: nothing is kept awake")
        assert facts["awake"] is True
        found = policies(servo.servo_pid)
        assert found.count(os.SCHED_IDLE) == 1
        assert found.count(os.SCHED_FIFO) >= 1
        pid = servo.servo_pid
    assert not Path(f"/proc/{pid}").exists()


def test_it_ends_with_its_process_and_holds_no_lock() -> None:
    program = (
        "import os; os.sched_setaffinity(0, {sorted(os.sched_getaffinity(0))[-1]})\n"
        "from haptorb.runtime.wakefulness import keep_awake\n"
        "assert keep_awake()\n"
        "print(sum(range(100_000)))\n"  # with the interpreter's lock in the spinning thread this would never come
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.strip() == str(sum(range(100_000)))


@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="one core: every process is bound to it")
def test_a_process_that_is_bound_to_no_core_keeps_none_awake() -> None:
    program = "from haptorb.runtime.wakefulness import keep_awake; import threading\n"
    program += "print(keep_awake(), threading.active_count())"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.split() == ["False", "1"]
