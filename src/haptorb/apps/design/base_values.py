"""The base device's own numbers, beside which the designs are shown."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from haptorb.design.base_values import compute_base_values
from haptorb.design.design import Design
from haptorb.design.device_keys import split_key
from haptorb.design.file_values import read_number
from haptorb.design.parameter import DesignParameter

__all__ = ["compute_base", "find_base_value"]


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
