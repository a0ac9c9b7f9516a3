"""Prevention of sleep states on the servo's core, without cost for others."""

import os
import signal
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from haptorb.runtime import keep_core_awake
from haptorb.runtime.keep_core_awake import CoreWaker, busy_share
from haptorb.runtime.servo import Servo

pytestmark = [pytest.mark.realtime(retry=False), pytest.mark.usefixtures("quick_starts")]

_POLICY = 38  #: field of /proc/PID/stat behind the program's name
ticks = st.integers(0, 10**9)


def children(pid: int) -> list[int]:
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def policy(pid: int) -> int:
    return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[_POLICY])


def is_ended(pid: int) -> bool:
    """Whether `pid` is gone, or only waits to be buried, within ten seconds."""
    for _ in range(500):
        try:
            state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
        except OSError:
            return True
        if state == "Z":
            return True
        time.sleep(0.02)
    return False


def awake(servo: Servo) -> int:
    """The process that keeps the servo's core awake."""
    servo.run(0.3)
    facts = servo.report()["scheduler"]
    if facts["core"] == -1:
        pytest.skip("this computer grants no real-time scheduler or has one core: nothing is kept awake")
    assert facts["awake"] is True
    (keeper,) = children(servo.servo_pid)
    assert policy(keeper) == os.SCHED_IDLE
    assert os.sched_getaffinity(keeper) == {facts["core"]}
    return keeper


def test_the_loops_core_is_kept_awake_behind_all_others_as_long_as_it_runs() -> None:
    with Servo("omni", "nothing", record=False) as servo:
        keeper = awake(servo)
    assert is_ended(keeper)


def test_it_ends_with_a_servo_that_is_killed() -> None:
    with Servo("omni", "nothing", record=False) as servo:
        keeper = awake(servo)
        os.kill(servo.servo_pid, signal.SIGKILL)
        assert is_ended(keeper)


def test_a_process_that_is_bound_to_no_core_keeps_none_awake() -> None:
    for core in (-1, 10_000):
        wakefulness = CoreWaker(core)
        assert not wakefulness.awake
        wakefulness.end()


def test_while_the_other_cores_are_loaded_it_does_not_spin(monkeypatch: pytest.MonkeyPatch) -> None:
    """Loaded from the first to the third second of five: what it spins in that time, another program would lose."""
    now, spun = 0.0, list[float]()

    def look() -> float:
        nonlocal now
        now += 1e-3
        spun.append(now)
        return now

    def sleep(seconds: float) -> None:
        nonlocal now
        now += seconds

    def read(core: int) -> tuple[int, int]:
        return round(100 * min(max(now - 1.0, 0.0), 2.0)), round(100 * now)

    monkeypatch.setattr(keep_core_awake, "time", SimpleNamespace(monotonic=look, sleep=sleep))
    monkeypatch.setattr(keep_core_awake, "_read_other_cores", read)
    monkeypatch.setattr(keep_core_awake, "os", SimpleNamespace(getppid=lambda: 7 if now < 5.0 else 1))
    keep_core_awake.spin(7, 0)
    assert [t for t in spun if 1.2 < t < 3.0] == []
    assert len([t for t in spun if t < 1.0]) > 900
    assert len([t for t in spun if t > 3.6]) > 1300


@given(ticks, ticks, ticks, ticks)
def test_busy_is_a_share(worked: int, passed: int, more: int, later: int) -> None:
    share = busy_share((worked, passed), (worked + min(more, later), passed + later))
    assert 0.0 <= share <= 1.0


def test_no_time_is_no_business() -> None:
    assert busy_share((5, 10), (5, 10)) == 0.0
