"""What a regression test of a world looks like: run it with `python -m pytest examples/testing`."""

from pathlib import Path

import pytest

from haptorb.testing import assert_force_within, assert_no_trip

GROOVE = f"{Path(__file__).with_name('groove.py')}:Groove"

ACROSS = """
start 0 0 52 mm
wait 0.4 s                      # the force fades in within 0.3 s
move 0 8 52 mm in 0.4 s
wait 0.2 s
line 0 -8 52 mm in 0.8 s
"""


def spring(state):
    """(3,) what the groove should ask: 20 N/m across it."""
    return 0.0, -20.0 * state.p[1], 0.0


def test_the_groove_pulls_back_with_its_stiffness(haptic_device, scripted_hand):
    with haptic_device("omni", GROOVE, hand=scripted_hand(ACROSS)) as run:
        run.play()
    assert_no_trip(run.recording)
    assert_force_within(run.recording, spring, newtons=0.01, share=0.05, between=(0.4, 1.8))


def test_twice_the_stiffness_is_noticed(haptic_device, scripted_hand):
    with haptic_device("omni", GROOVE, hand=scripted_hand(ACROSS)) as run:
        run.set_world("groove", stiffness=40.0)
        run.play()
    with pytest.raises(AssertionError, match="most of it along y"):
        assert_force_within(run.recording, spring, newtons=0.01, share=0.05, between=(0.4, 1.8))
