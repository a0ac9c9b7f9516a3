"""Pareto front: designs that no other design beats in one objective without loss in another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from haptorb.arrays import Array

__all__ = ["RULES", "Pick", "choose_best", "find_front"]


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
