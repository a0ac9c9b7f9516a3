"""The base device's own numbers, beside which candidates are shown."""

from __future__ import annotations

from collections.abc import Mapping

from haptorb.design.candidate import DesignCandidate
from haptorb.design.design import Design
from haptorb.design.device_changes import build_device
from haptorb.design.evaluate import compute_quantity, find_base
from haptorb.design.evaluation import Value

__all__ = ["compute_base_values", "describe_base_forces"]


def compute_base_values(design: Design) -> dict[str, float]:
    """Of the base device, "objectives.NAME" and "constraints.NAME" → number [SI]; what it has no number for is left
    out."""
    base = find_base(design)
    candidate = DesignCandidate(base, base, design.options)
    quantities = {f"objectives.{goal.name}": goal.quantity for goal in design.goals}
    quantities |= {f"constraints.{bound.name}": bound.quantity for bound in design.bounds}
    found = {name: compute_quantity(one, candidate) for name, one in quantities.items()}
    return {name: value for name, (value, reason) in found.items() if not reason}


def describe_base_forces(design: Design, values: Mapping[str, Value]) -> str:
    """How the base device's forces are computed, if not as those of the candidate with `values`; empty if alike."""
    base, device = find_base(design), build_device(design, values)
    if getattr(base, "moments_from", "") == getattr(device, "moments_from", ""):  # only electromagnets have it
        return ""
    return (
        f"forces of {base.name} are those of point dipoles with the moments of its file; forces of the designs are "
        "those of windings and core at their true size, so the two do not compare exactly"
    )
