"""Information transfer from a confusion matrix, in bits (Miller & Nicely 1955).

T = H(answers) − H(answers | prompts). Estimated from few answers with shares as probabilities (plug-in), T is biased
upwards: chance alone produces apparent dependence. Four estimates are reported:

    bits          both entropies after Chao & Shen 2003: the share of answers not yet met is guessed from those met
    once
    miller_madow  the plug-in less (cells − rows − columns + 1)/(2 N ln 2), counting what is not empty (Miller 1955)
    plug_in       as in Miller & Nicely 1955
    chance        mean plug-in of shuffled answers: no dependence

Plug-in minus chance is right only for nearly independent answers; otherwise fewer cells are occupied than after
shuffling, and the correction is far too large (a third, at 80 % correct of 25 set-points and 300 trials).
`benchmarks/study/study_localisation.py` measures all four.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from haptorb.arrays import Array, check_finite
from haptorb.errors import InputError

__all__ = ["Information", "plug_in_information", "transfer_information"]


_PERMUTATIONS = 199


@dataclass(frozen=True)
class Information:
    """Information transferred [bit], with its maximum and chance level."""

    bits: float  #: bias-corrected, 0 to `most`; NaN below two answers per prompt on average
    low: float  #: 95 %, jackknife over participants (Student); NaN for one participant, and where all agree
    high: float
    most: float  #: [bit] entropy of the prompts: all distinguished
    plug_in: float
    miller_madow: float
    chance: float  #: mean of the plug-in estimate of shuffled answers
    p: float  #: one-sided, permutation test; at least 1/200
    trials: int
    people: int


def transfer_information(counts: ArrayLike, *, seed: int = 0) -> Information:
    """Information transferred in `counts` (people, prompts, answers); the test shuffles answers within participants.

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
        bits = math.nan  # answers that occur once carry no estimate of the unseen ones
    if people > 1 and math.isfinite(bits):
        from scipy.special import stdtrit

        without = np.array([_correct_information(table - one) for one in each])
        error = math.sqrt((people - 1) / people * float(np.sum((without - without.mean()) ** 2)))
        half = float(stdtrit(people - 1, 0.975)) * error
        # The jackknife's bias estimate widens the interval.
        other = people * bits - (people - 1) * float(without.mean())
        if error > 1e-12:  # identical participants show no spread
            low, high = max(0.0, min(bits, other) - half), min(most, max(bits, other) + half)
    plug_in = float(plug_in_information(table))
    cells, rows, columns = ((table > 0).sum(), (table.sum(axis=1) > 0).sum(), (table.sum(axis=0) > 0).sum())
    bias = float(cells - rows - columns + 1) / (2 * trials * math.log(2))
    shuffled = _shuffle(each, seed)
    p = (1 + int(np.sum(shuffled >= plug_in - 1e-12))) / (1 + _PERMUTATIONS)
    bits = bits if math.isnan(bits) else min(most, max(0.0, bits))
    return Information(
        bits, low, high, most, plug_in, min(most, plug_in - bias), float(shuffled.mean()), p, trials, people
    )


def plug_in_information(counts: ArrayLike) -> Array:
    """(...) plug-in estimate [bit] from `counts` (..., prompts, answers).

    >>> float(plug_in_information([[1, 1], [1, 1]]))
    0.0
    """
    table = np.asarray(counts, dtype=float)
    both = table.reshape(*table.shape[:-2], -1)
    found: Array = _entropy(table.sum(axis=-1)) + _entropy(table.sum(axis=-2)) - _entropy(both)
    return np.maximum(found, 0.0)


def _correct_information(table: Array) -> float:
    """Estimate from `table` (prompts, answers) after Chao & Shen."""
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

    The observed shares are reduced by the probability of unseen answers, estimated by the share of singletons (Good
    1953), and weighted by the inverse probability of being observed.
    """
    n = counts.sum(axis=1, keepdims=True)
    once = (counts == 1).sum(axis=1, keepdims=True)
    once = np.where(once == n, n - 1, once)  # all singletons: the coverage estimate would be zero
    share = (1 - once / n) * counts / n
    met = 1 - (1 - share) ** n
    terms = share * np.log2(np.where(share > 0, share, 1.0)) / np.where(met > 0, met, 1.0)
    found: Array = -terms.sum(axis=1)
    return found


def _shuffle(each: Array, seed: int) -> Array:
    """(shuffles,) plug-in estimates with each participant's answers shuffled over the prompts."""
    draw = np.random.default_rng(seed)
    _, prompts, answers = each.shape
    asked, given = [], []
    for one in each.astype(int):
        asked.append(np.repeat(np.arange(prompts), one.sum(axis=1)))
        given.append(np.repeat(np.arange(answers), one.sum(axis=0)))
    at = np.concatenate(asked) * answers
    tables = np.empty((_PERMUTATIONS, prompts * answers))
    for n in range(_PERMUTATIONS):
        dealt = np.concatenate([draw.permutation(one) for one in given])
        tables[n] = np.bincount(at + dealt, minlength=prompts * answers)
    return plug_in_information(tables.reshape(_PERMUTATIONS, prompts, answers))
