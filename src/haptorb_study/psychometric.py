"""The psychometric function, share of answers over the level of a stimulus, and the answers it is fitted to."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from haptorb.arrays import Array, check_finite
from haptorb.errors import InputError

__all__ = [
    "FLAT",
    "LAPSES",
    "LAPSE_EDGES",
    "MOST_LAPSES",
    "NO_LIMIT",
    "ONE_LEVEL",
    "REVERSED",
    "UPPER_LIMIT",
    "Direction",
    "LevelCounts",
    "NormalEffect",
    "PersonFit",
    "Population",
    "PsychometricCurve",
    "PsychometricGrid",
    "SlopeLikelihood",
    "central_interval",
    "count_by_level",
    "find_median",
    "fit_group",
    "fit_normal_effect",
    "fit_person",
    "fit_population",
    "psychometric_fit",
]


@dataclass(frozen=True)
class PsychometricCurve:
    """p(x) = γ + (1 − γ − λ) Φ((x − middle)/spread).

    Constant stimuli with two intervals: γ = λ, because a person who does not attend is right in half of the cases.

    >>> float(PsychometricCurve(1.0, 0.1, 0.02, 0.02)(1.0))
    0.5
    """

    middle: float  #: level where Φ = ½; of a comparison the point of subjective equality
    spread: float  #: standard deviation of the normal distribution, in units of the level
    guess: float  #: γ, share at levels far below
    lapse: float  #: λ, 1 − share at levels far above

    def __call__(self, x: ArrayLike) -> Array:
        """p at `x`, of its shape."""
        from scipy.special import ndtr

        at = np.asarray(x, dtype=float)
        p: Array = self.guess + (1 - self.guess - self.lapse) * ndtr((at - self.middle) / self.spread)
        return p


@dataclass(frozen=True)
class LevelCounts:
    """Counted answers: `yes` (people, n) out of `of` (people, n) at `levels` (n,), ascending."""

    levels: Array
    yes: Array
    of: Array

    def __post_init__(self) -> None:
        x, k, n = check_finite(self.levels, "levels"), check_finite(self.yes, "yes"), check_finite(self.of, "of")
        fits = x.ndim == 1 and k.shape == n.shape == (len(k), len(x)) and len(k) > 0
        if not fits or (k < 0).any() or (k > n).any() or (np.diff(x) <= 0).any():
            raise InputError("a psychometric fit needs ascending levels, and 0 ≤ yes ≤ of for each person and level")
        if len(x) < 2:
            raise InputError("a psychometric fit needs at least two different levels")

    @property
    def pooled(self) -> tuple[Array, Array, Array]:
        """(levels, yes, of), (n,) each, over all people: for drawing, no fit is made of it."""
        return self.levels, self.yes.sum(axis=0), self.of.sum(axis=0)


def count_by_level(levels: ArrayLike, yes: ArrayLike, person: ArrayLike, people: int) -> LevelCounts:
    """Counts from trials: `levels`, `yes` (0 or 1) and `person` (from 0), (trials,) each."""
    at, which = np.unique(np.asarray(levels, dtype=float), return_inverse=True)
    place = np.asarray(person) * len(at) + which
    size, shape = people * len(at), (people, len(at))
    counted: Array = np.bincount(place, np.asarray(yes, dtype=float), size).reshape(shape).astype(np.float64)
    of: Array = np.bincount(place, minlength=size).reshape(shape).astype(np.float64)
    return LevelCounts(at, counted, of)


# --------------------------------------------------------------------------------------------------
# Likelihood and posterior of psychometric functions on a grid that all participants share; nothing to converge.


#: limits of the cells of the lapse rate; a rate's probability is that of its cell, so that no density is too sharp
LAPSE_EDGES = np.array([0.0, 0.004, 0.011, 0.021, 0.035, 0.055, 0.085, 0.13, 0.2, 0.3])
_PSYCHOMETRIC_GRID_LAPSES = (LAPSE_EDGES[1:] + LAPSE_EDGES[:-1]) / 2
_FARTHEST = 1 / 2  #: of the levels' range: how far outside it thresholds are considered
_FINEST = 0.6  #: step of the grid in standard deviations of the most certain participant
_POINTS = (21, 81)  #: fewest and most, per axis


@dataclass(frozen=True)
class PsychometricGrid:
    """Thresholds × spreads × lapse rates at which the likelihood of everybody's answers is computed.

    guess   γ; None: it equals the lapse rate
    target  the threshold is where the share is this much; None: where Φ = ½
    """

    answered: LevelCounts
    thresholds: Array  #: (m,) equal steps
    log_spreads: Array  #: (s,) equal steps
    guess: float | None = None
    target: float | None = None

    @classmethod
    def enclose(
        cls, answered: LevelCounts, guess: float | None = None, target: float | None = None,
        limits: tuple[float, float] | None = None, spreads: tuple[float, float] | None = None,
    ) -> PsychometricGrid:  # fmt: skip
        """A grid over the region of remaining probability, as fine as the most certain participant needs it.

        limits    of the thresholds; None: half of the levels' range beyond the levels on either side
        spreads   least and greatest; None: from a sixth of the least distance of two levels to twice their range
        """
        x = answered.levels
        span = float(np.ptp(x))
        low, high = limits or (float(x[0]) - _FARTHEST * span, float(x[-1]) + _FARTHEST * span)
        least, most = spreads or (max(float(np.diff(x).min()) / 6, span / 300), 2 * span)
        narrow, wide = float(np.log(least)), float(np.log(most))
        axes = np.linspace(low, high, 33), np.linspace(narrow, wide, 17)
        for _ in range(3):  # again where the grid was too coarse for the most certain person
            rough = cls(answered, *axes, guess, target)
            mass = rough.posterior
            one, sure = _zoom(rough.thresholds, mass.sum(axis=(2, 3)), low, high)
            two, certain = _zoom(rough.log_spreads, mass.sum(axis=(1, 3)), narrow, wide)
            axes = one, two
            if sure and certain:
                break
        return cls(answered, *axes, guess, target)

    @property
    def lapses(self) -> Array:
        """(9,) lapse rates, the middles of their cells."""
        middles: Array = _PSYCHOMETRIC_GRID_LAPSES
        return middles

    @cached_property
    def _logs(self) -> tuple[Array, Array]:
        """(points, levels) logarithms of the probability of yes and of no."""
        from scipy.special import ndtr, ndtri

        x, spreads = self.answered.levels, np.exp(self.log_spreads)
        if self.target is None or self.guess is None:
            shape = ndtr((x - self.thresholds[:, None, None]) / spreads[:, None])[:, :, None, :]
        else:
            reach = np.clip((self.target - self.guess) / (1 - self.guess - _PSYCHOMETRIC_GRID_LAPSES), 1e-6, 1 - 1e-6)
            z = (x - self.thresholds[:, None, None]) / spreads[:, None]
            shape = ndtr(z[:, :, None, :] + ndtri(reach)[:, None])
        low = _PSYCHOMETRIC_GRID_LAPSES[:, None] if self.guess is None else self.guess
        p = np.clip(low + (1 - low - _PSYCHOMETRIC_GRID_LAPSES[:, None]) * shape, 1e-12, 1 - 1e-12).reshape(-1, len(x))
        return np.log(p), np.log1p(-p)

    @property
    def shape(self) -> tuple[int, int, int]:
        """(thresholds, spreads, lapse rates)."""
        return len(self.thresholds), len(self.log_spreads), len(_PSYCHOMETRIC_GRID_LAPSES)

    def log_likelihoods(self, yes: Array, of: Array, points: NDArray[np.intp] | None = None) -> Array:
        """(k, points) of k people's or samples' answers, (k, levels) each; without the binomial coefficients."""
        log_yes, log_no = self._logs if points is None else (logs[points] for logs in self._logs)
        found: Array = yes @ log_yes.T + (of - yes) @ log_no.T
        return found

    @cached_property
    def likelihoods(self) -> Array:
        """(people, thresholds, spreads, lapse rates), each person's greatest 1."""
        logs = self.log_likelihoods(self.answered.yes, self.answered.of)
        relative: Array = np.exp(logs - logs.max(axis=1, keepdims=True)).reshape(-1, *self.shape)
        return relative

    def curve_at(self, point: int) -> PsychometricCurve:
        """The function at one point of the grid, counted as `log_likelihoods` does."""
        from scipy.special import ndtri

        i, j, k = (int(n) for n in np.unravel_index(point, self.shape))
        middle, spread, lapse = (
            float(self.thresholds[i]),
            float(np.exp(self.log_spreads[j])),
            float(_PSYCHOMETRIC_GRID_LAPSES[k]),
        )
        guess = lapse if self.guess is None else self.guess
        if self.target is not None:
            middle -= spread * float(ndtri(np.clip((self.target - guess) / (1 - guess - lapse), 1e-6, 1 - 1e-6)))
        return PsychometricCurve(middle, spread, guess, lapse)

    @cached_property
    def priors(self) -> tuple[Array, Array, Array]:
        """(m,), (s,) and (9,) prior probabilities, those of psignifit 4 (Schütt et al. 2016), for one person alone.

        Threshold: flat over the levels, falling as a raised cosine to zero half of their range outside. Width (5 to
        95 %, 3.29 spreads): flat from twice the least distance of two levels to the range, falling to zero at that
        distance and at three times the range. Lapse rate: Beta(1, 10). With γ fixed, the levels are an adaptive
        procedure's own choice and tell nothing about the width: threshold flat, width flat in its logarithm.
        """
        x = self.answered.levels
        span, step = float(np.ptp(x)), float(np.diff(x).min())
        lapse = np.diff(1 - (1 - LAPSE_EDGES) ** 10)
        if self.guess is not None:
            flat = np.full(len(self.thresholds), 1 / len(self.thresholds))
            return flat, np.full(len(self.log_spreads), 1 / len(self.log_spreads)), lapse / lapse.sum()
        away = np.maximum(np.maximum(x[0] - self.thresholds, self.thresholds - x[-1]), 0.0) / (_FARTHEST * span)
        width = 3.29 * np.exp(self.log_spreads)
        short = np.clip((2 * step - width) / step, 0, 1)
        long = np.clip((width - span) / (2 * span), 0, 1)
        found = (_cosine(away), _cosine(short) * _cosine(long) * width, lapse)
        one, two, three = (np.maximum(p, 1e-12 * p.max()) / p.sum() for p in found)
        return one, two, three

    @cached_property
    def posterior(self) -> Array:
        """(people, m, s, 9) probability of every point after each person's own answers only."""
        one, two, three = self.priors
        mass = self.likelihoods * one[:, None, None] * two[:, None] * three
        normal: Array = mass / mass.sum(axis=(1, 2, 3), keepdims=True)
        return normal


