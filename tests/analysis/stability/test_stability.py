"""Stability of a sampled loop with delay: three criteria against each other and against simulation in time."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from haptorb.analysis.stability import GRIPS, HandGrip, SampledLoop, check_grip
from haptorb.errors import InputError, UnknownName
from oracles.wall_trial import find_limit

HEAVY = HandGrip(1.0, 1.0, 0.0)  # slow against every period here: where the rough condition applies


def test_what_a_newton_second_per_metre_buys():
    """physics.md §5: 2000 N/m at 1 kHz, about 140 N/m at 240 Hz and 5 ms; and what the exact boundary says to it."""
    fast, slow = SampledLoop(1e-3), SampledLoop(1 / 240, 5e-3)
    assert fast.passive_bound(1.0) == pytest.approx(2000.0)
    assert fast.delay_bound(1.0) == pytest.approx(2000.0)
    assert slow.delay_bound(1.0) == pytest.approx(141.2, abs=0.1)
    assert fast.largest(HEAVY) == pytest.approx(2000.0, rel=0.01)
    assert slow.largest(HEAVY) == pytest.approx(141.2, rel=0.01)


@pytest.mark.parametrize("grip", GRIPS)
@pytest.mark.parametrize(("period", "delay"), [(1e-3, 0.0), (1e-3, 3e-3), (1 / 240, 5e-3), (1 / 120, 10e-3)])
def test_the_rough_condition_is_within_15_percent_where_it_applies(grip, period, delay):
    loop, hand = SampledLoop(period, delay), GRIPS[grip]
    exact = loop.largest(hand)
    turned = math.sqrt((exact + hand.stiffness) / hand.mass) * (period / 2 + delay)
    assert turned < 0.75  # radians of the oscillation within the delay: it is slow
    assert exact == pytest.approx(loop.delay_bound(hand.damping), rel=0.15)


@settings(max_examples=10, deadline=None)
@given(
    st.floats(0.05, 1.0), st.floats(0.5, 10.0), st.floats(0.0, 500.0), st.floats(0.5, 1.2),
    st.floats(0.0, 3.0), st.floats(0.0, 1.0), st.floats(-0.4, 0.4),
)  # fmt: skip
def test_eigenvalues_say_what_time_shows(mass, damping, stiffness, share, late, ramp, world_damping):
    """The same loop, stepped finely through time with a queue of forces: it grows as the eigenvalues say."""
    hand = HandGrip(mass, damping, stiffness)
    period = 2e-3
    loop = SampledLoop(period, round(late * 8) / 8 * period, round(ramp * 8) / 8 * period, 0.7e-3)
    K = share * loop.delay_bound(damping)
    B = world_damping * damping
    growth = loop.growth(hand, K, B)
    if abs(growth - 1) < 5e-4:
        return
    n, h = 16, period / 16
    x, v, before, force, pose = 1e-3, 0.0, 0.0, 0.0, 1e-3
    wait, queue, sizes = round(loop.delay / h), [], []
    ramp_steps, scale = round(loop.ramp / h), -math.expm1(-loop.ramp / 0.7e-3)
    step = _fine(hand, h)
    for tick in range(1500 * n):
        if tick % n == 0:
            queue.append((tick + wait, -K * x - B * (x - pose) / period))
            pose = x
            sizes.append(mass * v * v + (stiffness + K) * x * x)
        if queue and queue[0][0] == tick:
            before, force = force, queue.pop(0)[1]
            begun = tick
        since = tick - begun if tick >= wait else ramp_steps
        if since < ramp_steps:
            done = (-math.exp(-(since + 1) * h / 0.7e-3) + math.exp(-since * h / 0.7e-3)) * 0.7e-3 / h
            current = before + (force - before) * (1 - done) / scale
        else:
            current = force
        x, v = step @ (x, v, current)
        if sizes and not 1e-60 < sizes[-1] < 1e60:
            break
    half = len(sizes) // 2
    assert (np.max(sizes[half:]) > np.max(sizes[len(sizes) // 4 : half])) == (growth > 1)


def _fine(hand, h):
    from scipy.linalg import expm

    A = np.zeros((3, 3))
    A[0, 1], A[1] = 1.0, (-hand.stiffness / hand.mass, -hand.damping / hand.mass, 1 / hand.mass)
    return expm(A * h)[:2]


def test_a_late_slow_or_lagging_loop_renders_less():
    hand = GRIPS["light"]
    plain = SampledLoop(1e-3).largest(hand)
    assert SampledLoop(2e-3).largest(hand) < plain
    assert SampledLoop(1e-3, 1e-3).largest(hand) < plain
    assert SampledLoop(1e-3, 0.0, 1e-3, 0.7e-3).largest(hand) < plain
    assert SampledLoop(1e-3).largest(HandGrip(0.1, 4.0, 100.0)) > plain


def test_a_tracker_with_its_own_clock_waits_for_the_tick():
    assert SampledLoop.of(1000.0).delay == 0.0
    slow = SampledLoop.of(1000.0, 240.0, 5e-3, 0.6e-3)
    assert slow.period == pytest.approx(1 / 240)
    assert slow.delay == pytest.approx(5.5e-3)
    fast = SampledLoop.of(500.0, 1000.0)
    assert (fast.period, fast.delay) == (pytest.approx(2e-3), pytest.approx(0.5e-3))


@pytest.mark.parametrize(("tracker_rate", "latency"), [(240.0, 0.0), (240.0, 5e-3), (120.0, 10e-3), (300.0, 2e-3)])
@pytest.mark.parametrize("grip", GRIPS)
def test_the_limit_is_that_of_two_clocks_stepped_through_time(grip, tracker_rate, latency):
    """Every tick and every pose at its own time, until both clocks meet again: within 5 % of the mean over phases."""
    hand = GRIPS[grip]
    stepped = find_limit((hand.mass, hand.damping, hand.stiffness), tracker_rate, latency)
    assert SampledLoop.of(1000.0, tracker_rate, latency).largest(hand) == pytest.approx(stepped, rel=0.05)


def test_damping_that_comes_late_has_a_limit_as_well():
    """A sampled damper alone on a mass, its velocity from two poses: z² − (2 − β)z + 1 − β … is stable to about m/T."""
    loop, hand = SampledLoop(1e-3), HandGrip(0.1, 1e-6, 0.0)
    limit = loop.largest(hand, 0.0, 1.0)
    assert 50.0 < limit < 200.0
    assert SampledLoop(1e-3, 5e-3).largest(hand, 0.0, 1.0) < 0.3 * limit


def test_a_force_that_turns_grows_without_any_delay_to_speak_of():
    """A curl c needs damping: c < b √(k/m), whatever the rate."""
    hand = HandGrip(0.1, 2.0, 100.0)
    limit = SampledLoop(1e-5).largest(hand, 1j)
    assert limit == pytest.approx(2.0 * math.sqrt(100.0 / 0.1), rel=0.02)


def test_nothing_has_no_limit_and_a_hand_without_damping_stands_nothing():
    assert SampledLoop(1e-3).largest(GRIPS["light"], 0.0, 0.0) == math.inf
    assert SampledLoop(1e-3).largest(HandGrip(0.1, 0.0, 100.0)) == 0.0


@pytest.mark.parametrize(("mass", "damping", "stiffness"), [(1e-9, 1.0, 1e3), (1e3, 1e12, 0.0), (1e-6, 0.0, 1e6)])
def test_the_stiffest_hand_that_is_taken_can_be_computed(mass, damping, stiffness):
    assert SampledLoop(1e-3, 1e-4, 1e-3, 1e-3).largest(HandGrip(mass, damping, stiffness)) >= 0.0
    with pytest.raises(InputError, match="times mass"):
        HandGrip(mass / 2, damping, stiffness)


@pytest.mark.parametrize("bad", [(0.0,), (-1e-3,), (math.nan,), (1e-3, -1.0), (1e-3, math.inf), (1e-3, 0.0, 2e-3)])
def test_times_that_cannot_be(bad):
    with pytest.raises(InputError):
        SampledLoop(*bad)


def test_a_delay_of_more_than_64_periods_is_refused():
    with pytest.raises(InputError, match="64 periods"):
        SampledLoop(1e-3, 0.1)
    with pytest.raises(InputError, match="rates"):
        SampledLoop.of(1000.0, 0.0)


@pytest.mark.parametrize("text", ["tight", "1,2", "a,b,c", ""])
def test_grips_that_nobody_knows(text):
    with pytest.raises(UnknownName, match="grip"):
        check_grip(text)


@pytest.mark.parametrize("text", ["0,1,1", "0.1,-1,0", "nan,1,1"])
def test_grips_that_cannot_be(text):
    with pytest.raises(InputError, match="mass"):
        check_grip(text)
