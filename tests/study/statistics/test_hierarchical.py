"""Population model against closed forms and brute force, and coverage of its intervals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq, minimize
from scipy.special import ndtr
from scipy.stats import beta, norm, t

from haptorb.errors import InputError
from haptorb_study.statistics.population import fit_group, fit_normal_effect, fit_population
from haptorb_study.statistics.psychometric_function import LevelCounts, PsychometricGrid
from haptorb_study.statistics.psychometric_likelihood import SlopeLikelihood

X = np.linspace(0.6, 1.4, 9)


def draw_answers(draw: np.random.Generator, people: int, sd: float, of: int = 20) -> LevelCounts:
    middles, spreads = 1 + sd * draw.standard_normal(people), 0.12 * np.exp(sd * draw.standard_normal(people))
    p = 0.02 + 0.96 * ndtr((X - middles[:, None]) / spreads[:, None])
    return LevelCounts(X, draw.binomial(of, p).astype(float), np.full(p.shape, float(of)))


@pytest.mark.parametrize("spread", [0.3, 1.0, 3.0])
def test_equally_certain_people_give_students_interval_and_restricted_variance(spread: float) -> None:
    places = spread * np.array([-1.1, 0.4, 0.2, 1.3, -0.5, 0.6]) + 2.0
    values = np.linspace(-8, 12, 201)
    found = fit_normal_effect(values, norm.pdf(values, places[:, None], 0.8))
    n, s = len(places), places.std(ddof=1)
    half = t.ppf(0.975, n - 1) * s / np.sqrt(n)
    assert found.mean == pytest.approx(places.mean(), abs=1e-3)
    assert found.mean_95 == pytest.approx((places.mean() - half, places.mean() + half), abs=3e-3 * half + 1e-3)

    def fall(sd: float) -> float:  # twice the restricted log likelihood below its greatest value
        one, most = ((n - 1) * (np.log(v) + s**2 / v) for v in (sd**2 + 0.8**2, max(s**2, 0.8**2)))
        return float(one - most)

    assert found.sd == pytest.approx(np.sqrt(max(s**2 - 0.8**2, 0)), abs=0.02)
    high = brentq(lambda sd: fall(sd) - 3.8415, max(found.sd, 0.01) + 1e-3, 40)
    assert found.sd_95[1] == pytest.approx(high, rel=0.03)
    low = brentq(lambda sd: fall(sd) - 3.8415, 0.0, found.sd) if fall(0.0) > 3.8415 else 0.0
    assert found.sd_95[0] == pytest.approx(low, abs=0.03 * spread + 0.02)


def test_the_group_maximises_the_integral_over_its_people() -> None:
    answered = draw_answers(np.random.default_rng(4), 6, 0.1)
    grid = PsychometricGrid.enclose(answered)
    found = fit_population(grid)
    # All answers' likelihood on another, finer grid; then scipy looks for the greatest integral.
    x, y = np.linspace(0.6, 1.4, 90), np.linspace(np.log(0.03), np.log(0.4), 70)
    lapse = (np.arange(40) + 0.5) / 40 * 0.3
    z = ndtr((X - x[:, None, None]) / np.exp(y)[None, :, None])
    p = lapse[:, None] + (1 - 2 * lapse[:, None]) * z[:, :, None, :]
    logs = np.einsum("mslk,pk->pmsl", np.log(p), answered.yes) + np.einsum(
        "mslk,pk->pmsl", np.log1p(-p), answered.of - answered.yes
    )
    likelihoods = np.exp(logs - logs.max(axis=(1, 2, 3), keepdims=True))

    def fall(v: Any, three: Any) -> float:
        one = norm.pdf(x, v[0], max(found.threshold.sd, 0.01))
        two = norm.pdf(y, v[1], max(found.log_spread.sd, 0.05))
        return float(-np.log(((likelihoods @ (three / three.sum())) @ (two / two.sum())) @ (one / one.sum())).sum())

    def fall_with_lapses(v: Any) -> float:
        return fall(v, beta.pdf(lapse, 1, np.exp(-v[2]) - 1)) + float(v[2] - np.log(0.02)) ** 2 / 2

    options = {"xatol": 1e-4, "fatol": 1e-5}
    best = minimize(fall_with_lapses, [1.0, np.log(0.12), np.log(0.02)], method="Nelder-Mead", options=options)
    # The log spread is the mean over distributions of lapse rates, by how likely each is at its own maximum.
    means = np.array([0.005, 0.02, 0.04, 0.065, 0.09, 0.12])
    edges = np.array([0.0, *(means[1:] + means[:-1]) / 2, 0.12])
    ends = [
        minimize(fall, best.x[:2], (beta.pdf(lapse, a, a / m - a),), method="Nelder-Mead", options=options)
        for a in (1.0, 20.0) for m in means
    ]  # fmt: skip
    weights = np.exp(min(one.fun for one in ends) - np.array([one.fun for one in ends])) * np.tile(np.diff(edges), 2)
    log_spread = float(weights @ np.array([one.x[1] for one in ends]) / weights.sum())
    half = (found.threshold.mean_95[1] - found.threshold.mean, found.log_spread.mean_95[1] - found.log_spread.mean)
    assert found.threshold.mean == pytest.approx(best.x[0], abs=0.03 * half[0])
    assert found.log_spread.mean == pytest.approx(log_spread, abs=0.06 * half[1])
    assert np.log(found.lapse) == pytest.approx(best.x[2], abs=0.25)


def test_intervals_of_the_group_hold_the_truth() -> None:
    # Pooled answers, which know nothing of people, held it in four of ten such studies.
    hits = np.array([
        [low <= truth <= high for (low, high), truth in (
            (group.threshold.mean_95, 1.0), (group.log_spread.mean_95, np.log(0.12)), (group.threshold.sd_95, 0.1))]
        for seed in range(60)
        for group in [fit_population(PsychometricGrid.enclose(draw_answers(np.random.default_rng([9, seed]), 8, 0.1)))]
    ])  # fmt: skip
    assert (hits.mean(axis=0) > 0.87).all()


def test_people_who_make_no_error_have_a_group_too() -> None:
    yes = np.repeat((X > 0.95)[None, :] * 10.0, 4, axis=0)
    found = fit_population(PsychometricGrid.enclose(LevelCounts(X, yes, np.full(yes.shape, 10.0))))
    assert 0.9 <= found.threshold.mean <= 1.0
    # People who all answer alike show no spread to go by; levels that are 0.1 apart leave as much open nevertheless.
    for effect in (found.threshold, found.log_spread):
        assert 0.01 < effect.mean_95[1] - effect.mean_95[0] < 1.0


def test_somebody_who_answered_nothing_changes_nothing() -> None:
    answered = draw_answers(np.random.default_rng(8), 5, 0.1)
    more = LevelCounts(X, np.vstack([answered.yes, np.zeros(9)]), np.vstack([answered.of, np.zeros(9)]))
    one, other = (fit_population(PsychometricGrid.enclose(a)) for a in (answered, more))
    assert other.people == 5
    assert other.threshold.mean == pytest.approx(one.threshold.mean, abs=0.01)
    assert other.threshold.mean_95 == pytest.approx(one.threshold.mean_95, abs=0.01)


def test_one_person_is_no_group() -> None:
    grid = PsychometricGrid.enclose(draw_answers(np.random.default_rng(1), 1, 0.0))
    with pytest.raises(InputError, match="at least two people"):
        fit_population(grid)
    with pytest.raises(InputError, match="at least two people"):
        fit_normal_effect(X, np.ones((1, 9)))


def test_a_lattice_of_thresholds_does_not_draw_the_mean_towards_its_points() -> None:
    # Shifting everybody by a part of the grid's step shifts the mean by as much.
    values = np.linspace(-4, 4, 41)
    for shift in (0.03, 0.07, 0.11):
        found = fit_normal_effect(values, norm.pdf(values, np.array([[-0.2], [0.0], [0.1], [0.1]]) + shift, 0.4))
        assert found.mean == pytest.approx(shift, abs=2e-3)


@pytest.mark.parametrize("spread", [0.2, 0.5, 0.9])
def test_people_who_do_not_attend_to_a_fifth_of_the_trials_are_no_group_with_a_wider_function(spread: float) -> None:
    """Twenty people whose answers are as frequent as they are probable: only the lapse rates can mislead."""
    place = norm.ppf((np.arange(20) + 0.5) / 20)
    middles, spreads = 1 + 0.05 * place, 0.8 * spread * np.exp(0.15 * np.roll(place, 7))
    p = 0.1 + 0.8 * ndtr((X - middles[:, None]) / spreads[:, None])
    yes = np.round(20 * p + np.tile([0.25, -0.25], 90).reshape(20, 9))
    group = fit_group(SlopeLikelihood(LevelCounts(X, yes, np.full(p.shape, 20.0))))
    assert group is not None
    low, high = np.exp(group.log_spread.mean_95) / 0.8
    assert low <= spread <= high < 3 * low
