"""The valid designs of a results file as columns in the units that people read, with front, picks and base device."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from textwrap import shorten
from typing import Any, final

import numpy as np

from haptorb.arrays import Array
from haptorb.display import format_number, format_quantity, scale_unit
from haptorb.terminal import make_progress
from haptorb_design.analysis import Pick, choose_best, find_front
from haptorb_design.design_file import read_number
from haptorb_design.evaluate import DEVICE, OBJECTIVE, describe_base_forces
from haptorb_design.problem import BUILD, Design, DesignGoal, DesignParameter, Evaluation, Value, split_key
from haptorb_design.search_space import measure_miss
from haptorb_design.store import Results, ResultsWriter, Run
from haptorb_design.workers import compute_base_values

__all__ = ["Refusals", "ResultsColumn", "ResultsTable", "Tally", "compute_base", "find_base_value", "keep_candidates"]


# --------------------------------------------------------------------------------------------------
# The base device's own numbers, beside which the designs are shown.


def compute_base(design: Design) -> tuple[dict[str, float], dict[str, float]]:
    """Objectives and constraints of the base device, by name [SI]; NaN where it has no such number.

    What the results do not say is computed; of a user's own function that cannot be done without its file.
    """
    values = compute_base_values(design) if design.base_values is None else design.base_values
    goals = {goal.name: values.get(f"objectives.{goal.name}", math.nan) for goal in design.goals}
    bounds = {bound.name: values.get(f"constraints.{bound.name}", math.nan) for bound in design.bounds}
    return goals, bounds


def find_base_value(design: Design, parameter: DesignParameter) -> float:
    """The value of `parameter`, in its unit, that makes the base device; the place of a choice; NaN where none does."""
    place = parameter.places[0]
    try:
        node, unit = _find(design.base_tables.values, split_key(place.key))
        if parameter.choices:
            return float([value for _, value in parameter.choices].index(node))
        found = read_number(f"{node} {unit}" if unit else node, parameter.unit)[0]
        return (found - place.offset) / place.factor
    except (LookupError, TypeError, ValueError, ZeroDivisionError):
        return math.nan  # the file has no such key, or something else stands there


def _find(node: Any, path: list[str | int]) -> tuple[Any, str]:
    """What the tables say at `path`, without its provenance, and the unit that is said apart from it."""
    unit = ""
    for part in [*path, None]:
        if isinstance(node, Mapping) and "value" in node:
            node, unit = node["value"], str(node.get("unit", unit))
        if part is not None:
            node = node[part - 1] if isinstance(part, int) else node[part]
    return node, unit


_DIGITS = 6  #: of a number on a page


@dataclass(frozen=True)
class ResultsColumn:
    """One number of every valid design.

    kind    "parameter", "objective" or "constraint"
    unit    in which `values` (n,) and `base` are, with its prefix
    sense   1: to be made great; -1: to be made small; 0: neither
    labels  of a choice, whose values are places in this tuple; empty for a number
    base    the base device's own; NaN if it has none
    """

    name: str
    kind: str
    unit: str
    sense: int
    labels: tuple[str, ...]
    values: Array
    base: float

    @property
    def title(self) -> str:
        """The name as people read it."""
        return self.name.replace("_", " ")

    def describe(self) -> dict[str, Any]:
        """The column as plain JSON types."""
        return {
            "title": self.title, "unit": self.unit, "kind": self.kind, "sense": self.sense,
            "labels": list(self.labels) or None, "values": [_round_number(one) for one in self.values.tolist()],
            "base": _round_number(self.base),
        }  # fmt: skip


@dataclass(frozen=True)
class Refusals:
    """How many designs one constraint rejected, and the reason that one of them was given."""

    by: str
    count: int
    example: str


@dataclass(frozen=True)
class ResultsTable:
    """The valid designs, row by row, and what is said of the others.

    found      (run, evaluation) of each row
    total      designs that were computed, rejected ones included
    columns    parameters, objectives, constraints
    front      rows of the Pareto front
    picks      rows that were chosen to be looked at, the first one first
    refusals   by whom designs were rejected, the most frequent first
    remark     how the base device's forces are computed, if not as those of the designs; else empty
    """

    design: Design
    runs: tuple[Run, ...]
    found: tuple[tuple[Run, Evaluation], ...]
    total: int
    columns: tuple[ResultsColumn, ...]
    front: tuple[int, ...]
    picks: tuple[Pick, ...]
    refusals: tuple[Refusals, ...]
    remark: str

    @classmethod
    def of(cls, results: Results, count: int = 5) -> ResultsTable:
        """The table of `results` with at most `count` picks; the base device's own numbers are computed."""
        design = results.design
        found = tuple((run, one) for run in results.runs for one in run.evaluations if one.valid)
        valid = [one for _, one in found]
        goals, bounds = compute_base(design)
        columns = tuple(
            [_make_parameter(design, one, valid) for one in design.parameters]
            + [_scale(goal.name, "objective", goal.quantity.unit, 1 if goal.sense == "maximise" else -1,
                      _collect(valid, "objectives", goal.name), goals[goal.name]) for goal in design.goals]
            + [_scale(bound.name, "constraint", bound.quantity.unit, 0, _collect(valid, "constraints", bound.name),
                      bounds[bound.name]) for bound in design.bounds if bound.name not in goals]
        )  # fmt: skip
        objectives = [one for one in columns if one.kind == "objective"]
        costs = np.stack([-one.sense * one.values for one in objectives], axis=1)
        places = np.stack([_place(design, one) for one in columns[: len(design.parameters)]], axis=1)
        titles = [one.title for one in objectives]
        evaluations = results.evaluations
        return cls(
            design, results.runs, found, len(evaluations), columns, tuple(find_front(costs).tolist()),
            choose_best(costs, places, titles, count), _count_refusals(evaluations),
            describe_base_forces(design, valid[0].values) if valid else "",
        )  # fmt: skip

    def name(self, row: int) -> str:
        """What the design of a row, and its device, is called: design, run if there are several, and number."""
        run, one = self.found[row]
        return "-".join([self.design.name, *([str(run.id)] if len(self.runs) > 1 else []), str(one.number)])

    def select(self, kind: str) -> list[ResultsColumn]:
        """The columns of one kind."""
        return [one for one in self.columns if one.kind == kind]

    def describe(self) -> dict[str, Any]:
        """What the pages draw, as plain JSON types."""
        return {
            "title": self.design.title,
            "base": self.design.base.rpartition("/")[2],
            "remark": self.remark,
            "names": [self.name(row) for row in range(len(self.found))],
            "columns": [one.describe() for one in self.columns],
            "front": list(self.front),
            "picks": [{"row": one.row, "reason": one.reason} for one in self.picks],
        }


