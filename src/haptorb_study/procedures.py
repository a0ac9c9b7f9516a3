"""Procedures: state machines that choose the next prompt from the answers so far, without clock or random numbers.

The same answers give the same prompts, so an interrupted session is resumed by replaying its answers.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from typing import final

from haptorb.errors import InputError
from haptorb_study.prompts import Answer, Prompt

__all__ = ["FixedOrder", "InterleavedProcedures", "Procedure", "ProcedureSequence"]


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
        """Next prompt of the list."""
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
