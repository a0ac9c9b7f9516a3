"""Search space: the free parameters of a design as a unit cube."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import numpy as np
from numpy.typing import NDArray

from haptorb.errors import InputError
from haptorb_design.problem import BUILD, Bound, DesignParameter, Evaluation, Value
from haptorb_design.sampling import count_levels, pick_level, round_value

__all__ = ["SearchSpace", "measure_miss", "measure_violation"]


Array = NDArray[np.float64]

_COORDINATE_DIGITS = 9  #: digits of a coordinate; differences between processors in the last bit are rounded off


@final
class SearchSpace:
    """Mapping between points of the unit cube and parameter values.

    parameters  in the order of the cube's axes
    levels      (p,) int number of steps or choices of each parameter; 0: continuous
    free        (p,) bool: an unordered choice
    """

    def __init__(self, parameters: Sequence[DesignParameter]) -> None:
        if not parameters:
            raise InputError("the design has no free parameter: add a table [parameters.NAME]")
        self.parameters = tuple(parameters)
        self.levels: NDArray[np.int64] = np.array([count_levels(parameter) for parameter in parameters])
        self.free: NDArray[np.bool_] = np.array([bool(parameter.choices) for parameter in parameters])

    def snap(self, points: Array) -> Array:
        """The nearest permitted points (n, p), within the bounds."""
        inside = np.clip(points, 0.0, 1.0)
        widths = np.maximum(self.levels, 1)
        bins = np.minimum(np.floor(inside * widths), widths - 1)
        spans = np.maximum(self.levels - 1, 1)
        stepped = np.where(self.levels == 1, 0.0, np.round(inside * spans) / spans)
        found = np.where(self.free, (bins + 0.5) / widths, np.where(self.levels > 0, stepped, inside))
        places: Array = np.asarray(
            np.round(found, _COORDINATE_DIGITS) + 0.0, np.float64
        )  # no negative zero: equal points have equal bytes
        return places

    def values(self, point: Array) -> dict[str, Value]:
        """Parameter → value at the snapped `point` (p,)."""
        return {
            parameter.name: _value_at(parameter, int(levels), float(place))
            for parameter, levels, place in zip(self.parameters, self.levels, point, strict=True)
        }


def _value_at(parameter: DesignParameter, levels: int, place: float) -> Value:
    if parameter.choices:
        return pick_level(parameter, min(int(place * levels), levels - 1), levels)
    if levels:
        return pick_level(parameter, round(place * max(levels - 1, 1)), levels)
    return round_value(parameter.low + place * (parameter.high - parameter.low))


# --------------------------------------------------------------------------------------------------
# Constraint violation as one number, which an optimiser minimises.


def measure_violation(evaluation: Evaluation, bounds: Sequence[Bound]) -> float:
    """0 for a valid candidate; otherwise the sum over the constraints, each from 0 (satisfied) to 1 (not computed).

    A constraint violated by d counts d / (d + |bound|), or d / (d + 1) where the bound is 0. One that was not computed
    counts 1, as does an objective without a finite value. A device that cannot be built violates all of them, the less
    the closer its parts are to their limits; values that form no device are the worst.
    """
    if evaluation.valid:
        return 0.0
    lacks = evaluation.constraints.get(BUILD)
    if lacks is not None:
        return len(bounds) + lacks / (lacks + 1.0)
    total = sum(measure_miss(evaluation.constraints.get(bound.name), bound) for bound in bounds)
    named = any(bound.name == evaluation.refused_by for bound in bounds)
    return total + (0.0 if named and total > 0.0 else 1.0)


def measure_miss(value: float | None, bound: Bound) -> float:
    """Violation of `bound` by `value` [SI], from 0 (satisfied) to 1 (not computed)."""
    if value is None or value != value:
        return 1.0
    for limit, short in ((bound.low, -1.0), (bound.high, 1.0)):
        if limit is not None and (miss := short * (value - limit)) > 0.0:
            return 1.0 if miss == float("inf") else miss / (miss + (abs(limit) or 1.0))
    return 0.0