def _cosine(x: Array) -> Array:
    """1 at 0, 0 from 1 on, a raised cosine between."""
    found: Array = (1 + np.cos(np.pi * np.clip(x, 0, 1))) / 2
    return found


def _zoom(axis: Array, mass: Array, least: float, most: float) -> tuple[Array, bool]:
    """Points between the limits that hold all but 1e-4 of everybody's `mass` (people, n), equally far apart.

    And whether `axis` was fine enough to tell.
    """
    step = float(axis[1] - axis[0])
    sums = np.cumsum(mass, axis=1)
    low = max(least, float(axis[int((sums > 1e-4).any(axis=0).argmax())]) - 1.5 * step)
    high = min(most, float(axis[int((sums > 1 - 1e-4).all(axis=0).argmax())]) + 1.5 * step)
    spread = float(np.sqrt(np.maximum(mass @ axis**2 - (mass @ axis) ** 2, 0.0)).min())
    count = (high - low) / (_FINEST * max(spread, step / 3))
    return np.linspace(low, high, int(np.clip(np.ceil(count), *_POINTS))), spread > step / 3


# --------------------------------------------------------------------------------------------------
# What one person's answers tell of a psychometric function: its greatest likelihood, and limits, some of them open.
#
# p(x) = λ + (1 − 2λ) Φ(c + b u), with u = (x − middle of the levels)/range of the levels. In slope b and intercept c a
# function that does not depend on the level is an ordinary point, b = 0, and keys that were taken for each other are b
# < 0. In spread (1/b) and threshold (−c/b) neither has a place: there, every end of an interval is finite, whatever the
# answers (Gleser & Hwang 1987).
#
# λ has equal probability from 0 to 0.13 and is integrated over; b and c have no prior. A slope belongs to its interval
# where the likelihood, at the best c, is at most `_CUT` (1 + 12/trials) in its logarithm below the greatest; 12 was
# found by simulation. The interval of the threshold has every −c/b of the pairs (b, c) that are no farther below
# (Fieller's, by likelihood). `benchmarks/study/study_spreads.py` measures how often they hold the truth.


Direction = Literal["rising", "falling", "unknown"]
MOST_LAPSES = 0.13  #: greatest lapse rate in either tail that is considered: beyond, there is no interval
_SLOPE_LIKELIHOOD_LAPSES = (LAPSE_EDGES[1:] + LAPSE_EDGES[:-1]) / 2
_USUAL = LAPSE_EDGES[1:] <= MOST_LAPSES + 1e-9
_SLOPE_LIKELIHOOD_CUT = 1.9207  #: half of the 95 % quantile of χ² with one degree of freedom
_SMALL = 12.0  #: trials; by simulation: with few of them the likelihood ratio is greater than χ² by this much over them
_BEND = 1.2  #: slopes are equally far apart up to here, from here on in their logarithm
_STEEPEST = 60.0  #: spread of a sixtieth of the range; and six times the inverse of the least distance of two levels
_TAIL = 3.2  #: standard deviations beyond the outermost level that intercepts reach
_SLOPES, _FINE = 41, 25  #: slopes at which everybody's likelihood is computed first, and then each person's
_TINY = 1e-12


