"""Psychometric functions against scipy: maximum likelihood, posterior by brute force, deviance.

Limits of threshold and spread: test_psychometric_likelihood.py.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.special import ndtr
from scipy.stats import beta, binom

from haptorb.errors import InputError
from haptorb_study.statistics.psychometric_fit import PersonFit, fit_person, psychometric_fit
from haptorb_study.statistics.psychometric_function import LevelCounts, PsychometricGrid, count_by_level
from haptorb_study.statistics.psychometric_likelihood import SlopeLikelihood

X = np.linspace(0.7, 1.3, 7)
YES = np.array([[1.0, 2, 6, 13, 19, 24, 25], [0, 4, 9, 20, 23, 25, 24]])
OF = np.full((2, 7), 25.0)


def p_of(middle: Any, spread: Any, lapse: Any) -> Any:
    return lapse + (1 - 2 * lapse) * ndtr((X - middle) / spread)


def fit_all(answered: LevelCounts, samples: int = 0) -> list[PersonFit]:
    """The fits of those who have answered."""
    likelihood = SlopeLikelihood(answered)
    return [fit_person(likelihood, n, samples=samples) for n, of in enumerate(answered.of) if of.any()]


@pytest.fixture(scope="module")
def grid() -> PsychometricGrid:
    return PsychometricGrid.enclose(LevelCounts(X, YES, OF))


def test_the_greatest_likelihood_is_where_scipy_finds_it(grid: PsychometricGrid) -> None:
    for person in range(2):
        found = minimize(
            lambda v, k=YES[person]: -binom.logpmf(k, 25, np.clip(p_of(v[0], abs(v[1]), abs(v[2])), 1e-9, 1)).sum(),
            [1.0, 0.1, 0.02], method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-8},
        )  # fmt: skip
        best = int(np.argmax(grid.likelihoods[person]))
        curve = grid.curve_at(best)
        own = -binom.logpmf(YES[person], 25, curve(X)).sum()
        assert own - found.fun < 0.15  # the grid's steps are six tenths of a standard deviation
        assert curve.middle == pytest.approx(found.x[0], abs=0.6 * 0.02)


def test_the_posterior_is_that_of_brute_force(grid: PsychometricGrid) -> None:
    # Written out on a grid of its own, ten times as fine, with the priors as the documentation states them.
    middle, spread = np.linspace(0.6, 1.4, 241), np.linspace(0.02, 0.5, 161)
    lapse = (np.arange(60) + 0.5) / 60 * 0.3
    prior = beta.pdf(lapse, 1, 10)[None, None, :] * np.ones((241, 161, 1))
    away = np.maximum(np.maximum(0.7 - middle, middle - 1.3), 0) / 0.3
    prior *= (np.where(away < 1, (1 + np.cos(np.pi * away)) / 2, 0))[:, None, None]
    width = 3.29 * spread
    rise, fall = np.clip((0.2 - width) / 0.1, 0, 1), np.clip((width - 0.6) / 1.2, 0, 1)
    prior *= ((1 + np.cos(np.pi * rise)) / 2 * (1 + np.cos(np.pi * fall)) / 2)[None, :, None]
    z = ndtr((X - middle[:, None, None]) / spread[None, :, None])
    p = lapse[:, None] + (1 - 2 * lapse[:, None]) * z[:, :, None, :]
    logs = np.log(p) @ YES[0] + np.log1p(-p) @ (25 - YES[0])
    mass = prior * np.exp(logs - logs.max())
    mass /= mass.sum()
    found = psychometric_fit(X, YES[0], OF[0])
    for axis, marginal, value in ((middle, mass.sum((1, 2)), found.middle),
                                  (np.log(spread), mass.sum((0, 2)), np.log(found.spread)),
                                  (lapse, mass.sum((0, 1)), found.lapse)):  # fmt: skip
        deviation = np.sqrt(marginal @ axis**2 - (marginal @ axis) ** 2)
        assert value == pytest.approx(marginal @ axis, abs=0.05 * deviation)
    assert found.guess == found.lapse


def test_the_deviance_is_that_of_the_binomial_and_a_wrong_function_does_not_fit() -> None:
    draw = np.random.default_rng(3)
    fitting = draw.binomial(40, p_of(1.0, 0.12, 0.02), (12, 7))
    broken = np.array([[2, 4, 35, 8, 36, 5, 38]])
    answered = LevelCounts(X, np.vstack([fitting, broken]).astype(float), np.full((13, 7), 40.0))
    fits = fit_all(answered, samples=200)
    assert fits[-1].p_fit < 0.02
    ps = np.array([fit.p_fit for fit in fits[:-1]])
    assert ps.min() > 0.005
    assert 0.25 < ps.mean() < 0.8
    full = binom.logpmf(fitting[0], 40, fitting[0] / 40).sum()
    best = minimize(
        lambda v: -binom.logpmf(fitting[0], 40, np.clip(p_of(v[0], abs(v[1]), abs(v[2])), 1e-9, 1)).sum(),
        [1.0, 0.12, 0.02], method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-8},
    )  # fmt: skip
    assert fits[0].deviance == pytest.approx(2 * (full + best.fun), abs=0.4)


def test_counts_are_those_of_the_trials() -> None:
    found = count_by_level([1.0, 2.0, 1.0, 2.0], [1, 1, 0, 1], [0, 0, 1, 1], 3)
    assert found.yes.tolist() == [[1, 1], [0, 1], [0, 0]]
    assert found.of.tolist() == [[1, 1], [1, 1], [0, 0]]


@pytest.mark.parametrize(
    ("yes", "words"),
    [
        ([0, 0, 0, 1, 1, 1, 1], "no limit to the spread"),
        ([0, 0, 0, 25, 25, 25, 25], "only an upper limit"),
        ([25, 25, 25, 25, 24, 25, 25], "threshold has only an upper limit"),
        ([0, 0, 0, 0, 1, 3, 9], "above the levels shown"),
    ],
)
def test_it_says_what_the_trials_cannot_tell(yes: list[int], words: str) -> None:
    of = 1.0 if max(yes) == 1 else 25.0
    answered = LevelCounts(X, np.array([yes], dtype=float), np.full((1, 7), of))
    (fit,) = fit_all(answered)
    assert words in " ".join(fit.notes)
    assert np.isfinite([fit.curve.middle, fit.curve.spread]).all()


def test_good_data_need_no_remark() -> None:
    assert all(not fit.notes for fit in fit_all(LevelCounts(X, YES, OF)))


@pytest.mark.parametrize(
    ("levels", "yes", "of"),
    [
        ([1.0], [1], [3]),
        ([1.0, 1.0], [1, 2], [3, 3]),
        ([1.0, 2.0], [1, 4], [3, 3]),
        ([1.0, 2.0], [-1, 2], [3, 3]),
        ([1.0, np.nan], [1, 2], [3, 3]),
        ([1.0, 2.0], [1, 2, 3], [3, 3]),
    ],
)
def test_bad_counts_are_refused(levels: list[float], yes: list[int], of: list[int]) -> None:
    with pytest.raises(InputError):
        psychometric_fit(levels, yes, of)
