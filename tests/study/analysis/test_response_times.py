"""Response times: equal weight per participant, time-outs counted, a planted difference found."""

from __future__ import annotations

import numpy as np
import pytest

from haptorb_study.analysis.response_times import find_response_times, list_response_times
from haptorb_study.statistics.intervals import mean_interval
from haptorb_study.study_file import study_of

TWO = 'name = "x"\n[trials]\ntime_limit = 10\n[[conditions]]\nname = "a"\n[[conditions]]\nname = "b"\n'


def columns(seconds: dict[tuple[str, str], list[float]]) -> dict[str, np.ndarray]:
    rows = [(code, name, value) for (code, name), values in seconds.items() for value in values]
    people, names, values = zip(*rows, strict=True)
    return {"participant": np.array(people), "condition": np.array(names), "seconds": np.array(values, dtype=float)}


def test_every_person_counts_alike() -> None:
    found = find_response_times(
        study_of(TWO),
        columns({("P1", "a"): [1.0, 2.0, 4.0] * 20, ("P2", "a"): [8.0, 16.0], ("P1", "b"): [3.0, 12.0]}),
    )
    one, two = found
    assert (one.condition, one.trials, one.people, one.time_outs) == ("a", 62, 2, 1)
    assert one.median == pytest.approx((2.0 + 12.0) / 2)
    assert one.geometric_mean == pytest.approx(np.sqrt(2.0 * np.sqrt(8.0 * 16.0)))
    low, high = mean_interval([2.0, 12.0])
    assert one.median_95 == pytest.approx((float(low), float(high)))
    assert (two.people, two.time_outs) == (1, 1)
    row = list_response_times(found)[1]
    assert row["median_95_s"] == [None, None]
    assert row["geometric_mean_s"] == pytest.approx(6.0)


def test_times_of_a_known_distribution_are_found() -> None:
    draw = np.random.default_rng(1)
    own = np.exp(np.log(5.0) + 0.2 * draw.standard_normal(24))
    data = {(f"P{n}", "a"): (middle * np.exp(0.4 * draw.standard_normal(60))).tolist() for n, middle in enumerate(own)}
    (one,) = find_response_times(study_of(TWO.replace("time_limit = 10", "")), columns(data))
    low, high = one.geometric_mean_95
    assert low < 5.0 < high
    assert one.geometric_mean == pytest.approx(5.0, rel=0.1)
    assert one.time_outs is None


def test_a_time_of_zero_has_no_logarithm_and_does_no_harm() -> None:
    (one,) = find_response_times(study_of(TWO), columns({("P1", "b"): [0.0, 0.0]}))
    assert one.median == 0.0
    assert list_response_times((one,))[0]["geometric_mean_s"] is None


def test_where_two_are_compared_the_pair_has_the_time() -> None:
    text = TWO.replace("[trials]", 'procedure = "forced-choice"\n[trials]') + '[[conditions]]\nname = "c"\n'
    pairs = [("a", "b", 2.0), ("b", "a", 4.0), ("c", "a", 6.0), ("a", "c", 6.0)]
    first, second, seconds = zip(*pairs, strict=True)
    main = {
        "participant": np.array(["P1"] * 4), "condition": np.array(first), "other": np.array(second),
        "seconds": np.array(seconds),
    }  # fmt: skip
    found = find_response_times(study_of(text), main)
    assert [(one.condition, one.trials, one.median) for one in found] == [("a, b", 2, 3.0), ("a, c", 2, 6.0)]
