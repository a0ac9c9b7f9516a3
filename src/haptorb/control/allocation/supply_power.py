"""A supply has a power limit: currents that would take more are scaled by one factor, which keeps their direction."""

from __future__ import annotations

import numpy as np

from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel

__all__ = ["hold_power"]

_HAIR = 1.0 - 1e-12  #: the sum of rounded squares stays below the limit too


@kernel
def hold_power(currents: Array, resistance: Array, power: float) -> float:
    """Scale `currents` (m,) [A] so that Σ R i² with `resistance` (m,) [Ω] is at most `power` [W]; returns the factor.

    A wrench is linear in the currents: its part that they give keeps its direction, and is cut by the same factor.
    """
    total = 0.0
    for j in range(currents.size):
        total += resistance[j] * currents[j] * currents[j]
    if not total > power:
        return 1.0
    scale = np.sqrt(power / total) * _HAIR
    for j in range(currents.size):
        currents[j] *= scale
    return float(scale)
