"""Psychometric function: share of answers over the level of a stimulus, and its likelihood given counted answers."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from haptorb.arrays import Array, check_finite
from haptorb.errors import InputError

__all__ = ["LAPSE_EDGES", "LevelCounts", "PsychometricCurve", "PsychometricGrid", "count_by_level"]


@dataclass(frozen=True)
class PsychometricCurve:
    """p(x) = γ + (1 − γ − λ) Φ((x − middle)/spread).

    Constant stimuli with two intervals: γ = λ, because an inattentive participant is right in half of the cases.

    >>> float(PsychometricCurve(1.0, 0.1, 0.02, 0.02)(1.0))
    0.5
    """

    middle: float  #: level where Φ = ½: the point of subjective equality
    spread: float  #: standard deviation of the normal distribution, in units of the level
    guess: float  #: γ, asymptote at low levels
    lapse: float  #: λ, 1 − asymptote at high levels

    def __call__(self, x: ArrayLike) -> Array:
        """p at `x`, of its shape."""
        from scipy.special import ndtr

        at = np.asarray(x, dtype=float)
        p: Array = self.guess + (1 - self.guess - self.lapse) * ndtr((at - self.middle) / self.spread)
        return p


@dataclass(frozen=True)
class LevelCounts:
    """Counts of answers: `yes` (people, n) out of `of` (people, n) at `levels` (n,), ascending."""

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
        """(levels, yes, of), (n,) each, pooled over participants; for drawing, not for fits."""
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
# Likelihood and posterior of psychometric functions on a grid shared by all participants, without iteration.


#: edges of the cells of the lapse rate; integrating over cells keeps the density bounded
LAPSE_EDGES = np.array([0.0, 0.004, 0.011, 0.021, 0.035, 0.055, 0.085, 0.13, 0.2, 0.3])
_LAPSE_RATES = (LAPSE_EDGES[1:] + LAPSE_EDGES[:-1]) / 2
_THRESHOLD_MARGIN_RANGES = 1 / 2  #: in level ranges: extent of the threshold axis beyond the levels
_STEP_SDS = 0.6  #: grid step in SDs of the most certain participant
_AXIS_POINTS = (21, 81)  #: minimum and maximum, per axis


@dataclass(frozen=True)
class PsychometricGrid:
    """Grid of thresholds × spreads × lapse rates with the likelihood of all participants' answers.

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
        """Grid over the region of non-negligible posterior, as fine as the most certain participant needs.

        limits    of the thresholds; None: half of the levels' range beyond the levels on either side
        spreads   least and greatest; None: from a sixth of the least distance of two levels to twice their range
        """
        x = answered.levels
        span = float(np.ptp(x))
        low, high = limits or (
            float(x[0]) - _THRESHOLD_MARGIN_RANGES * span,
            float(x[-1]) + _THRESHOLD_MARGIN_RANGES * span,
        )
        least, most = spreads or (max(float(np.diff(x).min()) / 6, span / 300), 2 * span)
        narrow, wide = float(np.log(least)), float(np.log(most))
        axes = np.linspace(low, high, 33), np.linspace(narrow, wide, 17)
        for _ in range(3):  # repeat where the grid was too coarse for the most certain participant
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
        """(9,) lapse rates: centres of their cells."""
        middles: Array = _LAPSE_RATES
        return middles

    @cached_property
    def _logs(self) -> tuple[Array, Array]:
        """(points, levels) log probabilities of yes and of no."""
        from scipy.special import ndtr, ndtri

        x, spreads = self.answered.levels, np.exp(self.log_spreads)
        if self.target is None or self.guess is None:
            shape = ndtr((x - self.thresholds[:, None, None]) / spreads[:, None])[:, :, None, :]
        else:
            reach = np.clip((self.target - self.guess) / (1 - self.guess - _LAPSE_RATES), 1e-6, 1 - 1e-6)
            z = (x - self.thresholds[:, None, None]) / spreads[:, None]
            shape = ndtr(z[:, :, None, :] + ndtri(reach)[:, None])
        low = _LAPSE_RATES[:, None] if self.guess is None else self.guess
        p = np.clip(low + (1 - low - _LAPSE_RATES[:, None]) * shape, 1e-12, 1 - 1e-12).reshape(-1, len(x))
        return np.log(p), np.log1p(-p)

    @property
    def shape(self) -> tuple[int, int, int]:
        """(thresholds, spreads, lapse rates)."""
        return len(self.thresholds), len(self.log_spreads), len(_LAPSE_RATES)

    def log_likelihoods(self, yes: Array, of: Array, points: NDArray[np.intp] | None = None) -> Array:
        """(k, points) of k participants' or samples' answers, (k, levels) each; without binomial coefficients."""
        log_yes, log_no = self._logs if points is None else (logs[points] for logs in self._logs)
        found: Array = yes @ log_yes.T + (of - yes) @ log_no.T
        return found

    @cached_property
    def likelihoods(self) -> Array:
        """(people, thresholds, spreads, lapse rates), scaled to a maximum of 1 per participant."""
        logs = self.log_likelihoods(self.answered.yes, self.answered.of)
        relative: Array = np.exp(logs - logs.max(axis=1, keepdims=True)).reshape(-1, *self.shape)
        return relative

    def curve_at(self, point: int) -> PsychometricCurve:
        """The function at one point of the grid, indexed as in `log_likelihoods`."""
        from scipy.special import ndtri

        i, j, k = (int(n) for n in np.unravel_index(point, self.shape))
        middle, spread, lapse = (
            float(self.thresholds[i]),
            float(np.exp(self.log_spreads[j])),
            float(_LAPSE_RATES[k]),
        )
        guess = lapse if self.guess is None else self.guess
        if self.target is not None:
            middle -= spread * float(ndtri(np.clip((self.target - guess) / (1 - guess - lapse), 1e-6, 1 - 1e-6)))
        return PsychometricCurve(middle, spread, guess, lapse)

    @cached_property
    def priors(self) -> tuple[Array, Array, Array]:
        """(m,), (s,) and (9,) prior probabilities of psignifit 4 (Schütt et al. 2016), for a single participant.

        Threshold: flat over the levels, falling as a raised cosine to zero half of their range outside. Width (5 to
        95 %, 3.29 spreads): flat from twice the least distance of two levels to the range, falling to zero at that
        distance and at three times the range. Lapse rate: Beta(1, 10). With γ fixed, the levels are an adaptive
        procedure's own choice and carry no information on the width: threshold flat, width flat in its logarithm.
        """
        x = self.answered.levels
        span, step = float(np.ptp(x)), float(np.diff(x).min())
        lapse = np.diff(1 - (1 - LAPSE_EDGES) ** 10)
        if self.guess is not None:
            flat = np.full(len(self.thresholds), 1 / len(self.thresholds))
            return flat, np.full(len(self.log_spreads), 1 / len(self.log_spreads)), lapse / lapse.sum()
        away = np.maximum(np.maximum(x[0] - self.thresholds, self.thresholds - x[-1]), 0.0) / (
            _THRESHOLD_MARGIN_RANGES * span
        )
        width = 3.29 * np.exp(self.log_spreads)
        short = np.clip((2 * step - width) / step, 0, 1)
        long = np.clip((width - span) / (2 * span), 0, 1)
        found = (_cosine(away), _cosine(short) * _cosine(long) * width, lapse)
        one, two, three = (np.maximum(p, 1e-12 * p.max()) / p.sum() for p in found)
        return one, two, three

    @cached_property
    def posterior(self) -> Array:
        """(people, m, s, 9) posterior from each participant's own answers."""
        one, two, three = self.priors
        mass = self.likelihoods * one[:, None, None] * two[:, None] * three
        normal: Array = mass / mass.sum(axis=(1, 2, 3), keepdims=True)
        return normal


def _cosine(x: Array) -> Array:
    """Raised cosine from 1 at 0 to 0 at 1 and beyond."""
    found: Array = (1 + np.cos(np.pi * np.clip(x, 0, 1))) / 2
    return found


def _zoom(axis: Array, mass: Array, least: float, most: float) -> tuple[Array, bool]:
    """Equally spaced points within the limits that contain all but 1e-4 of each participant's `mass` (people, n).

    And whether `axis` was fine enough.
    """
    step = float(axis[1] - axis[0])
    sums = np.cumsum(mass, axis=1)
    low = max(least, float(axis[int((sums > 1e-4).any(axis=0).argmax())]) - 1.5 * step)
    high = min(most, float(axis[int((sums > 1 - 1e-4).all(axis=0).argmax())]) + 1.5 * step)
    spread = float(np.sqrt(np.maximum(mass @ axis**2 - (mass @ axis) ** 2, 0.0)).min())
    count = (high - low) / (_STEP_SDS * max(spread, step / 3))
    return np.linspace(low, high, int(np.clip(np.ceil(count), *_AXIS_POINTS))), spread > step / 3
