"""Minimum-power allocation of force, torque or both on a mover over any number of coils, within limits."""

from __future__ import annotations

from typing import final

import numpy as np
from numpy.typing import ArrayLike

from haptorb.arrays import Array, Records, fields
from haptorb.compiled import kernel
from haptorb.control.allocation import (
    TORQUE_ARM,
    Allocation,
    Allocator,
    WrenchChoice,
    check_arm,
    check_greatest,
    check_limit,
    check_power,
    is_missing,
    solve_problem,
    subtract_passive,
)
from haptorb.control.minimum_power import NOT_FINITE, solve_bounded_power, solve_least_heat
from haptorb.control.saturation import WRENCH_LIMITS, Saturation, scale_to_limits
from haptorb.devices.base import WrenchMap
from haptorb.devices.coil_array import CoilArray
from haptorb.worlds.base import PARTS, WrenchPart

__all__ = ["ArrayAllocator", "array_allocator", "array_choice", "array_remarks"]


_CURRENT = int(Saturation.CURRENT)
_COILS, _AXIS = int(Saturation.COILS), int(Saturation.AXIS)

_SETTINGS = fields(
    ("weights", "f8", (6,)),  # per component of the wrench; 0: unconstrained
    ("force_only", "?"),  # beyond the limits the force keeps its direction
    ("limits", WRENCH_LIMITS),
)


@kernel
def _allocate(
    settings: Records, matrix: Array, passive: Array, wrench: Array, limit: Array, resistance: Array, currents: Array,
    residual: Array,
) -> tuple[float, int]:  # fmt: skip
    """Currents (m,) [A] and residual (6,) for `wrench` (6,); returns scale (NaN for non-finite input) and limit."""
    s = settings[0]
    m = limit.shape[0]
    target = np.empty(6)
    if not subtract_passive(matrix, passive, wrench, target):
        return np.nan, 0
    scale, reason = 1.0, 0
    if s.force_only:
        status, scale = solve_bounded_power(matrix[:3], target[:3], limit, resistance, False, currents)
        if status == NOT_FINITE:
            return np.nan, 0
        reason = _CURRENT if scale < 1.0 else 0
    else:
        solve_least_heat(matrix, target, s.weights, limit, resistance, currents)
    for j in range(m):
        if limit[j] > 0.0 and abs(currents[j]) >= limit[j]:
            reason = _CURRENT
    scale, reason = scale_to_limits(matrix, passive, target, resistance, s.limits, currents, residual, scale, reason)
    if reason == 0 and not s.force_only:
        for part in range(2):
            if s.weights[3 * part] > 0.0 and is_missing(residual, wrench, part):
                reason = _AXIS if part == 1 and s.weights[0] == 0.0 else _COILS
    return scale, reason


@final
class ArrayAllocator(Allocator):
    """Minimum-power allocation of one part of a wrench ("force", "torque" or "both"); the passive wrench is included.

    current_limit   (m,) maximum magnitude per channel [A]
    resistance      (m,) of the channels at their maximum temperature [Ω]
    part            rendered part; the rest of the wrench accompanies it
    power           maximum power Σ R i² of the supply [W]; all currents are scaled to it
    greatest        maximum force [N] and torque [N·m] on the mover; they also limit the accompanying part
    arm             1 N is weighted like `arm` [m] × 1 N of torque, if both cannot be produced

    A force beyond the limits keeps its direction; a torque or a whole wrench becomes the nearest feasible one. Raises
    InputError for invalid values.

    >>> push = WrenchMap(np.vstack([np.tile(np.eye(3), 2), np.zeros((3, 6))]), np.zeros(6))
    >>> ArrayAllocator([1.0] * 6, [1.0] * 6).allocate(push, (0.5, 0, 0, 0, 0, 0)).currents.round(9).tolist()
    [0.25, 0.0, 0.0, 0.25, 0.0, 0.0]
    """

    def __init__(
        self,
        current_limit: ArrayLike,
        resistance: ArrayLike,
        part: WrenchPart = "force",
        *,
        power: float = np.inf,
        greatest: tuple[float, float] = (np.inf, np.inf),
        arm: float = TORQUE_ARM,
    ) -> None:
        self.current_limit = check_limit(current_limit)
        self.resistance = check_power(resistance, power, len(self.current_limit))
        self.part = part
        force, torque = (0.0 if part == "torque" else 1.0), (0.0 if part == "force" else 1.0 / check_arm(arm))
        self._settings = np.zeros(1, dtype=_SETTINGS)
        self._settings["weights"] = [force] * 3 + [torque] * 3
        self._settings["force_only"] = part == "force"
        self._settings["limits"] = (power, *check_greatest(greatest))

    def allocate(self, wrench_map: WrenchMap, wrench: ArrayLike) -> Allocation:
        """Currents (m,) [A] for `wrench` (6,) [N, N·m]. Raises InputError if either is not finite."""
        return solve_problem(_allocate, self._settings, self.current_limit, self.resistance, wrench_map, wrench)


# --------------------------------------------------------------------------------------------------
# Allocators of coil arrays, and notes for the user on the components that they can render.


def array_allocator(device: CoilArray) -> ArrayAllocator:
    """Minimum-power force; the accompanying torque stays within the device's limit.

    >>> from haptorb.devices.loader import load
    >>> array_allocator(load("tetrahedron")).part
    'force'
    """
    return _make(device, "force", TORQUE_ARM)


def array_choice(device: CoilArray, part: WrenchPart | None = None, arm: float | None = None) -> WrenchChoice:
    """Force, torque and both; `part` fixes one of them, `arm` [m] weights torque against force.

    Raises InputError for an invalid arm.

    >>> from haptorb.devices.loader import load
    >>> sorted(array_choice(load("planar")).allocators)
    ['both', 'force', 'torque']
    """
    weight = TORQUE_ARM if arm is None else arm
    hand = device.hand  # its rotational damping is the translational one at this arm
    held_at = (hand.turn_damping / hand.damping) ** 0.5 if hand.damping > 0.0 else 0.0
    return WrenchChoice({one: _make(device, one, weight) for one in PARTS}, held_at, part, weight)


def array_remarks(device: CoilArray, choice: WrenchChoice) -> tuple[str, ...]:
    """One or two sentences for each of `PARTS`, indexed by its number in recordings; empty where none is needed.

    >>> from haptorb.devices.loader import load
    >>> planar = load("planar")
    >>> len(array_remarks(planar, array_choice(planar)))
    3
    """
    components = 5 if len(device.tool.magnets) == 1 else 6
    missing = " There is no torque about the magnet's own axis." if components == 5 else ""
    few = (
        f" {device.channels} coils for {components} components: the best approximation is given, with errors of 1 N "
        "weighted like "
        f"{1e3 * choice.weight:.3g} mm × 1 N of torque."
        if device.channels < components
        else ""
    )
    fixed = "Only force is rendered, as chosen: torque from the world is left out."
    texts: dict[WrenchPart, str] = {
        "force": fixed if choice.fixed == "force" else "",
        "torque": f"Torque is rendered; the accompanying force stays within {device.limits.force:g} N.{missing}",
        "both": f"Force and torque are rendered.{few}{missing}",
    }
    return tuple(texts[part] for part in PARTS)


def _make(device: CoilArray, part: WrenchPart, arm: float) -> ArrayAllocator:
    limits = device.limits
    return ArrayAllocator(
        device.coils.current_limit, device.greatest_resistance, part, power=device.supply.power,
        greatest=(limits.force, limits.torque), arm=arm,
    )  # fmt: skip
