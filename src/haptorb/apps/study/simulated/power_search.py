"""The power of a test over people for groups out of a pool, and the fewest people that reach a wanted one."""

from __future__ import annotations

from typing import final

import numpy as np

from haptorb.apps.study.inference.significance import EXACT_PEOPLE, PairTest, decide_p, fewest_people
from haptorb.numerics.arrays import Array

__all__ = ["MOST_PEOPLE", "GroupPower"]

MOST_PEOPLE = 500  #: beyond which nothing is searched
_SLOW = 2000  #: groups at most for a test that takes long


@final
class GroupPower:
    """By number of people, the share of groups of so many out of `pool` in which `test` shows p < `alpha`.

    `seed` and the number of people decide what is drawn, so a power does not depend on which others were asked for.
    """

    def __init__(self, pool: Array, alpha: float, groups: int, seed: tuple[int, ...], test: PairTest = "t") -> None:
        self._pool, self._alpha, self._groups, self._seed, self._test = pool, alpha, groups, seed, test
        self.found: dict[int, float] = {}  #: what was computed so far

    def power(self, people: int) -> float:
        """Of groups of `people`."""
        if people not in self.found:
            draw = np.random.default_rng([*self._seed, people])
            count = self._groups
            if self._test == "sign-flip" and people > EXACT_PEOPLE:
                count = min(count, _SLOW)  # thousands of sign patterns for each group
            groups = self._pool[draw.integers(0, len(self._pool), (count, people))]
            self.found[people] = float(np.mean(decide_p(groups, self._test) < self._alpha))
        return self.found[people]

    @property
    def least(self) -> int:
        """Fewest people with whom the test can show p < alpha at all."""
        return fewest_people(self._alpha, self._test)

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
