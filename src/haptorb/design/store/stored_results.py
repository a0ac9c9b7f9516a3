"""What a results file must hold for its report to be made: it may be damaged, or come from anybody."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from math import isfinite
from typing import Any, Protocol

from haptorb.design.design import Design
from haptorb.design.evaluation import Evaluation
from haptorb.design.parameter import DesignParameter
from haptorb.errors import InputError, quote

__all__ = ["check_results"]

_NAME = re.compile(r"[a-z][a-z0-9-]{0,63}")  #: of a design: its devices' files are called so
_WORD = re.compile(r"[\w.-]{1,64}")
_LARGE = 1e300  #: of any number
_LONG = 4000  #: characters of a text


class StoredRun(Protocol):
    """One sweep or optimisation."""

    @property
    def method(self) -> str:
        """How its values were chosen."""

    @property
    def seed(self) -> int:
        """Its seed."""

    @property
    def version(self) -> str:
        """Of haptorb."""

    @property
    def started(self) -> str:
        """UTC, ISO 8601."""

    @property
    def settings(self) -> Mapping[str, Any]:
        """What else decides the values."""

    @property
    def evaluations(self) -> tuple[Evaluation, ...]:
        """What was computed."""


def check_results(design: Design, runs: Iterable[StoredRun]) -> None:
    """Raise InputError for the first thing in a results file that haptorb did not write."""
    _require(isinstance(design.name, str) and bool(_NAME.fullmatch(design.name)), "name of the design", design.name)
    for what, text in (("title", design.title), ("base", design.base), ("text", design.text)):
        _require(isinstance(text, str) and len(text) <= 64 * _LONG, f"{what} of the design", text)
    _require(0 < len(design.parameters) <= 1000 and 0 < len(design.goals) <= 100, "parameters and objectives", design)
    for parameter in design.parameters:
        _check_parameter(parameter)
    for goal in design.goals:
        _check_word("name of an objective", goal.name)
        _require(goal.sense in ("minimise", "maximise"), "sense of an objective", goal.sense)
    parts = [(one.name, one.quantity) for one in design.goals] + [(one.name, one.quantity) for one in design.bounds]
    for name, quantity in parts:
        _check_word("name of an objective or constraint", name)
        for text in (quantity.name, quantity.unit, quantity.text):
            _check_text("text of an objective or constraint", text)
    for bound in design.bounds:
        _require(all(end is None or _is_number(end) for end in (bound.low, bound.high)), "bounds", bound.name)
    for run in runs:
        _require(isinstance(run.seed, int) and isinstance(run.settings, Mapping), "seed or settings of a run", run.seed)
        for text in (run.method, run.version, run.started):
            _check_text("text of a run", text)
        for one in run.evaluations:
            _check_evaluation(design, one)


def _check_parameter(one: DesignParameter) -> None:
    _check_word("name of a parameter", one.name)
    _check_text("unit of a parameter", one.unit)
    if one.choices:
        _require(all(isinstance(label, str) and len(label) <= 400 for label, _ in one.choices), "choices", one.name)
        return
    _require(_is_number(one.low) and _is_number(one.high) and one.low < one.high, "range of a parameter", one.name)


def _check_evaluation(design: Design, one: Evaluation) -> None:
    where = f"design {quote(one.number)}"
    _require(isinstance(one.number, int) and 0 <= one.number < 10**12, f"number of {where}", one.number)
    values = one.values
    _require(isinstance(values, Mapping) and set(values) == {p.name for p in design.parameters}, where, values)
    for parameter in design.parameters:
        value = values[parameter.name]
        fits = value in parameter.labels if parameter.labels else _is_number(value)
        _require(fits, f"{parameter.name} of {where}", value)
    for numbers in (one.objectives, one.constraints):
        _require(
            isinstance(numbers, Mapping) and all(map(_is_number, numbers.values())), f"numbers of {where}", numbers
        )
    _require(_is_number(one.seconds), f"time of {where}", one.seconds)
    for text in (one.refused_by, one.reason):
        _require(isinstance(text, str) and len(text) <= _LONG, f"reason of {where}", text)
    if one.valid:
        _require({goal.name for goal in design.goals} <= set(one.objectives), f"objectives of {where}", one.objectives)


def _check_word(what: str, text: Any) -> None:
    _require(isinstance(text, str) and bool(_WORD.fullmatch(text)), what, text)


def _check_text(what: str, text: Any) -> None:
    _require(isinstance(text, str) and len(text) <= _LONG and (text.isprintable() or not text), what, text)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value) and abs(value) < _LARGE


def _require(fits: bool, what: str, found: Any) -> None:
    if not fits:
        raise InputError(f"{what} is not one that haptorb wrote; got {quote(found)}")
