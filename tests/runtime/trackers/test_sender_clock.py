"""A sender's clock: what was held up is seen, what tells no time is not believed, and no pose comes from the future."""

import random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from haptorb.runtime.trackers.base import SenderClock


def test_a_senders_clock_shows_what_was_held_up() -> None:
    clock = SenderClock()
    draw = random.Random(3)
    late = []
    for k in range(4000):
        sent = 0.01 * k
        delay = 0.002 + (0.03 if draw.random() < 0.05 else 0.0)
        arrival = 500.0 + sent * (1 + 50e-6) + delay  # a clock that loses 50 µs a second
        late.append((delay - 0.002, arrival - clock.stamp(sent, arrival)))
    true, seen = np.array(late).T
    assert np.abs(seen - true).max() < 1.1e-3
    assert seen.min() >= 0.0
    restarted = clock.stamp(0.0, 541.0)  # the sender began again, its clock at zero
    assert restarted == 541.0


@pytest.mark.parametrize("sent", [1e13, -1e13, 7.2e16, 1e300])
def test_a_number_too_great_to_tell_time_makes_a_pose_as_old_as_its_arrival(sent: float) -> None:
    clock = SenderClock()
    for k in range(50):
        arrival = 100.0 + 1.0003e-2 * k
        assert clock.stamp(sent + 0.01 * k, arrival) == arrival


@pytest.mark.parametrize("origin", [0.0, 1.7e9, 3.9e9, -2.2e9])  # a program's start, 1970, 1900; a clock set back
def test_clocks_that_count_from_long_ago_are_believed(origin: float) -> None:
    clock = SenderClock()
    clock.stamp(origin, 100.0)
    assert clock.stamp(origin + 0.01, 100.03) == pytest.approx(100.01, abs=1e-5)


@given(st.lists(st.tuples(st.floats(-1e12, 1e12), st.floats(0.0, 0.3)), min_size=1, max_size=20))
def test_no_pose_was_measured_after_it_came(sent: list[tuple[float, float]]) -> None:
    clock, arrival = SenderClock(), 1000.0
    for time, gap in sent:
        arrival += gap
        assert clock.stamp(time, arrival) <= arrival
