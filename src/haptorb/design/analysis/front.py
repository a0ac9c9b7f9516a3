"""The Pareto front: the designs that no other design beats in one objective without loss in another."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from haptorb.numerics.arrays import Array

__all__ = ["find_front"]


def find_front(costs: Array) -> NDArray[np.int_]:
    """Rows (k,), ascending, of `costs` (n, m) that are on the front; every cost is to be made small [any unit].

    A row is on the front if no other row is at most as large in every column and smaller in one. Equal rows are both.

    >>> find_front(np.array([[1.0, 3.0], [2.0, 2.0], [2.0, 3.0], [3.0, 1.0]])).tolist()
    [0, 1, 3]
    """
    rows: NDArray[np.int_] = np.arange(len(costs))
    if not len(rows):
        return rows
    # What comes early in the order of the sum of ranks beats many others: they leave at once.
    ranks = np.argsort(np.argsort(costs, axis=0, kind="stable"), axis=0, kind="stable")
    rows = rows[np.argsort(ranks.sum(axis=1), kind="stable")]
    left, place = costs[rows], 0
    while place < len(rows):
        one = left[place]
        stays = (left < one).any(axis=1) | (left == one).all(axis=1)
        rows, left = rows[stays], left[stays]
        place = int(stays[:place].sum()) + 1
    return np.sort(rows)
