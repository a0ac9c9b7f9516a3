"""Confidence intervals of proportions (Wilson), of means over participants (Student), and of mean proportions."""

from __future__ import annotations

from typing import final

import numpy as np
from numpy.typing import ArrayLike

from haptorb.arrays import Array
from haptorb.errors import InputError

__all__ = ["mean_interval", "share_interval", "wilson"]


def wilson(right: int, of: int, confidence: float = 0.95) -> tuple[float, float]:
    """Wilson's interval for a proportion (Wilson 1927).

    >>> [round(x, 4) for x in wilson(0, 10)]
    [0.0, 0.2775]
    """
    from scipy.special import ndtri

    if not 0 <= right <= of or of < 1:
        raise InputError(f"needs 0 ≤ right ≤ of and of ≥ 1; got {right} of {of}")
    p, square = right / of, float(ndtri((1 + confidence) / 2)) ** 2 / of
    middle = (p + square / 2) / (1 + square)
    half = float(np.sqrt(square * p * (1 - p) + square * square / 4)) / (1 + square)
    return max(0.0, middle - half), min(1.0, middle + half)


def mean_interval(values: ArrayLike, confidence: float = 0.95) -> tuple[Array, Array]:
    """(low, high), shape (...): Student's interval of the mean over participants; values (people, ...), NaN left out.

    Participants are the sampling units: with few of them a percentile bootstrap is too narrow, by (n − 1)/n in the
    variance and by the normal quantile in place of t. NaN with fewer than two participants.

    >>> [round(float(end), 4) for end in mean_interval([1.0, 2.0, 3.0])]
    [-0.4841, 4.4841]
    """
    from scipy.special import stdtrit

    x = np.asarray(values, dtype=float)
    known = np.isfinite(x)
    n = known.sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(known, x, 0.0).sum(axis=0) / n
        variance = np.where(known, (x - mean) ** 2, 0.0).sum(axis=0) / (n - 1)
        half = stdtrit(np.maximum(n - 1, 1), (1 + confidence) / 2) * np.sqrt(variance / n)
    half = np.where(n > 1, half, np.nan)
    return mean - half, mean + half


# --------------------------------------------------------------------------------------------------
# Interval of a mean proportion over the population from which the participants are sampled.
#
# Participants differ. Their proportions have a mean m, and their answers an intraclass correlation ρ: 0 where all
# participants are equal, 1 where each is always right or always wrong. Counts are then beta-binomial. For each
# candidate m, ρ is its maximum-likelihood estimate, and m belongs to the interval while
#
#     N (p̂ − m)²/V(m) ≤ c,    V(m) = m (1 − m) Σ (1 + (nᵢ − 1) ρ(m))/nᵢ / N,    c = N t²/(N − 1 + t²)
#
# and the likelihood at m is not much below the maximum: by at most N/2 log(1 + t₉₉²/(N − 1)) in its
# logarithm. p̂ is the mean of N participants' shares, of nᵢ answers each; t and t₉₉ are Student's quantiles for 95 and
# 99 % with N − 1 degrees of freedom. V is the variance about m, not about p̂, which c corrects: in the middle of the
# range this is nearly Student's interval. Near 100 % it stays within [0, 1], and includes a population with rare
# participants who are often wrong: V(m) is large wherever only a large ρ explains the answers.


_CANDIDATE_MEANS = np.sin(np.linspace(0, np.pi / 2, 98)[1:-1]) ** 2  #: candidate means, denser near 0 and 1
_END_SUBDIVISIONS = 24  #: subdivisions of a step at each end of the interval
_POSITIVE_CORRELATIONS = np.append(0.0, np.geomspace(2e-4, 0.999, 46))  #: candidate correlations
_NEGATIVE_CORRELATIONS = np.array([0.98, 0.8, 0.6, 0.4, 0.2])  #: fractions of the largest negative correlation
_MIN_MEAN = 1e-12  #: distance from 0 and 1, which are no mean of a beta distribution
_LIKELIHOOD_ERROR_SHARE = 0.2  #: share of the error probability that the likelihood criterion takes


def share_interval(right: ArrayLike, of: ArrayLike, confidence: float = 0.95) -> tuple[float, float]:
    """Interval of the mean over participants of their proportions `right` (people,) of `of` (people,); of = 0 left out.

    NaN with fewer than two participants.

    >>> [round(end, 2) for end in share_interval([36, 41, 33, 38, 29, 40], [50] * 6)]
    [0.62, 0.79]
    """
    k, n = np.asarray(right, dtype=float), np.asarray(of, dtype=float)
    k, n = k[n > 0], n[n > 0]
    if len(n) < 2:
        return np.nan, np.nan
    counts = _CountedAnswers(k, n, confidence)
    p, inside = counts.share, _CANDIDATE_MEANS[counts.coarse <= 0]
    ends = np.concatenate([[0.0], _CANDIDATE_MEANS, [1.0]])
    least, most = float(min([p, *inside])), float(max([p, *inside]))
    low = 0.0 if p == 0 else _cross(counts, least, float(ends[ends < least].max()))
    high = 1.0 if p == 1 else _cross(counts, most, float(ends[ends > most].min()))
    return low, high


