"""Significance tests: exact binomial, paired differences, and correction for multiple tests."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from itertools import product
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from haptorb.arrays import Array, check_finite
from haptorb.errors import InputError

__all__ = [
    "CORRECTIONS",
    "MAX_EXACT_PARTICIPANTS",
    "TESTS",
    "Correction",
    "PairTest",
    "binomial_tail",
    "check_test",
    "compute_p",
    "correct_p",
    "fewest_people",
]


PairTest = Literal["t", "sign-flip"]
Correction = Literal["holm", "bonferroni", "none"]
CORRECTIONS: Mapping[str, str] = {
    "holm": "Holm's correction", "bonferroni": "Bonferroni's correction", "none": "no correction",
}  # fmt: skip
TESTS: tuple[PairTest, ...] = get_args(PairTest)

MAX_EXACT_PARTICIPANTS = 14  #: participants up to whom all sign patterns are enumerated
_SAMPLED_PATTERNS = 5_000  #: sign patterns sampled above, with the observed one
_BLOCK_ELEMENTS = 1 << 22  #: array elements at a time


def binomial_tail(right: int, of: int, chance: float) -> float:
    """P(X ≥ right) of the binomial distribution: probability of so many correct answers by guessing.

    >>> round(binomial_tail(3, 3, 0.5), 3)
    0.125
    """
    from scipy.special import bdtrc

    return 1.0 if right <= 0 else float(bdtrc(right - 1, of, chance))


def compute_p(differences: ArrayLike, test: PairTest = "t") -> Array:
    """(...) two-sided p of a zero mean of `differences` (..., people); shared by analysis and power estimate.

    t          Student's test of the mean; the 95 % interval of `mean_interval` excludes zero where p < 0.05
    sign-flip  signs of all differences are exchangeable: all patterns up to 14 people, beyond 5 000, the observed one
               among them

    If all differences are equal, Student's test is undefined; then p is 1 if they are zero, else that of the sign-flip
    test, 2/2ⁿ. InputError with fewer than two participants.

    >>> float(compute_p([1.0, 2.0, 3.0, 4.0], "sign-flip")), round(float(compute_p([1.0, 2.0, 3.0, 4.0])), 4)
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
    """Validate the `name` of a test over participants; InputError if it is unknown."""
    for known in TESTS:
        if name == known:
            return known
    raise InputError(f"there is no test '{name}'; known: {', '.join(TESTS)}")


def fewest_people(alpha: float, test: PairTest = "t") -> int:
    """Smallest sample in which `test` can show p < `alpha`: with n sign flips p is at least 2/2ⁿ.

    >>> fewest_people(0.05), fewest_people(0.05, "sign-flip")
    (2, 6)
    """
    n = 2
    while test == "sign-flip" and 2.0 ** (1 - n) >= alpha:
        n += 1
    return n


def correct_p(p: Sequence[float], correction: Correction = "holm") -> tuple[float, ...]:
    """Adjust the `p` of several tests: family-wise error rate at most alpha.

    holm        the smallest times their number, the next times one fewer ..., never falling (Holm 1979)
    bonferroni  each times their number
    none        as they are

    NaN, a test that was not possible, remains NaN and is not counted.

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
    """(groups,) p of each row (people,), in blocks that fit into memory."""
    people = groups.shape[1]
    signs = _signs(people).T
    step = max(1, _BLOCK_ELEMENTS // signs.shape[1])
    found = np.empty(len(groups))
    for first in range(0, len(groups), step):
        rows = groups[first : first + step]
        limit = np.abs(rows.sum(axis=1)) - 1e-12 * np.abs(rows).sum(axis=1)
        found[first : first + step] = np.mean(np.abs(rows @ signs) >= limit[:, None], axis=1)
    return found


@cache
def _signs(people: int) -> Array:
    """(patterns, people): all patterns up to a common sign, or sampled ones with the observed."""
    if people <= MAX_EXACT_PARTICIPANTS:
        return np.array([(1.0, *rest) for rest in product((1.0, -1.0), repeat=people - 1)])
    drawn: Array = np.random.default_rng(people).choice((-1.0, 1.0), (_SAMPLED_PATTERNS, people))
    drawn[0] = 1.0
    return drawn
