"""1-up/2-down: two right answers in a row make it harder, one wrong answer makes it easier; it settles at 70.7 %.

Levitt 1971: at the level where it settles, p² = ½.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import isfinite
from typing import final

from haptorb.apps.asking.procedure import Procedure
from haptorb.apps.asking.prompt import Answer, Prompt
from haptorb.errors import InputError

__all__ = ["Staircase"]


@final
@dataclass(frozen=True)
class Staircase(Procedure):
    """Differences from a reference, changed by a factor: `step` until the second reversal, its root from then on.

    The difference is what the comparison interval has more than the reference. `intervals` holds, trial by trial, in
    which interval it comes, and so how long the staircase may be at most.
    """

    reference: float
    start: float  #: first difference
    least: float  #: differences stay between this
    most: float  #: and this
    step: float  #: factor, greater than 1
    reversals: int  #: it ends after so many
    intervals: tuple[int, ...]
    condition: str = ""
    difference: float = field(default=float("nan"))
    right: int = 0  #: right answers in a row at this difference
    way: int = 0  #: −1: it last got harder, +1: easier, 0: it has not moved
    turned: tuple[float, ...] = ()  #: differences at the reversals so far
    done: int = 0

    def __post_init__(self) -> None:
        numbers = (self.reference, self.start, self.least, self.most, self.step)
        if not all(map(isfinite, numbers)) or not 0 < self.least <= self.start <= self.most:
            raise InputError(
                f"a staircase needs 0 < least ≤ start ≤ most; got {self.least:g}, {self.start:g}, {self.most:g}"
            )
        if not self.step > 1 or self.reversals < 4 or not set(self.intervals) <= {1, 2}:
            raise InputError(
                "a staircase needs a step factor greater than 1, at least 4 reversals, and intervals 1 or 2"
            )
        if not isfinite(self.difference):
            object.__setattr__(self, "difference", self.start)

    @property
    def prompt(self) -> Prompt | None:
        """The comparison at the present difference, until enough reversals or trials."""
        if len(self.turned) >= self.reversals or self.done >= len(self.intervals):
            return None
        return Prompt(
            condition=self.condition,
            level=self.reference + self.difference,
            interval=self.intervals[self.done],
            low=1,
            high=2,
        )

    @property
    def expected(self) -> int:
        """The most that can still come."""
        return 0 if self.prompt is None else len(self.intervals) - self.done

    def advance(self, answer: Answer) -> Staircase:
        """Harder after two right answers, easier after one wrong; in between the same again."""
        right = answer.value == self.intervals[self.done]
        way = (-1 if self.right == 1 else 0) if right else 1
        turned = (*self.turned, self.difference) if way * self.way < 0 else self.turned
        factor = self.step if len(turned) < 2 else self.step**0.5
        return replace(
            self,
            difference=min(self.most, max(self.least, self.difference * factor**way)),
            right=1 if right and way == 0 else 0,
            way=way or self.way,
            turned=turned,
            done=self.done + 1,
        )

    @property
    def threshold(self) -> float:
        """Difference at 70.7 %: geometric mean of an even number of the reversals after the second; NaN before."""
        used = self.turned[2:]
        used = used[len(used) % 2 :]
        if not used:
            return float("nan")
        product = 1.0
        for difference in used:
            product *= difference ** (1 / len(used))
        return product
