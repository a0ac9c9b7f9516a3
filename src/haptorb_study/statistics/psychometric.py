"""Psychometric function: share of answers over the level of a stimulus, and counts of answers by level."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from haptorb.arrays import Array, check_finite
from haptorb.errors import InputError

__all__ = ["LevelCounts", "PsychometricCurve", "count_by_level"]


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
