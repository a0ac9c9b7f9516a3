"""How large a difference is beside the spread of people: d_z and Hedges' g_av, with intervals."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import product
from typing import Literal, final, get_args

import numpy as np
from numpy.typing import ArrayLike

from haptorb.arrays import Array, check_finite
from haptorb.errors import InputError

__all__ = [
    "CORRECTIONS",
    "EXACT_PEOPLE",
    "TESTS",
    "Correction",
    "DirectionSpread",
    "EffectSize",
    "Information",
    "PairTest",
    "PowerLaw",
    "binomial_tail",
    "check_test",
    "correct_p",
    "decide_p",
    "effect_size",
    "error_vectors",
    "fewest_people",
    "find_away_axes",
    "fit_power_law",
    "local_axes",
    "mean_interval",
    "plug_in_information",
    "share_interval",
    "summarize_directions",
    "transfer_information",
    "wilson",
]


@dataclass(frozen=True)
class EffectSize:
    """Standardized differences of pairs (Lakens 2013); NaN where there is no spread to measure them by."""

    d_z: float  #: mean difference over the standard deviation of the differences
    d_z_95: tuple[float, float]  #: exact for normal differences: noncentral t
    g_av: float  #: over the root mean of both variances, corrected for few people (Hedges)
    g_av_95: tuple[float, float]  #: noncentral t, after Algina & Keselman 2003; approximate


_NONE = (math.nan, math.nan)


def effect_size(differences: ArrayLike, spread: float | None = None, confidence: float = 0.95) -> EffectSize:
    """Effect size of paired `differences` (people,); `spread` is √((s_a² + s_b²)/2), without it there is no g_av.

    d_z = m/s has the noncentral t distribution with δ √n: its interval holds the δ for which m √n/s lies between the
    quantiles (Morey; Steiger & Fouladi 1997). g_av = J(n − 1) m/spread, J(f) = Γ(f/2)/(√(f/2) Γ((f − 1)/2)).

    >>> size = effect_size([1.0, 2.0, 3.0, 4.0])
    >>> round(size.d_z, 3), [round(end, 3) for end in size.d_z_95]
    (1.936, [0.146, 3.672])
    """
    from scipy.special import gammaln

    d = check_finite(differences, "differences")
    if d.ndim != 1 or len(d) < 2:
        raise InputError(f"an effect size needs at least two people; got shape {d.shape}")
    n, mean, sd = len(d), float(d.mean()), float(d.std(ddof=1))
    if sd <= 1e-12 * float(np.abs(d).max()):
        return EffectSize(math.nan, _NONE, math.nan, _NONE)
    ends = _shift_interval(mean / sd * math.sqrt(n), n - 1, confidence)
    low, high = (end / math.sqrt(n) for end in ends)
    if spread is None or not spread > 0:
        return EffectSize(mean / sd, (low, high), math.nan, _NONE)
    f = n - 1
    # With one degree of freedom the correction is zero: Γ has a pole, and the mean of d does not exist.
    correction = 0.0 if f < 2 else math.exp(gammaln(f / 2) - gammaln((f - 1) / 2)) / math.sqrt(f / 2)
    scale = sd / spread
    return EffectSize(mean / sd, (low, high), correction * mean / spread, (low * scale, high * scale))


def _shift_interval(t: float, freedom: int, confidence: float) -> tuple[float, float]:
    """The noncentralities for which `t` is at the upper and at the lower end of its distribution."""
    from scipy.optimize import brentq
    from scipy.special import nctdtr

    def find_shift(share: float) -> float:
        """Where the probability of less than `t` is `share`; it falls with the noncentrality."""
        step = 2.0 + abs(t)
        low, high = t - step, t + step
        while nctdtr(freedom, low, t) < share:
            low -= step
        while nctdtr(freedom, high, t) > share:
            high += step
        return float(brentq(lambda shift: float(nctdtr(freedom, shift, t)) - share, low, high, xtol=1e-10))

    return find_shift((1 + confidence) / 2), find_shift((1 - confidence) / 2)


# --------------------------------------------------------------------------------------------------
# How much answers tell of what was asked: information transferred, in bits, from a confusion matrix (Miller & Nicely).
#
# T = H(answers) − H(answers | prompts). Counted from few answers as if shares were probabilities (plug-in), T is too
# large: by chance alone, answers seem to follow prompts. Four formulations are reported:
#
#     bits          both entropies after Chao & Shen 2003: the share of answers not yet met is guessed from those met
#     once
#     miller_madow  the plug-in less (cells − rows − columns + 1)/(2 N ln 2), counting what is not empty (Miller 1955)
#     plug_in       as in Miller & Nicely 1955
#     chance        the plug-in of shuffled answers, on average: what no relation at all would give
#
# Plug-in less chance is right only where answers hardly depend on prompts; where they do, fewer cells are met than
# after shuffling, and it takes away far too much (a third, at 80 % right of 25 set-points and 300 trials).
# `benchmarks/study/study_localisation.py` measures all four.


_SHUFFLES = 199


@dataclass(frozen=True)
class Information:
    """Information transferred [bit] and what it can be compared with."""

    bits: float  #: corrected for few answers, 0 to `most`; NaN with fewer than two answers to a prompt on average
    low: float  #: 95 %, jackknife over people, Student's; NaN for one person, and where all are alike
    high: float
    most: float  #: [bit] of the prompts, if every one were distinguished
    plug_in: float
    miller_madow: float
    chance: float  #: plug-in of shuffled answers, on average
    p: float  #: of at least so much by chance, one-sided, by shuffling; not less than 1/200
    trials: int
    people: int


def transfer_information(counts: ArrayLike, *, seed: int = 0) -> Information:
    """From `counts` (people, prompts, answers) of answers; answers are shuffled within each person.

    InputError for counts that are negative, or none at all.

    >>> found = transfer_information([[[5, 0], [0, 5]], [[5, 0], [0, 5]]])
    >>> found.bits, found.most
    (1.0, 1.0)
    """
    each = check_finite(counts, "counts")
    if each.ndim != 3 or (each < 0).any() or each.sum() < 1 or (each != np.round(each)).any():
        raise InputError(f"counts must be whole, ≥ 0, shape (people, prompts, answers), not all 0; got {each.shape}")
    each = each[each.sum(axis=(1, 2)) > 0]
    table = each.sum(axis=0)
    bits, trials, people = _correct_information(table), int(table.sum()), len(each)
    most = float(_entropy(table.sum(axis=1)))
    low = high = math.nan
    if trials < 2 * int(np.count_nonzero(table.sum(axis=1))):
        bits = math.nan  # an answer that occurred once says nothing about those that did not occur
    if people > 1 and math.isfinite(bits):
        from scipy.special import stdtrit

        without = np.array([_correct_information(table - one) for one in each])
        error = math.sqrt((people - 1) / people * float(np.sum((without - without.mean()) ** 2)))
        half = float(stdtrit(people - 1, 0.975)) * error
        # What the jackknife would correct tells how far off the estimate may be besides its scatter.
        other = people * bits - (people - 1) * float(without.mean())
        if error > 1e-12:  # people who all answer alike show no spread to go by
            low, high = max(0.0, min(bits, other) - half), min(most, max(bits, other) + half)
    plug_in = float(plug_in_information(table))
    cells, rows, columns = ((table > 0).sum(), (table.sum(axis=1) > 0).sum(), (table.sum(axis=0) > 0).sum())
    bias = float(cells - rows - columns + 1) / (2 * trials * math.log(2))
    shuffled = _shuffle(each, seed)
    p = (1 + int(np.sum(shuffled >= plug_in - 1e-12))) / (1 + _SHUFFLES)
    bits = bits if math.isnan(bits) else min(most, max(0.0, bits))
    return Information(
        bits, low, high, most, plug_in, min(most, plug_in - bias), float(shuffled.mean()), p, trials, people
    )


def plug_in_information(counts: ArrayLike) -> Array:
    """(...) information transferred [bit] of `counts` (..., prompts, answers), shares taken for probabilities.

    >>> float(plug_in_information([[1, 1], [1, 1]]))
    0.0
    """
    table = np.asarray(counts, dtype=float)
    both = table.reshape(*table.shape[:-2], -1)
    found: Array = _entropy(table.sum(axis=-1)) + _entropy(table.sum(axis=-2)) - _entropy(both)
    return np.maximum(found, 0.0)


def _correct_information(table: Array) -> float:
    """Of `table` (prompts, answers), after Chao & Shen."""
    each = table.sum(axis=1)
    asked = each > 0
    rows = _unseen_entropy(table[asked])
    return float(_unseen_entropy(table.sum(axis=0)[None])[0] - each[asked] @ rows / each.sum())


def _entropy(counts: Array) -> Array:
    """(...) entropy [bit] of the shares of `counts` (..., k)."""
    share = counts / np.maximum(counts.sum(axis=-1, keepdims=True), 1e-300)
    found: Array = -np.sum(share * np.log2(np.where(share > 0, share, 1.0)), axis=-1)
    return found


def _unseen_entropy(counts: Array) -> Array:
    """(rows,) entropy [bit] of `counts` (rows, k), each row with one count or more (Chao & Shen 2003, eq. 8).

    The shares of what was met are lessened by that of what was not, which is the share of answers met once (Good 1953),
    and each is weighted by the inverse probability that it was met at all.
    """
    n = counts.sum(axis=1, keepdims=True)
    once = (counts == 1).sum(axis=1, keepdims=True)
    once = np.where(once == n, n - 1, once)  # all met once: nothing would be left
    share = (1 - once / n) * counts / n
    met = 1 - (1 - share) ** n
    terms = share * np.log2(np.where(share > 0, share, 1.0)) / np.where(met > 0, met, 1.0)
    found: Array = -terms.sum(axis=1)
    return found


def _shuffle(each: Array, seed: int) -> Array:
    """(shuffles,) plug-in information after shuffling each person's answers over the prompts."""
    draw = np.random.default_rng(seed)
    _, prompts, answers = each.shape
    asked, given = [], []
    for one in each.astype(int):
        asked.append(np.repeat(np.arange(prompts), one.sum(axis=1)))
        given.append(np.repeat(np.arange(answers), one.sum(axis=0)))
    at = np.concatenate(asked) * answers
    tables = np.empty((_SHUFFLES, prompts * answers))
    for n in range(_SHUFFLES):
        dealt = np.concatenate([draw.permutation(one) for one in given])
        tables[n] = np.bincount(at + dealt, minlength=prompts * answers)
    return plug_in_information(tables.reshape(_SHUFFLES, prompts, answers))


