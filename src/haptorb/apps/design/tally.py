"""The state of a run: how many candidates, how many each constraint refuses, and the best."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from textwrap import shorten
from typing import final

from haptorb.design.design import Design, DesignGoal
from haptorb.design.evaluate import DEVICE, OBJECTIVE
from haptorb.design.evaluation import Evaluation, Value
from haptorb.display.quantity_text import format_number, format_quantity

__all__ = ["Tally"]

_MOST = 2  #: objectives that a bar has room for
_LONGEST = 160  #: characters of a reason


@final
class Tally:
    """Counts of a run, and the best of each objective."""

    def __init__(self, design: Design, found: Iterable[Evaluation] = ()) -> None:
        self.design = design
        self.count = 0
        self.refused: Counter[str] = Counter()
        self.best: dict[str, Evaluation] = {}
        self._reasons: dict[str, Counter[str]] = {}
        self._examples: dict[tuple[str, str], Evaluation] = {}  # the first of each kind of reason
        for one in found:
            self.add(one)

    def add(self, one: Evaluation) -> None:
        """Count one more candidate."""
        self.count += 1
        if not one.valid:
            by, kind = one.refused_by, one.reason.partition(": ")[0]
            self.refused[by] += 1
            self._reasons.setdefault(by, Counter())[kind] += 1
            example = self._examples.setdefault((by, kind), one)
            if one.number < example.number:
                self._examples[by, kind] = one
            return
        for goal in self.design.goals:
            sign = 1.0 if goal.sense == "minimise" else -1.0
            best = self.best.get(goal.name)
            mine = (sign * one.objectives[goal.name], one.number)  # of two equals the first, whichever came first
            if best is None or mine < (sign * best.objectives[goal.name], best.number):
                self.best[goal.name] = one

    @property
    def valid(self) -> int:
        """How many designs keep every constraint."""
        return self.count - self.refused.total()

    @property
    def short(self) -> str:
        """For a bar: the best so far, and the share of refused candidates."""
        parts = [f"best {goal.name} {self._format_best(goal)}" for goal in self.design.goals[:_MOST] if self.best]
        if self.count:
            parts.append(f"{100 * self.refused.total() / self.count:.0f} % rejected")
        return ", ".join(parts)

    @property
    def sentence(self) -> str:
        """How many designs there are, and which constraint refuses how many."""
        text = f"{self.count} designs: {self.valid} valid"
        if self.refused:
            whom = ", ".join(f"{count} by {name}" for name, count in self.refused.most_common())
            text += f", {self.refused.total()} rejected: {whom}"
        return text

    @property
    def advice(self) -> str:
        """Where no design is valid: what refuses the most, the whole reason of one, and what to do; empty otherwise."""
        if self.valid or not self.count:
            return ""
        name, count = self.refused.most_common(1)[0]
        kind, often = self._reasons[name].most_common(1)[0]
        example = self._examples[name, kind]
        share = f"{count} of {self.count} designs"
        if name == OBJECTIVE:
            what, remedy = f"an objective is not a number for {share}", "Correct the objective, or change the ranges"
        elif name == DEVICE:
            what, remedy = f"the values of {share} do not form a valid device", "Change the ranges"
        else:
            what, remedy = f"constraint '{name}' rejects {share}", "Change the ranges, or relax the constraint"
        reason = shorten(example.reason, _LONGEST, placeholder=" ...")
        return f"no design is valid: {what}. Design {example.number} ({often} alike): {reason}. {remedy}"

    def list_best(self) -> list[tuple[str, str]]:
        """(objective, text) of the best design for each objective."""
        return [
            (f"best {goal.name}", f"{self._format_best(goal)}, design {one.number}: {self._format_values(one)}")
            for goal in self.design.goals
            if (one := self.best.get(goal.name)) is not None
        ]

    def _format_best(self, goal: DesignGoal) -> str:
        return format_quantity(self.best[goal.name].objectives[goal.name], goal.quantity.unit)

    def _format_values(self, one: Evaluation) -> str:
        return ", ".join(f"{name} {self._format_value(name, value)}" for name, value in one.values.items())

    def _format_value(self, name: str, value: Value) -> str:
        if isinstance(value, str):
            return value
        return f"{format_number(value, 4)} {self.design.parameter(name).unit}".rstrip()
