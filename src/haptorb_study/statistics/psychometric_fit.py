"""Psychometric function of one participant: estimates, confidence intervals, goodness of fit, and notes."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from haptorb.arrays import Array
from haptorb_study.json_values import json_number
from haptorb_study.statistics.psychometric_function import LAPSE_EDGES, LevelCounts, PsychometricCurve, PsychometricGrid
from haptorb_study.statistics.psychometric_likelihood import MAX_LAPSE_RATE, SlopeLikelihood

__all__ = [
    "FLAT",
    "LAPSES",
    "NO_LIMIT",
    "ONE_LEVEL",
    "REVERSED",
    "UPPER_LIMIT",
    "PersonFit",
    "central_interval",
    "find_median",
    "fit_person",
    "psychometric_fit",
]


Interval = tuple[float, float]
#: notes on what the trials do not determine
ONE_LEVEL = "answers at one level only: they determine no function"
UPPER_LIMIT = "the answers change from one level to the next: the spread has only an upper limit"
FLAT = "the answers hardly depend on the level: the spread has only a lower limit"
NO_LIMIT = "the answers set no limit to the spread: too few trials, or nearly all answers the same"
REVERSED = "the answers fall with the level: the keys were probably reversed"
LAPSES = f"more than {200 * MAX_LAPSE_RATE:.0f} % of the trials seem to be answered at random: no interval"
_UNKNOWN = (math.nan, math.nan)
_REPETITIONS = 400  #: simulated repetitions for the goodness of fit


@dataclass(frozen=True)
class PersonFit:
    """Maximum-likelihood function and 95 % intervals; 0 and ±∞ are open limits, NaN is unknown.

    A curve that falls with the level has a negative spread.
    """

    trials: int
    curve: PsychometricCurve
    middle_95: Interval
    spread_95: Interval
    guess_95: Interval
    lapse_95: Interval
    deviance: float  #: against the saturated model
    p_fit: float  #: share of simulated repetitions with at least this deviance
    notes: tuple[str, ...] = field(default=())

    @property
    def middle(self) -> float:
        """Point of subjective equality; NaN where its interval has an open limit."""
        return self.curve.middle if all(map(math.isfinite, self.middle_95)) else math.nan

    @property
    def spread(self) -> float:
        """Spread; NaN where its interval has an open limit."""
        low, high = self.spread_95
        return abs(self.curve.spread) if low > 0 and math.isfinite(high) else math.nan

    def numbers(self) -> dict[str, Any]:
        """As plain JSON types; NaN and open limits are None."""
        curve = self.curve
        return {
            "trials": self.trials,
            "middle": json_number(self.middle), "middle_95": [json_number(end) for end in self.middle_95],
            "spread": json_number(self.spread), "spread_95": [json_number(end) for end in self.spread_95],
            "jnd_75_percent": json_number(0.6745 * self.spread),
            "guess": json_number(curve.guess), "guess_95": [json_number(end) for end in self.guess_95],
            "lapse": json_number(curve.lapse), "lapse_95": [json_number(end) for end in self.lapse_95],
            "deviance": json_number(self.deviance), "p_fit": json_number(self.p_fit), "notes": list(self.notes),
        }  # fmt: skip


def psychometric_fit(levels: ArrayLike, yes: ArrayLike, of: ArrayLike) -> PsychometricCurve:
    """Posterior means for one participant: `yes` (n,) out of `of` (n,) at `levels` (n,), ascending; γ = λ.

    With the priors of psignifit 4, so that every participant has a finite value, whatever the answers. InputError with
    fewer than two levels.
    """
    counts = (np.asarray(values, dtype=float) for values in (yes, of))
    grid = PsychometricGrid.enclose(LevelCounts(np.asarray(levels, dtype=float), *(n[None, :] for n in counts)))
    mass = grid.posterior[0]
    lapse = float(mass.sum(axis=(0, 1)) @ grid.lapses)
    spread = math.exp(float(mass.sum(axis=(0, 2)) @ grid.log_spreads))
    return PsychometricCurve(float(mass.sum(axis=(1, 2)) @ grid.thresholds), spread, lapse, lapse)


def fit_person(likelihood: SlopeLikelihood, person: int, *, seed: int = 0, samples: int = _REPETITIONS) -> PersonFit:
    """Fit of one participant in `likelihood`; `samples` = 0: without goodness of fit.

    With answers at one level only, all numbers are NaN.
    """
    of = likelihood.answered.of[person]
    if np.count_nonzero(of) < 2:
        nothing = PsychometricCurve(math.nan, math.nan, math.nan, math.nan)
        return PersonFit(
            int(of.sum()), nothing, _UNKNOWN, _UNKNOWN, _UNKNOWN, _UNKNOWN, math.nan, math.nan, (ONE_LEVEL,)
        )
    lapses = likelihood.lapses(person)
    lapse, lapse_95 = float(lapses @ (LAPSE_EDGES[1:] + LAPSE_EDGES[:-1]) / 2), _quantiles(LAPSE_EDGES, lapses)
    curve = likelihood.curve(person, lapse)
    middle_95, spread_95 = likelihood.threshold_95(person), likelihood.spread_95(person)
    deviance, p = _check_fit(likelihood, person, seed, samples) if samples else (math.nan, math.nan)
    notes = tuple(_note(likelihood, person, curve, middle_95, spread_95))
    return PersonFit(int(of.sum()), curve, middle_95, spread_95, lapse_95, lapse_95, deviance, p, notes)


def _note(
    likelihood: SlopeLikelihood, person: int, curve: PsychometricCurve, middle_95: Interval, spread_95: Interval
) -> list[str]:
    """Notes on what one participant's trials do not determine."""
    found = []
    if likelihood.too_many_lapses[person]:
        return [LAPSES]
    if likelihood.direction(person) == "falling":
        found.append(REVERSED)
    low, high = spread_95
    if math.isinf(high):
        found.append(FLAT if low > 0 else NO_LIMIT)
    elif low == 0:
        found.append(UPPER_LIMIT)
    least, most = middle_95
    if math.isinf(least) and math.isinf(most):
        found.append("the answers set no limit to the threshold")
    elif math.isinf(least) or math.isinf(most):
        found.append(f"the threshold has only {'an upper' if math.isinf(least) else 'a lower'} limit")
    else:
        x = likelihood.answered.levels[likelihood.answered.of[person] > 0]
        for outside, where in ((curve.middle < x[0], "below"), (curve.middle > x[-1], "above")):
            if outside:
                found.append(f"the threshold lies {where} the levels shown: the function is extrapolated there")
    return found


