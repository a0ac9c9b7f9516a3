"""Statistics of the loop: every tick counted once, complete rows, and the maximum force, known or not."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from haptorb.recording.row import RowLayout
from haptorb.runtime.loop import count_tick, publish_row
from haptorb.runtime.shared_memory import COUNTS, Histogram, Word

LAYOUT = RowLayout(3, 1)
FILLED = ("tick", "wall", "lateness", "missed", "buttons", "grip", "hand_t")


def page() -> np.ndarray:
    return np.zeros(1, COUNTS)


def test_a_row_is_completed_and_copied() -> None:
    row, slot = np.arange(float(LAYOUT.width)), LAYOUT.empty()
    publish_row(row, slot, LAYOUT.places, page(), 7, 2_000_000_000, 3_000, 4)
    np.testing.assert_array_equal(slot, row)
    told = {name: slot[LAYOUT[name]][0] for name in FILLED}
    assert told == {
        "tick": 7.0,
        "wall": 2.0,
        "lateness": pytest.approx(3e-6),
        "missed": 4.0,
        "buttons": 0.0,
        "grip": 0.0,
        "hand_t": 0.0,
    }
    others = np.ones(LAYOUT.width, dtype=bool)
    for name in FILLED:
        others[LAYOUT[name]] = False
    np.testing.assert_array_equal(slot[others], np.arange(float(LAYOUT.width))[others])


def test_the_greatest_force_is_that_given_or_else_that_modelled() -> None:
    words = page()
    for given_, modelled, force, torque in (
        ((3, 0, 4, 0, 0, 1), (0, 0, 0, 0, 0, 9), 5.0, 1.0),
        ((1, 0, 0, 0, 2, 0), (9, 9, 9, 9, 9, 9), 5.0, 2.0),
        ((1, 0, 0, 0, 1, 0), (9, 9, 9, 9, 9, 9), 5.0, 2.0),
        ((np.nan,) * 6, (0, 6, 0, 0, 0, 3), 6.0, 3.0),
        ((np.nan,) * 6, (np.nan,) * 6, 6.0, 3.0),  # nobody knows: what was known stays
    ):
        row = LAYOUT.empty()
        row[LAYOUT["wrench_actual"]], row[LAYOUT["wrench_model"]] = given_, modelled
        publish_row(row, row.copy(), LAYOUT.places, words, 0, 0, 0, 0)
        floats = words.view(np.float64)
        assert floats[Word.PEAK] == force
        assert floats[Word.PEAK_TORQUE] == torque


@example([(400_000, 600_000), (400_000, 600_001)])  # just fits into the period, and just does not
@given(st.lists(st.tuples(st.integers(-(10**6), 10**11), st.integers(0, 10**11)), max_size=30))
def test_every_tick_is_counted_as_a_histogram_counts(ticks: list[tuple[int, int]]) -> None:
    counts = page()
    wanted = Histogram(), Histogram()
    for number, (lateness, took) in enumerate(ticks, 1):
        count_tick(counts, number, 2 * number, lateness, took, 1_000_000)
        wanted[0].add(lateness)
        wanted[1].add(took)
    np.testing.assert_array_equal(counts["lateness"][0], wanted[0].counts)
    np.testing.assert_array_equal(counts["compute"][0], wanted[1].counts)
    words = counts.view(np.int64)
    assert words[Word.TICKS] == len(ticks)
    assert words[Word.MISSED] == 2 * len(ticks)
    assert words[Word.ON_TIME] == sum(lateness + took <= 1_000_000 for lateness, took in ticks)
