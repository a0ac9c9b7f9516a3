"""Elapsed time and missed deadlines: an overrun is detected quickly, a single pause of the computer is not one."""

import numpy as np
import pytest

from haptorb.control.missed_deadlines import WATCHDOG_TIMEOUT_S, advance_clock, make_clock, silence_of

DT = 1e-3


def overrun_after(steps, seconds=3.0, period=DT):
    """When the clock tells of an overrun [s]; None: never. `steps` are whole periods between ticks, in turn."""
    clock, now, n = make_clock(period), 0, 0
    advance_clock(clock[0], 0.0)
    while now * period < seconds:
        now += steps[n % len(steps)]
        n += 1
        advance_clock(clock[0], now * period)
        if clock["overrun"][0]:
            return now * period
    return None


@pytest.mark.parametrize("steps", [(2,), (1, 2), (1, 1, 2), (3,), (5,), (12,), (19,), (30,), (50,)])
def test_too_few_deadlines_are_an_overrun_within_a_fifth_of_a_second(steps):
    assert overrun_after(steps) <= 0.2 + 2e-3


@pytest.mark.parametrize("steps", [(1,), (1, 1, 1, 1, 2), (1,) * 120 + (19,), (1,) * 960 + (40,), (1,) * 960 + (900,)])
def test_enough_deadlines_and_a_single_pause_are_none(steps):
    assert overrun_after(steps) is None


def test_what_was_missed_is_forgotten_after_the_window():
    clock = make_clock(DT)
    for now in (0.0, 0.030, 0.330, 0.630):  # one gap each: never two within the window
        advance_clock(clock[0], now)
        assert not clock["overrun"][0]


@pytest.mark.parametrize("rate", [50, 250, 1000, 4000])
def test_every_rate_is_judged_by_its_own_deadlines(rate):
    assert overrun_after((1,), period=1 / rate) is None
    assert overrun_after((3,), period=1 / rate) <= 0.2 + 3 / rate


def test_lateness_that_is_excused_is_no_missed_time_but_a_silence_all_the_same():
    clock = make_clock(DT)
    advance_clock(clock[0], 0.0)
    for n in range(1, 40):
        clock["excused"] = True
        assert advance_clock(clock[0], 0.03 * n) == pytest.approx(0.03)
        assert clock["restart"][0]
        assert not clock["overrun"][0]
    for n in range(3):  # each time anew
        advance_clock(clock[0], 1.2 + 0.03 * n)
    assert clock["overrun"][0]


def test_a_silence_of_the_loop_restarts_the_ramp_and_a_late_tick_does_not():
    clock = make_clock(DT)
    assert advance_clock(clock[0], 7.0) == DT  # nothing is known of what was before the first tick
    assert advance_clock(clock[0], 7.0 + 0.9 * WATCHDOG_TIMEOUT_S) == pytest.approx(0.9 * WATCHDOG_TIMEOUT_S)
    assert not clock["restart"][0]
    advance_clock(clock[0], 8.0)
    assert clock["restart"][0]
    advance_clock(clock[0], 8.0 + DT)
    assert not clock["restart"][0]
    assert silence_of(0.02) == 0.04  # at 50 Hz a single period would be silence


def test_a_clock_that_goes_back_or_is_no_number_is_no_time():
    clock = make_clock(DT)
    advance_clock(clock[0], 1.0)
    assert advance_clock(clock[0], 0.5) == 0.0
    assert advance_clock(clock[0], np.nan) == DT
    assert np.isfinite(advance_clock(clock[0], 2.0))
