"""A wall that is too stiff for its loop comes to rest, in an unknown hand; by true force and true motion."""

from __future__ import annotations

import pytest

from haptorb.analysis.stability import GRIPS, SampledLoop
from haptorb.devices.loader import load
from oracles.wall_trial import run_wall

TRACKERS = ((120.0, 10e-3), (240.0, 5e-3))
LAG = float((load("omni").coils.inductance / load("omni").coils.resistance).max())


def limit(grip: str, tracker_rate: float, latency: float) -> float:
    return SampledLoop.of(1000.0, tracker_rate, latency, LAG).largest(GRIPS[grip])


def hand(grip: str) -> tuple[float, float, float]:
    return GRIPS[grip].mass, GRIPS[grip].damping, GRIPS[grip].stiffness


@pytest.mark.parametrize(("tracker_rate", "latency"), TRACKERS)
@pytest.mark.parametrize("grip", GRIPS)
def test_a_wall_beyond_the_limit_comes_to_rest_within_five_seconds(grip, tracker_rate, latency):
    """Let go 1 mm deep: below 0.05 mm, and in no later second more than 1 µJ for the hand."""
    for times in (1.2, 1.6, 2.0):
        run = run_wall(hand(grip), times * limit(grip, tracker_rate, latency), tracker_rate, latency, 8.0)
        assert run.motion(5.0) < 0.05e-3, times
        assert run.most_given(5.0) <= 1e-6, times


def test_left_alone_it_does_not():
    """What the trial sees without the control: the oscillation in free flight and wall that feeds a loose hand."""
    run = run_wall(hand("loose"), 2.0 * limit("loose", 240.0, 5e-3), 240.0, 5e-3, 8.0, controlled=False)
    assert run.motion(5.0) > 0.3e-3
    assert run.most_given(5.0) > 100e-6


@pytest.mark.parametrize(("tracker_rate", "latency"), TRACKERS)
@pytest.mark.parametrize("grip", GRIPS)
def test_at_two_thirds_of_the_limit_no_stiffness_is_lost(grip, tracker_rate, latency):
    """At rest the wall pushes as stiffly as it says, within 10 %."""
    stiffness = limit(grip, tracker_rate, latency) / 1.5
    run = run_wall(hand(grip), stiffness, tracker_rate, latency, 6.0)
    there = -1e-3 * GRIPS[grip].stiffness / (GRIPS[grip].stiffness + stiffness)  # where hand and wall are in balance
    assert run.x[-1] == pytest.approx(there, rel=0.05)
    assert run.softened[-1] < 0.1


def test_the_stiffness_returns_after_a_second_in_free_space():
    """The hand is drawn out of the wall that was softened: what it meets next is as stiff as ever."""
    stiffness = 2.0 * limit("firm", 240.0, 5e-3)
    run = run_wall(hand("firm"), stiffness, 240.0, 5e-3, 8.0, goal=lambda t: -1e-3 if t < 5.0 else 2e-3)
    softened = dict(zip(run.t.round(3).tolist(), run.softened.tolist(), strict=True))
    assert softened[5.0] > 0.3
    assert softened[5.9] == softened[5.0]
    assert softened[7.5] == 0.0
