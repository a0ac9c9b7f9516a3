"""A resting hand yields to a lasting push, so that the coils of an unattended demonstration stay cool."""

import numpy as np
import pytest

from haptorb import worlds
from haptorb.devices.loader import load
from haptorb.runtime.assembly import assemble
from haptorb.runtime.config import RunConfig
from haptorb.runtime.pointer import PointerTracker
from haptorb.simulation.hand_motion import RelaxedHand

REST = np.array([0.03, 0.0, 0.04, 0.0, 0.0, 0.0, 1.0])
PULL = np.array([0.0, 0.004, 0.0])


def follow(hand, push, seconds):
    """Where the hand is after so long, if the tool is `push(place)` away from where it wants it."""
    place = REST
    for n in range(round(seconds * 50)):
        place = hand.rest_at(REST, 0.02 * n)
        if hand.is_due(0.02 * n):
            hand.yield_to(place + push(place), 0.02 * n)
    return place


def pull_to_plane(place):
    """A valley at y = 10 mm, as deep everywhere: 4 mm of give until it is near."""
    return np.array([0.0, np.clip(0.010 - place[1], -0.004, 0.004), 0.0, 0.0, 0.0, 0.0, 0.0])


def test_it_goes_where_the_push_ends_and_keeps_its_distance_from_the_device():
    place = follow(RelaxedHand(), pull_to_plane, 11.0)
    assert place[1] == pytest.approx(0.010, abs=5e-4)
    assert np.linalg.norm(place[:3]) == pytest.approx(0.05, rel=1e-9)


def test_a_stream_that_never_ends_carries_it_no_further_than_its_reach_and_then_it_goes_back():
    hand = RelaxedHand()
    assert 0.0 < np.linalg.norm(follow(hand, lambda place: np.r_[PULL, 0, 0, 0, 0], 11.0)[:3] - REST[:3]) <= 0.03
    assert follow(RelaxedHand(), lambda place: np.r_[PULL, 0, 0, 0, 0], 20.0) == pytest.approx(REST, abs=1e-4)


def test_another_place_of_rest_is_taken_as_it_is():
    hand = RelaxedHand()
    follow(hand, pull_to_plane, 5.0)
    other = REST[[1, 0, 2, 3, 4, 5, 6]]
    assert (hand.rest_at(other, 5.0) == other).all()


def test_a_turn_fades_too_and_is_bounded():
    hand, half = RelaxedHand(), np.radians(5.0)
    turned = np.array([0.03, 0.0, 0.04, np.sin(half), 0.0, 0.0, np.cos(half)])
    for n in range(500):
        hand.rest_at(REST, 0.02 * n)
        hand.yield_to(turned, 0.02 * n)
    assert hand.rest_at(REST, 10.0) == pytest.approx(turned, abs=1e-3)
    over = np.array([0.03, 0.0, 0.04, 1.0, 0.0, 0.0, 0.0])
    far = RelaxedHand()
    for n in range(500):
        far.rest_at(REST, 0.02 * n)
        far.yield_to(over, 0.02 * n)
    assert 2 * np.arccos(abs(far.rest_at(REST, 10.0)[6])) <= np.radians(40.0) + 1e-9


def test_the_force_on_an_untouched_tool_fades():
    """Without giving way 0.35 N are asked for ever. All worlds: benchmarks/heat_at_rest.py."""
    tick = assemble(RunConfig(device=load("omni"), world=worlds.Guidance(), rate=500.0), PointerTracker())
    row, asked = tick.layout.empty(), []
    with tick.driver:
        for n in range(10_000, 16_000):  # from 20 s on every guided motion is over
            tick.prepare(n / 500)
            tick.step(row, n / 500)
            asked.append(np.linalg.norm(row[tick.layout["wrench_commanded"]]))
    assert np.mean(asked[-250:]) < 0.25 * np.max(asked)
