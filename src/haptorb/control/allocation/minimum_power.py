"""The currents that give a torque with the least heat: Bai 2012 eq. (4), and the same within every channel's limit."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from haptorb.control.allocation.allocator import (
    SATURATIONS,
    Allocation,
    Allocator,
    Saturation,
    check_limit,
    check_power,
    check_problem,
)
from haptorb.control.allocation.bounded_power import NOT_FINITE, solve_bounded_power
from haptorb.control.allocation.supply_power import hold_power
from haptorb.devices.wrench_map import WrenchMap
from haptorb.errors import InputError, UnknownName
from haptorb.numerics.arrays import Array, check_finite, vectors
from haptorb.numerics.compiled import tick_kernel

__all__ = ["MinimumPowerAllocator", "minimum_power_currents"]

_CURRENT, _POWER = int(Saturation.CURRENT), int(Saturation.POWER)
_BEYOND = ("scale", "least-squares")


def minimum_power_currents(K: ArrayLike, T: ArrayLike) -> Array:
    """Currents (..., m) [A] for torque T (..., 3) [N·m], torque characteristic K (..., 3, m) [N·m/A], without limits.

    u = Kᵀ (K Kᵀ)⁻¹ T, Bai 2012 eq. (4): the least Σ u². Raises InputError if K turns fewer than three axes.

    >>> minimum_power_currents(np.eye(3), (1.0, 2.0, 3.0)).tolist()
    [1.0, 2.0, 3.0]
    """
    k = check_finite(K, "K")
    if k.ndim < 2 or k.shape[-2] != 3:
        raise InputError(f"K must be a torque characteristic, shape (..., 3, m); got shape {k.shape}")
    torque = vectors(T, "T")
    left, values, right = np.linalg.svd(k, full_matrices=False)
    if k.shape[-1] < 3 or (values[..., -1] <= 1e-12 * values[..., 0]).any():
        raise InputError(
            "K must have rank 3 (torque about all three axes) for eq. (4); MinimumPowerAllocator reports why not"
        )
    inner = np.einsum("...ij,...i->...j", left, torque) / values
    currents: Array = np.einsum("...ji,...j->...i", right, inner)
    return currents


@tick_kernel
def _allocate(
    matrix: Array,
    passive: Array,
    wrench: Array,
    limit: Array,
    resistance: Array,
    compensated: float,
    power: float,
    nearest: bool,
    currents: Array,
    residual: Array,
) -> tuple[int, float, int]:
    torque = residual[3:]  # filled with the residual afterwards
    ready = True
    for i in range(6):
        ready = ready and np.isfinite(wrench[i]) and np.isfinite(passive[i])
    for i in range(3):
        torque[i] = wrench[3 + i] - compensated * passive[3 + i] if ready else np.nan
    status, scale = solve_bounded_power(matrix[3:], torque, limit, resistance, nearest, currents)
    reason = _CURRENT if scale < 1.0 else 0
    for j in range(currents.shape[0]):
        if limit[j] > 0.0 and abs(currents[j]) >= limit[j]:
            reason = _CURRENT
    share = hold_power(currents, resistance, power)  # safety: supply-power-of-motors
    if share < 1.0:
        scale *= share
        reason = _POWER
    for i in range(6):
        given = passive[i]
        for j in range(currents.shape[0]):
            given += matrix[i, j] * currents[j]
        residual[i] = wrench[i] - given
    return status, scale, reason


class MinimumPowerAllocator(Allocator):
    """Torque with the least heat, every current within its limit; force rows are carried by the bearing.

    current_limit        (m,) greatest magnitude per channel [A]; 0 turns a channel off
    infeasible           what becomes of a torque beyond the limits: "scale" keeps its direction, "least-squares" gives
                         the nearest torque there is
    resistance           (m,) [Ω], alike for all channels if not given: the heat is Σ R i²
    compensate_passive   subtract the torque that is there at zero current (a weight-compensating regulator's)
    power                greatest power Σ R i² that the supply gives [W]; needs `resistance`. The currents of least heat
                         are scaled, which is the most torque for that power unless some stand at their limits

    Raises UnknownName for another `infeasible`, InputError for limits or resistances that cannot be.

    >>> from haptorb.devices.wrench_map import WrenchMap
    >>> motor = WrenchMap(np.vstack([np.zeros((3, 4)), [[1, 0, 0, 1], [0, 1, 0, 0], [0, 0, 1, 0]]]), np.zeros(6))
    >>> MinimumPowerAllocator([1.0, 1, 1, 1]).allocate(motor, (0, 0, 0, 1.0, 0, 0)).currents.round(12).tolist()
    [0.5, 0.0, 0.0, 0.5]
    """

    def __init__(
        self,
        current_limit: ArrayLike,
        *,
        infeasible: str = "scale",
        resistance: ArrayLike | None = None,
        compensate_passive: bool = False,
        power: float = np.inf,
    ) -> None:
        self.current_limit = check_limit(current_limit)
        if infeasible not in _BEYOND:
            raise UnknownName("choice for an infeasible torque", infeasible, _BEYOND)
        self.resistance = check_power(resistance, power, len(self.current_limit))
        self.power = float(power)
        self._nearest = infeasible == "least-squares"
        self._compensated = 1.0 if compensate_passive else 0.0

    def allocate(self, wrench_map: WrenchMap, wrench: ArrayLike) -> Allocation:
        """Currents (m,) [A] for the torque in `wrench` (6,) [N, N·m]. Raises InputError where either is not finite."""
        limit = self.current_limit
        matrix, passive, asked = check_problem(wrench_map, wrench, limit.shape[0])
        currents = np.empty(limit.shape[0])
        residual = np.empty(6)
        status, scale, reason = _allocate(
            matrix, passive, asked, limit, self.resistance, self._compensated, self.power, self._nearest, currents,
            residual,
        )  # fmt: skip
        if status == NOT_FINITE:
            raise InputError(f"wrench and wrench map must be finite; got wrench {wrench!r}, map {wrench_map!r}")
        return Allocation(currents, residual, SATURATIONS[reason], scale)
