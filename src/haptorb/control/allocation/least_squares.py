"""Least-squares allocation: force, torque or a weighted blend, for any number of channels and any tool orientation.

The wrench is linear in the currents, w = A i. A tool over three coils can be given any force, or any torque but the one
about its own axis (rank 2), or a compromise; a motor with many channels can give its torque in many ways. One solver
serves all: minimise ‖W (A i − w)‖², and where many currents do so, take the smallest. Zárate 2020's radial case is the
special case of force weights at a radial tool.

Above a channel's limit, or the supply's power, all currents are scaled by one factor: the direction of the wrench
is kept, its magnitude is cut and the cut is reported.
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
from haptorb.control.allocation.supply_power import hold_power
from haptorb.devices.wrench_map import WrenchMap
from haptorb.errors import InputError
from haptorb.numerics.arrays import Array, Records, check_finite, fields
from haptorb.numerics.compiled import kernel, tick_kernel

__all__ = ["LeastSquaresAllocator", "least_squares_currents"]

_CURRENT, _POWER = int(Saturation.CURRENT), int(Saturation.POWER)
FORCE = (1.0, 1.0, 1.0, 0.0, 0.0, 0.0)
TORQUE = (0.0, 0.0, 0.0, 1.0, 1.0, 1.0)

#: What an allocator goes by.
_SETTINGS = fields(
    ("weights", "f8", (6,)),  # of the components of the wrench
    ("truncation", "f8"),  # relative singular value
    ("damping", "f8"),  # relative to the greatest singular value
    ("compensated", "f8"),  # share of the wrench at zero current that is subtracted
    ("power", "f8"),  # of the supply [W]
)


@kernel
def _orthogonal(columns: Array, turned: Array) -> None:
    """Turn the columns of `columns` (r, k) until they are orthogonal: one-sided Jacobi, the exact small SVD.

    turned (k, k) collects the rotations V, so that columns_before @ V = columns_after = U Σ.
    """
    rows, k = columns.shape
    for i in range(k):
        for j in range(k):
            turned[i, j] = 1.0 if i == j else 0.0
    nothing = 0.0  # below this squared length a column is rounding: turning it further would never end
    for r in range(rows):
        for j in range(k):
            nothing += columns[r, j] * columns[r, j]
    nothing *= 1e-30
    for _ in range(40):
        rotated = False
        for p in range(k - 1):
            for q in range(p + 1, k):
                a, b, c = 0.0, 0.0, 0.0
                for r in range(rows):
                    a += columns[r, p] * columns[r, p]
                    b += columns[r, q] * columns[r, q]
                    c += columns[r, p] * columns[r, q]
                if c * c <= 1e-30 * a * b or a <= nothing or b <= nothing:
                    continue
                rotated = True
                ratio = (b - a) / (2.0 * c)
                t = 1.0 / (abs(ratio) + np.sqrt(1.0 + ratio * ratio))
                if ratio < 0.0:
                    t = -t
                cosine = 1.0 / np.sqrt(1.0 + t * t)
                sine = cosine * t
                for r in range(rows):
                    x, y = columns[r, p], columns[r, q]
                    columns[r, p] = cosine * x - sine * y
                    columns[r, q] = sine * x + cosine * y
                for r in range(k):
                    x, y = turned[r, p], turned[r, q]
                    turned[r, p] = cosine * x - sine * y
                    turned[r, q] = sine * x + cosine * y
        if not rotated:
            return


@kernel
def least_squares_currents(
    matrix: Array,
    target: Array,
    weights: Array,
    limit: Array,
    truncation: float,
    damping: float,
    currents: Array,
) -> float:
    """Write the currents (m,) for `target` (6,) into `currents`; return the scale, or NaN (and NaN currents).

    For use inside compiled code; `LeastSquaresAllocator` is the checked door.
    """
    m = matrix.shape[1]
    total = 0.0
    for i in range(6):
        total += abs(target[i]) + abs(weights[i])
        for j in range(m):
            total += abs(matrix[i, j])
    for j in range(m):
        total += abs(limit[j])
    if not np.isfinite(total):
        for j in range(m):
            currents[j] = np.nan
        return np.nan

    tall = m <= 6  # keep the short side as columns: at most six, for any m
    k = m if tall else 6
    columns = np.empty((6, m)) if tall else np.empty((m, 6))
    for i in range(6):
        for j in range(m):
            if tall:
                columns[i, j] = weights[i] * matrix[i, j]
            else:
                columns[j, i] = weights[i] * matrix[i, j]
    turned = np.empty((k, k))
    _orthogonal(columns, turned)

    greatest = 0.0
    square = np.empty(k)
    for c in range(k):
        s = 0.0
        for r in range(columns.shape[0]):
            s += columns[r, c] * columns[r, c]
        square[c] = s
        greatest = max(greatest, s)
    for j in range(m):
        currents[j] = 0.0
    if greatest == 0.0:
        return 1.0
    floor = truncation * truncation * greatest
    extra = damping * damping * greatest
    for c in range(k):
        if square[c] <= floor:
            continue  # a direction that cannot be reached: no current is spent on it
        share = 0.0
        for i in range(6):
            share += (columns[i, c] if tall else turned[i, c]) * weights[i] * target[i]
        share /= square[c] + extra
        for j in range(m):
            currents[j] += share * (turned[j, c] if tall else columns[j, c])

    scale = 1.0
    for j in range(m):
        if abs(currents[j]) > limit[j]:
            scale = min(scale, limit[j] / abs(currents[j]))
    if scale < 1.0:
        for j in range(m):
            # the product may land one rounding above the limit; the limit is a promise
            currents[j] = min(max(currents[j] * scale, -limit[j]), limit[j])
    return scale


@tick_kernel
def _allocate(
    settings: Records, matrix: Array, passive: Array, wrench: Array, limit: Array, resistance: Array, currents: Array,
    residual: Array,
) -> tuple[float, int]:  # fmt: skip
    s = settings[0]
    target = residual  # filled with the residual afterwards
    for i in range(6):
        target[i] = wrench[i] - s.compensated * passive[i]
        if not np.isfinite(passive[i]):
            target[i] = np.nan
    scale = least_squares_currents(matrix, target, s.weights, limit, s.truncation, s.damping, currents)
    reason = _CURRENT if scale < 1.0 else 0
    share = hold_power(currents, resistance, s.power)  # safety: supply-power-of-forces
    if share < 1.0:
        scale *= share
        reason = _POWER
    for i in range(6):
        given = passive[i]
        for j in range(currents.shape[0]):
            given += matrix[i, j] * currents[j]
        residual[i] = wrench[i] - given
    return scale, reason


class LeastSquaresAllocator(Allocator):
    """Weighted least squares, smallest currents where there is a choice, limits by one common factor.

    current_limit        (m,) greatest magnitude per channel [A]
    weights              (6,) what a newton or a newton metre is worth, per component of the wrench
    damping              relative to the greatest singular value: near singular poses trades accuracy for current
    truncation           relative singular value up to which a direction counts as unreachable
    compensate_passive   subtract the wrench that is there at zero current
    resistance           (m,) of the channels as warm as they may be [Ω]
    power                greatest power Σ R i² that the supply gives [W]; needs `resistance`

    Raises InputError for weights that are not six, negative or all zero, and for damping or truncation outside 0 to 1.

    >>> from haptorb.devices.wrench_map import WrenchMap
    >>> pull = WrenchMap(np.vstack([np.eye(3), np.zeros((3, 3))]), np.zeros(6))
    >>> allocation = LeastSquaresAllocator((2.0, 2.0, 2.0)).allocate(pull, (3.0, 0, 4.0, 0, 0, 0))
    >>> allocation.currents.tolist(), allocation.scale
    ([1.5, 0.0, 2.0], 0.5)
    """

    def __init__(
        self,
        current_limit: ArrayLike,
        weights: ArrayLike = FORCE,
        *,
        damping: float = 0.0,
        truncation: float = 1e-6,
        compensate_passive: bool = False,
        resistance: ArrayLike | None = None,
        power: float = np.inf,
    ) -> None:
        self.current_limit = check_limit(current_limit)
        worth = check_finite(weights, "weights")
        if worth.shape != (6,) or (worth < 0).any() or not worth.any():
            raise InputError(f"weights must be six numbers, none negative, not all zero; got {weights!r}")
        if not 0.0 <= damping <= 1.0:
            raise InputError(f"damping must be between 0 and 1; got {damping!r}")
        if not 0.0 < truncation < 1.0:
            raise InputError(f"truncation must be between 0 and 1; got {truncation!r}")
        self.truncation = truncation
        self.resistance = check_power(resistance, power, len(self.current_limit))
        self._settings = np.zeros(1, dtype=_SETTINGS)
        self._settings["weights"], self._settings["compensated"] = worth, compensate_passive
        self._settings["truncation"], self._settings["damping"] = truncation, damping
        self._settings["power"] = power
        self.weights: Array = self._settings["weights"][0]

    @classmethod
    def force(
        cls, current_limit: ArrayLike, *, compensate_passive: bool = False, resistance: ArrayLike | None = None,
        power: float = np.inf,
    ) -> LeastSquaresAllocator:  # fmt: skip
        """Force only: the accompanying torque is in the residual."""
        return cls(current_limit, FORCE, compensate_passive=compensate_passive, resistance=resistance, power=power)

    @classmethod
    def torque(cls, current_limit: ArrayLike, *, compensate_passive: bool = False) -> LeastSquaresAllocator:
        """Torque only: over a single magnet rank 2, see `unreachable`."""
        return cls(current_limit, TORQUE, compensate_passive=compensate_passive)

    @classmethod
    def both(cls, current_limit: ArrayLike, arm: float, *, compensate_passive: bool = False) -> LeastSquaresAllocator:
        """Force and torque together; 1 N counts as much as `arm` [m] × 1 N of torque.

        Raises InputError for an arm that is no length.
        """
        if not (np.isfinite(arm) and arm > 0):
            raise InputError(f"arm must be a length greater than zero [m]; got {arm!r}")
        return cls(current_limit, (1, 1, 1, 1 / arm, 1 / arm, 1 / arm), compensate_passive=compensate_passive)

    def allocate(self, wrench_map: WrenchMap, wrench: ArrayLike) -> Allocation:
        """Currents (m,) [A] for `wrench` (6,) [N, N·m]. Raises InputError where either is not finite."""
        return solve_problem(_allocate, self._settings, self.current_limit, self.resistance, wrench_map, wrench)
