"""Tally of a run: candidates, refusals per constraint, best designs."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterable
from textwrap import shorten
from typing import final

from haptorb.display import format_number, format_quantity
from haptorb.terminal import make_progress
from haptorb_design.evaluate import DEVICE, OBJECTIVE
from haptorb_design.problem import BUILD, Design, DesignGoal, Evaluation, Value
from haptorb_design.search_space import measure_miss
from haptorb_design.store import ResultsWriter

__all__ = ["Tally", "store_candidates"]


_MAX_BAR_OBJECTIVES = 2  #: objectives shown in a progress bar
_MAX_REASON_CHARACTERS = 160  #: maximum length of a reason [characters]


@final
class Tally:
    """Counts of a run, and the best design of each objective."""

    def __init__(self, design: Design, found: Iterable[Evaluation] = ()) -> None:
        self.design = design
        self.count = 0
        self.refused: Counter[str] = Counter()
        self.best: dict[str, Evaluation] = {}
        self._reasons: dict[str, Counter[str]] = {}
        self._examples: dict[tuple[str, str], Evaluation] = {}  # first example of each kind of reason
        self._nearest: dict[str, tuple[float, int, str]] = {}  # per constraint: violation, number, reason
        for one in found:
            self.add(one)

    def add(self, one: Evaluation) -> None:
        """Add one candidate."""
        self.count += 1
        if not one.valid:
            by, parts = one.refused_by, one.reason.split(": ")
            kind = ": ".join(parts[: 2 if by == OBJECTIVE else 1])
            self.refused[by] += 1
            for bound in self.design.bounds:
                if bound.name == by:
                    miss = (measure_miss(one.constraints.get(by), bound), one.number, one.reason)
                    self._nearest[by] = min(self._nearest.get(by, miss), miss)
            self._reasons.setdefault(by, Counter())[kind] += 1
            example = self._examples.setdefault((by, kind), one)
            if one.number < example.number:
                self._examples[by, kind] = one
            return
        for goal in self.design.goals:
            sign = 1.0 if goal.sense == "minimise" else -1.0
            best = self.best.get(goal.name)
            mine = (sign * one.objectives[goal.name], one.number)  # of equal designs the first, in any order of arrival
            if best is None or mine < (sign * best.objectives[goal.name], best.number):
                self.best[goal.name] = one

    @property
    def valid(self) -> int:
        """Number of valid designs."""
        return self.count - self.refused.total()

    @property
    def short(self) -> str:
        """For a progress bar: the best so far, and the share of refused candidates."""
        parts = [
            f"best {goal.name} {self._format_best(goal)}"
            for goal in self.design.goals[:_MAX_BAR_OBJECTIVES]
            if self.best
        ]
        if self.count:
            parts.append(f"{100 * self.refused.total() / self.count:.0f} % rejected")
        return ", ".join(parts)

    @property
    def sentence(self) -> str:
        """Number of designs, and of refusals per constraint."""
        text = f"{self.count} designs: {self.valid} valid"
        if self.refused:
            whom = ", ".join(f"{count} by {name}" for name, count in self.refused.most_common())
            text += f", {self.refused.total()} rejected: {whom}"
        return text

    @property
    def advice(self) -> str:
        """If no design is valid: the main cause and a remedy; empty otherwise."""
        if self.valid or not self.count:
            return ""
        name, count = self.refused.most_common(1)[0]
        share = f"{count} of {self.count} designs"
        if name == OBJECTIVE:
            what, remedy = f"an objective is not a number for {share}", "Correct the objective, or change the ranges"
        elif name.startswith(BUILD):
            what, remedy = f"{share} cannot be built, by '{name.removeprefix(f'{BUILD}: ')}'", "Change the ranges"
        elif name == DEVICE:
            what, remedy = f"the values of {share} do not form a valid device", "Change the ranges"
        else:
            what, remedy = f"constraint '{name}' rejects {share}", "Change the ranges, or relax the constraint"
        return f"no design is valid: {what}. {self._explain(name)}. {remedy}"

    @property
    def failures(self) -> str:
        """If some designs have a non-finite objective: how many, with one reason; otherwise empty."""
        count = self.refused[OBJECTIVE]
        if not self.valid or not count:
            return ""
        return f"an objective is not a number for {count} designs. {self._explain(OBJECTIVE)}"

    def _explain(self, by: str) -> str:
        """The design closest to the constraint `by`, or an example of the most frequent reason."""
        if by in self._nearest:
            _, number, reason = self._nearest[by]
            return f"The closest is design {number}: {shorten(reason, _MAX_REASON_CHARACTERS, placeholder=' ...')}"
        kind, often = self._reasons[by].most_common(1)[0]
        example = self._examples[by, kind]
        others = f" ({often} alike)" if often > 1 else ""
        return f"Design {example.number}{others}: {shorten(example.reason, _MAX_REASON_CHARACTERS, placeholder=' ...')}"

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


# --------------------------------------------------------------------------------------------------
# Candidates stored as they arrive, with a progress bar.


_MAX_BATCH = 200  #: candidates stored together at most
_STORING_INTERVAL_FACTOR = 20.0  #: storing takes at most 1/20 of the time


def store_candidates(writer: ResultsWriter, found: Iterable[Evaluation], design: Design, total: int) -> Tally:
    """Store the candidates `found` in a run of `total`; returns the tally, with earlier candidates.

    If it ends early, also by ^C, all candidates computed so far are stored.
    """
    known = [one for number, one in writer.list_known().items() if number < total]
    tally = Tally(design, known)
    waiting: list[Evaluation] = []
    next_time = time.monotonic()  # of the next transaction
    with make_progress() as bar:
        task = bar.add_task(tally.short or "first designs", total=total, completed=len(known))
        try:
            for one in found:
                waiting.append(one)
                tally.add(one)
                if (now := time.monotonic()) >= next_time or len(waiting) >= _MAX_BATCH:
                    writer.add(waiting)
                    waiting.clear()
                    next_time = now + _STORING_INTERVAL_FACTOR * (time.monotonic() - now)
                bar.update(task, completed=tally.count, description=tally.short)
        finally:
            writer.add(waiting)
    return tally
