"""Procedures: state machines that choose the next prompt from the answers so far, without clock or random numbers.

The same answers give the same prompts, so an interrupted session is resumed by replaying its answers.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from math import isfinite
from typing import Any, final

import numpy as np

from haptorb.arrays import Array
from haptorb.errors import InputError

__all__ = [
    "SCALE",
    "Answer",
    "Bayesian",
    "FixedOrder",
    "InterleavedProcedures",
    "Procedure",
    "ProcedureSequence",
    "Prompt",
    "Staircase",
    "rating",
    "read_value",
]


# --------------------------------------------------------------------------------------------------
# Prompts and answers.


@dataclass(frozen=True)
class Prompt:
    """One trial before its answer; plain values, stored as they are."""

    phase: str = "main"  #: "practice" is stored, but excluded from analysis
    condition: str = ""  #: condition that is rendered
    other: str = ""  #: forced choice between conditions: the one in the other interval
    set_point: int = 0  #: number; 0: none
    level: float = 0.0  #: value of the varied parameter in the comparison interval
    interval: int = 0  #: 1 or 2: interval of the comparison (or of `condition`); 0: a single interval
    low: int = 0  #: smallest and
    high: int = 0  #: largest number that may be answered; both 0: the answer is the position
    decimal: bool = False  #: whether any number above `low` and up to `high` may be answered, not only whole ones
    numbers: tuple[int, ...] = ()  #: numbers that may be answered, if they are not a range
    pause: float = 0.0  #: break before this trial [s]

    @classmethod
    def read(cls, stored: dict[str, Any]) -> Prompt:
        """From a stored `row`."""
        known = {field.name for field in fields(cls)}
        values = {key: value for key, value in stored.items() if key in known}
        values["numbers"] = tuple(values.get("numbers", ()))
        return cls(**values)

    def row(self) -> dict[str, Any]:
        """As plain JSON types; `decimal`, unknown to older versions, only where it is set."""
        stored = {**asdict(self), "numbers": list(self.numbers)}
        return stored if self.decimal else {key: value for key, value in stored.items() if key != "decimal"}

    @property
    def wants_number(self) -> bool:
        """Whether the answer is a number, besides the position."""
        return bool(self.numbers) or self.high > 0

    def check_answer(self, answer: Answer) -> Answer:
        """Validate `answer`; InputError if it is not permitted."""
        value = answer.value
        if not self.wants_number:
            if value is not None:
                raise InputError("the answer to this trial is the tool's position, not a number: leave out the number")
            if answer.position is None:
                raise InputError("the answer to this trial is the tool's position, but no position is known")
        elif self.decimal:
            if isinstance(value, bool) or not isinstance(value, int | float) or not self.low < value <= self.high:
                raise InputError(f"answer must be a number above {self.low}, up to {self.high}; got {value!r}")
        elif isinstance(value, bool) or not isinstance(value, int):
            raise InputError(f"answer must be a whole number; got {value!r}")
        elif self.numbers and value not in self.numbers:
            raise InputError(f"answer must be the number of a set-point, {_list_numbers(self.numbers)}; got {value}")
        elif not self.numbers and not self.low <= value <= self.high:
            raise InputError(f"answer must be a whole number from {self.low} to {self.high}; got {value}")
        return answer


@dataclass(frozen=True)
class Answer:
    """Value answered, position of the tool's magnet [m, frame S], and response time [s]."""

    value: int | float | None = None
    position: tuple[float, float, float] | None = None
    seconds: float = 0.0

    def __post_init__(self) -> None:
        if self.position is not None and (len(self.position) != 3 or not all(map(isfinite, self.position))):
            raise InputError(f"position of an answer must be 3 finite numbers; got {self.position!r}")
        if not (isfinite(self.seconds) and self.seconds >= 0):
            raise InputError(f"duration of an answer must be 0 s or more; got {self.seconds!r}")


def read_value(stored: float | None) -> int | float | None:
    """Answer from its database column, which holds whole and decimal numbers.

    >>> read_value(7.0), read_value(2.5), read_value(None)
    (7, 2.5, None)
    """
    return int(stored) if stored is not None and stored == int(stored) else stored


def _list_numbers(numbers: tuple[int, ...]) -> str:
    if numbers == tuple(range(numbers[0], numbers[-1] + 1)):
        return f"{numbers[0]} to {numbers[-1]}"
    return ", ".join(map(str, numbers))