def _check_fit(likelihood: SlopeLikelihood, person: int, seed: int, samples: int) -> tuple[float, float]:
    """Deviance, and share of simulated repetitions, each fitted, with at least this deviance (Wichmann & Hill 2001)."""
    yes, of = likelihood.answered.yes[person], likelihood.answered.of[person]
    shares = likelihood.nearby(person)
    log_no = np.log1p(-shares).T
    odds, none = np.log(shares).T - log_no, of @ log_no
    logs = yes @ odds + none
    drawn = np.random.default_rng([seed, person]).binomial(
        of.astype(int), shares[int(logs.argmax())], (samples, len(of))
    )
    repeated: Array = drawn.astype(np.float64)
    again = (repeated @ odds + none).max(axis=1)
    deviances = 2 * (_saturate(repeated, of) - again)
    deviance = float(2 * (_saturate(yes[None, :], of)[0] - logs.max()))
    return deviance, float((1 + np.count_nonzero(deviances >= deviance - 1e-9)) / (samples + 1))


def _saturate(yes: Array, of: Array) -> Array:
    """(k,) log likelihood of the saturated model for answers (k, levels)."""
    from scipy.special import xlogy

    share = yes / np.maximum(of, 1)
    found: Array = (xlogy(yes, share) + xlogy(of - yes, 1 - share)).sum(axis=-1)
    return found


def central_interval(axis: Array, mass: Array) -> Interval:
    """Central 95 % of `mass` (n,) at `axis` (n,), equal steps, with each mass uniform over its step."""
    return _quantiles(_edges(axis), mass)


def find_median(axis: Array, mass: Array) -> float:
    """Median of `mass` (n,) at `axis` (n,), with each mass uniform over its step."""
    return float(np.interp(0.5, np.append(0.0, np.cumsum(mass)) / mass.sum(), _edges(axis)))


def _edges(axis: Array) -> Array:
    step = float(axis[1] - axis[0])
    return np.append(axis - step / 2, axis[-1] + step / 2)


def _quantiles(edges: Array, mass: Array) -> Interval:
    """2.5 and 97.5 % quantiles of `mass` (n,) in cells between `edges` (n + 1,)."""
    sums = np.append(0.0, np.cumsum(mass)) / mass.sum()
    low, high = np.interp((0.025, 0.975), sums, edges)
    return float(low), float(high)
