"""How far a candidate is from keeping every constraint, as one number that an optimiser can make small."""

from __future__ import annotations

from collections.abc import Sequence

from haptorb.design.design import Bound
from haptorb.design.evaluation import Evaluation

__all__ = ["measure_miss", "measure_violation"]


def measure_violation(evaluation: Evaluation, bounds: Sequence[Bound]) -> float:
    """0 for a valid candidate; otherwise the sum over the constraints, each from 0 (kept) to 1 (not computed).

    A constraint that misses its bound by d counts d / (d + |bound|), or d / (d + 1) where the bound is 0. One that was
    not computed counts 1, and so does a device that cannot be built or an objective without a finite number.
    """
    if evaluation.valid:
        return 0.0
    total = sum(measure_miss(evaluation.constraints.get(bound.name), bound) for bound in bounds)
    named = any(bound.name == evaluation.refused_by for bound in bounds)
    return total + (0.0 if named and total > 0.0 else 1.0)


def measure_miss(value: float | None, bound: Bound) -> float:
    """How far `value` [SI] is from keeping `bound`, 0 (kept) to 1 (not computed)."""
    if value is None or value != value:
        return 1.0
    for limit, short in ((bound.low, -1.0), (bound.high, 1.0)):
        if limit is not None and (miss := short * (value - limit)) > 0.0:
            return 1.0 if miss == float("inf") else miss / (miss + (abs(limit) or 1.0))
    return 0.0
