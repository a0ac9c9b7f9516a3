"""Table of the valid designs of a results file in display units, with Pareto front, picks and base device."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from haptorb.arrays import Array
from haptorb.display import scale_unit
from haptorb_design.design_file import read_number
from haptorb_design.evaluate import describe_base_forces
from haptorb_design.pareto_front import Pick, choose_best, find_front
from haptorb_design.problem import Design, DesignParameter, Evaluation, split_key
from haptorb_design.store import Results, Run
from haptorb_design.workers import compute_base_values

__all__ = ["Refusals", "ResultsColumn", "ResultsTable", "compute_base", "find_base_value"]


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
