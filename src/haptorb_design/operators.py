"""Genetic operators of pymoo for parameters with steps and unordered choices.

pymoo's operators for real numbers rarely leave a step or a choice, since their changes are smaller.
"""

from __future__ import annotations

from typing import Any, final

import numpy as np
from numpy.typing import NDArray
from pymoo.core.duplicate import DuplicateElimination
from pymoo.core.repair import Repair
from pymoo.operators.crossover.sbx import SBX
from pymoo.operators.mutation.pm import PM

from haptorb_design.search_space import SearchSpace

__all__ = ["MixedCrossover", "MixedMutation", "NewOnly", "Snap"]

Array = NDArray[np.float64]


@final
class MixedCrossover(SBX):  # type: ignore[misc]
    """Simulated binary crossover of ranges and steps (Deb & Agrawal 1995); choices are inherited from either parent."""

    def __init__(self, space: SearchSpace) -> None:
        super().__init__(eta=15, prob=0.9)
        self._space = space

    def _do(self, problem: Any, X: Array, *args: Any, random_state: Any = None, **options: Any) -> Array:
        children: Array = super()._do(problem, X, *args, random_state=random_state, **options)
        swap = random_state.random(X.shape[1:]) < 0.5
        choices = np.where(swap, X[::-1], X)
        return np.where(self._space.free, choices, children)


@final
class MixedMutation(PM):  # type: ignore[misc]
    """Polynomial mutation of ranges (Deb & Goyal 1996); a step or a few up or down; any other choice.

    Each parameter of a child that is changed does so with probability 1 / (number of parameters).

    prob  probability that a child is changed
    """

    def __init__(self, space: SearchSpace, prob: float = 1.0) -> None:
        super().__init__(eta=20, prob=prob)
        self._space = space

    def _do(self, problem: Any, X: Array, *args: Any, random_state: Any = None, **options: Any) -> Array:
        space = self._space
        ranges: Array = super()._do(problem, X, *args, random_state=random_state, **options)
        levels = np.maximum(space.levels, 1)
        hit = random_state.random(X.shape) < 1.0 / X.shape[1]
        draw = random_state.random(X.shape)
        up = np.where(random_state.random(X.shape) < 0.5, 1.0, -1.0)
        steps = X + up * np.ceil(-np.log2(1.0 - draw) + 1e-12) / np.maximum(
            levels - 1, 1
        )  # 1, 2, 3 …: half as often each
        choices = np.mod(X + (1.0 + np.floor(draw * np.maximum(levels - 1, 1))) / levels, 1.0)
        moved = np.where(space.free, choices, steps)
        return np.where(space.levels > 0, np.where(hit, moved, X), ranges)


@final
class Snap(Repair):  # type: ignore[misc]
    """Rounds candidates to the steps and choices."""

    def __init__(self, space: SearchSpace) -> None:
        super().__init__()
        self._space = space

    def _do(self, problem: Any, X: Array, **options: Any) -> Array:
        return self._space.snap(X)


@final
class NewOnly(DuplicateElimination):  # type: ignore[misc]
    """Removes candidates that the run had before.

    old  bytes of the points of the run so far; extended by the optimiser
    """

    def __init__(self) -> None:
        super().__init__()
        self.old: set[bytes] = set()

    def find_old(self, pop: Any) -> NDArray[np.bool_]:
        """Mask of the candidates in `pop` (n,) that the run had before, or that are duplicates."""
        return self._do(pop, None, np.zeros(len(pop), dtype=bool))

    def _do(self, pop: Any, other: Any, is_duplicate: NDArray[np.bool_]) -> NDArray[np.bool_]:
        there = set() if other is None else {point.tobytes() for point in other.get("X")}
        for index, point in enumerate(pop.get("X")):
            key = point.tobytes()
            is_duplicate[index] = key in there or key in self.old
            if other is None:
                there.add(key)
        return is_duplicate
