"""The valid designs of a results file as columns in the units that people read, with front, picks and base device."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from haptorb.apps.design.base_values import compute_base, find_base_value
from haptorb.design.analysis.best import Pick, choose_best
from haptorb.design.analysis.front import find_front
from haptorb.design.base_values import describe_base_forces
from haptorb.design.design import Design
from haptorb.design.evaluation import Evaluation
from haptorb.design.parameter import DesignParameter
from haptorb.design.store import Results, Run
from haptorb.display.quantity_text import scale_unit
from haptorb.numerics.arrays import Array

__all__ = ["Refusals", "ResultsColumn", "ResultsTable"]

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
