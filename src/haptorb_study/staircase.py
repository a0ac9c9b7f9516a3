"""1-up/2-down staircase: two correct answers decrease the difference, a wrong one increases it.

It converges to 70.7 % correct, where p² = ½ (Levitt 1971).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import isfinite
from typing import final

from haptorb.errors import InputError
from haptorb_study.procedures import Procedure
from haptorb_study.prompts import Answer, Prompt

__all__ = ["Staircase"]


@final
@dataclass(frozen=True)
class Staircase(Procedure):
    """Staircase of differences from a reference, changed by the factor `step`, after the second reversal by its root.

    The difference is that of the comparison interval from the reference. `intervals` is the interval of the comparison
    in each trial; its length is the maximum number of trials.
    """

    reference: float
    start: float  #: first difference
    least: float  #: smallest and
    most: float  #: largest difference
    step: float  #: factor above 1
    reversals: int  #: number of reversals after which it ends
    intervals: tuple[int, ...]
    condition: str = ""
    difference: float = field(default=float("nan"))
    right: int = 0  #: consecutive correct answers at this difference
    way: int = 0  #: direction of the last change: −1 harder, +1 easier, 0 none yet
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
        """Comparison at the present difference, until enough reversals or trials."""
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
        """Remaining trials at most."""
        return 0 if self.prompt is None else len(self.intervals) - self.done

    def advance(self, answer: Answer) -> Staircase:
        """Decrease the difference after two correct answers, increase it after a wrong one."""
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
        """Difference at 70.7 %: geometric mean of an even number of reversals after the second; NaN before."""
        used = self.turned[2:]
        used = used[len(used) % 2 :]
        if not used:
            return float("nan")
        product = 1.0
        for difference in used:
            product *= difference ** (1 / len(used))
        return product