class Procedure(ABC):
    """Base class of procedures. Immutable: `record_answer` returns the next state."""

    @property
    @abstractmethod
    def prompt(self) -> Prompt | None:
        """Next prompt; None: the procedure is complete."""

    @abstractmethod
    def advance(self, answer: Answer) -> Procedure:
        """The procedure after a validated answer."""

    @property
    @abstractmethod
    def expected(self) -> int:
        """Remaining trials; of an adaptive procedure at most."""

    def record_answer(self, answer: Answer) -> Procedure:
        """Validate `answer` and advance. Raises InputError if it is not permitted, or the procedure is complete."""
        prompt = self.prompt
        if prompt is None:
            raise InputError("this procedure is complete: there are no more trials")
        return self.advance(prompt.check_answer(answer))


@final
@dataclass(frozen=True)
class FixedOrder(Procedure):
    """Trials in a fixed order: identification, localisation, constant stimuli, forced choice, rating.

    >>> start = FixedOrder((Prompt(low=1, high=2), Prompt(low=1, high=2)))
    >>> start.record_answer(Answer(1)).record_answer(Answer(2)).prompt is None
    True
    """

    prompts: tuple[Prompt, ...]
    done: int = 0

    @property
    def prompt(self) -> Prompt | None:
        """The next of the list."""
        return self.prompts[self.done] if self.done < len(self.prompts) else None

    @property
    def expected(self) -> int:
        """Remaining trials."""
        return len(self.prompts) - self.done

    def advance(self, answer: Answer) -> FixedOrder:
        """Continue with the next trial, whatever the answer."""
        return replace(self, done=self.done + 1)


@final
@dataclass(frozen=True)
class ProcedureSequence(Procedure):
    """Procedures in sequence: practice, then a staircase per condition."""

    parts: tuple[Procedure, ...]

    @property
    def prompt(self) -> Prompt | None:
        """Prompt of the first incomplete part."""
        return next((prompt for part in self.parts if (prompt := part.prompt) is not None), None)

    @property
    def expected(self) -> int:
        """Sum over all parts."""
        return sum(part.expected for part in self.parts)

    def advance(self, answer: Answer) -> ProcedureSequence:
        """Advance the first incomplete part."""
        at = next(n for n, part in enumerate(self.parts) if part.prompt is not None)
        return ProcedureSequence((*self.parts[:at], self.parts[at].advance(answer), *self.parts[at + 1 :]))


@final
@dataclass(frozen=True)
class InterleavedProcedures(Procedure):
    """Interleaved procedures: `turns` is the part of each trial; complete parts are skipped.

    pauses   {number of trials answered: break before the next [s]}

    >>> one, two = (FixedOrder((Prompt(level=n, high=1),) * 2) for n in (1.0, 2.0))
    >>> both = InterleavedProcedures((one, two), (0, 1, 1, 0))
    >>> both.record_answer(Answer(1)).prompt.level
    2.0
    """

    parts: tuple[Procedure, ...]
    turns: tuple[int, ...]
    pauses: dict[int, float] = field(default_factory=dict)
    done: int = 0  #: trials answered
    place: int = 0  #: index into `turns`

    def __post_init__(self) -> None:
        if not set(self.turns) <= set(range(len(self.parts))):
            raise InputError(f"turns must name one of {len(self.parts)} procedures; got {sorted(set(self.turns))}")

    @property
    def _next(self) -> int:
        """Index of the next turn of an incomplete part; the number of turns if there is none."""
        over = {n for n, part in enumerate(self.parts) if part.prompt is None}
        at = self.place
        while at < len(self.turns) and self.turns[at] in over:
            at += 1
        return at

    @property
    def prompt(self) -> Prompt | None:
        """Prompt of the part in turn, with the break before this trial."""
        at = self._next
        if at >= len(self.turns):
            return None
        prompt = self.parts[self.turns[at]].prompt
        assert prompt is not None
        pause = self.pauses.get(self.done, 0.0)
        return replace(prompt, pause=pause) if pause else prompt

    @property
    def expected(self) -> int:
        """Sum over all parts."""
        return sum(part.expected for part in self.parts)

    def advance(self, answer: Answer) -> InterleavedProcedures:
        """Advance the part in turn."""
        at = self._next
        turn = self.turns[at]
        parts = (*self.parts[:turn], self.parts[turn].advance(answer), *self.parts[turn + 1 :])
        return replace(self, parts=parts, done=self.done + 1, place=at + 1)


# --------------------------------------------------------------------------------------------------
# Rating scale, shared by studies and feel sessions.