# --------------------------------------------------------------------------------------------------
# Intervals of one person's share of answers (Wilson) and of means over people (Student).


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
    """(low, high), shape (...), Student's interval of the mean over people; values (people, ...), NaN left out.

    People are the units that a study draws: with few of them a percentile bootstrap is too narrow, by (n − 1)/n in
    the variance and by the normal quantile in place of t. With fewer than two people there is no interval: NaN.

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
# Stevens' power law ψ = k φⁿ of one person's estimates, least squares in the logarithms (Stevens 1957).


@dataclass(frozen=True)
class PowerLaw:
    """log ψ = log_at_reference + exponent · log(φ/reference); NaN with fewer than two levels."""

    exponent: float
    log_at_reference: float  #: natural logarithm of the estimate that the law gives at the reference


def fit_power_law(levels: ArrayLike, estimates: ArrayLike, reference: float) -> PowerLaw:
    """The law of `estimates` (n,) of `levels` (n,), all above zero, as the reference is.

    >>> law = fit_power_law([1.0, 2.0, 4.0], [10.0, 20.0, 40.0], 2.0)
    >>> round(law.exponent, 3), round(float(np.exp(law.log_at_reference)), 3)
    (1.0, 20.0)
    """
    x = np.log(np.asarray(levels, dtype=float) / reference)
    if len(np.unique(x)) < 2:
        return PowerLaw(math.nan, math.nan)
    exponent, constant = np.polyfit(x, np.log(np.asarray(estimates, dtype=float)), 1)
    return PowerLaw(float(exponent), float(constant))


# --------------------------------------------------------------------------------------------------
# Interval of the share of right answers, or of any choice, over all people of whom the participants are a sample.
#
# People differ. Their own shares have a mean m, and their answers an intraclass correlation ρ: 0 where all people are
# alike, 1 where everybody answers always right or always wrong. Counted answers are then beta-binomial. For each m that
# may be the truth, ρ is the one that makes the answers most probable, and m belongs to the interval while
#
#     N (p̂ − m)²/V(m) ≤ c,    V(m) = m (1 − m) Σ (1 + (nᵢ − 1) ρ(m))/nᵢ / N,    c = N t²/(N − 1 + t²)
#
# and the answers are not much less probable than with the best m: by at most N/2 log(1 + t₉₉²/(N − 1)) in log
# likelihood. p̂ is the mean of N people's shares, of nᵢ answers each; t and t₉₉ are Student's quantiles for 95 and 99 %
# with N − 1 degrees of freedom. V is the spread about m and not about p̂, and c makes up for that: in the middle of the
# range this is nearly Student's interval. Near 100 % it stays inside, and allows for people who are often wrong and are
# missing from a sample that is nearly always right: V(m) is large wherever only a large ρ explains the answers.


_MEANS = np.sin(np.linspace(0, np.pi / 2, 98)[1:-1]) ** 2  #: considered, denser near 0 and 1
_FINER = 24  #: parts of a step between them, at each end of the interval
_POSITIVE = np.append(0.0, np.geomspace(2e-4, 0.999, 46))  #: correlations considered
_NEGATIVE = np.array([0.98, 0.8, 0.6, 0.4, 0.2])  #: parts of the greatest negative correlation
_SHARE_INTERVAL_TINY = 1e-12  #: from 0 and 1, which are no mean of a beta distribution
_WIDER = 0.2  #: of what the interval may miss: what the likelihood alone may miss


def share_interval(right: ArrayLike, of: ArrayLike, confidence: float = 0.95) -> tuple[float, float]:
    """Interval of the mean over people of each one's share `right` (people,) out of `of` (people,), of = 0 left out.

    With fewer than two people there is no interval: NaN.

    >>> [round(end, 2) for end in share_interval([36, 41, 33, 38, 29, 40], [50] * 6)]
    [0.62, 0.79]
    """
    k, n = np.asarray(right, dtype=float), np.asarray(of, dtype=float)
    k, n = k[n > 0], n[n > 0]
    if len(n) < 2:
        return np.nan, np.nan
    counts = _CountedAnswers(k, n, confidence)
    p, inside = counts.share, _MEANS[counts.coarse <= 0]
    ends = np.concatenate([[0.0], _MEANS, [1.0]])
    least, most = float(min([p, *inside])), float(max([p, *inside]))
    low = 0.0 if p == 0 else _cross(counts, least, float(ends[ends < least].max()))
    high = 1.0 if p == 1 else _cross(counts, most, float(ends[ends > most].min()))
    return low, high


@final
class _CountedAnswers:
    """Right answers `k` out of `n` (people,) each, and how far a mean of everybody's share is from explaining them."""

    def __init__(self, k: Array, n: Array, confidence: float) -> None:
        from scipy.special import stdtrit

        people = len(n)
        self.share = float((k / n).mean())  #: mean over people
        self._pairs, self._times = np.unique(np.stack([k, n]), axis=1, return_counts=True)
        miss = 1 - confidence
        square, wide = (float(stdtrit(people - 1, 1 - part * miss / 2)) ** 2 for part in (1.0, _WIDER))
        self._cut = square / (people - 1 + square)  # c/N
        self._drop = people / 2 * float(np.log1p(wide / (people - 1)))
        logs, effect = self._fit(_MEANS)
        self._best = float(logs.max())
        self.coarse = self._judge(_MEANS, logs, effect)  #: (96,) how far the means considered are outside

    def exceed(self, means: Array) -> Array:
        """(m,) how far `means` (m,), above 0 and below 1, are outside of the interval; not above 0 within it."""
        return self._judge(means, *self._fit(means))

    def _judge(self, means: Array, logs: Array, effect: Array) -> Array:
        variance = means * (1 - means) * effect
        away: Array = np.maximum((self.share - means) ** 2 / variance / self._cut, (self._best - logs) / self._drop)
        return away - 1.0

    def _fit(self, means: Array) -> tuple[Array, Array]:
        """(m,) greatest log likelihood at `means` (m,), and mean over people of (1 + (n − 1) ρ)/n there."""
        correlations, logs = _log_probabilities(means, self._pairs)
        total = logs @ self._times
        best = np.clip(np.argmax(total, axis=1), 1, total.shape[1] - 2)
        rows = np.arange(len(means))
        # The top of a parabola through three points: without it, the correlation would jump from mean to mean.
        before, here, after = (total[rows, best + shift] for shift in (-1, 0, 1))
        bend = np.minimum(before - 2 * here + after, -1e-12)
        step = np.clip((before - after) / (2 * bend), -1.0, 1.0)
        aside = np.where(step < 0, correlations[rows, best - 1], correlations[rows, best + 1])
        rho = correlations[rows, best] + np.abs(step) * (aside - correlations[rows, best])
        of = self._pairs[1]
        effect: Array = ((1 + (of - 1) * rho[:, None]) / of) @ self._times / self._times.sum()
        return total.max(axis=1), effect


