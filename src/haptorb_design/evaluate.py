"""Evaluation of a candidate: build the device, check constraints in order, compute objectives."""

from __future__ import annotations

import math
import sys
import time
import traceback
from collections.abc import Mapping
from functools import lru_cache

from threadpoolctl import ThreadpoolController

from haptorb.devices.base import Device
from haptorb.devices.build_checks import BuildError
from haptorb.devices.loader import build_tables
from haptorb.display import format_quantity
from haptorb.errors import HaptorbError
from haptorb_design.problem import (
    BUILD,
    Bound,
    Design,
    DesignCandidate,
    DesignQuantity,
    Evaluation,
    Value,
    build_device,
)

__all__ = [
    "DEVICE",
    "OBJECTIVE",
    "compute_quantity",
    "describe_base_forces",
    "evaluate",
    "find_base",
]


DEVICE = "device"  #: `refused_by` of values that form no valid device
OBJECTIVE = "objective"  #: `refused_by` of a design for which an objective is not finite
_MAX_CACHED_BASES = 8
_bases: dict[str, Device] = {}  # by the text of their files


def find_base(design: Design) -> Device:
    """The base device, built once per process; it may be invalid, as a search may mend it."""
    tables = design.base_tables
    if tables.text not in _bases:
        if len(_bases) >= _MAX_CACHED_BASES:
            _bases.clear()
        _bases[tables.text] = build_tables(tables, override=True)
    return _bases[tables.text]


def evaluate(design: Design, number: int, values: Mapping[str, Value]) -> Evaluation:
    """Evaluate one candidate of a design.

    Constraints are computed in the order of the design file, up to the first that is not met. The result does not
    depend on the number of processor cores.

    Parameters
    ----------
    design : Design
        The design.
    number : int
        Number of the candidate in its run.
    values : Mapping
        Parameter → value.

    Returns
    -------
    Evaluation
        Objectives and constraints; or the reason of the rejection: invalid device, violated constraint, or a
        quantity that cannot be computed.
    """
    with _find_pools(len(sys.modules)).limit(limits=1):  # results must not depend on the number of cores
        return _evaluate(design, number, values)


@lru_cache(maxsize=1)
def _find_pools(modules: int) -> ThreadpoolController:
    """Find the libraries of this process that use threads of their own. The search takes milliseconds; it is repeated
    when the number of loaded `modules` changes."""
    return ThreadpoolController()


def _evaluate(design: Design, number: int, values: Mapping[str, Value]) -> Evaluation:
    begin = time.process_time()
    constraints: dict[str, float] = {}
    objectives: dict[str, float] = {}
    by, reason = "", ""
    try:
        candidate = DesignCandidate(build_device(design, values), find_base(design), design.options)
    except BuildError as cause:
        by, reason = DEVICE, _shorten(_explain_device(cause))
        if cause.failures:
            worst = max(cause.failures, key=lambda check: check.miss)
            by, reason = f"{BUILD}: {worst.condition}", _shorten(worst.explain())
            constraints[BUILD] = sum(check.miss for check in cause.failures)
    except (HaptorbError, ArithmeticError, ValueError) as cause:
        by, reason = DEVICE, _shorten(_explain_device(cause))
    else:
        for bound in design.bounds:
            found, reason = compute_quantity(bound.quantity, candidate)
            if not reason:
                constraints[bound.name] = found
                reason = _break(bound, found)
            if reason:
                by = bound.name
                break
        for goal in () if by else design.goals:
            found, reason = compute_quantity(goal.quantity, candidate)
            if reason:
                by, objectives = OBJECTIVE, {}
                reason = f"{goal.name}: {reason}"
                break
            objectives[goal.name] = found
    return Evaluation(
        number=number, values=dict(values), objectives=objectives, constraints=constraints, refused_by=by,
        reason=reason, seconds=time.process_time() - begin,
    )  # fmt: skip


def _explain_device(cause: Exception) -> str:
    """Why the values do not form a device, without the internal name, and without advice for a single file."""
    lines = str(cause).replace("device 'candidate': ", "").splitlines()
    return "\n".join(line for line in lines if not line.endswith("override=True"))


def compute_quantity(quantity: DesignQuantity, candidate: DesignCandidate) -> tuple[float, str]:
    """The quantity, and the reason if it has no finite value: one line, else empty."""
    try:
        found = float(quantity.compute(candidate))
    except HaptorbError as cause:
        return math.nan, _shorten(str(cause))
    except Exception as cause:  # a user's own function may raise any exception
        last = traceback.extract_tb(cause.__traceback__)[-1]
        place = f"{last.filename.rpartition('/')[2]}, line {last.lineno}"
        return math.nan, _shorten(f"{type(cause).__name__}: {cause} ({place})")
    if not math.isfinite(found):
        return math.nan, f"is {found}, not a finite number"
    return found, ""


def _break(bound: Bound, found: float) -> str:
    """Violation of `bound` by `found` as text; empty within a tolerance of 1e-9, so that the base device is valid."""
    unit = bound.quantity.unit
    for limit, sense, word in ((bound.low, -1.0, "below"), (bound.high, 1.0, "above")):
        if limit is not None and sense * (found - limit) > 1e-9 * abs(limit):
            return f"{_format_value(found, unit)} is {word} {_format_value(limit, unit)}"
    return ""


def _format_value(value: float, unit: str) -> str:
    """Format a value with prefix and enough digits to distinguish it from a bound it just violates."""
    return format_quantity(value, unit, 6)


def _shorten(text: str) -> str:
    """One line of at most 300 characters; lines of `text` are joined by semicolons."""
    line = "; ".join(" ".join(one.split()) for one in text.splitlines() if one.strip())
    return line if len(line) <= 300 else f"{line[:297]}..."


# --------------------------------------------------------------------------------------------------
# Base device, for comparison with the candidates.


def describe_base_forces(design: Design, values: Mapping[str, Value]) -> str:
    """Model of the base device's forces, if it differs from that of the candidate with `values`; else empty."""
    base, device = find_base(design), build_device(design, values, override=True)
    if getattr(base, "moments_from", "") == getattr(device, "moments_from", ""):  # electromagnets only
        return ""
    return (
        f"forces of {base.name} are scaled to the moments of its file; forces of the designs follow from their "
        "windings and core alone, so the two do not compare exactly"
    )
