"""Likelihood of one participant's psychometric function in slope and intercept, with intervals that may be open.

p(x) = λ + (1 − 2λ) Φ(c + b u), with u = (x − middle of the levels)/range of the levels. In slope b and intercept c a
function that does not depend on the level is an ordinary point, b = 0, and reversed keys are b < 0. Spread (1/b)
and threshold (−c/b) cannot represent either: there, every interval has finite limits, whatever the answers (Gleser &
Hwang 1987).

λ is uniform from 0 to 0.13 and integrated out; b and c have no prior. The interval of the slope contains every b whose
profile log likelihood is at most `_HALF_CHI2_95` (1 + 12/trials) below the maximum; 12 was determined by simulation.
The interval of the threshold contains −c/b of all pairs (b, c) within the same limit (Fieller's, by likelihood).
`benchmarks/study/study_spreads.py` measures their coverage.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from haptorb.arrays import Array
from haptorb_study.statistics.psychometric_function import LAPSE_EDGES, LevelCounts, PsychometricCurve

__all__ = ["MAX_LAPSE_RATE", "Direction", "SlopeLikelihood"]


Direction = Literal["rising", "falling", "unknown"]
MAX_LAPSE_RATE = 0.13  #: highest lapse rate of either asymptote: beyond it, there is no interval
_LAPSE_RATES = (LAPSE_EDGES[1:] + LAPSE_EDGES[:-1]) / 2
_ADMITTED_LAPSES = LAPSE_EDGES[1:] <= MAX_LAPSE_RATE + 1e-9
_HALF_CHI2_95 = 1.9207  #: half of the 95 % quantile of χ²₁
_SMALL_SAMPLE_TRIALS = 12.0  #: trials; small-sample correction of the likelihood ratio, by simulation: 1 + 12/trials
_LINEAR_SLOPE_LIMIT = 1.2  #: slope up to which the grid is linear, logarithmic beyond
_MAX_SLOPE = 60.0  #: range/60 as the smallest spread; at most 6 over the least distance of two levels
_TAIL_SDS = 3.2  #: standard deviations that intercepts extend beyond the outermost level
_COMMON_SLOPES, _REFINED_SLOPES = 41, 25  #: slopes of the common grid, and of each participant's refined grid
_MIN_PROBABILITY = 1e-12


@dataclass(frozen=True)
class SlopeLikelihood:
    """Likelihood of each participant's answers; all arrays by participant.

    weights  (9,) probabilities of the lapse rates' cells; None: equal up to `MAX_LAPSE_RATE`
    """

    answered: LevelCounts
    weights: Array | None = None

    @cached_property
    def scale(self) -> tuple[float, float]:
        """Centre and range of the levels."""
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
        """(9,) log weights; −∞ where a lapse rate is excluded."""
        if self.weights is None:
            cells = np.diff(np.minimum(LAPSE_EDGES, MAX_LAPSE_RATE))
            cells = cells / cells.sum()
        else:
            cells = self.weights
        with np.errstate(divide="ignore"):
            found: Array = np.log(cells)
        return found

    @cached_property
    def cuts(self) -> Array:
        """(people,) cut-off: decrease of the log likelihood at the limits of an interval."""
        found: Array = _HALF_CHI2_95 * (1 + _SMALL_SAMPLE_TRIALS / np.maximum(self.answered.of.sum(axis=1), 1))
        return found

    @cached_property
    def steepest(self) -> float:
        """Slope from which on the function is a step at these levels."""
        return min(_MAX_SLOPE, 6 / float(np.diff(self.units).min()))

    # --- likelihood ---------------------------------------------------------------------------------------------------

    def log_likelihood(self, slopes: Array, intercepts: Array) -> Array:
        """(people, ...) with λ integrated out, at slopes and intercepts (people, ...)."""
        return self._differentiate(slopes, intercepts)[0]

    def _differentiate(self, slopes: Array, intercepts: Array) -> tuple[Array, Array, Array]:
        """Log likelihood, its derivative with respect to the intercept, and the information on it, (people, n) each."""
        from scipy.special import ndtr

        used = np.flatnonzero(np.isfinite(self.log_weights))
        z = intercepts[..., None] + slopes[..., None] * self.units
        rise, density = ndtr(z), np.exp(-z * z / 2) / math.sqrt(2 * math.pi)
        yes = self.answered.yes[:, None, :]
        no = (self.answered.of - self.answered.yes)[:, None, :]
        logs, firsts, informations = [], [], []
        for n in used:
            part = 1 - 2 * _LAPSE_RATES[n]
            p = _LAPSE_RATES[n] + part * rise
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
        """Maximise over the intercept by Fisher scoring, never downhill: intercept, value, information."""
        limit = _TAIL_SDS + np.abs(slopes) / 2
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
        """Slopes (s,), best intercepts and log likelihoods (people, s), and the maximum for each lapse rate."""
        from scipy.special import ndtr

        bend = np.arcsinh(self.steepest / _LINEAR_SLOPE_LIMIT)
        slopes = _LINEAR_SLOPE_LIMIT * np.sinh(np.linspace(-bend, bend, _COMMON_SLOPES))
        count = int(np.ceil((2 * _TAIL_SDS + self.steepest) / 1.3)) + 1
        intercepts = np.linspace(-1, 1, count) * (_TAIL_SDS + np.abs(slopes[:, None]) / 2)
        rise = ndtr(intercepts[..., None] + slopes[:, None, None] * self.units).reshape(-1, len(self.units))
        yes, no = self.answered.yes, self.answered.of - self.answered.yes
        best = np.full((len(yes), len(_LAPSE_RATES)), -np.inf)
        total = np.full((len(yes), len(rise)), -np.inf)
        for n, lapse in enumerate(_LAPSE_RATES):
            p = np.clip(lapse + (1 - 2 * lapse) * rise, _MIN_PROBABILITY, 1 - _MIN_PROBABILITY)
            logs = yes @ np.log(p).T + no @ np.log1p(-p).T
            best[:, n] = logs.max(axis=1)
            if np.isfinite(self.log_weights[n]):
                total = np.logaddexp(total, logs + self.log_weights[n])
        each = total.reshape(len(yes), _COMMON_SLOPES, count)
        start = np.take_along_axis(np.broadcast_to(intercepts, each.shape), each.argmax(axis=2)[..., None], 2)[..., 0]
        wide = np.broadcast_to(slopes, start.shape)
        c, value, _ = self._climb(wide, start, 4)
        return slopes, c, value, best

    @cached_property
    def _profile(self) -> tuple[Array, Array, Array, Array]:
        """Profile likelihood: slopes, best intercepts, log likelihoods, information on intercepts, (people, f) each.

        Only where a participant's likelihood is not negligible; slopes are equally far apart in asinh(b/1.2).
        """
        slopes, c, value, _ = self._rough
        axis = np.arcsinh(slopes / _LINEAR_SLOPE_LIMIT)
        step = axis[1] - axis[0]
        near = value >= value.max(axis=1, keepdims=True) - 3 * self.cuts[:, None]
        low = np.maximum(axis[near.argmax(axis=1)] - step, axis[0])
        high = np.minimum(axis[len(axis) - 1 - near[:, ::-1].argmax(axis=1)] + step, axis[-1])
        fine = low[:, None] + (high - low)[:, None] * np.linspace(0, 1, _REFINED_SLOPES)
        start = np.array([np.interp(one, axis, row) for one, row in zip(fine, c, strict=True)])
        nearest = np.abs(fine[..., None] - axis).argmin(axis=-1)
        other = np.take_along_axis(c, nearest, 1)
        wide = _LINEAR_SLOPE_LIMIT * np.sinh(fine)
        start = np.where(self.log_likelihood(wide, other) > self.log_likelihood(wide, start), other, start)
        return wide, *self._climb(wide, start, 3)

    @cached_property
    def _dense(self) -> tuple[Array, Array, Array]:
        """Slopes, log likelihoods and intercepts (people, 32 f) by spline interpolation of the profile."""
        from scipy.interpolate import CubicSpline

        slopes, c, value, _ = self._profile
        count = 32 * (_REFINED_SLOPES - 1) + 1
        place = np.linspace(0, _REFINED_SLOPES - 1, count)
        bent = np.arcsinh(slopes / _LINEAR_SLOPE_LIMIT)
        axis = bent[:, :1] + (bent[:, -1:] - bent[:, :1]) * place / (_REFINED_SLOPES - 1)
        smooth = CubicSpline(np.arange(_REFINED_SLOPES), value, axis=1)(place)
        middles = np.array([np.interp(place, np.arange(_REFINED_SLOPES), row) for row in c])
        return _LINEAR_SLOPE_LIMIT * np.sinh(axis), smooth, middles

    # --- what it says -------------------------------------------------------------------------------------------------

    @cached_property
    def slope_95(self) -> tuple[Array, Array]:
        """(low, high) of b for each participant; ±∞ where the likelihood does not fall towards a step."""
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
        """(people,) whether lapse rates above `MAX_LAPSE_RATE` are clearly more likely than those below."""
        best = self.by_lapse
        found: NDArray[np.bool_] = (
            best[:, ~_ADMITTED_LAPSES].max(axis=1) - best[:, _ADMITTED_LAPSES].max(axis=1) > 2 * self.cuts
        )
        return found

    def direction(self, person: int) -> Direction:
        """Established direction of the function over the level: rising, falling or unknown."""
        low, high = (float(end[person]) for end in self.slope_95)
        return "rising" if low > 0 else "falling" if high < 0 else "unknown"

    def spread_95(self, person: int) -> tuple[float, float]:
        """95 % interval of the spread, in units of the level; 0 and ∞ are open limits, NaN: no interval.

        Where the direction is not established, the lower limit is that of both directions, since keys may be reversed.
        """
        low, high = (float(end[person]) for end in self.slope_95)
        if self.too_many_lapses[person]:
            return math.nan, math.nan
        steep, shallow = max(high, -low), max(low, -high)
        span = self.scale[1]
        return span / steep, (span / shallow if shallow > 0 else math.inf)

    def threshold_95(self, person: int) -> tuple[float, float]:
        """95 % interval of the point of subjective equality; ±∞ are open limits, both if it is undetermined.

        Where the direction is not established and more likely rises, keys are assumed to be as instructed.
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
        if self.direction(person) == "unknown":  # at b = 0 thresholds are infinite, with the sign of c
            flat = int(np.abs(b).argmin())
            least = -math.inf if high[flat] > 0 else least
            most = math.inf if low[flat] < 0 else most
        return middle + span * least, middle + span * most

    @cached_property
    def estimates(self) -> tuple[Array, Array]:
        """(people,) maximum-likelihood slopes and intercepts."""
        slopes, value, intercepts = self._dense
        rows, best = np.arange(len(slopes)), value.argmax(axis=1)
        return slopes[rows, best], intercepts[rows, best]

    @property
    def by_lapse(self) -> Array:
        """(people, 9) maximum log likelihood for each lapse rate, without weights."""
        return self._rough[3]

    @cached_property
    def common(self) -> tuple[Array, Array, Array, Array]:
        """Slopes (n,) common to all participants; log likelihood, its derivative and best intercept (people, n)."""
        from scipy.interpolate import CubicSpline

        slopes, c, value, _ = self._rough
        axis = np.arcsinh(slopes / _LINEAR_SLOPE_LIMIT)
        fine = np.linspace(axis[0], axis[-1], 1601)
        spline = CubicSpline(axis, value, axis=1)
        dense = _LINEAR_SLOPE_LIMIT * np.sinh(fine)
        middles = np.array([np.interp(fine, axis, row) for row in c])
        return dense, spline(fine), spline(fine, 1) / (_LINEAR_SLOPE_LIMIT * np.cosh(fine)), middles

    def curve(self, person: int, lapse: float) -> PsychometricCurve:
        """Maximum-likelihood function with `lapse`; a falling one has a negative spread."""
        b, c = (float(one[person]) for one in self.estimates)
        middle, span = self.scale
        b = b if abs(b) > 1e-6 else math.copysign(1e-6, b)
        return PsychometricCurve(middle - span * c / b, span / b, lapse, lapse)

    def lapses(self, person: int) -> Array:
        """(9,) posterior of the lapse rate at the maximum-likelihood function."""
        from scipy.special import ndtr

        slopes, intercepts = self.estimates
        rise = ndtr(intercepts[person] + slopes[person] * self.units)
        p = np.clip(
            _LAPSE_RATES[:, None] + (1 - 2 * _LAPSE_RATES[:, None]) * rise, _MIN_PROBABILITY, 1 - _MIN_PROBABILITY
        )
        yes = self.answered.yes[person]
        logs = np.log(p) @ yes + np.log1p(-p) @ (self.answered.of[person] - yes) + self.log_weights
        mass = np.exp(logs - logs.max())
        found: Array = mass / mass.sum()
        return found

    def nearby(self, person: int, far: float = 3.5, count: int = 13) -> Array:
        """(points, levels) probabilities of functions near the most likely one, with lapses."""
        from scipy.special import ndtr

        slopes, c, value, information = (one[person] for one in self._profile)
        keep = np.flatnonzero(value >= value.max() - far**2 / 2)
        keep = keep[:: max(1, len(keep) // 16)]
        width = 1 / np.sqrt(np.maximum(information[keep], 0.05))
        intercepts = c[keep][:, None] + width[:, None] * np.linspace(-far, far, count)
        rise = ndtr(intercepts[..., None] + slopes[keep][:, None, None] * self.units).reshape(-1, 1, len(self.units))
        usual = np.append(0.0, _LAPSE_RATES[1::2])[:, None]
        found: Array = np.clip(usual + (1 - 2 * usual) * rise, _MIN_PROBABILITY, 1 - _MIN_PROBABILITY).reshape(
            -1, len(self.units)
        )
        return found

    def _falls_more_likely(self, person: int) -> bool:
        """Whether the best falling function is more likely than the best rising one."""
        slopes, value = self._dense[0][person], self._dense[1][person]
        rising, falling = (value[side].max(initial=-np.inf) for side in (slopes >= 0, slopes < 0))
        return bool(falling > rising + 0.1)

    def _outline(self, person: int) -> tuple[Array, Array, Array]:
        """Outline of the confidence region: slopes, lower and upper intercept at each, with both tips.

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
        """Confidence region: slopes, best, lower and upper intercept (±∞ if open), and the mask of slopes inside.

        The root of the likelihood's fall is nearly linear in the intercept: Newton's steps need few.
        """
        slopes, c, value, information = (one[:, ::2] for one in self._profile)
        room = np.sqrt(np.maximum(2 * (value - self._profile[2].max(axis=1, keepdims=True) + self.cuts[:, None]), 0.0))
        inside = room > 0
        found = []
        for side in (-1.0, 1.0):
            limit = _TAIL_SDS + np.abs(slopes) / 2 + 1.0
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
