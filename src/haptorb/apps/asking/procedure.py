"""A procedure decides what is asked next from the answers so far: a pure state machine, so a session can be replayed.

No clock, no randomness, no file: the same answers give the same prompts. That is how an interrupted session resumes.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from typing import final

from haptorb.apps.asking.prompt import Answer, Prompt
from haptorb.errors import InputError

__all__ = ["FixedOrder", "InterleavedProcedures", "Procedure", "ProcedureSequence"]


class Procedure(ABC):
    """Immutable: `record_answer` returns the procedure as it is afterwards."""

    @property
    @abstractmethod
    def prompt(self) -> Prompt | None:
        """What to ask now; None: done."""

    @abstractmethod
    def advance(self, answer: Answer) -> Procedure:
        """The procedure after an answer that has been checked."""

    @property
    @abstractmethod
    def expected(self) -> int:
        """Trials still to come; for an adaptive procedure the most there can be."""

    def record_answer(self, answer: Answer) -> Procedure:
        """The procedure after `answer`. Raises InputError if it may not be answered so, or nothing is asked."""
        prompt = self.prompt
        if prompt is None:
            raise InputError("this procedure is complete: there are no more trials")
        return self.advance(prompt.check_answer(answer))


@final
@dataclass(frozen=True)
class FixedOrder(Procedure):
    """Trials in an order that was settled beforehand: identification, localisation, constant stimuli, choice, rating.

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
        """Exactly what is left."""
        return len(self.prompts) - self.done

    def advance(self, answer: Answer) -> FixedOrder:
        """The next trial; the answer does not matter here."""
        return replace(self, done=self.done + 1)


@final
@dataclass(frozen=True)
class ProcedureSequence(Procedure):
    """Several procedures, one after the other: practice, then a staircase per condition."""

    parts: tuple[Procedure, ...]

    @property
    def prompt(self) -> Prompt | None:
        """Of the first part that is not done."""
        return next((prompt for part in self.parts if (prompt := part.prompt) is not None), None)

    @property
    def expected(self) -> int:
        """Over all parts."""
        return sum(part.expected for part in self.parts)

    def advance(self, answer: Answer) -> ProcedureSequence:
        """The first part that is not done takes the answer."""
        at = next(n for n, part in enumerate(self.parts) if part.prompt is not None)
        return ProcedureSequence((*self.parts[:at], self.parts[at].advance(answer), *self.parts[at + 1 :]))


@final
@dataclass(frozen=True)
class InterleavedProcedures(Procedure):
    """Several procedures side by side: `turns` says, trial by trial, whose turn it is; one that is done is passed over.

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
    place: int = 0  #: in `turns`

    def __post_init__(self) -> None:
        if not set(self.turns) <= set(range(len(self.parts))):
            raise InputError(f"turns must name one of {len(self.parts)} procedures; got {sorted(set(self.turns))}")

    @property
    def _next(self) -> int:
        """Place of the next turn of a procedure that is not done; the number of turns where there is none."""
        over = {n for n, part in enumerate(self.parts) if part.prompt is None}
        at = self.place
        while at < len(self.turns) and self.turns[at] in over:
            at += 1
        return at

    @property
    def prompt(self) -> Prompt | None:
        """Of the procedure whose turn it is, with the break before this trial."""
        at = self._next
        if at >= len(self.turns):
            return None
        prompt = self.parts[self.turns[at]].prompt
        assert prompt is not None
        pause = self.pauses.get(self.done, 0.0)
        return replace(prompt, pause=pause) if pause else prompt

    @property
    def expected(self) -> int:
        """Over all procedures."""
        return sum(part.expected for part in self.parts)

    def advance(self, answer: Answer) -> InterleavedProcedures:
        """The procedure whose turn it is takes the answer."""
        at = self._next
        turn = self.turns[at]
        parts = (*self.parts[:turn], self.parts[turn].advance(answer), *self.parts[turn + 1 :])
        return replace(self, parts=parts, done=self.done + 1, place=at + 1)
