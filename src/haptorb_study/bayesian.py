"""Adaptive Bayesian procedure: each trial minimises the expected entropy, after QUEST+ (Watson 2017).

The observer is a cumulative normal in the logarithm of the difference, with a guess rate of one half:
p(correct) = ½ + (½ − λ) Φ(s log₂(difference / threshold)), threshold and slope s unknown, lapse rate λ fixed.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import final

import numpy as np

from haptorb.arrays import Array
from haptorb.errors import InputError
from haptorb_study.procedures import Procedure
from haptorb_study.prompts import Answer, Prompt

__all__ = ["Bayesian"]


_CANDIDATE_SLOPES = np.geomspace(0.5, 6.0, 12)


@final
@dataclass(frozen=True)
class Bayesian(Procedure):
    """As many trials as `intervals`, each at the difference with the least expected posterior entropy.

    `threshold` is the difference answered right in 75 % of the cases without lapses.
    """

    reference: float
    least: float  #: smallest difference
    most: float  #: largest difference
    intervals: tuple[int, ...]
    condition: str = ""
    lapse: float = 0.02
    answers: tuple[tuple[int, bool], ...] = field(default=(), repr=False)  #: (index of difference, correct) so far

    def __post_init__(self) -> None:
        if not 0 < self.least < self.most or not set(self.intervals) <= {1, 2} or not 0 <= self.lapse < 0.5:
            raise InputError(
                f"needs 0 < least < most, intervals 1 or 2 and 0 ≤ lapse < 0.5; got {self.least:g}, {self.most:g}, "
                f"{self.lapse:g}"
            )

    @cached_property
    def differences(self) -> Array:
        """(30,) candidate differences."""
        return np.geomspace(self.least, self.most, 30)

    @cached_property
    def _right_probability(self) -> Array:
        """(30, 40, 12) probability of a correct answer by difference, threshold and slope."""
        from scipy.special import ndtr

        x = np.log2(self.differences[:, None] / self.thresholds[None, :])
        right: Array = 0.5 + (0.5 - self.lapse) * ndtr(_CANDIDATE_SLOPES * x[..., None])
        return right

    @cached_property
    def thresholds(self) -> Array:
        """(40,) candidate thresholds."""
        return np.geomspace(self.least, self.most, 40)

    @cached_property
    def posterior(self) -> Array:
        """(40, 12) posterior of threshold and slope."""
        log = np.zeros((40, len(_CANDIDATE_SLOPES)))
        for asked, right in self.answers:
            p = self._right_probability[asked]
            log += np.log(p if right else 1 - p)
        p = np.exp(log - log.max())
        normal: Array = p / p.sum()
        return normal

    @cached_property
    def _choice(self) -> int:
        posterior = self.posterior
        best, least = 0, float("inf")
        for n, p in enumerate(self._right_probability):
            entropy = 0.0
            for likelihood in (p, 1 - p):
                joint = posterior * likelihood
                total = float(joint.sum())
                after = joint / total
                entropy -= total * float((after * np.log(np.maximum(after, 1e-300))).sum())
            if entropy < least - 1e-12:
                best, least = n, entropy
        return best

    @property
    def prompt(self) -> Prompt | None:
        """Comparison at the most informative difference."""
        done = len(self.answers)
        if done >= len(self.intervals):
            return None
        level = self.reference + float(self.differences[self._choice])
        return Prompt(condition=self.condition, level=level, interval=self.intervals[done], low=1, high=2)

    @property
    def expected(self) -> int:
        """Remaining trials."""
        return len(self.intervals) - len(self.answers)

    def advance(self, answer: Answer) -> Bayesian:
        """Add one answer."""
        right = answer.value == self.intervals[len(self.answers)]
        return replace(self, answers=(*self.answers, (self._choice, right)))

    @property
    def threshold(self) -> float:
        """Posterior mean of the logarithm."""
        return float(np.exp(self.posterior.sum(axis=1) @ np.log(self.thresholds)))
