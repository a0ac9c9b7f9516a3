"""Currents at the time of the field, interpolated from earlier and later measurements."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from haptorb.estimation.hall_tracker import CurrentHistory
from haptorb.estimation.types import Pose, Sample

NOBODY = Pose(0.0, np.eye(3), np.zeros(3), np.zeros(3), np.zeros(3), False)
START, SLOPE = np.array([1.0, -2.0, 0.5]), np.array([100.0, 300.0, -50.0])  #: [A], [A/s]


def take_sample(history, t, currents_age, field_age, *, field=True, at=None):
    """One sample of currents that rise steadily, its field full of its own time."""
    when = t - currents_age if at is None else at
    read = np.full((2, 3), t - field_age if field else np.nan)
    history.append(Sample(t, START + SLOPE * when, np.full(3, 298.0), read, NOBODY, currents_age, field_age))


@given(
    st.lists(
        st.tuples(st.floats(0.8e-3, 3e-3), st.floats(0.3e-3, 1.5e-3), st.floats(-0.8e-3, 0.8e-3)),
        min_size=3,
        max_size=20,
    )
)
def test_steady_change_is_followed_exactly_whatever_the_ages(steps):
    history, t = CurrentHistory(3, 2), 0.0
    for step, age, apart in steps:
        t += step
        take_sample(history, t, age, max(age - apart, 0.0))
        if np.isfinite(history.field).all():
            assert history.field == pytest.approx(history.taken)
            assert history.currents == pytest.approx(START + SLOPE * history.taken)


def test_each_field_is_told_once_and_a_tick_later():
    history, seen = CurrentHistory(3, 2), []
    for tick in range(6):
        take_sample(history, 1e-3 * tick, 1.3e-3, 1e-3)
        seen.append(history.field[0, 0])
    assert np.isnan(seen[0])
    assert seen[1:] == pytest.approx([1e-3 * tick - 1e-3 for tick in range(5)])


def test_a_lost_answer_tells_nothing_and_the_field_goes_on_waiting():
    history = CurrentHistory(3, 2)
    take_sample(history, 0.0, 1e-3, 0.7e-3)
    take_sample(history, 1e-3, 2e-3, 1.7e-3, field=False)  # the same currents, a tick older
    assert np.isnan(history.field).all()
    take_sample(history, 2e-3, 1e-3, 0.7e-3)
    assert history.taken == pytest.approx(-0.7e-3)
    assert history.currents == pytest.approx(START + SLOPE * history.taken)


def test_after_a_pause_and_far_from_all_currents_nothing_is_told():
    history = CurrentHistory(3, 2)
    take_sample(history, 0.0, 1e-3, 0.7e-3)
    take_sample(history, 0.2, 1e-3, 0.7e-3)
    assert np.isnan(history.field).all()  # what flowed in a fifth of a second, nobody knows
    take_sample(history, 0.201, 1e-3, 0.9e-3)
    assert np.isfinite(history.field).all()
    history = CurrentHistory(3, 2)
    for tick in range(40):
        take_sample(
            history, 1e-3 * tick, 1e-3, 30e-3
        )  # a field that waited on the board for longer than currents are kept
        assert np.isnan(history.field).all()


def test_a_field_that_waited_on_the_board_has_the_currents_of_its_own_time():
    """A board tells what is newest; where a host asks in every second millisecond only, some sensors wait for 7 ms."""
    history, bent = CurrentHistory(3, 2), np.array([3.0, 0.0, -1.0])
    for tick in range(12):
        t = 1.5e-3 * tick
        history.append(
            Sample(t, bent * (t - 1e-3) ** 2, np.full(3, 298.0), np.full((2, 3), t), NOBODY, 1e-3, 1e-3 + 7e-3)
        )
        if tick > 6:
            assert history.taken == pytest.approx(t - 1.5e-3 - 8e-3)
            assert history.currents == pytest.approx(bent * history.taken**2, abs=6.0 * 1.5e-3**2 / 8 * 1.01)


def test_doubt_is_that_of_a_change_and_fades():
    history = CurrentHistory(3, 2)
    for tick in range(3):
        take_sample(history, 1e-3 * tick, 1e-3, 0.7e-3)
    assert history.doubt == pytest.approx(0.15e-3 * np.abs(SLOPE))
    for tick in range(3, 23):
        take_sample(history, 1e-3 * tick, 1e-3, 0.7e-3, at=1.0)
    assert (history.doubt < 0.25 * 0.15e-3 * 1e3 * np.abs(SLOPE)).all()


def test_ages_that_make_a_measurement_seem_older_than_the_last_tell_nothing_new():
    """Ages are known to some tenths of a millisecond; the order in which answers come is not in doubt."""
    history = CurrentHistory(3, 2)
    for tick in range(3):
        take_sample(history, 1e-3 * tick, 1e-3, 0.7e-3)
    take_sample(history, 3e-3, 2.2e-3, 1.9e-3)
    assert np.isnan(history.field).all()
    take_sample(history, 4e-3, 1e-3, 0.7e-3)
    assert history.currents == pytest.approx(START + SLOPE * history.taken)


def test_a_clock_that_begins_anew_begins_anew():
    history = CurrentHistory(3, 2)
    for tick in range(3):
        take_sample(history, 5.0 + 1e-3 * tick, 1e-3, 0.7e-3)
    take_sample(history, 0.0, 1e-3, 0.7e-3)
    assert np.isnan(history.field).all()
    take_sample(history, 1e-3, 1e-3, 0.7e-3)
    assert history.taken == pytest.approx(-0.7e-3)
    assert history.currents == pytest.approx(START + SLOPE * history.taken)
