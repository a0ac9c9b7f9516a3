"""The power of the paired sign-flip test for groups out of a pool, and the fewest people that reach a wanted one."""

from __future__ import annotations

from functools import cache
from itertools import product
from typing import final

import numpy as np

from haptorb.numerics.arrays import Array

__all__ = ["MOST_PEOPLE", "GroupPower"]

MOST_PEOPLE = 500  #: beyond which nothing is searched
_SIGNS = 512  #: sign patterns of the test, all there are up to 9 people; more where alpha asks for them
_PER_ALPHA = 8


@final
class GroupPower:
    """By number of people, the share of groups of so many out of `pool` in which the test shows p < `alpha`.

    `seed` and the number of people decide what is drawn, so a power does not depend on which others were asked for.
    """

    def __init__(self, pool: Array, alpha: float, groups: int, seed: tuple[int, ...]) -> None:
        self._pool, self._alpha, self._groups, self._seed = pool, alpha, groups, seed
        self.found: dict[int, float] = {}  #: what was computed so far

    def power(self, people: int) -> float:
        """Of groups of `people`."""
        if people not in self.found:
            draw = np.random.default_rng([*self._seed, people])
            groups = self._pool[draw.integers(0, len(self._pool), (self._groups, people))]
            sums = np.abs(groups @ _signs(people, max(_SIGNS, round(_PER_ALPHA / self._alpha))).T)
            size = np.abs(groups.sum(axis=1))[:, None]
            p = np.mean(sums >= size - 1e-12 * np.abs(groups).sum(axis=1)[:, None], axis=1)
            self.found[people] = float(np.mean(p < self._alpha))
        return self.found[people]

    @property
    def least(self) -> int:
        """Fewest people with whom the test can show p < alpha at all: all signs alike have p = 2/2ⁿ."""
        n = 2
        while 2.0 ** (1 - n) >= self._alpha:
            n += 1
        return n

    def find_fewest(self, wanted: float, start: int) -> int | None:
        """The fewest people who reach the power `wanted`, searched from `start` on; None: more than MOST_PEOPLE.

        Power is taken to grow with the number of people, as it does but for the last step of small numbers.
        """
        low, high = self.least - 1, min(max(start, self.least), MOST_PEOPLE)
        while self.power(high) < wanted:
            if high == MOST_PEOPLE:
                return None
            low, high = high, min(2 * high, MOST_PEOPLE)
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (low, middle) if self.power(middle) >= wanted else (middle, high)
        return high


@cache
def _signs(people: int, most: int) -> Array:
    """(patterns, people): all there are, or `most` drawn ones, the observed among them."""
    if 2**people <= most:
        return np.array(list(product((1.0, -1.0), repeat=people)))
    drawn: Array = np.random.default_rng([people, most]).choice((-1.0, 1.0), (most, people))
    drawn[0] = 1.0
    return drawn