@dataclass(frozen=True)
class SlopeLikelihood:
    """Everybody's answers, each person by themselves; all arrays by person.

    weights  (9,) probabilities of the lapse rates' cells; None: equal up to `MOST_LAPSES`
    """

    answered: LevelCounts
    weights: Array | None = None

    @cached_property
    def scale(self) -> tuple[float, float]:
        """Middle and range of the levels."""
        x = self.answered.levels
        return float(x[0] + x[-1]) / 2, float(x[-1] - x[0])

    @cached_property
    def units(self) -> Array:
        """(levels,) u, from −½ to ½."""
        middle, span = self.scale
        found: Array = (self.answered.levels - middle) / span
        return found

    @cached_property
    def log_weights(self) -> Array:
        """(9,) logarithms; −∞ where a lapse rate is not considered."""
        if self.weights is None:
            cells = np.diff(np.minimum(LAPSE_EDGES, MOST_LAPSES))
            cells = cells / cells.sum()
        else:
            cells = self.weights
        with np.errstate(divide="ignore"):
            found: Array = np.log(cells)
        return found

    @cached_property
    def cuts(self) -> Array:
        """(people,) by how much the log likelihood may be below its greatest value inside an interval."""
        found: Array = _SLOPE_LIKELIHOOD_CUT * (1 + _SMALL / np.maximum(self.answered.of.sum(axis=1), 1))
        return found

    @cached_property
    def steepest(self) -> float:
        """The slope from which on the function is a step, for these levels."""
        return min(_STEEPEST, 6 / float(np.diff(self.units).min()))

    # --- likelihood ---------------------------------------------------------------------------------------------------

    def log_likelihood(self, slopes: Array, intercepts: Array) -> Array:
        """(people, ...) with λ integrated over, of each person's own slopes and intercepts (people, ...)."""
        return self._differentiate(slopes, intercepts)[0]

    def _differentiate(self, slopes: Array, intercepts: Array) -> tuple[Array, Array, Array]:
        """Log likelihood, its derivative by the intercept, and the information on it, (people, n) each."""
        from scipy.special import ndtr

        used = np.flatnonzero(np.isfinite(self.log_weights))
        z = intercepts[..., None] + slopes[..., None] * self.units
        rise, density = ndtr(z), np.exp(-z * z / 2) / math.sqrt(2 * math.pi)
        yes = self.answered.yes[:, None, :]
        no = (self.answered.of - self.answered.yes)[:, None, :]
        logs, firsts, informations = [], [], []
        for n in used:
            part = 1 - 2 * _SLOPE_LIKELIHOOD_LAPSES[n]
            p = _SLOPE_LIKELIHOOD_LAPSES[n] + part * rise
            change = part * density
            logs.append((yes * np.log(p) + no * np.log1p(-p)).sum(axis=-1) + self.log_weights[n])
            firsts.append((change * (yes / p - no / (1 - p))).sum(axis=-1))
            informations.append(((yes + no) * change**2 / (p * (1 - p))).sum(axis=-1))
        stack = np.array(logs)
        most = stack.max(axis=0)
        share = np.exp(stack - most)
        total = share.sum(axis=0)
        share /= total
        return most + np.log(total), (share * firsts).sum(axis=0), (share * informations).sum(axis=0)

    def _climb(self, slopes: Array, intercepts: Array, steps: int) -> tuple[Array, Array, Array]:
        """Best intercepts near those given, their log likelihood and information: scoring, never downwards."""
        limit = _TAIL + np.abs(slopes) / 2
        c = np.clip(intercepts, -limit, limit)
        value, first, information = self._differentiate(slopes, c)
        for _ in range(steps):
            step = np.clip(first / np.maximum(information, 1e-3), -1.0, 1.0)
            tried = np.clip(c + step, -limit, limit)
            new = self._differentiate(slopes, tried)
            better = new[0] >= value
            c = np.where(better, tried, c)
            value, first, information = (
                np.where(better, one, other) for one, other in zip(new, (value, first / 2, information), strict=True)
            )
        return c, value, information

    # --- profile over the slope ---------------------------------------------------------------------------------------

    @cached_property
    def _rough(self) -> tuple[Array, Array, Array, Array]:
        """Slopes (s,), best intercepts and log likelihoods (people, s), and the greatest with each rate of lapses."""
        from scipy.special import ndtr

        bend = np.arcsinh(self.steepest / _BEND)
        slopes = _BEND * np.sinh(np.linspace(-bend, bend, _SLOPES))
        count = int(np.ceil((2 * _TAIL + self.steepest) / 1.3)) + 1
        intercepts = np.linspace(-1, 1, count) * (_TAIL + np.abs(slopes[:, None]) / 2)
        rise = ndtr(intercepts[..., None] + slopes[:, None, None] * self.units).reshape(-1, len(self.units))
        yes, no = self.answered.yes, self.answered.of - self.answered.yes
        best = np.full((len(yes), len(_SLOPE_LIKELIHOOD_LAPSES)), -np.inf)
        total = np.full((len(yes), len(rise)), -np.inf)
        for n, lapse in enumerate(_SLOPE_LIKELIHOOD_LAPSES):
            p = np.clip(lapse + (1 - 2 * lapse) * rise, _TINY, 1 - _TINY)
            logs = yes @ np.log(p).T + no @ np.log1p(-p).T
            best[:, n] = logs.max(axis=1)
            if np.isfinite(self.log_weights[n]):
                total = np.logaddexp(total, logs + self.log_weights[n])
        each = total.reshape(len(yes), _SLOPES, count)
        start = np.take_along_axis(np.broadcast_to(intercepts, each.shape), each.argmax(axis=2)[..., None], 2)[..., 0]
        wide = np.broadcast_to(slopes, start.shape)
        c, value, _ = self._climb(wide, start, 4)
        return slopes, c, value, best

    @cached_property
    def _profile(self) -> tuple[Array, Array, Array, Array]:
        """Slopes, best intercepts, log likelihoods and information of the intercepts, (people, f) each.

        Only where a person's likelihood is not negligible; slopes are equally far apart in asinh(b/1.2).
        """
        slopes, c, value, _ = self._rough
        axis = np.arcsinh(slopes / _BEND)
        step = axis[1] - axis[0]
        near = value >= value.max(axis=1, keepdims=True) - 3 * self.cuts[:, None]
        low = np.maximum(axis[near.argmax(axis=1)] - step, axis[0])
        high = np.minimum(axis[len(axis) - 1 - near[:, ::-1].argmax(axis=1)] + step, axis[-1])
        fine = low[:, None] + (high - low)[:, None] * np.linspace(0, 1, _FINE)
        start = np.array([np.interp(one, axis, row) for one, row in zip(fine, c, strict=True)])
        nearest = np.abs(fine[..., None] - axis).argmin(axis=-1)
        other = np.take_along_axis(c, nearest, 1)
        wide = _BEND * np.sinh(fine)
        start = np.where(self.log_likelihood(wide, other) > self.log_likelihood(wide, start), other, start)
        return wide, *self._climb(wide, start, 3)

    @cached_property
    def _dense(self) -> tuple[Array, Array, Array]:
        """Slopes, log likelihoods and intercepts (people, 32 f) by splines, and never below the computed points."""
        from scipy.interpolate import CubicSpline

        slopes, c, value, _ = self._profile
        count = 32 * (_FINE - 1) + 1
        place = np.linspace(0, _FINE - 1, count)
        bent = np.arcsinh(slopes / _BEND)
        axis = bent[:, :1] + (bent[:, -1:] - bent[:, :1]) * place / (_FINE - 1)
        smooth = CubicSpline(np.arange(_FINE), value, axis=1)(place)
        middles = np.array([np.interp(place, np.arange(_FINE), row) for row in c])
        return _BEND * np.sinh(axis), smooth, middles

    # --- what it says -------------------------------------------------------------------------------------------------

    @cached_property
    def slope_95(self) -> tuple[Array, Array]:
        """(low, high) of b for each person; −∞ and ∞ where the likelihood does not fall towards a step."""
        slopes, value, _ = self._dense
        inside = value >= value.max(axis=1, keepdims=True) - self.cuts[:, None]
        first = inside.argmax(axis=1)
        last = inside.shape[1] - 1 - inside[:, ::-1].argmax(axis=1)
        rows = np.arange(len(slopes))
        low = np.where((first == 0) & (slopes[:, 0] < -0.99 * self.steepest), -np.inf, slopes[rows, first])
        high = np.where(
            (last == inside.shape[1] - 1) & (slopes[:, -1] > 0.99 * self.steepest), np.inf, slopes[rows, last]
        )
        return low, high

    @cached_property
    def too_many_lapses(self) -> NDArray[np.bool_]:
        """(people,) whether lapse rates above `MOST_LAPSES` are clearly more likely than all below."""
        best = self.by_lapse
        found: NDArray[np.bool_] = best[:, ~_USUAL].max(axis=1) - best[:, _USUAL].max(axis=1) > 2 * self.cuts
        return found

    def direction(self, person: int) -> Direction:
        """Whether it is established that the share of answers rises or falls with the level."""
        low, high = (float(end[person]) for end in self.slope_95)
        return "rising" if low > 0 else "falling" if high < 0 else "unknown"

    def spread_95(self, person: int) -> tuple[float, float]:
        """Of the spread, in units of the level; 0 and ∞ are open ends, NaN without an interval.

        Where the direction is not established, the lower limit is that of both: nobody knows how the keys were taken.
        """
        low, high = (float(end[person]) for end in self.slope_95)
        if self.too_many_lapses[person]:
            return math.nan, math.nan
        steep, shallow = max(high, -low), max(low, -high)
        span = self.scale[1]
        return span / steep, (span / shallow if shallow > 0 else math.inf)

    def threshold_95(self, person: int) -> tuple[float, float]:
        """Of the level where Φ = ½; −∞ and ∞ are open ends, both where the answers tell nothing of it.

        Where the direction is not established and more likely rises, keys are taken to be as instructed.
        """
        if self.too_many_lapses[person]:
            return math.nan, math.nan
        middle, span = self.scale
        sign = -1.0 if self.direction(person) == "falling" else 1.0
        b, low, high = self._outline(person)
        known = sign * b > 1e-9
        if not known.any() or (self.direction(person) == "unknown" and self._falls_more_likely(person)):
            return -math.inf, math.inf
        ends = np.concatenate([-low[known] / b[known], -high[known] / b[known]])
        least, most = float(ends.min()), float(ends.max())
        if self.direction(person) == "unknown":  # at b = 0 thresholds are infinite, on the side that c has there
            flat = int(np.abs(b).argmin())
            least = -math.inf if high[flat] > 0 else least
            most = math.inf if low[flat] < 0 else most
        return middle + span * least, middle + span * most

    @cached_property
    def estimates(self) -> tuple[Array, Array]:
        """(people,) slopes and intercepts of greatest likelihood."""
        slopes, value, intercepts = self._dense
        rows, best = np.arange(len(slopes)), value.argmax(axis=1)
        return slopes[rows, best], intercepts[rows, best]

    @property
    def by_lapse(self) -> Array:
        """(people, 9) greatest log likelihood with each lapse rate, without weights."""
        return self._rough[3]

    @cached_property
    def common(self) -> tuple[Array, Array, Array, Array]:
        """Slopes (n,), the same for all people, and log likelihood, its derivative, best intercept (people, n)."""
        from scipy.interpolate import CubicSpline

        slopes, c, value, _ = self._rough
        axis = np.arcsinh(slopes / _BEND)
        fine = np.linspace(axis[0], axis[-1], 1601)
        spline = CubicSpline(axis, value, axis=1)
        dense = _BEND * np.sinh(fine)
        middles = np.array([np.interp(fine, axis, row) for row in c])
        return dense, spline(fine), spline(fine, 1) / (_BEND * np.cosh(fine)), middles

    def curve(self, person: int, lapse: float) -> PsychometricCurve:
        """The function of greatest likelihood, with `lapse`; a falling one has a negative spread."""
        b, c = (float(one[person]) for one in self.estimates)
        middle, span = self.scale
        b = b if abs(b) > 1e-6 else math.copysign(1e-6, b)
        return PsychometricCurve(middle - span * c / b, span / b, lapse, lapse)

    def lapses(self, person: int) -> Array:
        """(9,) probabilities of the lapse rates' cells at the greatest likelihood, before the person's own weights."""
        from scipy.special import ndtr

        slopes, intercepts = self.estimates
        rise = ndtr(intercepts[person] + slopes[person] * self.units)
        p = np.clip(
            _SLOPE_LIKELIHOOD_LAPSES[:, None] + (1 - 2 * _SLOPE_LIKELIHOOD_LAPSES[:, None]) * rise, _TINY, 1 - _TINY
        )
        yes = self.answered.yes[person]
        logs = np.log(p) @ yes + np.log1p(-p) @ (self.answered.of[person] - yes) + self.log_weights
        mass = np.exp(logs - logs.max())
        found: Array = mass / mass.sum()
        return found

    def nearby(self, person: int, far: float = 3.5, count: int = 13) -> Array:
        """(points, levels) probabilities of functions near the most likely one, lapses too: to fit repetitions at."""
        from scipy.special import ndtr

        slopes, c, value, information = (one[person] for one in self._profile)
        keep = np.flatnonzero(value >= value.max() - far**2 / 2)
        keep = keep[:: max(1, len(keep) // 16)]
        width = 1 / np.sqrt(np.maximum(information[keep], 0.05))
        intercepts = c[keep][:, None] + width[:, None] * np.linspace(-far, far, count)
        rise = ndtr(intercepts[..., None] + slopes[keep][:, None, None] * self.units).reshape(-1, 1, len(self.units))
        usual = np.append(0.0, _SLOPE_LIKELIHOOD_LAPSES[1::2])[:, None]
        found: Array = np.clip(usual + (1 - 2 * usual) * rise, _TINY, 1 - _TINY).reshape(-1, len(self.units))
        return found

    def _falls_more_likely(self, person: int) -> bool:
        """Whether a falling function explains the answers better than every rising one."""
        slopes, value = self._dense[0][person], self._dense[1][person]
        rising, falling = (value[side].max(initial=-np.inf) for side in (slopes >= 0, slopes < 0))
        return bool(falling > rising + 0.1)

    def _outline(self, person: int) -> tuple[Array, Array, Array]:
        """Slopes, and the least and greatest intercept inside the interval at each, its two tips among them.

        Between slopes, squares of the distances from the best intercept are interpolated: near a tip they are linear.
        """
        slopes, c, low, high, inside = (one[person] for one in self._region)
        tips = np.clip([end[person] for end in self.slope_95], slopes[0], slopes[-1])
        between = slopes[inside & (slopes > tips[0]) & (slopes < tips[1])]
        nodes = np.unique(np.concatenate([tips, between, [0.0] if tips[0] < 0 < tips[1] else []]))
        fine = np.interp(np.linspace(0, len(nodes) - 1, 12 * (len(nodes) - 1) + 1), np.arange(len(nodes)), nodes)
        dense = self._dense
        best = np.interp(fine, dense[0][person], dense[2][person])
        bounds = []
        for side, ends in ((-1.0, low), (1.0, high)):
            squares = np.where(np.isfinite(ends), ends - c, 1e150) ** 2 * inside
            known = np.interp(nodes, slopes, squares)
            known = np.where(np.isin(nodes, tips) & ~np.isin(nodes, slopes[[0, -1]]), 0.0, known)
            width = np.sqrt(np.interp(fine, nodes, known))
            bounds.append(np.where(width > 1e9, side * np.inf, best + side * width))
        return fine, bounds[0], bounds[1]

    @cached_property
    def _region(self) -> tuple[Array, Array, Array, Array, NDArray[np.bool_]]:
        """Slopes, the best, least and greatest intercept at each, ±∞ without an end, and which are inside.

        The root of the likelihood's fall is nearly linear in the intercept: Newton's steps need few.
        """
        slopes, c, value, information = (one[:, ::2] for one in self._profile)
        room = np.sqrt(np.maximum(2 * (value - self._profile[2].max(axis=1, keepdims=True) + self.cuts[:, None]), 0.0))
        inside = room > 0
        found = []
        for side in (-1.0, 1.0):
            limit = _TAIL + np.abs(slopes) / 2 + 1.0
            away = room / np.sqrt(np.maximum(information, 0.02))
            for _ in range(5):
                at = np.clip(c + side * away, -limit, limit)
                now, first, _ = self._differentiate(slopes, at)
                fall = np.sqrt(np.maximum(2 * (value - now), 1e-12))
                steep = np.maximum(-side * first / fall, 1e-3)
                away = np.clip(away + np.clip((room - fall) / steep, -away / 2, 1.0), 0.0, 2 * limit)
            endless = (np.abs(c + side * away) >= limit) & (fall < room)
            found.append(np.where(endless, side * np.inf, c + side * away))
        return slopes, c, found[0], found[1], inside


# --------------------------------------------------------------------------------------------------
# The psychometric function of each person: estimates, intervals, how well it fits, and what the trials cannot tell.


Interval = tuple[float, float]
#: what trials do not determine
ONE_LEVEL = "answers at one level only: they determine no function"
UPPER_LIMIT = "the answers change from one level to the next: the spread has only an upper limit"
FLAT = "the answers hardly depend on the level: the spread has only a lower limit"
NO_LIMIT = "the answers set no limit to the spread: too few trials, or nearly all answers the same"
REVERSED = "the answers fall with the level: the keys were probably reversed"
LAPSES = f"more than {200 * MOST_LAPSES:.0f} % of the trials seem to be answered at random: no interval"
_UNKNOWN = (math.nan, math.nan)
_SAMPLES = 400  #: simulated repetitions of a person's trials


@dataclass(frozen=True)
class PersonFit:
    """The function of greatest likelihood, and 95 % intervals; 0 and ±∞ are open ends, NaN is unknown.

    A curve that falls with the level has a negative spread.
    """

    trials: int
    curve: PsychometricCurve
    middle_95: Interval
    spread_95: Interval
    guess_95: Interval
    lapse_95: Interval
    deviance: float  #: of the greatest likelihood against a share of its own for every level
    p_fit: float  #: share of simulated repetitions with so great a deviance or a greater one
    notes: tuple[str, ...] = field(default=())

    @property
    def middle(self) -> float:
        """Threshold; NaN where its interval has an open end."""
        return self.curve.middle if all(map(math.isfinite, self.middle_95)) else math.nan

    @property
    def spread(self) -> float:
        """NaN where its interval has an open end."""
        low, high = self.spread_95
        return abs(self.curve.spread) if low > 0 and math.isfinite(high) else math.nan

    def numbers(self) -> dict[str, Any]:
        """As plain JSON types; what is not a number, or an end that does not exist, is None."""
        curve = self.curve
        return {
            "trials": self.trials,
            "middle": _to_json(self.middle), "middle_95": [_to_json(end) for end in self.middle_95],
            "spread": _to_json(self.spread), "spread_95": [_to_json(end) for end in self.spread_95],
            "jnd_75_percent": _to_json(0.6745 * self.spread),
            "guess": _to_json(curve.guess), "guess_95": [_to_json(end) for end in self.guess_95],
            "lapse": _to_json(curve.lapse), "lapse_95": [_to_json(end) for end in self.lapse_95],
            "deviance": _to_json(self.deviance), "p_fit": _to_json(self.p_fit), "notes": list(self.notes),
        }  # fmt: skip


def psychometric_fit(levels: ArrayLike, yes: ArrayLike, of: ArrayLike) -> PsychometricCurve:
    """Posterior means for one person: `yes` (n,) out of `of` (n,) at `levels` (n,), ascending; γ = λ.

    With the priors of psignifit 4, so that everybody has a number to be compared, whatever the answers. InputError with
    fewer than two levels.
    """
    counts = (np.asarray(values, dtype=float) for values in (yes, of))
    grid = PsychometricGrid.enclose(LevelCounts(np.asarray(levels, dtype=float), *(n[None, :] for n in counts)))
    mass = grid.posterior[0]
    lapse = float(mass.sum(axis=(0, 1)) @ grid.lapses)
    spread = math.exp(float(mass.sum(axis=(0, 2)) @ grid.log_spreads))
    return PsychometricCurve(float(mass.sum(axis=(1, 2)) @ grid.thresholds), spread, lapse, lapse)


def fit_person(likelihood: SlopeLikelihood, person: int, *, seed: int = 0, samples: int = _SAMPLES) -> PersonFit:
    """The fit of one of the people in `likelihood`; without `samples` its goodness is not computed.

    With answers at one level only, nothing is known: all numbers are NaN.
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
    """What the trials of one person cannot tell."""
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
    """Deviance, and the share of simulated repetitions, each fitted, with at least this deviance (Wichmann 2001)."""
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
    """(k,) log likelihood of answers (k, levels) with a share of its own for every level."""
    from scipy.special import xlogy

    share = yes / np.maximum(of, 1)
    found: Array = (xlogy(yes, share) + xlogy(of - yes, 1 - share)).sum(axis=-1)
    return found


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


# --------------------------------------------------------------------------------------------------
# The group behind some people: mean and standard deviation of threshold and log spread, from everybody's answers.
#
# Every person has a threshold μ_i ~ N(M, T²), a log spread log σ_i ~ N(S, U²) and a lapse rate λ_i ~ Beta(1, 1/m − 1).
# The likelihood of one person's answers is known on a grid and integrated over these distributions. M, S and m maximise
# the product over people; T and U the same after M or S is integrated out (restricted likelihood). Intervals of M and
# S: Student's quantile with n − 1 degrees of freedom times a standard error from how much people's scores differ
# (sandwich), which is right however much or little people differ; of T and U: likelihood ratio. Where everybody answers
# alike, as where nobody errs, scores have no spread to go by: then the standard error is that of the likelihood, with
# the normal quantile.


_TYPICAL_LAPSE, _LAPSE_SPREAD = 0.02, 1.0  #: of the group's mean lapse rate: median, standard deviation of its log
#: mean lapse rates of groups, equally probable up to the last, over which the slope's interval is taken; and shapes a
#: of their distributions Beta(a, a/m − a): many near zero, or people who are alike
_MEAN_LAPSES = np.array([0.005, 0.02, 0.04, 0.065, 0.09, 0.12])
_LAPSE_MODELS = [(float(mean), shape) for shape in (1.0, 20.0) for mean in _MEAN_LAPSES]
#: of the slope's standard error per unit of the mean lapse rate: a slope and a lapse rate from the same few answers
#: differ together, which the information of neither says. Chosen on simulated groups, tested on others (documentation)
_WIDER = 3.2
_HIERARCHICAL_CUT = 1.9207  #: half of the 95 % quantile of χ² with one degree of freedom
_SHALLOW = 2.0  #: of the levels' range: spreads that may be greater are averaged as slopes
_PASSES = 6
_CANDIDATES, _TRIED = 24, 25  #: standard deviations and means that are compared before anything is refined


@dataclass(frozen=True)
class NormalEffect:
    """A quantity that differs between people."""

    mean: float  #: of the population
    mean_95: tuple[float, float]
    sd: float  #: between people
    sd_95: tuple[float, float]


@dataclass(frozen=True)
class Population:
    """The group's psychometric function."""

    people: int
    threshold: NormalEffect
    log_spread: NormalEffect
    lapse: float  #: mean lapse rate
    by_slope: bool = (
        False  #: whether it is the function of the mean slope, because somebody's spread has no upper limit
    )


def fit_group(likelihood: SlopeLikelihood) -> Population | None:
    """The group behind the people in `likelihood`; None with fewer than two whose answers do not fall with the level.

    Where everybody's spread has an upper limit, thresholds and log spreads are normal over people. Where somebody's has
    none, or one beyond twice the range of the levels, a logarithm has no place for it: then slopes and intercepts are
    averaged, with Student's intervals over people, and the threshold has Fieller's. An end that does not exist is ±∞.
    """
    answered = likelihood.answered
    ends = np.array([likelihood.spread_95(n) for n in range(len(answered.of))])
    used = np.count_nonzero(answered.of, axis=1) > 1
    used &= [likelihood.direction(n) != "falling" for n in range(len(used))]
    if np.count_nonzero(used) < 2:
        return None
    kept = LevelCounts(answered.levels, answered.yes[used], answered.of[used])
    ends = ends[used]
    middle, span = likelihood.scale
    if (ends[:, 1] > _SHALLOW * span).any():
        return _average_slopes(kept)
    places = np.array([likelihood.threshold_95(int(n)) for n in np.flatnonzero(used)])
    places = places[np.isfinite(places).all(axis=1)]
    far = np.clip(np.abs(places - middle).max(initial=span), span, 4 * span)
    most = float(np.clip(2 * np.nanmax(ends[:, 1]), 2 * span, 40 * span)) if np.isfinite(ends).any() else 2 * span
    least = max(float(np.diff(answered.levels).min()) / 6, span / 300)
    grid = PsychometricGrid.enclose(kept, limits=(middle - far, middle + far), spreads=(least, most))
    found = fit_population(grid)
    if 2 * np.count_nonzero(ends[:, 0] == 0) > len(ends):  # steeper than most people's levels resolve
        spread = found.log_spread
        found = replace(found, log_spread=replace(spread, mean_95=(-np.inf, spread.mean_95[1])))
    return found


def _average_slopes(answered: LevelCounts) -> Population:
    """The function of the mean slope and intercept over people, with open ends where these are not told from zero."""
    from scipy.special import stdtrit

    # Of a shallow function only (1 − 2λ) b is told: lapses are those of the model above without data.
    likelihood = SlopeLikelihood(answered, _weigh_lapses(np.log(_TYPICAL_LAPSE)))
    slopes, value, scores, intercepts = likelihood.common
    people = len(scores)
    t = float(stdtrit(people - 1, 0.975))
    # Everybody's score at a common slope, with an intercept of their own: its mean by its spread over people.
    at = int(value.sum(axis=0).argmax())
    error = np.sqrt(scores.var(axis=0, ddof=1) / people)
    # By chance as much as the likelihood is curved, with the normal quantile, where people differ less than by chance.
    expected = np.sqrt(np.maximum(-np.gradient(scores.mean(axis=0), slopes), 1e-12) / people)
    above = _tail(scores.mean(axis=0), error, expected, people)
    # With another mean lapse rate the same (1 − 2λ) b belongs to another b.
    same = (1 - 2 * _MEAN_LAPSES[:, None]) / (1 - 2 * _TYPICAL_LAPSE) * slopes
    above = _share_lapses() @ np.array([np.interp(row, slopes, above) for row in same])
    told = (above < 0.025) | (above > 0.975)
    first, last = at, at
    while first > 0 and not told[first - 1]:
        first -= 1
    while last < len(slopes) - 1 and not told[last + 1]:
        last += 1
    slope, shallow, steep = float(slopes[at]), float(slopes[first]), float(slopes[last])
    near = slice(max(at - 8, 0), at + 9)
    bread = -np.polyfit(slopes[near], scores[:, near].sum(axis=0), 1)[0] / people
    bend = np.array([np.polyfit(slopes[near], row, 1)[0] for row in intercepts[:, near]])
    b = slope + (scores[:, at] - scores[:, at].mean()) / max(float(bread), 1e-9)
    c = intercepts[:, at] + bend * (b - slope)
    intercept = float(c.mean())
    (rise, both), (_, shift) = np.cov(b, c) / people
    middle, span = likelihood.scale
    if steep > 0:
        log_95 = (float(np.log(span / steep)), float(np.log(span / shallow)) if shallow > 0 else np.inf)
    else:  # falling
        log_95 = (np.nan, np.nan)
    # Fieller: levels at which the mean of c + b u is not told from zero.
    two, one, zero = slope**2 - t * t * rise, slope * intercept - t * t * both, intercept**2 - t * t * shift
    inner = one * one - two * zero
    low, high = -np.inf, np.inf
    if inner > 0 and steep > 0:
        roots = sorted((-one + sign * np.sqrt(inner)) / two for sign in (-1.0, 1.0))
        if shallow > 0 and two > 0:
            low, high = roots
        elif intercept > 0:
            high = roots[0]
        else:
            low = roots[1]
    unknown = (np.nan, np.nan)
    mean = float(np.log(span / slope)) if slope > 0 else np.inf
    place = middle - span * intercept / slope if slope != 0 else np.nan
    return Population(
        people,
        NormalEffect(place, (middle + span * low, middle + span * high), np.nan, unknown),
        NormalEffect(mean, log_95, np.nan, unknown), _TYPICAL_LAPSE, by_slope=True,
    )  # fmt: skip


def fit_normal_effect(values: Array, likelihoods: Array) -> NormalEffect:
    """One quantity x_i ~ N(mean, sd²), whose likelihoods (people, n) are known at `values` (n,), equal steps.

    InputError with fewer than two people.
    """
    from scipy.special import stdtrit

    people = len(likelihoods)
    if people < 2:
        raise InputError(f"a group needs at least two people; got {people}")
    fine, finer = _refine(values, likelihoods)
    sd, sd_95, floor = _estimate_sd(fine, finer)
    used = max(sd, floor)
    mean = _mean_at(fine, finer, np.array([used]))
    score, information = _scores(fine, finer, mean, np.array([used]))
    # Each score as it would be without its person (MacKinnon, White 1985), since some tell much more than others.
    share = np.clip(information[:, 0] / information.sum(), 0.0, 0.9)
    left_out = score[:, 0] / (1 - share)
    error = np.sqrt((people - 1) / people * (left_out**2).sum()) / information.sum()
    half = float(stdtrit(people - 1, 0.975) * error)
    return NormalEffect(float(mean[0]), (float(mean[0]) - half, float(mean[0]) + half), sd, sd_95)


def fit_population(grid: PsychometricGrid) -> Population:
    """The group behind the people whose answers `grid` has. InputError with fewer than two people."""
    likelihoods, alone = (array[grid.answered.of.any(axis=1)] for array in (grid.likelihoods, grid.posterior))
    people = len(likelihoods)
    if people < 2:
        raise InputError(f"a group needs at least two people; got {people}")
    x, y = grid.thresholds, grid.log_spreads
    at = np.array([
        (alone.sum(axis=(2, 3)) @ x).mean(), (alone.sum(axis=(1, 3)) @ y).mean(), np.log(_TYPICAL_LAPSE),
    ])  # fmt: skip
    t = u = 0.0
    t_95 = u_95 = (0.0, 0.0)
    scores, information = np.zeros((people, 3)), np.eye(3)
    for _ in range(_PASSES):
        before = at.copy(), t, u
        weights = _weigh(y, at[1], u), _weigh_lapses(at[2])
        t, t_95, _ = _estimate_sd(*_refine(x, (likelihoods @ weights[1]) @ weights[0]))
        weights = _weigh(x, at[0], t), _weigh_lapses(at[2])
        u, u_95, _ = _estimate_sd(*_refine(y, np.einsum("pms,m->ps", likelihoods @ weights[1], weights[0])))
        for _ in range(3 if before[1] == 0 else 2):
            scores, information = _joint_scores(likelihoods, (x, y), at, (t, u))
            at = at + _limit_step(np.linalg.solve(information, scores.sum(axis=0)), x, y)
        size = np.sqrt(np.diag(np.linalg.inv(information)))
        if (np.abs(at - before[0]) < 0.03 * size).all() and abs(t - before[1]) + abs(u - before[2]) < 0.02 * (t + u):
            break
    inverse = np.linalg.inv(information)
    error = np.sqrt(np.diag(inverse @ (scores.T @ scores) @ inverse) * people / (people - 1))
    half = _halve(error, np.sqrt(np.diag(inverse)), people)[0]
    return Population(
        people,
        NormalEffect(float(at[0]), (float(at[0] - half), float(at[0] + half)), t, t_95),
        NormalEffect(*_bound_log_spread(likelihoods, (x, y), at, (t, u)), u, u_95),
        float(np.exp(at[2])),
    )  # fmt: skip


def _bound_log_spread(
    likelihoods: Array, axes: tuple[Array, Array], at: Array, sds: tuple[float, float]
) -> tuple[float, tuple[float, float]]:
    """S and its 95 % interval: Student's with each distribution of lapse rates, weighted by how likely it is."""
    from scipy.optimize import brentq

    people, found, logs = len(likelihoods), [], []
    place = at[:2].copy()
    for mean, shape in _LAPSE_MODELS:
        known = likelihoods @ _weigh_lapses(np.log(mean), shape)
        for _ in range(2):
            scores, information, _ = _place_scores(known, axes, place, sds)
            place = place + _limit_step(np.append(np.linalg.solve(information, scores.sum(axis=0)), 0.0), *axes)[:2]
        scores, information, value = _place_scores(known, axes, place, sds)
        inverse = np.linalg.inv(information)
        error = np.sqrt((inverse @ (scores.T @ scores) @ inverse)[1, 1] * people / max(people - 1, 1))
        wider = 1.0 + _WIDER * mean
        found.append((place[1], wider * error, wider * np.sqrt(inverse[1, 1])))
        logs.append(value)
    means, errors, expected = np.array(found).T
    weights = np.exp(np.array(logs) - max(logs)) * np.tile(_share_lapses(), 2)
    weights /= weights.sum()

    def share_below(place: float, share: float) -> float:
        return float(weights @ _tail(means - place, errors, expected, people)) - share

    far = 200 * float(np.maximum(errors, expected).max())
    low, high = (float(brentq(share_below, means.min() - far, means.max() + far, (share,))) for share in (0.025, 0.975))
    return float(weights @ means), (low, high)


def _share_lapses() -> Array:
    """(6,) weights of the mean lapse rates, each that of the rates nearest to it."""
    edges = np.concatenate([[0.0], (_MEAN_LAPSES[1:] + _MEAN_LAPSES[:-1]) / 2, _MEAN_LAPSES[-1:]])
    found: Array = np.diff(edges) / edges[-1]
    return found


def _place_scores(
    known: Array, axes: tuple[Array, Array], at: Array, sds: tuple[float, float]
) -> tuple[Array, Array, float]:
    """As `_joint_scores` by (M, S) alone, of likelihoods (people, m, s) whose lapse rates are integrated over."""
    bases, least = [], []
    for values, mean, sd in zip(axes, at, sds, strict=True):
        least.append(_least_sd(values, sd))
        w, a = _weigh(values, mean, sd), (values - mean) / least[-1] ** 2
        bases.append(np.stack([w, w * a, w * a**2], axis=1))
    moments = np.einsum("pmb,ma->pab", known @ bases[1], bases[0], optimize=True)
    value = float(np.log(moments[:, 0, 0]).sum())
    moments /= moments[:, :1, :1]
    score = np.stack([moments[:, 1, 0], moments[:, 0, 1]], axis=1)
    both = moments[:, 1, 1]
    square = np.stack([np.stack([moments[:, 2, 0], both], axis=1), np.stack([both, moments[:, 0, 2]], axis=1)], axis=1)
    curved = np.diag(len(known) / np.array(least) ** 2)
    information = curved - (square - score[:, :, None] * score[:, None, :]).sum(axis=0)
    size = np.linalg.eigvalsh(information)
    if size[0] <= 1e-6 * size[-1]:
        information = score.T @ score + np.diag(np.diag(np.abs(information))) * 0.1
    return score, information, value


def _tail(away: Array, error: Array, expected: Array, people: int) -> Array:
    """Probability of more than `away`, by the standard errors and quantiles of `_halve`."""
    from scipy.special import ndtr, stdtr

    alike = _halve(error, expected, people) == 1.96 * expected
    with np.errstate(divide="ignore", invalid="ignore"):
        found: Array = np.where(alike, ndtr(-away / expected), stdtr(people - 1, -away / error))
    return found


def _halve(error: Array, expected: Array, people: int) -> Array:
    """Half of the 95 % intervals from standard errors by people's differences, and those `expected` by likelihood.

    Those of the likelihood serve where people differ less than they do by chance in 999 of 1000 groups.
    """
    from scipy.special import chdtri, stdtrit

    least = expected * np.sqrt(chdtri(people - 1, 0.999) / (people - 1))
    found: Array = np.where(error < least, 1.96 * expected, stdtrit(people - 1, 0.975) * error)
    return found


def _refine(values: Array, likelihoods: Array) -> tuple[Array, Array]:
    """(g,) and (people, g): between the grid's points, with steps of a quarter of the most certain person's spread."""
    from scipy.interpolate import CubicSpline

    mass = likelihoods / likelihoods.sum(axis=1, keepdims=True)
    spread = np.sqrt(np.maximum(mass @ values**2 - (mass @ values) ** 2, 0.0)).min()
    step = max(float(spread) / 4, float(values[1] - values[0]) / 8)
    fine = np.linspace(values[0], values[-1], int(np.ceil((values[-1] - values[0]) / step)) + 1)
    logs = CubicSpline(values, np.log(np.maximum(likelihoods, 1e-300)), axis=1)(fine)
    return fine, np.exp(logs - logs.max(axis=1, keepdims=True))


def _estimate_sd(values: Array, likelihoods: Array) -> tuple[float, tuple[float, float], float]:
    """Standard deviation between people, its 95 % interval, and the least that the grid can tell from zero."""
    from scipy.interpolate import CubicSpline

    floor = float(values[1] - values[0])
    candidates = np.geomspace(floor, values[-1] - values[0], _CANDIDATES)
    mean = _mean_at(values, likelihoods, candidates)
    _, information = _scores(values, likelihoods, mean, candidates)
    joint = np.maximum(likelihoods @ _normal(values, mean, candidates), 1e-300)
    logs = np.log(joint).sum(axis=0) - np.log(np.maximum(information.sum(axis=0), 1e-12)) / 2
    above = np.linspace(np.log(candidates[0]), np.log(candidates[-1]), 600)[1:]
    # Below the least candidate nothing can be integrated; near zero the likelihood is linear in the variance.
    below = np.linspace(0.0, floor, 30)
    slope = (logs[1] - logs[0]) / (candidates[1] ** 2 - candidates[0] ** 2)
    sds = np.append(below, np.exp(above))
    fine = np.append(logs[0] + slope * (below**2 - floor**2), CubicSpline(np.log(candidates), logs)(above))
    best = int(np.argmax(fine))
    low = high = best
    while low > 0 and fine[low - 1] >= fine[best] - _HIERARCHICAL_CUT:
        low -= 1
    while high < len(fine) - 1 and fine[high + 1] >= fine[best] - _HIERARCHICAL_CUT:
        high += 1
    return float(sds[best]), (float(sds[low]), float(sds[high])), floor


def _normal(values: Array, mean: Array, sd: Array) -> Array:
    """(n, k) probabilities of `values` (n,), equal steps, under k normal distributions."""
    step = values[1] - values[0]
    found: Array = np.exp(-0.5 * ((values[:, None] - mean) / sd) ** 2) * (step / (sd * np.sqrt(2 * np.pi)))
    return found


def _mean_at(values: Array, likelihoods: Array, sd: Array) -> Array:
    """(k,) means of greatest likelihood, one for each standard deviation: the best of some, then Newton's steps."""
    mass = likelihoods / likelihoods.sum(axis=1, keepdims=True)
    places = mass @ values
    away = float(np.sqrt(np.maximum(mass @ values**2 - places**2, 0.0)).max())
    tried = np.linspace(max(places.min() - away, values[0]), min(places.max() + away, values[-1]), _TRIED)
    weights = np.exp(-0.5 * ((values[:, None, None] - tried[:, None]) / sd) ** 2).reshape(len(values), -1)
    joint = np.log(np.maximum(likelihoods @ weights, 1e-300)).sum(axis=0).reshape(_TRIED, -1)
    mean: Array = tried[np.argmax(joint, axis=0)]
    step = tried[1] - tried[0]
    for _ in range(3):
        score, information = _scores(values, likelihoods, mean, sd)
        bread = information.sum(axis=0)
        change = np.where(bread > 0, score.sum(axis=0) / np.where(bread > 0, bread, 1.0), 0.0)
        mean = np.clip(mean + np.clip(change, -step, step), values[0], values[-1])
    return mean


def _scores(values: Array, likelihoods: Array, mean: Array, sd: Array) -> tuple[Array, Array]:
    """(people, k) derivatives of the log likelihood by the mean, and its negative second derivatives."""
    weights = _normal(values, mean, sd)
    away = (values[:, None] - mean) / sd**2
    total = np.maximum(likelihoods @ weights, 1e-300)
    first = (likelihoods @ (weights * away)) / total
    second = (likelihoods @ (weights * away**2)) / total
    return first, 1 / sd**2 - (second - first**2)


def _weigh(values: Array, mean: float, sd: float) -> Array:
    """(n,) probabilities on a grid too coarse for a smaller standard deviation than its step."""
    return _normal(values, np.array([mean]), np.array([_least_sd(values, sd)]))[:, 0]


def _least_sd(values: Array, sd: float) -> float:
    return max(sd, float(values[1] - values[0]))


def _weigh_lapses(log_mean: float, shape: float = 1.0) -> Array:
    """(9,) probabilities of the lapse rates' cells under Beta(a, a/m − a), m = exp(log_mean), a = `shape`."""
    from scipy.special import betainc

    if shape == 1.0:
        cells = np.diff(1 - (1 - LAPSE_EDGES) ** (np.exp(-log_mean) - 1))
    else:
        cells = np.diff(betainc(shape, shape * (np.exp(-log_mean) - 1), LAPSE_EDGES))
    found: Array = np.maximum(cells, 1e-300) / cells.sum()
    return found


def _joint_scores(
    likelihoods: Array, axes: tuple[Array, Array], at: Array, sds: tuple[float, float]
) -> tuple[Array, Array]:
    """(people, 3) derivatives by (M, S, log m), and (3, 3) the sum of their negative derivatives (Louis 1982)."""
    people = len(likelihoods)
    parts = []
    for values, mean, sd in zip(axes, at[:2], sds, strict=True):
        least = _least_sd(values, sd)
        away = (values - mean) / least**2
        parts.append((_weigh(values, mean, sd), away, np.full(len(values), -1 / least**2)))
    h = 1e-3
    low, middle, high = (np.log(_weigh_lapses(at[2] + shift)) for shift in (-h, 0.0, h))
    parts.append((np.exp(middle), (high - low) / (2 * h), (high - 2 * middle + low) / h**2))
    bases = [np.stack([w, w * a, w * a**2, w * b], axis=1) for w, a, b in parts]
    moments = likelihoods @ bases[2]  # (p, m, s, 4)
    moments = np.einsum("pmsc,sb->pmbc", moments, bases[1], optimize=True)
    moments = np.einsum("pmbc,ma->pabc", moments, bases[0], optimize=True)
    moments /= moments[:, :1, :1, :1]
    index = np.eye(3, dtype=int)
    score = np.stack([moments[:, i, j, k] for i, j, k in index], axis=1)
    square = np.empty((people, 3, 3))
    for n in range(3):
        for m in range(3):
            i, j, k = index[n] + index[m]
            square[:, n, m] = moments[:, i, j, k]
    curvature = np.zeros((3, 3))
    for n in range(3):
        i, j, k = 3 * index[n]
        curvature[n, n] = moments[:, i, j, k].sum()
    information = -curvature - (square - score[:, :, None] * score[:, None, :]).sum(axis=0)
    score[:, 2] -= (at[2] - np.log(_TYPICAL_LAPSE)) / _LAPSE_SPREAD**2 / people
    information[2, 2] += 1 / _LAPSE_SPREAD**2
    size = np.linalg.eigvalsh(information)
    if size[0] <= 1e-6 * size[-1]:  # far from the maximum: the scores' own spread serves as a step's scale
        information = score.T @ score + np.diag(np.diag(np.abs(information))) * 0.1
    return score, information


def _limit_step(step: Array, x: Array, y: Array) -> Array:
    """No further than a tenth of the grid at a time, and a factor e of the lapse rate."""
    most = np.array([np.ptp(x) / 10, np.ptp(y) / 10, 1.0])
    return np.clip(step, -most, most)
