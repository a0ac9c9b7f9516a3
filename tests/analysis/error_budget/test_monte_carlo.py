"""Bands and shares of chains with closed-form results."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from haptorb.analysis.error_budget import Component, ErrorModel, ErrorSource, error_budget
from haptorb.errors import InputError


def keep_deviates(name, standard, dimension):
    """Source that keeps what it drew, times `standard`."""

    def perturb(deviates, trial):
        setattr(trial, name, standard * deviates)

    return ErrorSource(name, "1", "default", dimension, perturb)


class Chain(ErrorModel):
    """An error that is a function of two sources, asked for in any direction."""

    device, estimator, unit, motion, jnd, asked = "chain", "none", "N", "at rest", 0.1, 2.0
    regions = ("all",)
    components = (Component("x", (0,)), Component("across", (1, 2)))

    def __init__(self, error, sources):
        self.error, self.sources = error, sources

    def draw_point(self, region, rng):
        direction = rng.standard_normal(3)
        return self.asked * direction / np.linalg.norm(direction)

    def make_trial(self):
        return SimpleNamespace(a=np.zeros(3), b=np.zeros(3))

    def wrench_error(self, point, trial):
        return self.error(point, trial)


def make_budget(error, standard_a, standard_b, dimension=3, samples=6000, seed=0):
    sources = (keep_deviates("a", standard_a, dimension), keep_deviates("b", standard_b, dimension))
    return error_budget(Chain(error, sources), samples, seed)


def test_the_band_of_a_sum_is_that_of_the_combined_standard_uncertainty() -> None:
    band = make_budget(lambda point, trial: trial.a + trial.b, 3e-3, 4e-3).bands[-1]
    assert band.standard == pytest.approx([5e-3, 5e-3], rel=0.03)
    assert band.low == pytest.approx([-1.96 * 5e-3] * 2, rel=0.06)
    assert band.high == pytest.approx([1.96 * 5e-3] * 2, rel=0.06)
    assert band.size == pytest.approx(2.795 * 5e-3, rel=0.03)  # 95 % of a chi distribution of 3 degrees of freedom


def test_shares_are_those_of_the_variances_and_add_up() -> None:
    budget = make_budget(lambda point, trial: trial.a + trial.b, 1e-3, 3e-3)
    assert [share.name for share in budget.shares] == ["b", "a"]
    assert [share.first_order for share in budget.shares] == pytest.approx([0.9, 0.1], abs=0.08)
    assert [share.total for share in budget.shares] == pytest.approx([0.9, 0.1], abs=0.08)
    assert [share.alone for share in budget.shares] == pytest.approx([2.795 * 3e-3, 2.795 * 1e-3], rel=0.1)


def test_the_intervals_of_the_shares_hold_the_true_ones() -> None:
    """Of 100 budgets about 95 do for each share, whichever way the estimate misses; with few samples they are wide."""
    held, above = np.zeros(4), 0
    for seed in range(100):
        budget = make_budget(lambda point, trial: trial.a + trial.b, 1e-3, 3e-3, samples=1000, seed=seed)
        b, a = sorted(budget.shares, key=lambda share: -share.total)
        for n, (share, true) in enumerate(((a, 0.1), (b, 0.9))):
            for k, (low, high) in enumerate((share.first_order_interval, share.total_interval)):
                held[2 * n + k] += low <= true <= high
            above += share.first_order_interval[0] > share.total_interval[1]
    assert (held >= 88).all(), held
    assert above <= 5
    wide = a.first_order_interval[1] - a.first_order_interval[0]
    exact = make_budget(lambda point, trial: trial.a + trial.b, 1e-3, 3e-3, samples=16000).shares[1]
    assert exact.first_order_interval[1] - exact.first_order_interval[0] < 0.4 * wide


def test_a_gain_counts_although_its_error_has_no_mean_over_the_directions() -> None:
    budget = make_budget(lambda point, trial: point * trial.a[0], 0.01, 0.0, dimension=1)
    a = next(share for share in budget.shares if share.name == "a")
    assert a.first_order == pytest.approx(1.0, abs=0.1)
    assert budget.bands[-1].size == pytest.approx(1.96 * 0.01 * Chain.asked, rel=0.05)
    assert budget.count_jnd(budget.bands[-1].size) == pytest.approx(1.96 * 0.01 / 0.1, rel=0.05)


def test_what_two_sources_do_only_together_is_in_the_total_alone() -> None:
    budget = make_budget(lambda point, trial: trial.a * trial.b, 1.0, 1.0)
    for share in budget.shares:
        assert share.first_order == pytest.approx(0.0, abs=0.15)
        assert share.total == pytest.approx(1.0, abs=0.25)
        assert share.alone == 0.0


def test_a_seed_repeats_and_another_one_does_not() -> None:
    def error(point, trial):
        return trial.a

    sources = (keep_deviates("a", 1.0, 3),)
    first, again, other = (error_budget(Chain(error, sources), 200, seed).bands[-1].size for seed in (1, 1, 2))
    assert first == again != other


@pytest.mark.parametrize(("samples", "seed"), [(99, 0), (200, -1)])
def test_too_few_samples_and_a_negative_seed_are_refused(samples: int, seed: int) -> None:
    with pytest.raises(InputError, match="samples must be 100 or more"):
        error_budget(Chain(lambda point, trial: trial.a, ()), samples, seed)


def test_progress_is_told_up_to_the_end() -> None:
    shares: list[float] = []
    error_budget(Chain(lambda point, trial: trial.a, (keep_deviates("a", 1.0, 3),)), 200, report=shares.append)
    assert shares == sorted(shares)
    assert 0.5 < shares[-1] <= 1.0
