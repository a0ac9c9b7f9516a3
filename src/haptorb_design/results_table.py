"""Table of the valid designs of a results file in display units, with Pareto front, picks and base device."""

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

__all__ = ["Refusals", "ResultsColumn", "ResultsTable", "Tally", "compute_base", "find_base_value", "store_candidates"]


# --------------------------------------------------------------------------------------------------
# Quantities of the base device, for comparison.


def compute_base(design: Design) -> tuple[dict[str, float], dict[str, float]]:
    """Objectives and constraints of the base device, by name [SI]; NaN if it has no such value.

    Missing values are computed; those of a user's own function need its file.
    """
    values = compute_base_values(design) if design.base_values is None else design.base_values
    goals = {goal.name: values.get(f"objectives.{goal.name}", math.nan) for goal in design.goals}
    bounds = {bound.name: values.get(f"constraints.{bound.name}", math.nan) for bound in design.bounds}
    return goals, bounds


def find_base_value(design: Design, parameter: DesignParameter) -> float:
    """Value of `parameter`, in its unit, in the base device; the index of a choice; NaN if none matches."""
    place = parameter.places[0]
    try:
        node, unit = _find(design.base_tables.values, split_key(place.key))
        if parameter.choices:
            return float([value for _, value in parameter.choices].index(node))
        found = read_number(f"{node} {unit}" if unit else node, parameter.unit)[0]
        return (found - place.offset) / place.factor
    except (LookupError, TypeError, ValueError, ZeroDivisionError):
        return math.nan  # the file has no such key, or another type of value there


def _find(node: Any, path: list[str | int]) -> tuple[Any, str]:
    """Value at `path` of the tables, without its provenance, and its separate unit."""
    unit = ""
    for part in [*path, None]:
        if isinstance(node, Mapping) and "value" in node:
            node, unit = node["value"], str(node.get("unit", unit))
        if part is not None:
            node = node[part - 1] if isinstance(part, int) else node[part]
    return node, unit


_SIGNIFICANT_DIGITS = 6  #: significant digits on a page


@dataclass(frozen=True)
class ResultsColumn:
    """One quantity of every valid design.

    kind    "parameter", "objective" or "constraint"
    unit    of `values` (n,) and `base`, with its prefix
    sense   1: maximise; -1: minimise; 0: neither
    labels  of a choice, whose values are indices into this tuple; empty for a number
    base    value of the base device; NaN if it has none
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
        """The name for display."""
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
    """Number of designs that one constraint rejected, with the reason of one of them."""

    by: str
    count: int
    example: str


@dataclass(frozen=True)
class ResultsTable:
    """The valid designs, row by row, and counts of the others.

    found      (run, evaluation) of each row
    total      evaluated designs, with rejected ones
    columns    parameters, objectives, constraints
    front      rows of the Pareto front
    picks      picked rows, in order
    refusals   rejections by constraint, the most frequent first
    remark     model of the base device's forces, if it differs from the designs'; else empty
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
        """Table of `results` with at most `count` picks; quantities of the base device are computed."""
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
        """Name of a row's design and device: design, run if there are several, and number."""
        run, one = self.found[row]
        return "-".join([self.design.name, *([str(run.id)] if len(self.runs) > 1 else []), str(one.number)])

    def select(self, kind: str) -> list[ResultsColumn]:
        """Columns of one kind."""
        return [one for one in self.columns if one.kind == kind]

    def describe(self) -> dict[str, Any]:
        """Data for the pages, as plain JSON types."""
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
    """The column in the unit prefix that suits most of its values."""
    known = np.abs(values[np.isfinite(values)])
    factor, shown = scale_unit(float(np.median(known)) if known.size else 0.0, unit)
    return ResultsColumn(name, kind, shown, sense, (), values * factor, base * factor)


def _collect(valid: list[Evaluation], table: str, name: str) -> Array:
    return np.array([getattr(one, table).get(name, math.nan) for one in valid], dtype=float)


def _place(design: Design, column: ResultsColumn) -> Array:
    """The parameter's values relative to its range; choices as whole numbers."""
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
    """`value` rounded for a page; None for NaN."""
    return float(f"{value:.{_SIGNIFICANT_DIGITS}g}") if math.isfinite(value) else None


# --------------------------------------------------------------------------------------------------
# Tally of a run: candidates, refusals per constraint, best designs.


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
