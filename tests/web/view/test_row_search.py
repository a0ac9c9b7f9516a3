"""Search for a time: result of NumPy's search of all times, with few short reads."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from haptorb.web.view import find_row

STEPS = st.lists(st.floats(1e-6, 1e3), min_size=1, max_size=400)


@given(STEPS, st.floats(-10.0, 1e5))
def test_finds_what_a_search_of_all_times_finds(steps, value):
    times = np.cumsum(steps)
    reads = []

    def read(first, last):
        assert 0 <= first < last <= len(times)
        reads.append(last - first)
        return times[first:last]

    found = find_row(read, len(times), value, (times[0], times[-1]))
    assert found == max(int(np.searchsorted(times, value, side="right")) - 1, 0)
    assert sum(reads) <= 64 * 20


def test_evenly_spaced_times_are_found_at_once():
    reads = []

    def read(first, last):
        reads.append(first)
        return np.arange(first, last) / 1000.0

    assert find_row(read, 3_600_000, 1234.5678, (0.0, 3599.999)) == 1_234_567
    assert len(reads) == 1


def test_numbers_that_are_no_times_give_some_row():
    for times in (np.full(500, np.nan), np.zeros(500), np.arange(500.0)[::-1]):
        found = find_row(lambda a, b, times=times: times[a:b], 500, 3.0, (float(times[0]), float(times[-1])))
        assert 0 <= found < 500