def _cross(counts: _CountedAnswers, inside: float, outside: float) -> float:
    """Where the interval ends, between a mean `inside` of it and one `outside`, which may be 0 or 1."""
    means = np.linspace(inside, outside, _FINER + 1)
    beyond = np.append(counts.exceed(np.clip(means[:-1], _SHARE_INTERVAL_TINY, 1 - _SHARE_INTERVAL_TINY)), np.inf)
    beyond[0] = min(float(beyond[0]), 0.0)
    first = int(np.argmax(beyond > 0))
    if first == _FINER:
        return outside
    share = beyond[first - 1] / (beyond[first - 1] - beyond[first])
    return float(means[first - 1] + share * (means[first] - means[first - 1]))


def _log_probabilities(means: Array, pairs: Array) -> tuple[Array, Array]:
    """(m, r) correlations at `means` (m,), and (m, r, k) log probability of `pairs`, without binomial coefficients.

    Negative correlations, as answers that alternate have, are those that the same formula allows (Prentice 1986): with
    γ = ρ/(1 − ρ) the probability of k answers out of n is Π(m + γ j) Π(1 − m + γ j)/Π(1 + γ j), over j < k, n − k, n.
    """
    from scipy.special import gammaln, xlog1py, xlogy

    k, n = pairs
    size = 1 / _POSITIVE[1:, None] - 1
    a, b = means[:, None, None] * size, (1 - means)[:, None, None] * size
    positive = gammaln(k + a) - gammaln(a) + gammaln(n - k + b) - gammaln(b) + gammaln(size) - gammaln(n + size)
    none = (xlogy(k, means[:, None]) + xlog1py(n - k, -means[:, None]))[:, None]
    gamma = _NEGATIVE * (np.minimum(means, 1 - means) / max(float(n.max()) - 1, 1.0))[:, None]
    q, r, s = (x[..., None] for x in (means[:, None] / gamma, (1 - means)[:, None] / gamma, 1 / gamma))
    negative = (
        gammaln(q + 1) - gammaln(q - k + 1) + gammaln(r + 1) - gammaln(r - n + k + 1) - gammaln(s + 1)
        + gammaln(s - n + 1)
    )  # fmt: skip
    known = np.broadcast_to(_POSITIVE, (len(means), len(_POSITIVE)))
    return np.concatenate([-gamma / (1 - gamma), known], axis=1), np.concatenate([negative, none, positive], axis=1)


