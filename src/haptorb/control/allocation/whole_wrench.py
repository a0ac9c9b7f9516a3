"""Torque on a tool, or force and torque at once: what the coils can give of a whole wrench, and what holds it back.

A magnet over three coils can be turned about any axis but its own, and a torque brings a force along: at contact about
54 N for every newton metre. Force and torque at once are six numbers from three currents, hence a compromise: weighted
least squares within the limits.

1 N weighs as much as `TORQUE_ARM` × 1 N of torque. It is the ratio of just noticeable differences in fingers: 12.7 % of
60 mN·m (Jandura and Srinivasan 1994) is as hard to notice as 7 % of 2.5 N (Pang, Tan and Durlach 1991, their smallest
force).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from haptorb.control.allocation.allocator import (
    Allocation,
    Allocator,
    Saturation,
    check_limit,
    check_power,
    solve_problem,
)
from haptorb.control.allocation.bounded_compromise import solve_compromise
from haptorb.control.allocation.least_squares import least_squares_currents
from haptorb.control.allocation.wrench_limits import (
    WRENCH_LIMITS,
    check_greatest,
    hold_limits,
    is_missing,
    subtract_passive,
)
from haptorb.devices.wrench_map import WrenchMap
from haptorb.errors import InputError
from haptorb.numerics.arrays import Array, Records, fields
from haptorb.numerics.compiled import kernel

__all__ = ["TORQUE_ARM", "WholeWrenchAllocator", "check_arm"]

TORQUE_ARM = 0.127 * 60e-3 / (0.07 * 2.5)  #: 43.5 mm [m]

_CURRENT = int(Saturation.CURRENT)
_AXIS, _COILS = int(Saturation.AXIS), int(Saturation.COILS)
_TURNED = np.array((0.0, 0.0, 0.0, 1.0, 1.0, 1.0))
_TRUNCATION = 1e-6

_SETTINGS = fields(
    ("together", "?"),  # force and torque, not torque alone
    ("arm", "f8"),  # [m]
    ("limits", WRENCH_LIMITS),
)


def check_arm(arm: float) -> float:
    """`arm` itself, or InputError if it is no length of 1 mm to 10 m.

    >>> check_arm(0.05)
    0.05
    """
    if isinstance(arm, bool) or not isinstance(arm, int | float) or not 1e-3 <= arm <= 10.0:
        raise InputError(f"torque arm must be a length from 1 mm to 10 m; got {arm!r} m")
    return float(arm)


@kernel
def _allocate(
    settings: Records, matrix: Array, passive: Array, wrench: Array, limit: Array, resistance: Array, currents: Array,
    residual: Array,
) -> tuple[float, int]:  # fmt: skip
    """Currents (m,) [A] and residual (6,) for `wrench` (6,); the scale, NaN for what is not finite, and the reason."""
    s = settings[0]
    m = limit.shape[0]
    target = np.empty(6)
    if not subtract_passive(matrix, passive, wrench, target):
        return np.nan, 0
    scale, reason = 1.0, 0
    if s.together:
        H, g = np.zeros((m, m)), np.zeros(m)
        for i in range(6):
            weight = 1.0 if i < 3 else 1.0 / (s.arm * s.arm)
            for j in range(m):
                g[j] += weight * matrix[i, j] * target[i]
                for k in range(m):
                    H[j, k] += weight * matrix[i, j] * matrix[i, k]
        reason = solve_compromise(H, g, limit, resistance, s.limits.power, currents)
    else:
        scale = least_squares_currents(matrix, target, _TURNED, limit, _TRUNCATION, 0.0, currents)
        if scale < 1.0:
            reason = _CURRENT
    scale, reason = hold_limits(matrix, passive, target, resistance, s.limits, currents, residual, scale, reason)
    if reason == 0:
        for part in range(0 if s.together else 1, 2):
            if is_missing(residual, wrench, part):
                reason = _COILS if s.together else _AXIS
    return scale, reason


class WholeWrenchAllocator(Allocator):
    """Torque (`together` False) or force and torque; the passive wrench counts as given, limits are kept.

    current_limit   (m,) greatest magnitude per channel [A]
    resistance      (m,) of the channels as warm as they may be [Ω]
    power           greatest power Σ R i² that the supply gives [W]
    greatest        largest force [N] and torque [N·m] on the mover; they also limit the accompanying part
    arm             1 N weighs as much as `arm` [m] × 1 N of torque, where both are asked

    A torque beyond the limits keeps its direction, as forces do. Force and torque together are the nearest that the
    limits allow: no direction could be kept. Raises InputError for values that cannot be.

    >>> from haptorb.devices.api import wrench_map
    >>> from haptorb.devices.state import State
    >>> over = wrench_map("omni", State.at((0, 0, 0.05)))
    >>> torque = WholeWrenchAllocator((20.0,) * 3, (0.78,) * 3)
    >>> given = over.wrench(torque.allocate(over, (0, 0, 0, 0.005, 0, 0)).currents)
    >>> (given[3:].round(6) + 0.0).tolist(), given[1].round(2).item()
    ([0.005, 0.0, 0.0], 0.27)
    >>> torque.allocate(over, (0, 0, 0, 0, 0, 0.005)).saturated.text
    "the magnet's own axis, about which there is no torque"
    """

    def __init__(
        self,
        current_limit: ArrayLike,
        resistance: ArrayLike,
        power: float = np.inf,
        *,
        together: bool = False,
        greatest: tuple[float, float] = (np.inf, np.inf),
        arm: float = TORQUE_ARM,
    ) -> None:
        self.current_limit = check_limit(current_limit)
        self.resistance = check_power(resistance, power, len(self.current_limit))
        self.together = together
        self._settings = np.zeros(1, dtype=_SETTINGS)
        self._settings["together"], self._settings["arm"] = together, check_arm(arm)
        self._settings["limits"] = (power, *check_greatest(greatest))

    def allocate(self, wrench_map: WrenchMap, wrench: ArrayLike) -> Allocation:
        """Currents (m,) [A] for `wrench` (6,) [N, N·m]. Raises InputError where either is not finite."""
        return solve_problem(_allocate, self._settings, self.current_limit, self.resistance, wrench_map, wrench)
