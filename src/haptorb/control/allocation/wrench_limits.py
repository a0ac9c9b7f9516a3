"""Limits on the whole wrench that currents give: the supply's power, and force and torque on the mover."""

from __future__ import annotations

import numpy as np

from haptorb.control.allocation.allocator import Saturation
from haptorb.control.allocation.supply_power import hold_power
from haptorb.errors import InputError
from haptorb.numerics.arrays import Array, Record, fields
from haptorb.numerics.compiled import kernel

__all__ = ["WRENCH_LIMITS", "check_greatest", "hold_limits", "is_missing", "subtract_passive"]

_POWER, _ALONG = int(Saturation.POWER), int(Saturation.ALONG)
_MISSING = 0.02  #: share of what was asked that may be missing without a word
_LEAST = (1e-3, 1e-5)  #: force [N] and torque [N·m] that may

WRENCH_LIMITS = fields(
    ("power", "f8"),  # of the supply [W]
    ("force", "f8"),  # greatest on the mover [N]
    ("torque", "f8"),  # greatest on the mover [N·m]
)


def check_greatest(greatest: tuple[float, float]) -> tuple[float, float]:
    """`greatest` force [N] and torque [N·m], or InputError if one is not above 0."""
    if not (greatest[0] > 0.0 and greatest[1] > 0.0):
        raise InputError(f"the greatest force [N] and torque [N·m] must be above 0; got {greatest!r}")
    return greatest


@kernel
def subtract_passive(matrix: Array, passive: Array, wrench: Array, target: Array) -> bool:
    """Fill target (6,) with what currents must give of `wrench` (6,); whether it and `matrix` (6, m) are finite."""
    total = 0.0
    for i in range(6):
        target[i] = wrench[i] - passive[i]
        total += target[i]
        for j in range(matrix.shape[1]):
            total += matrix[i, j]
    return bool(np.isfinite(total))


@kernel
def _share_within(passive: Array, active: Array, first: int, greatest: float) -> float:
    """The greatest share of `active` (6,), at most 1, that keeps three of its components with `passive` within
    `greatest`; 0 where the passive wrench alone is beyond it."""
    a, b, c = 0.0, 0.0, -greatest * greatest
    for i in range(first, first + 3):
        a += active[i] * active[i]
        b += active[i] * passive[i]
        c += passive[i] * passive[i]
    if a + 2.0 * b + c <= 0.0:
        return 1.0
    if c >= 0.0 or a == 0.0:
        return 0.0
    return float(min(1.0, (np.sqrt(b * b - a * c) - b) / a))


@kernel
def hold_limits(
    matrix: Array, passive: Array, target: Array, resistance: Array, limits: Record, currents: Array, residual: Array,
    scale: float, reason: int,
) -> tuple[float, int]:  # fmt: skip
    """Scale currents (m,) [A] into `limits`, a WRENCH_LIMITS; fill residual (6,) with what they lack of target (6,).

    Returns `scale` and `reason`, of what was decided before, after that.
    """
    m = matrix.shape[1]
    share = hold_power(currents, resistance, limits.power)  # safety: supply-power-of-wrenches
    if share < 1.0 - 1e-6:
        scale *= share
        reason = _POWER
    active = np.zeros(6)
    for i in range(6):
        for j in range(m):
            active[i] += matrix[i, j] * currents[j]
    share = min(_share_within(passive, active, 0, limits.force), _share_within(passive, active, 3, limits.torque))
    if share < 1.0:  # safety: what-comes-along-is-limited
        scale *= share
        reason = _ALONG
        for j in range(m):
            currents[j] *= share
    for i in range(6):
        residual[i] = target[i] - share * active[i]
    return scale, reason


@kernel
def is_missing(residual: Array, wrench: Array, part: int) -> bool:
    """Whether more of the force (part 0) or torque (1) of `wrench` (6,) is in residual (6,) than may be."""
    missing, asked = 0.0, 0.0
    for i in range(3 * part, 3 * part + 3):
        missing += residual[i] * residual[i]
        asked += wrench[i] * wrench[i]
    return bool(np.sqrt(missing) > max(_MISSING * np.sqrt(asked), _LEAST[part]))
