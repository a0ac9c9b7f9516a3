"""From a point of the unit cube to values of a design's parameters."""

from __future__ import annotations

from collections.abc import Sequence

from haptorb.design.design import Design
from haptorb.design.evaluation import Value
from haptorb.design.parameter import DesignParameter

__all__ = ["count_levels", "make_values", "pick_level", "round_value"]

_DIGITS = 9  #: of a value: as many as a device file can do with


def make_values(design: Design, point: Sequence[float]) -> dict[str, Value]:
    """Parameter → value at `point`, one coordinate of [0, 1) per parameter; steps and choices share it evenly."""
    return {one.name: _find_value(one, float(share)) for one, share in zip(design.parameters, point, strict=True)}


def count_levels(parameter: DesignParameter) -> int:
    """How many values the parameter can have; 0 for a continuous range.

    >>> count_levels(DesignParameter("turns", (), low=10.0, high=20.0, step=5.0))
    3
    """
    if parameter.choices:
        return len(parameter.choices)
    if parameter.step == 0.0:
        return 0
    return 1 + int((parameter.high - parameter.low) / parameter.step + 1e-9)


def pick_level(parameter: DesignParameter, level: int, levels: int) -> Value:
    """Value number `level` of so many: of its own, or evenly from `low` to `high` of a continuous range."""
    if parameter.choices:
        return parameter.labels[level]
    if parameter.step > 0.0:
        return round_value(parameter.low + level * parameter.step)
    share = level / (levels - 1) if levels > 1 else 0.5
    return round_value(parameter.low + share * (parameter.high - parameter.low))


def round_value(number: float) -> float:
    """`number` with as many digits as are kept of a value."""
    return float(f"{number:.{_DIGITS}g}")


def _find_value(parameter: DesignParameter, share: float) -> Value:
    levels = count_levels(parameter)
    if levels:
        return pick_level(parameter, min(int(share * levels), levels - 1), levels)
    return round_value(parameter.low + share * (parameter.high - parameter.low))
