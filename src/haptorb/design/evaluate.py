"""Evaluate one set of values: build the device, check its constraints in order, compute its objectives."""

from __future__ import annotations

import math
import sys
import time
import traceback
from collections.abc import Mapping
from functools import lru_cache

from threadpoolctl import ThreadpoolController

from haptorb.design.candidate import DesignCandidate
from haptorb.design.design import Bound, Design
from haptorb.design.device_changes import build_device
from haptorb.design.evaluation import Evaluation, Value
from haptorb.design.quantity import DesignQuantity
from haptorb.devices.device import Device
from haptorb.devices.loader import build_tables
from haptorb.errors import HaptorbError

__all__ = ["DEVICE", "OBJECTIVE", "compute_quantity", "evaluate", "find_base"]

DEVICE = "device"  #: `refused_by` of values that make no device
OBJECTIVE = "objective"  #: `refused_by` of a design that an objective has no finite number for
_MOST_BASES = 8
_bases: dict[str, Device] = {}  # by the text of their files


def find_base(design: Design) -> Device:
    """The base device, built once per process."""
    tables = design.base_tables
    if tables.text not in _bases:
        if len(_bases) >= _MOST_BASES:
            _bases.clear()
        _bases[tables.text] = build_tables(tables)
    return _bases[tables.text]


def evaluate(design: Design, number: int, values: Mapping[str, Value]) -> Evaluation:
    """The evaluation of `values`; `number` is their place in the run.

    A candidate that makes no device, breaks a constraint, or of which a quantity cannot be computed, is refused with
    the reason. Constraints are computed in the order of the design file, up to the first that is broken.
    """
    with _find_pools(len(sys.modules)).limit(limits=1):  # results must not depend on how many cores a computer has
        return _evaluate(design, number, values)


@lru_cache(maxsize=1)
def _find_pools(modules: int) -> ThreadpoolController:
    """The libraries of this process with threads of their own. To look for them takes milliseconds: they are looked for
    again where another number of `modules` is loaded."""
    return ThreadpoolController()


def _evaluate(design: Design, number: int, values: Mapping[str, Value]) -> Evaluation:
    begin = time.process_time()
    constraints: dict[str, float] = {}
    objectives: dict[str, float] = {}
    by, reason = "", ""
    try:
        candidate = DesignCandidate(build_device(design, values), find_base(design), design.options)
    except (HaptorbError, ArithmeticError, ValueError) as cause:
        by, reason = DEVICE, _shorten(str(cause).replace("device 'candidate': ", ""))
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


def compute_quantity(quantity: DesignQuantity, candidate: DesignCandidate) -> tuple[float, str]:
    """The number, and why there is none: one line, empty if it is finite."""
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
    """How `found` breaks `bound`; empty if it keeps it, to 1e-9 of the bound: the base device keeps its own values."""
    unit = f" {bound.quantity.unit}" if bound.quantity.unit else ""
    if bound.low is not None and found < bound.low - 1e-9 * abs(bound.low):
        return f"{found:.6g}{unit} is below {bound.low:.6g}{unit}"
    if bound.high is not None and found > bound.high + 1e-9 * abs(bound.high):
        return f"{found:.6g}{unit} is above {bound.high:.6g}{unit}"
    return ""


def _shorten(text: str) -> str:
    """One line of at most 300 characters."""
    line = " ".join(text.split())
    return line if len(line) <= 300 else f"{line[:297]}..."