def _make_parameter(design: Design, parameter: DesignParameter, valid: list[Evaluation]) -> ResultsColumn:
    found = [one.values[parameter.name] for one in valid]
    labels = parameter.labels
    values = np.array([labels.index(str(one)) if labels else float(one) for one in found], dtype=float)
    base = find_base_value(design, parameter)
    return ResultsColumn(parameter.name, "parameter", parameter.unit, 0, labels, values, base)


def _scale(name: str, kind: str, unit: str, sense: int, values: Array, base: float) -> ResultsColumn:
    """The column in the prefix that suits most of its values."""
    known = np.abs(values[np.isfinite(values)])
    factor, shown = scale_unit(float(np.median(known)) if known.size else 0.0, unit)
    return ResultsColumn(name, kind, shown, sense, (), values * factor, base * factor)


def _collect(valid: list[Evaluation], table: str, name: str) -> Array:
    return np.array([getattr(one, table).get(name, math.nan) for one in valid], dtype=float)


def _place(design: Design, column: ResultsColumn) -> Array:
    """The parameter's values as shares of its range; choices as whole numbers."""
    if column.labels:
        return column.values
    parameter = design.parameter(column.name)
    shares: Array = (column.values - parameter.low) / (parameter.high - parameter.low)
    return shares


def _count_refusals(evaluations: Iterable[Evaluation]) -> tuple[Refusals, ...]:
    refused = [one for one in evaluations if not one.valid]
    reasons = {one.refused_by: one.reason for one in reversed(refused)}
    counts = Counter(one.refused_by for one in refused)
    return tuple(Refusals(by, count, reasons[by]) for by, count in counts.most_common())


def _round_number(value: float) -> float | None:
    """`value` with the digits that a page needs; None where there is no number."""
    return float(f"{value:.{_DIGITS}g}") if math.isfinite(value) else None


# --------------------------------------------------------------------------------------------------
# The state of a run: how many candidates, how many each constraint refuses, and the best.


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
        self._nearest: dict[str, tuple[float, int, str]] = {}  # of each constraint: miss, number, reason
        for one in found:
            self.add(one)

    def add(self, one: Evaluation) -> None:
        """Count one more candidate."""
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
        """Where no design is valid: what refuses the most, and what to do; empty otherwise."""
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
        """If designs are valid, but an objective of others is not a number: how many, and one reason; or ""."""
        count = self.refused[OBJECTIVE]
        if not self.valid or not count:
            return ""
        return f"an objective is not a number for {count} designs. {self._explain(OBJECTIVE)}"

    def _explain(self, by: str) -> str:
        """The design closest to the constraint `by`, or the first with the most frequent reason."""
        if by in self._nearest:
            _, number, reason = self._nearest[by]
            return f"The closest is design {number}: {shorten(reason, _LONGEST, placeholder=' ...')}"
        kind, often = self._reasons[by].most_common(1)[0]
        example = self._examples[by, kind]
        others = f" ({often} alike)" if often > 1 else ""
        return f"Design {example.number}{others}: {shorten(example.reason, _LONGEST, placeholder=' ...')}"

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
# Candidates stored as they are computed, with a bar: the best so far, the refused share, the time left.


_BATCH = 200  #: candidates that are stored together at most
_SHARE = 20.0  #: storing takes at most one part in so many of the time


def keep_candidates(writer: ResultsWriter, found: Iterable[Evaluation], design: Design, total: int) -> Tally:
    """Store the candidates `found` in a run of `total`; returns the tally, together with what was stored before.

    If it ends early, also by ^C, what was computed until then is stored.
    """
    known = [one for number, one in writer.list_known().items() if number < total]
    tally = Tally(design, known)
    waiting: list[Evaluation] = []
    next_time = time.monotonic()  # of storing
    with make_progress() as bar:
        task = bar.add_task(tally.short or "first designs", total=total, completed=len(known))
        try:
            for one in found:
                waiting.append(one)
                tally.add(one)
                if (now := time.monotonic()) >= next_time or len(waiting) >= _BATCH:
                    writer.add(waiting)
                    waiting.clear()
                    next_time = now + _SHARE * (time.monotonic() - now)
                bar.update(task, completed=tally.count, description=tally.short)
        finally:
            writer.add(waiting)
    return tally
