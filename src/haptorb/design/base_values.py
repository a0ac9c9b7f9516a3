"""The base device's own numbers, beside which candidates are shown."""

from __future__ import annotations

from haptorb.design.candidate import DesignCandidate
from haptorb.design.design import Design
from haptorb.design.evaluate import compute_quantity, find_base

__all__ = ["compute_base_values"]


def compute_base_values(design: Design) -> dict[str, float]:
    """Of the base device, "objectives.NAME" and "constraints.NAME" → number [SI]; what it has no number for is left
    out."""
    base = find_base(design)
    candidate = DesignCandidate(base, base, design.options)
    quantities = {f"objectives.{goal.name}": goal.quantity for goal in design.goals}
    quantities |= {f"constraints.{bound.name}": bound.quantity for bound in design.bounds}
    found = {name: compute_quantity(one, candidate) for name, one in quantities.items()}
    return {name: value for name, (value, reason) in found.items() if not reason}
