"""Limits of threshold and spread: against scipy's optimiser, and coverage with simulated observers."""

from __future__ import annotations

import importlib.util
import math
from itertools import pairwise
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scipy.optimize import minimize, minimize_scalar
from scipy.stats import norm

from haptorb_study.statistics.population import fit_group
from haptorb_study.statistics.psychometric_fit import FLAT, NO_LIMIT, REVERSED, UPPER_LIMIT, fit_person
from haptorb_study.statistics.psychometric_function import LAPSE_EDGES, LevelCounts
from haptorb_study.statistics.psychometric_likelihood import SlopeLikelihood

ROOT = Path(__file__).resolve().parents[3]
X = np.linspace(0.6, 1.4, 9)
MIXED = np.array(
    [[1.0, 2, 4, 5, 11, 13, 17, 18, 19], [4, 5, 8, 7, 11, 10, 12, 15, 14], [0, 1, 0, 3, 9, 18, 20, 19, 20]]
)


@pytest.fixture(scope="module")
def spreads() -> ModuleType:
    """benchmarks/study/study_spreads.py, whose observers are simulated without the functions of the fit."""
    spec = importlib.util.spec_from_file_location("study_spreads", ROOT / "benchmarks" / "study" / "study_spreads.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def fall(yes: np.ndarray, b: float, c: float) -> float:
    """Minus the log likelihood at slope b per range and intercept c, lapses integrated over the seven cells to 0.13."""
    edges = LAPSE_EDGES[:8]
    logs = []
    for low, high in pairwise(edges):
        lapse = (low + high) / 2
        p = lapse + (1 - 2 * lapse) * norm.cdf(c + b * (X - 1) / 0.8)
        logs.append(math.log((high - low) / 0.13) + float(yes @ np.log(p) + (20 - yes) @ np.log1p(-p)))
    return -float(np.logaddexp.reduce(logs))


@pytest.mark.parametrize("person", range(3))
def test_ends_are_where_the_likelihood_ratio_is_at_its_limit(person: int) -> None:
    yes = MIXED[person]
    found = SlopeLikelihood(LevelCounts(X, MIXED, np.full(MIXED.shape, 20.0)))
    best = min(
        (minimize(lambda v: fall(yes, *v), [b, 0.0], method="Nelder-Mead") for b in (0.5, 2.0, 6.0)),
        key=lambda one: one.fun,
    )
    limit = 1.9207 * (1 + 12 / 180)
    curve = found.curve(person, 0.02)
    assert 0.8 / curve.spread == pytest.approx(best.x[0], rel=0.02)
    for end in found.spread_95(person):
        at = minimize_scalar(lambda c, end=end: fall(yes, 0.8 / end, c), bounds=(-6, 6), method="bounded").fun
        assert at - best.fun == pytest.approx(limit, abs=0.06)
    for end in found.threshold_95(person):
        # The most likely function with its threshold there.
        at = min(
            minimize_scalar(
                lambda b, end=end: fall(yes, b, -b * (end - 1) / 0.8), bounds=(low, high), method="bounded"
            ).fun
            for low, high in ((0.01, 2.0), (2.0, 15.0))
        )
        assert at - best.fun == pytest.approx(limit, abs=0.08)


@pytest.mark.parametrize(
    ("yes", "note", "spread", "threshold"),
    [
        (np.full(9, 10.0), FLAT, (True, False), (False, False)),
        (np.full(9, 20.0), NO_LIMIT, (False, False), (False, True)),
        (np.zeros(9), NO_LIMIT, (False, False), (True, False)),
        (np.array([0.0] * 4 + [20.0] * 5), UPPER_LIMIT, (False, True), (True, True)),
        (MIXED[0][::-1].copy(), REVERSED, (True, True), (True, True)),
    ],
)
def test_what_the_answers_do_not_limit_has_no_end(
    yes: np.ndarray, note: str, spread: tuple[bool, bool], threshold: tuple[bool, bool]
) -> None:
    fit = fit_person(SlopeLikelihood(LevelCounts(X, yes[None, :], np.full((1, 9), 20.0))), 0, samples=0)
    assert note in fit.notes
    assert (fit.spread_95[0] > 0, math.isfinite(fit.spread_95[1])) == spread
    assert tuple(map(math.isfinite, fit.middle_95)) == threshold
    numbers = fit.numbers()
    assert (numbers["spread"] is not None) == all(spread)
    assert (numbers["middle"] is not None) == all(threshold)


def test_a_group_that_presses_one_key_has_a_lower_limit_only(spreads: ModuleType) -> None:
    draw = np.random.default_rng(2)
    for people in (4, 12):
        answered, _ = spreads.draw_observers(draw, "always-1", np.inf, people, X, 20)
        group = fit_group(SlopeLikelihood(answered))
        assert group is not None
        low, high = np.exp(group.log_spread.mean_95)
        assert low > 0.8
        assert high == math.inf
        assert group.threshold.mean_95 == (-math.inf, math.inf)


def test_people_with_reversed_keys_are_no_part_of_the_group(spreads: ModuleType) -> None:
    draw = np.random.default_rng(5)
    good, _ = spreads.draw_observers(draw, "careful", 0.2, 5, X, 20)
    swapped, _ = spreads.draw_observers(draw, "reversed", 0.2, 2, X, 20)
    both = LevelCounts(X, np.vstack([good.yes, swapped.yes]), np.vstack([good.of, swapped.of]))
    one, other = fit_group(SlopeLikelihood(good)), fit_group(SlopeLikelihood(both))
    assert one is not None
    assert other is not None
    assert other.people == 5
    assert other.threshold.mean_95 == pytest.approx(one.threshold.mean_95)
    assert fit_group(SlopeLikelihood(swapped)) is None


@pytest.mark.parametrize(
    ("observer", "spread"),
    [("careful", 0.2), ("careful", 1.0), ("careful", 5.0), ("careful", np.inf), ("reversed", 0.5)],
)
def test_intervals_hold_the_truth_or_have_an_open_end(spreads: ModuleType, observer: str, spread: float) -> None:
    # 200 people: the standard error is 1.5 %. The benchmark has 1000 and more in each cell.
    one = spreads.check_people(observer, spread, (9, 20), 200)
    assert one["holds"] > 0.90
    assert one["threshold_holds"] is None or one["threshold_holds"] > 0.90
    if spread in (0.2, 1.0):
        assert one["closed"] > 0.84
    if spread >= 1.0 and np.isfinite(spread):  # no test can tell more observers from one who does not look at all
        assert one["possible"] - 0.06 < one["closed"] < one["possible"] + 0.06
    if observer == "reversed":
        assert one["reversed"] > 0.95


def test_a_group_of_shallow_functions_holds_the_truth(spreads: ModuleType) -> None:
    one = spreads.check_groups("careful", 2.0, 8, 60)
    assert one["holds"] > 0.86
    assert one["threshold_holds"] > 0.86
    assert one["closed"] > 0.8