# --------------------------------------------------------------------------------------------------
# How probable what was found is by chance: exact guessing, paired differences, and several tests at once.


PairTest = Literal["t", "sign-flip"]
Correction = Literal["holm", "bonferroni", "none"]
TESTS: tuple[PairTest, ...] = get_args(PairTest)
CORRECTIONS: tuple[Correction, ...] = get_args(Correction)

EXACT_PEOPLE = 14  #: people up to whom all signs are tried
_DRAWN = 5_000  #: sign patterns beyond, the observed one among them
_AT_ONCE = 1 << 22  #: numbers held at a time


def binomial_tail(right: int, of: int, chance: float) -> float:
    """Probability of at least so many right answers by guessing: the binomial tail, exactly.

    >>> round(binomial_tail(3, 3, 0.5), 3)
    0.125
    """
    from scipy.special import bdtrc

    return 1.0 if right <= 0 else float(bdtrc(right - 1, of, chance))


def decide_p(differences: ArrayLike, test: PairTest = "t") -> Array:
    """(...) two-sided p that `differences` (..., people) are zero on average. Both analysis and power ask here.

    t          Student's test of the mean; the 95 % interval of `mean_interval` excludes zero where p < 0.05
    sign-flip  signs of all differences are exchangeable: all patterns up to 14 people, beyond 5 000, the observed one
               among them

    Where all differences of a group are equal there is no spread for Student's test to go by; then p is 1 if they are
    zero, else that of the sign-flip test, 2/2ⁿ. InputError with fewer than two people.

    >>> float(decide_p([1.0, 2.0, 3.0, 4.0], "sign-flip")), round(float(decide_p([1.0, 2.0, 3.0, 4.0])), 4)
    (0.125, 0.0305)
    """
    from scipy.special import stdtr

    d = check_finite(differences, "differences")
    if d.ndim < 1 or d.shape[-1] < 2:
        raise InputError(f"a test over people needs at least two, one difference each; got shape {d.shape}")
    if check_test(test) == "sign-flip":
        return _flip_signs(d.reshape(-1, d.shape[-1])).reshape(d.shape[:-1])
    n = d.shape[-1]
    mean, sd = d.mean(axis=-1), d.std(axis=-1, ddof=1)
    flat = sd <= 1e-12 * np.abs(d).max(axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        p = 2 * stdtr(n - 1, -np.abs(mean) / np.where(flat, 1.0, sd) * np.sqrt(n))
    found: Array = np.where(flat, np.where(mean == 0, 1.0, 2.0 ** (1 - n)), p)
    return found


def check_test(name: str) -> PairTest:
    """`name` of a test over people, or InputError."""
    for known in TESTS:
        if name == known:
            return known
    raise InputError(f"there is no test '{name}'; known: {', '.join(TESTS)}")


def fewest_people(alpha: float, test: PairTest = "t") -> int:
    """Fewest people with whom `test` can show p < `alpha` at all: with the signs of n people p is at least 2/2ⁿ.

    >>> fewest_people(0.05), fewest_people(0.05, "sign-flip")
    (2, 6)
    """
    n = 2
    while test == "sign-flip" and 2.0 ** (1 - n) >= alpha:
        n += 1
    return n


def correct_p(p: Sequence[float], correction: Correction = "holm") -> tuple[float, ...]:
    """`p` of several tests, adjusted so that any false one among them has at most the probability alpha.

    holm        the smallest times their number, the next times one fewer ..., never falling (Holm 1979)
    bonferroni  each times their number
    none        as they are

    NaN, a test that could not be made, stays NaN and does not count.

    >>> correct_p([0.01, 0.04, 0.03])
    (0.03, 0.06, 0.06)
    """
    values = np.asarray(p, dtype=float)
    known = np.flatnonzero(np.isfinite(values))
    if correction not in CORRECTIONS:
        raise InputError(f"there is no correction '{correction}'; known: {', '.join(CORRECTIONS)}")
    if correction == "none":
        return tuple(values.tolist())
    m = len(known)
    if correction == "bonferroni":
        values[known] = np.minimum(1.0, m * values[known])
    else:
        order = known[np.argsort(values[known], kind="stable")]
        values[order] = np.minimum(1.0, np.maximum.accumulate((m - np.arange(m)) * values[order]))
    return tuple(float(x) for x in values)


def _flip_signs(groups: Array) -> Array:
    """(groups,) p of each row (people,), as many rows at a time as the memory bears."""
    people = groups.shape[1]
    signs = _signs(people).T
    step = max(1, _AT_ONCE // signs.shape[1])
    found = np.empty(len(groups))
    for first in range(0, len(groups), step):
        rows = groups[first : first + step]
        limit = np.abs(rows.sum(axis=1)) - 1e-12 * np.abs(rows).sum(axis=1)
        found[first : first + step] = np.mean(np.abs(rows @ signs) >= limit[:, None], axis=1)
    return found


@cache
def _signs(people: int) -> Array:
    """(patterns, people): all up to one common sign, or drawn ones with the observed."""
    if people <= EXACT_PEOPLE:
        return np.array([(1.0, *rest) for rest in product((1.0, -1.0), repeat=people - 1)])
    drawn: Array = np.random.default_rng(people).choice((-1.0, 1.0), (_DRAWN, people))
    drawn[0] = 1.0
    return drawn


# --------------------------------------------------------------------------------------------------
# Directions on the sphere: errors as vectors in local axes, mean direction, and spread.


_SPHERE_TINY = 1e-9  #: of a unit vector: below it a direction is not known


@dataclass(frozen=True)
class DirectionSpread:
    """Directions about their mean (Fisher 1953; Mardia & Jupp 2000, §10.3)."""

    count: int
    theta_deg: float  #: mean direction from the top [deg]; NaN where the directions cancel
    phi_deg: float  #: about the vertical [deg]
    resultant: float  #: mean resultant length, 0 to 1; 1: all alike
    kappa: float  #: concentration, (n − 1)/(n − n·resultant); infinite where all are alike, NaN for one direction
    spread_deg: float  #: standard deviation in each of two directions, 1/√κ [deg]; means little below κ = 3


def local_axes(ways: ArrayLike) -> tuple[Array, Array]:
    """(up, round): unit tangents (..., 3) at `ways` (..., 3), along the meridian to the top, and along φ.

    NaN at the top itself, and at the bottom, where every way leads away.

    >>> up, round_ = local_axes([1.0, 0.0, 0.0])
    >>> up.tolist(), round_.tolist()
    ([0.0, 0.0, 1.0], [0.0, 1.0, 0.0])
    """
    n = _unit(ways, "ways")
    flat = np.hypot(n[..., 0], n[..., 1])
    with np.errstate(invalid="ignore", divide="ignore"):
        cos, sin = (np.where(flat > _SPHERE_TINY, n[..., k] / flat, np.nan) for k in (0, 1))
    up = np.stack([-n[..., 2] * cos, -n[..., 2] * sin, np.where(np.isfinite(cos), flat, np.nan)], axis=-1)
    return up + 0.0, np.stack([-sin, cos, np.where(np.isfinite(cos), 0.0, np.nan)], axis=-1) + 0.0


def find_away_axes(ways: ArrayLike, hand_deg: float) -> Array:
    """(..., 3) unit tangents at `ways` (..., 3) that lead away from a hand at `hand_deg` about the vertical, from +x.

    The horizontal direction from the hand to the vertical axis, in the tangent plane; known at the top too. NaN where
    that direction is the normal.

    >>> (find_away_axes([0.0, 0.0, 1.0], 180.0).round(9) + 0.0).tolist()
    [1.0, 0.0, 0.0]
    """
    n = _unit(ways, "ways")
    away = -np.array([math.cos(math.radians(hand_deg)), math.sin(math.radians(hand_deg)), 0.0])
    along = away - (n @ away)[..., None] * n
    size = np.linalg.norm(along, axis=-1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        found: Array = np.where(size > _SPHERE_TINY, along / size, np.nan) + 0.0
    return found


def error_vectors(asked: ArrayLike, answered: ArrayLike) -> Array:
    """(n, 3) errors [deg] in the tangent planes at `asked` (n, 3): as long as the arc to `answered`, and that way.

    Their lengths are angles, so a component is a share of the angle along its axis. NaN where the answer lies opposite,
    every way being equally short, and where an answer is missing (NaN).

    >>> error_vectors([[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]]).tolist()
    [[90.0, 0.0, 0.0]]
    """
    n = _unit(asked, "asked")
    given = np.asarray(answered, dtype=float)
    if given.shape != n.shape:
        raise InputError(f"as many answers as were asked are needed, shape {n.shape}; got {given.shape}")
    with np.errstate(invalid="ignore", divide="ignore"):
        a = given / np.linalg.norm(given, axis=-1, keepdims=True)
    cos = np.sum(n * a, axis=-1, keepdims=True)
    side = a - cos * n
    sin = np.linalg.norm(side, axis=-1, keepdims=True)
    angle = np.degrees(np.arctan2(sin, cos))
    with np.errstate(invalid="ignore", divide="ignore"):
        found = np.where(sin > _SPHERE_TINY, angle * side / sin, np.where(cos > 0, 0.0, np.nan))
    return np.where(np.isfinite(a), found, np.nan) + 0.0


def summarize_directions(ways: ArrayLike) -> DirectionSpread:
    """Mean direction and spread of `ways` (n, 3), n ≥ 1.

    Directions that cancel, such as two opposite ones, have no mean direction; their resultant is zero and κ is as small
    as so few directions can tell.

    >>> one = summarize_directions([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    >>> one.resultant, one.kappa, one.theta_deg
    (0.0, 0.5, nan)
    """
    n = _unit(ways, "ways")
    if n.ndim != 2 or not len(n):
        raise InputError(f"a mean direction needs directions, shape (n, 3); got {n.shape}")
    count, total = len(n), n.sum(axis=0)
    length = float(np.linalg.norm(total))
    resultant = min(1.0, length / count)
    theta = phi = math.nan
    if resultant > _SPHERE_TINY:
        theta = math.degrees(math.atan2(math.hypot(total[0], total[1]), total[2]))
        phi = math.degrees(math.atan2(total[1], total[0]))
    rest = count - length
    kappa = math.nan if count < 2 else math.inf if rest < 1e-12 * count else (count - 1) / rest
    spread = 0.0 if math.isinf(kappa) else math.degrees(kappa**-0.5)
    return DirectionSpread(count, theta, phi, resultant, kappa, spread)


def _unit(ways: ArrayLike, name: str) -> Array:
    n = check_finite(ways, name)
    if n.ndim < 1 or n.shape[-1] != 3:
        raise InputError(f"{name} must be directions, shape (..., 3); got {n.shape}")
    length = np.linalg.norm(n, axis=-1, keepdims=True)
    if (length <= _SPHERE_TINY).any():
        raise InputError(f"{name} must be directions; a vector of length zero has none")
    unit: Array = n / length
    return unit
