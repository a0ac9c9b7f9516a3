"""The psychometric function of each person: estimates, intervals, how well it fits, and what the trials cannot tell."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from haptorb.apps.study.inference.psychometric import LevelCounts, PsychometricCurve
from haptorb.apps.study.inference.psychometric_grid import LAPSE_EDGES, PsychometricGrid
from haptorb.numerics.arrays import Array

__all__ = [
    "ONE_LEVEL",
    "TOO_FEW",
    "UPPER_LIMIT",
    "PersonFit",
    "central_interval",
    "find_median",
    "fit_person",
    "psychometric_fit",
]

Interval = tuple[float, float]
#: what trials do not determine; `TOO_FEW` goes before its name
ONE_LEVEL = "answers at one level only: they determine no function"
UPPER_LIMIT = "no answer against the order of the levels: the spread has only an upper limit"
TOO_FEW = "too few trials for the "
_UNKNOWN = (math.nan, math.nan)
_SAMPLES = 400  #: simulated repetitions of a person's trials
_FAR = 12.0  #: in log likelihood: repetitions are fitted at points of the grid that are at most so much worse
_UNINFORMED = 0.7  #: posterior over prior standard deviation above which trials said little


@dataclass(frozen=True)
class PersonFit:
    """Means of the posterior and its central 95 %; what is unknown is NaN."""

    trials: int
    curve: PsychometricCurve
    middle_95: Interval
    spread_95: Interval
    guess_95: Interval
    lapse_95: Interval
    deviance: float  #: of the greatest likelihood against a share of its own for every level
    p_fit: float  #: share of simulated repetitions with so great a deviance or a greater one
    notes: tuple[str, ...] = field(default=())

    def numbers(self) -> dict[str, Any]:
        """As plain JSON types; what is not a number is None."""
        curve = self.curve
        return {
            "trials": self.trials,
            "middle": _to_json(curve.middle), "middle_95": [_to_json(end) for end in self.middle_95],
            "spread": _to_json(curve.spread), "spread_95": [_to_json(end) for end in self.spread_95],
            "jnd_75_percent": _to_json(0.6745 * curve.spread),
            "guess": _to_json(curve.guess), "guess_95": [_to_json(end) for end in self.guess_95],
            "lapse": _to_json(curve.lapse), "lapse_95": [_to_json(end) for end in self.lapse_95],
            "deviance": _to_json(self.deviance), "p_fit": _to_json(self.p_fit), "notes": list(self.notes),
        }  # fmt: skip


def psychometric_fit(levels: ArrayLike, yes: ArrayLike, of: ArrayLike) -> PsychometricCurve:
    """Posterior means for one person: `yes` (n,) out of `of` (n,) at `levels` (n,), ascending; γ = λ.

    InputError with fewer than two levels.
    """
    counts = (np.asarray(values, dtype=float) for values in (yes, of))
    grid = PsychometricGrid.enclose(LevelCounts(np.asarray(levels, dtype=float), *(n[None, :] for n in counts)))
    return fit_person(grid, 0, samples=0).curve


def fit_person(grid: PsychometricGrid, person: int, *, seed: int = 0, samples: int = _SAMPLES) -> PersonFit:
    """The fit of one of the people in `grid`; without `samples` its goodness is not computed.

    With answers at one level only, nothing is known: all numbers are NaN.
    """
    answered = grid.answered
    yes, of = answered.yes[person], answered.of[person]
    if np.count_nonzero(of) < 2:
        nothing = PsychometricCurve(math.nan, math.nan, math.nan, math.nan)
        return PersonFit(
            int(of.sum()), nothing, _UNKNOWN, _UNKNOWN, _UNKNOWN, _UNKNOWN, math.nan, math.nan, (ONE_LEVEL,)
        )
    mass = grid.posterior[person]
    middles, spreads, lapses = mass.sum(axis=(1, 2)), mass.sum(axis=(0, 2)), mass.sum(axis=(0, 1))
    middle, spread = float(middles @ grid.thresholds), float(np.exp(spreads @ grid.log_spreads))
    lapse = float(lapses @ grid.lapses)
    low, high = central_interval(grid.log_spreads, spreads)
    lapse_95 = _quantiles(LAPSE_EDGES, lapses)
    guess, guess_95 = (lapse, lapse_95) if grid.guess is None else (grid.guess, (grid.guess, grid.guess))
    deviance, p = _check_fit(grid, person, seed, samples) if samples else (math.nan, math.nan)
    return PersonFit(
        int(of.sum()), PsychometricCurve(middle, spread, guess, lapse), central_interval(grid.thresholds, middles),
        (math.exp(low), math.exp(high)), guess_95, lapse_95, deviance, p, tuple(_note(grid, yes, of, middles, spreads)),
    )  # fmt: skip


def _note(grid: PsychometricGrid, yes: Array, of: Array, middles: Array, spreads: Array) -> list[str]:
    """What the trials of one person cannot tell."""
    x = grid.answered.levels
    met = of > 0
    found = []
    one, two, _ = grid.priors
    for what, axis, mass, prior in (("threshold", grid.thresholds, middles, one),
                                    ("spread", grid.log_spreads, spreads, two)):  # fmt: skip
        if _deviation(axis, mass) > _UNINFORMED * _deviation(axis, prior):
            found.append(f"{TOO_FEW}{what}: its interval is almost as wide as without answers")
    below, above = x[met & (yes < of)], x[met & (yes > 0)]
    if len(below) and len(above) and below.max() < above.min():
        found.append(UPPER_LIMIT)
    outside = float(middles[grid.thresholds < x[met].min()].sum()), float(middles[grid.thresholds > x[met].max()].sum())
    for share, where in zip(outside, ("below", "above"), strict=True):
        if share > 0.5:
            found.append(f"the threshold lies {where} the levels shown: the function is extrapolated there")
    return found


def _check_fit(grid: PsychometricGrid, person: int, seed: int, samples: int) -> tuple[float, float]:
    """Deviance, and the share of simulated repetitions, each fitted, with at least this deviance (Wichmann 2001)."""
    yes, of = grid.answered.yes[person], grid.answered.of[person]
    logs = grid.log_likelihoods(yes[None, :], of[None, :])[0]
    near = np.flatnonzero(logs > logs.max() - _FAR)
    p = grid.curve_at(int(np.argmax(logs)))(grid.answered.levels)
    drawn = np.random.default_rng([seed, person]).binomial(of.astype(int), np.clip(p, 0, 1), (samples, len(of)))
    repeated: Array = drawn.astype(np.float64)
    again = grid.log_likelihoods(repeated, of, near).max(axis=1)
    deviances = 2 * (_saturate(repeated, of) - again)
    deviance = float(2 * (_saturate(yes[None, :], of)[0] - logs.max()))
    return deviance, float((1 + np.count_nonzero(deviances >= deviance - 1e-9)) / (samples + 1))


def _saturate(yes: Array, of: Array) -> Array:
    """(k,) log likelihood of answers (k, levels) with a share of its own for every level."""
    from scipy.special import xlogy

    share = yes / np.maximum(of, 1)
    found: Array = (xlogy(yes, share) + xlogy(of - yes, 1 - share)).sum(axis=-1)
    return found


def _deviation(axis: Array, mass: Array) -> float:
    middle = float(mass @ axis)
    return math.sqrt(max(float(mass @ (axis - middle) ** 2), 0.0))


def central_interval(axis: Array, mass: Array) -> Interval:
    """Central 95 % of `mass` (n,) at `axis` (n,), equal steps: a step's probability is spread over the step."""
    return _quantiles(_edges(axis), mass)


def find_median(axis: Array, mass: Array) -> float:
    """Median of `mass` (n,) at `axis` (n,), as `central_interval` has its ends."""
    return float(np.interp(0.5, np.append(0.0, np.cumsum(mass)) / mass.sum(), _edges(axis)))


def _edges(axis: Array) -> Array:
    step = float(axis[1] - axis[0])
    return np.append(axis - step / 2, axis[-1] + step / 2)


def _quantiles(edges: Array, mass: Array) -> Interval:
    """2.5 and 97.5 % of `mass` (n,) in cells between `edges` (n + 1,)."""
    sums = np.append(0.0, np.cumsum(mass)) / mass.sum()
    low, high = np.interp((0.025, 0.975), sums, edges)
    return float(low), float(high)


def _to_json(value: float) -> float | None:
    return value if math.isfinite(value) else None
