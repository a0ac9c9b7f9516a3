"""Sensitivity of an objective to each parameter, from the evaluated designs, with confidence intervals.

    share      correlation ratio of the objective's ranks on the parameter: share of the variance of the ranks explained
               by it, Var(E[R|x]) / Var(R). It is Sobol's first-order index of the ranks, and detects an optimum
               within the range, which a slope does not. The parameter is divided into bins with equal counts; the share
               expected by chance is subtracted (adjusted: Kelley's ε²).
    direction  Spearman's rank correlation: +1, the objective grows with the parameter; −1, it falls. None for choices.

Ranks, because an objective such as heat per force squared grows without bound at the limits of feasibility, where a
few designs would dominate.

Intervals are 95 %, from 200 random halves of the designs. The spread of an estimate from n/2 designs about that from
n is the standard error with n designs (delete-half jackknife: Shao and Wu 1989); a bootstrap, which draws designs
repeatedly, mistakes these repetitions for an effect of the parameter, and finds a share where there is none.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rankdata

from haptorb.arrays import Array

__all__ = ["MIN_DESIGNS", "Sensitivity", "estimate_sensitivity"]


MIN_DESIGNS = 40  #: minimum number of designs for an estimate
_MAX_BINS = 60  #: maximum number of bins
_RANDOM_HALVES = 200  #: random halves of the designs


@dataclass(frozen=True)
class Sensitivity:
    """Sensitivity of one objective to one parameter; each number with its interval (low, high); None: not defined.

    share      of the variance of the objective's ranks, 0 to 1
    direction  rank correlation, −1 to +1; None for a choice between values without order
    """

    share: float
    share_interval: tuple[float, float]
    direction: float | None
    direction_interval: tuple[float, float] | None


def estimate_sensitivity(parameter: Array, objective: Array, *, ordered: bool = True, seed: int = 0) -> Sensitivity:
    """Sensitivity of `objective` (n,) to `parameter` (n,), in any units, n ≥ `MIN_DESIGNS`.

    ordered   False: the parameter's values number choices without order
    seed      of the random halves

    >>> x = np.linspace(-1.0, 1.0, 400)
    >>> found = estimate_sensitivity(x, x**2)
    >>> found.share > 0.95, abs(found.direction) < 0.1
    (True, True)
    """
    ranks = rankdata(objective)
    parts = _cut(parameter) if ordered else np.unique(parameter, return_inverse=True)[1]
    steps = rankdata(parameter) if ordered else None
    share = _explain(parts, ranks)
    direction = None if steps is None else _correlate(steps, ranks)
    generator = np.random.default_rng(seed)
    shares, directions = np.empty(_RANDOM_HALVES), np.empty(_RANDOM_HALVES)
    for number in range(_RANDOM_HALVES):
        half = generator.permutation(len(ranks))[: len(ranks) // 2]
        shares[number] = _explain(parts[half], ranks[half])
        directions[number] = 0.0 if steps is None else _correlate(steps[half], ranks[half])
    spread = None if direction is None else _interval(direction, directions, -1.0)
    return Sensitivity(max(share, 0.0), _interval(share, shares, 0.0), direction, spread)


def _cut(values: Array) -> NDArray[np.int_]:
    """Bin index of each of `values`: equal counts, equal values in one bin."""
    count = min(round(1.5 * len(values) ** 0.5), _MAX_BINS)
    if len(np.unique(values)) <= count:
        return np.unique(values, return_inverse=True)[1]
    edges = np.unique(np.quantile(values, np.arange(1, count) / count))
    return np.searchsorted(edges, values, side="right")


def _explain(parts: NDArray[np.int_], ranks: Array) -> float:
    """ε²: 1 minus the ratio of the mean square within bins to the total mean square."""
    count = np.bincount(parts)
    total = np.bincount(parts, ranks)
    used = int((count > 0).sum())
    squares = float(((ranks - ranks.mean()) ** 2).sum())
    if used < 2 or squares == 0.0 or len(ranks) <= used:
        return 0.0
    within = float((ranks**2).sum() - (total[count > 0] ** 2 / count[count > 0]).sum())
    return 1.0 - within / (len(ranks) - used) / (squares / (len(ranks) - 1))


def _correlate(x: Array, y: Array) -> float:
    x, y = x - x.mean(), y - y.mean()
    scale = float(np.sqrt((x @ x) * (y @ y)))
    return float(x @ y) / scale if scale > 0.0 else 0.0


def _interval(value: float, halves: Array, least: float) -> tuple[float, float]:
    below, above = np.quantile(halves - value, [0.025, 0.975]).tolist()
    low, high = value - above, value - below
    return min(max(low, least), 1.0), min(max(high, least), 1.0)
