"""Deadlines: constant phase, none used twice, none made up; and the real clock under an overrunning loop."""

from __future__ import annotations

from time import monotonic_ns
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from haptorb.errors import InputError
from haptorb.runtime.clock import Clock, Schedule

MS = 1_000_000


@given(
    rate=st.floats(50, 4000),
    origin=st.integers(0, 10**15),
    work=st.lists(st.integers(0, 20 * MS), min_size=1, max_size=60),
    late=st.lists(st.integers(0, 5 * MS), min_size=60, max_size=60),
)
def test_any_course_of_things(rate: float, origin: int, work: list[int], late: list[int]) -> None:
    schedule = Schedule(rate, origin)
    now, used, skipped_in_all = origin - schedule.period, [], 0
    for busy, wake in zip(work, late, strict=False):
        deadline = schedule.next(now)
        assert deadline >= now  # never into the past: no bursts
        assert (deadline - origin) % schedule.period == 0  # the phase is kept
        begin = deadline + wake
        lateness, skipped = schedule.begin(begin)
        assert 0 <= lateness < schedule.period
        assert lateness == (begin - origin) % schedule.period
        used.append(schedule.number)
        skipped_in_all += skipped
        now = begin + busy
    assert used == sorted(set(used))  # every deadline at most once, in order
    assert schedule.missed == skipped_in_all == used[-1] + 1 - len(used)  # every deadline accounted for


def test_one_slow_tick_costs_what_it_covers() -> None:
    schedule = Schedule(1000.0, origin=0)
    assert schedule.begin(schedule.next(-1)) == (0, 0)
    assert schedule.next(2_300_000) == 3 * MS  # 1 and 2 passed while it ran
    assert schedule.begin(3 * MS) == (0, 2)
    assert schedule.next(3_100_000) == 4 * MS
    assert schedule.begin(4 * MS) == (0, 0)


def test_overslept() -> None:
    schedule = Schedule(1000.0, origin=0)
    schedule.begin(0)
    assert schedule.begin(5 * MS + 10) == (10, 4)


@pytest.mark.parametrize("rate", [49.99, 4000.1, 0, -1, float("nan"), float("inf"), "1000", None, True])
def test_rate_out_of_range(rate: Any) -> None:
    with pytest.raises(InputError, match="rate"):
        Schedule(rate, 0)


@pytest.mark.parametrize("rate", [50.0, 1000.0, 4000.0])
@pytest.mark.realtime(retry=False)
def test_clock_never_comes_early(rate: float) -> None:
    clock = Clock(rate)
    for _ in range(20):
        due = clock.sleep()
        now, lateness, _ = clock.wait()
        assert lateness >= 0
        assert due <= clock.schedule.time(now - lateness)  # above it where a busy machine slept through it
        assert now - lateness == clock.schedule.deadline(clock.schedule.number)
        assert monotonic_ns() >= now


@pytest.mark.realtime(retry=False)
def test_signals_do_not_end_the_wait() -> None:
    import signal

    clock, rings = Clock(50.0), []
    before = signal.signal(signal.SIGALRM, lambda number, frame: rings.append(number))
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.003, 0.003)
        for _ in range(10):
            clock.sleep()
            _, lateness, _ = clock.wait()
            assert lateness >= 0
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    assert len(rings) > 10


@pytest.mark.realtime(retry=False)
def test_slow_ticks_are_skipped_and_counted(fake_servo: Any) -> None:
    """Ticks 100 to 149 take 3.4 periods each: about three deadlines are skipped after each, and then all is well."""
    with fake_servo({"slow_at": 100, "slow_until": 150, "slow": 0.0034}).servo as servo:
        servo.run(0.6)
    rows, at = servo.recording.rows[:-1], servo.layout
    missed, number = rows[:, at["missed"]][:, 0], rows[:, at["tick"]][:, 0]
    slow = (number > 100) & (number <= 150)
    assert np.median(missed[slow]) == 3
    assert np.median(missed[~slow]) == 0
    # Not made up for: after a slow tick the next begins at a deadline, at least half a period later.
    wall, t = rows[:, at["wall"]][:, 0], rows[:, at["t"]][:, 0]
    phase = (wall - rows[:, at["lateness"]][:, 0] - t) * 1e9
    assert np.ptp(phase) < 1000  # one microsecond: the phase is kept to the end
    assert np.diff(t).min() > 0.0009
    report = servo.report()
    assert report["success_rate"] == pytest.approx(
        1 - (report["missed"] + 50) / (report["ticks"] + report["missed"]), abs=0.05
    )