@final
class _CountedAnswers:
    """Beta-binomial model of correct answers `k` out of `n` (people,), and the criterion for a mean proportion."""

    def __init__(self, k: Array, n: Array, confidence: float) -> None:
        from scipy.special import stdtrit

        people = len(n)
        self.share = float((k / n).mean())  #: mean over participants
        self._pairs, self._times = np.unique(np.stack([k, n]), axis=1, return_counts=True)
        miss = 1 - confidence
        square, wide = (float(stdtrit(people - 1, 1 - part * miss / 2)) ** 2 for part in (1.0, _LIKELIHOOD_ERROR_SHARE))
        self._cut = square / (people - 1 + square)  # c/N
        self._drop = people / 2 * float(np.log1p(wide / (people - 1)))
        logs, effect = self._fit(_CANDIDATE_MEANS)
        self._best = float(logs.max())
        self.coarse = self._judge(_CANDIDATE_MEANS, logs, effect)  #: (96,) criterion at the candidate means

    def exceed(self, means: Array) -> Array:
        """(m,) criterion at `means` (m,), within (0, 1); at most 0 inside the interval."""
        return self._judge(means, *self._fit(means))

    def _judge(self, means: Array, logs: Array, effect: Array) -> Array:
        variance = means * (1 - means) * effect
        away: Array = np.maximum((self.share - means) ** 2 / variance / self._cut, (self._best - logs) / self._drop)
        return away - 1.0

    def _fit(self, means: Array) -> tuple[Array, Array]:
        """(m,) maximum log likelihood at `means` (m,), and mean over participants of (1 + (n − 1) ρ)/n there."""
        correlations, logs = _log_probabilities(means, self._pairs)
        total = logs @ self._times
        best = np.clip(np.argmax(total, axis=1), 1, total.shape[1] - 2)
        rows = np.arange(len(means))
        # Parabola through three points, so that the correlation is continuous in the mean.
        before, here, after = (total[rows, best + shift] for shift in (-1, 0, 1))
        bend = np.minimum(before - 2 * here + after, -1e-12)
        step = np.clip((before - after) / (2 * bend), -1.0, 1.0)
        aside = np.where(step < 0, correlations[rows, best - 1], correlations[rows, best + 1])
        rho = correlations[rows, best] + np.abs(step) * (aside - correlations[rows, best])
        of = self._pairs[1]
        effect: Array = ((1 + (of - 1) * rho[:, None]) / of) @ self._times / self._times.sum()
        return total.max(axis=1), effect


def _cross(counts: _CountedAnswers, inside: float, outside: float) -> float:
    """End of the interval between a mean `inside` and a mean `outside`, which may be 0 or 1."""
    means = np.linspace(inside, outside, _END_SUBDIVISIONS + 1)
    beyond = np.append(counts.exceed(np.clip(means[:-1], _MIN_MEAN, 1 - _MIN_MEAN)), np.inf)
    beyond[0] = min(float(beyond[0]), 0.0)
    first = int(np.argmax(beyond > 0))
    if first == _END_SUBDIVISIONS:
        return outside
    share = beyond[first - 1] / (beyond[first - 1] - beyond[first])
    return float(means[first - 1] + share * (means[first] - means[first - 1]))


def _log_probabilities(means: Array, pairs: Array) -> tuple[Array, Array]:
    """(m, r) correlations at `means` (m,), and (m, r, k) log probabilities of `pairs`, without binomial coefficients.

    Negative correlations, as answers that alternate have, are those that the same formula allows (Prentice 1986): with
    γ = ρ/(1 − ρ) the probability of k answers out of n is Π(m + γ j) Π(1 − m + γ j)/Π(1 + γ j), over j < k, n − k, n.
    """
    from scipy.special import gammaln, xlog1py, xlogy

    k, n = pairs
    size = 1 / _POSITIVE_CORRELATIONS[1:, None] - 1
    a, b = means[:, None, None] * size, (1 - means)[:, None, None] * size
    positive = gammaln(k + a) - gammaln(a) + gammaln(n - k + b) - gammaln(b) + gammaln(size) - gammaln(n + size)
    none = (xlogy(k, means[:, None]) + xlog1py(n - k, -means[:, None]))[:, None]
    gamma = _NEGATIVE_CORRELATIONS * (np.minimum(means, 1 - means) / max(float(n.max()) - 1, 1.0))[:, None]
    q, r, s = (x[..., None] for x in (means[:, None] / gamma, (1 - means)[:, None] / gamma, 1 / gamma))
    negative = (
        gammaln(q + 1) - gammaln(q - k + 1) + gammaln(r + 1) - gammaln(r - n + k + 1) - gammaln(s + 1)
        + gammaln(s - n + 1)
    )  # fmt: skip
    known = np.broadcast_to(_POSITIVE_CORRELATIONS, (len(means), len(_POSITIVE_CORRELATIONS)))
    return np.concatenate([-gamma / (1 - gamma), known], axis=1), np.concatenate([negative, none, positive], axis=1)