SCALE = (1, 7)  #: from "not at all" to "just right", unless a study file sets another


def rating(of: str, scale: tuple[int, int] = SCALE, set_point: int = 0) -> Prompt:
    """Prompt for a whole number on `scale`, for the condition `of`.

    >>> from haptorb_study.procedures import Answer
    >>> rating("soft").check_answer(Answer(7)).value
    7
    """
    low, high = scale
    return Prompt(condition=of, set_point=set_point, low=low, high=high)


# --------------------------------------------------------------------------------------------------
# 1-up/2-down staircase: two correct answers decrease the difference, a wrong one increases it.
#
# It converges to 70.7 % correct, where p² = ½ (Levitt 1971).


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


# --------------------------------------------------------------------------------------------------
# Adaptive Bayesian procedure: each trial minimises the expected entropy, after QUEST+ (Watson 2017).
#
# The observer is a cumulative normal in the logarithm of the difference, with a guess rate of one half:
# p(correct) = ½ + (½ − λ) Φ(s log₂(difference / threshold)), threshold and slope s unknown, lapse rate λ fixed.


_CANDIDATE_SLOPES = np.geomspace(0.5, 6.0, 12)


@final
@dataclass(frozen=True)
class Bayesian(Procedure):
    """As many trials as `intervals`, each at the difference with the least expected posterior entropy.

    `threshold` is the difference answered right in 75 % of the cases without lapses.
    """

    reference: float
    least: float  #: smallest difference
    most: float  #: largest difference
    intervals: tuple[int, ...]
    condition: str = ""
    lapse: float = 0.02
    answers: tuple[tuple[int, bool], ...] = field(default=(), repr=False)  #: (index of difference, correct) so far

    def __post_init__(self) -> None:
        if not 0 < self.least < self.most or not set(self.intervals) <= {1, 2} or not 0 <= self.lapse < 0.5:
            raise InputError(
                f"needs 0 < least < most, intervals 1 or 2 and 0 ≤ lapse < 0.5; got {self.least:g}, {self.most:g}, "
                f"{self.lapse:g}"
            )

    @cached_property
    def differences(self) -> Array:
        """(30,) candidate differences."""
        return np.geomspace(self.least, self.most, 30)

    @cached_property
    def _right_probability(self) -> Array:
        """(30, 40, 12) probability of a correct answer by difference, threshold and slope."""
        from scipy.special import ndtr

        x = np.log2(self.differences[:, None] / self.thresholds[None, :])
        right: Array = 0.5 + (0.5 - self.lapse) * ndtr(_CANDIDATE_SLOPES * x[..., None])
        return right

    @cached_property
    def thresholds(self) -> Array:
        """(40,) candidate thresholds."""
        return np.geomspace(self.least, self.most, 40)

    @cached_property
    def posterior(self) -> Array:
        """(40, 12) posterior of threshold and slope."""
        log = np.zeros((40, len(_CANDIDATE_SLOPES)))
        for asked, right in self.answers:
            p = self._right_probability[asked]
            log += np.log(p if right else 1 - p)
        p = np.exp(log - log.max())
        normal: Array = p / p.sum()
        return normal

    @cached_property
    def _choice(self) -> int:
        posterior = self.posterior
        best, least = 0, float("inf")
        for n, p in enumerate(self._right_probability):
            entropy = 0.0
            for likelihood in (p, 1 - p):
                joint = posterior * likelihood
                total = float(joint.sum())
                after = joint / total
                entropy -= total * float((after * np.log(np.maximum(after, 1e-300))).sum())
            if entropy < least - 1e-12:
                best, least = n, entropy
        return best

    @property
    def prompt(self) -> Prompt | None:
        """Comparison at the most informative difference."""
        done = len(self.answers)
        if done >= len(self.intervals):
            return None
        level = self.reference + float(self.differences[self._choice])
        return Prompt(condition=self.condition, level=level, interval=self.intervals[done], low=1, high=2)

    @property
    def expected(self) -> int:
        """Remaining trials."""
        return len(self.intervals) - len(self.answers)

    def advance(self, answer: Answer) -> Bayesian:
        """Add one answer."""
        right = answer.value == self.intervals[len(self.answers)]
        return replace(self, answers=(*self.answers, (self._choice, right)))

    @property
    def threshold(self) -> float:
        """Posterior mean of the logarithm."""
        return float(np.exp(self.posterior.sum(axis=1) @ np.log(self.thresholds)))
