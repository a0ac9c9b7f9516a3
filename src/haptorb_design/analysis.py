"""Analysis of evaluated designs: Pareto front, representative picks, and sensitivity to each parameter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rankdata

from haptorb.arrays import Array

__all__ = ["MIN_DESIGNS", "RULES", "Pick", "Sensitivity", "choose_best", "estimate_sensitivity", "find_front"]


# --------------------------------------------------------------------------------------------------
# Pareto front: designs that no other design beats in one objective without loss in another.


def find_front(costs: Array) -> NDArray[np.int_]:
    """Rows (k,), ascending, of `costs` (n, m) on the Pareto front of a minimisation.

    A row is on the front if no other row is at most as large in every column and smaller in one. Equal rows both are.

    >>> find_front(np.array([[1.0, 3.0], [2.0, 2.0], [2.0, 3.0], [3.0, 1.0]])).tolist()
    [0, 1, 3]
    """
    rows: NDArray[np.int_] = np.arange(len(costs))
    if not len(rows):
        return rows
    # Designs with a small sum of ranks dominate many others, so they are tested first.
    ranks = np.argsort(np.argsort(costs, axis=0, kind="stable"), axis=0, kind="stable")
    rows = rows[np.argsort(ranks.sum(axis=1), kind="stable")]
    left, place = costs[rows], 0
    while place < len(rows):
        one = left[place]
        stays = (left < one).any(axis=1) | (left == one).all(axis=1)
        rows, left = rows[stays], left[stays]
        place = int(stays[:place].sum()) + 1
    return np.sort(rows)


_MIN_DIFFERENCE = 0.05  #: difference between picks, relative to a parameter's range

#: rule of the picks, by whether there are several objectives
RULES = {
    False: "The best design, then the next best that differ from every design before them by at least 5 % of the range "
    "of one parameter, or in a choice. If there are not enough such designs, the next best follow.",
    True: "First the compromise: the design of the front that is nearest to the best value of every objective at once "
    "(Euclidean distance; every objective runs from 0, its best value on the front, to 1, its worst there). Then the "
    "best design of each objective. Then, one after another, the design of the front that is farthest from all chosen "
    "so far. If the front is too short, the front of the remaining designs follows.",
}


@dataclass(frozen=True)
class Pick:
    """A picked design: its row, and the reason in one line."""

    row: int
    reason: str


def choose_best(costs: Array, places: Array, names: Sequence[str], count: int = 5) -> tuple[Pick, ...]:
    """At most `count` rows of `costs`, picked by `RULES`.

    costs   (n, m) objectives to be minimised [any unit]
    places  (n, p) parameters relative to their ranges, 0 to 1; choices as whole numbers
    names   of the m objectives

    >>> costs, places = np.array([[3.0], [1.0], [1.01], [2.0]]), np.array([[0.0], [0.5], [0.51], [1.0]])
    >>> [pick.row for pick in choose_best(costs, places, ["heat"], 3)]
    [1, 3, 0]
    """
    if not len(costs):
        return ()
    return _choose_apart(costs[:, 0], places, count) if costs.shape[1] == 1 else _choose_spread(costs, names, count)


def _choose_apart(costs: Array, places: Array, count: int) -> tuple[Pick, ...]:
    order = np.argsort(costs, kind="stable")
    chosen = [int(order[0])]
    for row in order[1:].tolist():
        if len(chosen) == count:
            break
        if all((np.abs(places[row] - places[one]) >= _MIN_DIFFERENCE).any() for one in chosen):
            chosen.append(row)
    rest = [row for row in order[: 2 * count].tolist() if row not in chosen]
    chosen = sorted((chosen + rest)[:count], key=lambda row: float(costs[row]))
    return tuple(Pick(row, "the best" if row == order[0] else "next best") for row in chosen)


def _choose_spread(costs: Array, names: Sequence[str], count: int) -> tuple[Pick, ...]:
    picks: list[Pick] = []
    left = np.arange(len(costs))
    first = True
    while len(picks) < count and len(left):
        front = left[find_front(costs[left])]
        for row, reason in _order_front(costs[front], names, count - len(picks)):
            picks.append(Pick(int(front[row]), reason if first else "of the next front"))
        left, first = np.setdiff1d(left, front), False
    return tuple(picks)


def _order_front(costs: Array, names: Sequence[str], count: int) -> list[tuple[int, str]]:
    """Rows of a front in the order of the picks, each once, with the reason."""
    low, high = costs.min(axis=0), costs.max(axis=0)
    shares = (costs - low) / np.where(high > low, high - low, 1.0)
    found = {int(np.argmin(np.linalg.norm(shares, axis=1))): "compromise"}
    for column, name in enumerate(names):
        # Ties in one objective are resolved by the others.
        best = int(np.lexsort((shares.sum(axis=1), shares[:, column]))[0])
        found[best] = f"{found[best]}, best {name}" if best in found else f"best {name}"
    while len(found) < min(count, len(costs)):
        away = np.linalg.norm(shares[:, None] - shares[list(found)], axis=2).min(axis=1)
        away[list(found)] = -1.0
        found[int(np.argmax(away))] = "between the others"
    return list(found.items())[:count]


# --------------------------------------------------------------------------------------------------
# Sensitivity of an objective to each parameter, from the evaluated designs, with confidence intervals.
#
# share      correlation ratio of the objective's ranks on the parameter: share of the variance of the ranks explained
#            by it, Var(E[R|x]) / Var(R). It is Sobol's first-order index of the ranks, and detects an optimum
#            within the range, which a slope does not. The parameter is divided into bins with equal counts; the share
#            expected by chance is subtracted (adjusted: Kelley's ε²).
# direction  Spearman's rank correlation: +1, the objective grows with the parameter; −1, it falls. None for choices.
#
# Ranks, because an objective such as heat per force squared grows without bound at the limits of feasibility, where a
# few designs would dominate.
#
# Intervals are 95 %, from 200 random halves of the designs. The spread of an estimate from n/2 designs about that from
# n is the standard error with n designs (delete-half jackknife: Shao and Wu 1989); a bootstrap, which draws designs
# repeatedly, mistakes these repetitions for an effect of the parameter, and finds a share where there is none.


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
