"""Wrench allocation: coil currents for the wrench that a world commands, with residual and active limit."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Final, final

import numpy as np
from numpy import ascontiguousarray
from numpy.typing import ArrayLike

from haptorb.arrays import Array, Records, check_finite, fields, record
from haptorb.compiled import kernel, tick_kernel
from haptorb.control.minimum_power import NOT_FINITE, solve_bounded_power
from haptorb.control.saturation import (
    SATURATIONS,
    WRENCH_LIMITS,
    Saturation,
    scale_to_limits,
    scale_to_power,
    solve_compromise,
)
from haptorb.devices.arm import Arm
from haptorb.devices.base import Device, WrenchMap
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.errors import InputError, UnknownName
from haptorb.magnetics.dipole import MU0
from haptorb.worlds.base import PARTS, World, WrenchPart

__all__ = [
    "PART_NUMBERS",
    "TORQUE_ARM",
    "Allocation",
    "Allocator",
    "LeastSquaresAllocator",
    "MinimumPowerAllocator",
    "WholeWrenchAllocator",
    "WrenchChoice",
    "arm_allocator",
    "check_arm",
    "check_greatest",
    "check_limit",
    "check_power",
    "check_problem",
    "force_allocator",
    "is_missing",
    "least_squares_currents",
    "part_remarks",
    "solve_problem",
    "subtract_passive",
    "tool_choice",
    "torque_allocator",
]


_FLOAT = np.dtype(np.float64)  #: comparing with a stored dtype is faster than constructing it


@record
class Allocation:
    """Allocated currents, with the residual wrench and the limit that caused it.

    Parameters
    ----------
    currents : ndarray, shape (m,)
        Current of each channel [A].
    residual : ndarray, shape (6,)
        Requested minus delivered wrench [N, N·m]; the passive wrench counts as delivered.
    saturated : Saturation
        Active limit, or component that no current can produce; false: none.
    scale : float
        Common factor by which the wrench was reduced to respect the limits; 1 if it was not [1].
    """

    currents: Array
    residual: Array
    saturated: Saturation
    scale: float


class Allocator(ABC):
    """Computes currents for a wrench; one final class per method.

    Allocators are stateless: the same arguments give the same currents.
    """

    @abstractmethod
    def allocate(self, wrench_map: WrenchMap, wrench: ArrayLike) -> Allocation:
        """Currents (m,) [A] for `wrench` (6,) [N, N·m] at the pose of `wrench_map`.

        Raises InputError if shapes do not fit or a number is not finite.
        """


def check_limit(value: ArrayLike) -> Array:
    """Check (m,) current limits [A]: magnitudes, one per channel; zero disables a channel. Raises InputError.

    >>> check_limit([3, 0]).tolist()
    [3.0, 0.0]
    """
    limit = check_finite(value, "current_limit")
    if limit.ndim != 1 or limit.size == 0:
        raise InputError(f"current_limit must have one entry per channel, shape (m,); got shape {limit.shape}")
    if (limit < 0).any():
        raise InputError(f"current_limit must not be negative: it bounds a magnitude [A]; got {value!r}")
    return np.ascontiguousarray(limit)


def check_power(resistance: ArrayLike | None, power: float, channels: int) -> Array:
    """Check (m,) resistances [Ω] for the heat Σ R i² (None: all equal), together with the `power` limit [W].

    Raises InputError for another shape, values that are not positive, and a power limit without resistances.
    """
    if not power > 0.0:
        raise InputError(f"power must be the supply's limit, above 0 W, or inf for none; got {power!r} W")
    if resistance is None:
        if np.isfinite(power):
            raise InputError("a power limit needs the resistance of every channel")
        return np.ones(channels)
    ohms = np.ascontiguousarray(check_finite(resistance, "resistance"))
    if ohms.shape != (channels,) or not (ohms > 0).all():
        raise InputError(
            f"resistance must have one entry above 0 Ω per channel, shape ({channels},); got {resistance!r}"
        )
    return ohms


def check_problem(wrench_map: WrenchMap, wrench: ArrayLike, channels: int) -> tuple[Array, Array, Array]:
    """Return matrix (6, m), passive wrench (6,) and wrench (6,) as contiguous float64 arrays of checked shape.

    The kernels check that all numbers are finite.

    Raises InputError for a wrench or a map of another shape or type.

    The matrix is in [N/A, N·m/A], the wrenches in [N, N·m].
    """
    try:
        asked = ascontiguousarray(wrench, _FLOAT)
    except (TypeError, ValueError) as cause:
        raise InputError(f"wrench must be numbers; got {wrench!r}") from cause
    if asked.shape != (6,):
        raise InputError(f"wrench must be force then torque, shape (6,); got shape {asked.shape}")
    matrix, passive = ascontiguousarray(wrench_map.matrix, _FLOAT), ascontiguousarray(wrench_map.passive, _FLOAT)
    if matrix.shape != (6, channels):
        raise InputError(
            f"the wrench map must have shape (6, {channels}), one column per channel of current_limit; "
            f"got {matrix.shape}"
        )
    if passive.shape != (6,):
        raise InputError(f"the passive wrench must have shape (6,); got {passive.shape}")
    return matrix, passive, asked


def solve_problem(
    solve: Callable[..., tuple[float, int]],
    settings: Records,
    limit: Array,
    resistance: Array,
    wrench_map: WrenchMap,
    wrench: ArrayLike,
) -> Allocation:
    """Run the kernel `solve` with `settings`, current limits (m,) [A] and resistances (m,) [Ω]; return its allocation.

    `solve` fills currents (m,) [A] and residual (6,) [N, N·m]; it returns the scale, NaN for non-finite input, and the
    number of the saturation.

    Raises InputError for a wrench (6,) [N, N·m] or a map of another shape, or if either is not finite.
    """
    matrix, passive, asked = check_problem(wrench_map, wrench, limit.shape[0])
    currents, residual = np.empty(limit.shape[0]), np.empty(6)
    scale, reason = solve(settings, matrix, passive, asked, limit, resistance, currents, residual)
    if scale != scale:
        raise InputError(f"wrench and wrench map must be finite; got wrench {wrench!r}, map {wrench_map!r}")
    return Allocation(currents, residual, SATURATIONS[reason], scale)


# --------------------------------------------------------------------------------------------------
# Least-squares allocation: force, torque or a weighted blend, for any number of channels and any tool orientation.
#
# The wrench is linear in the currents, w = A i. Three coils can apply any force to a tool, or any torque except
# the one about its own axis (rank 2), or a compromise; a motor with many channels has redundant solutions. One
# solver covers all: minimise ‖W (A i − w)‖², and among the minimisers take the smallest currents. Zárate 2020's radial
# case is the special case of force weights at a radial tool.
#
# Beyond a channel's current limit, or the supply's power, all currents are scaled by one factor: the direction of the
# wrench is preserved, its magnitude is reduced and the residual is reported.


_LEAST_SQUARES_CURRENT, _LEAST_SQUARES_POWER = int(Saturation.CURRENT), int(Saturation.POWER)
FORCE = (1.0, 1.0, 1.0, 0.0, 0.0, 0.0)
TORQUE = (0.0, 0.0, 0.0, 1.0, 1.0, 1.0)

#: Settings of the least-squares allocator.
_LEAST_SQUARES_SETTINGS = fields(
    ("weights", "f8", (6,)),  # per component of the wrench
    ("truncation", "f8"),  # threshold on relative singular values
    ("damping", "f8"),  # relative to the largest singular value
    ("compensated", "f8"),  # share of the wrench at zero current that is subtracted
    ("power", "f8"),  # of the supply [W]
)


@kernel
def _orthogonal(columns: Array, turned: Array) -> None:
    """Orthogonalise the columns of `columns` (r, k): one-sided Jacobi, an exact SVD for small matrices.

    turned (k, k) collects the rotations V, so that columns_before @ V = columns_after = U Σ.
    """
    rows, k = columns.shape
    for i in range(k):
        for j in range(k):
            turned[i, j] = 1.0 if i == j else 0.0
    nothing = 0.0  # squared length below which a column is rounding error: rotating it further would not terminate
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

    For use inside compiled code; `LeastSquaresAllocator` checks its input.
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
            continue  # unreachable direction: no current is spent on it
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
            # the product may exceed the limit by one rounding; the limit is strict
            currents[j] = min(max(currents[j] * scale, -limit[j]), limit[j])
    return scale


@tick_kernel
def _least_squares_allocate(
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
    reason = _LEAST_SQUARES_CURRENT if scale < 1.0 else 0
    share = scale_to_power(currents, resistance, s.power)  # safety: supply-power-of-forces
    if share < 1.0:
        scale *= share
        reason = _LEAST_SQUARES_POWER
    for i in range(6):
        given = passive[i]
        for j in range(currents.shape[0]):
            given += matrix[i, j] * currents[j]
        residual[i] = wrench[i] - given
    return scale, reason


class LeastSquaresAllocator(Allocator):
    """Weighted least squares with minimum-norm currents and limits by one common factor.

    Parameters
    ----------
    current_limit : array_like, shape (m,)
        Maximum magnitude per channel [A].
    weights : array_like, shape (6,)
        Weight of each component of the wrench [1/N, 1/(N·m)].
    damping : float
        Relative to the largest singular value: trades accuracy for current near singular poses [1].
    truncation : float
        Relative singular value up to which a direction counts as unreachable [1].
    compensate_passive : bool
        Subtract the wrench at zero current.
    resistance : array_like, shape (m,), optional
        Resistance of the channels at their maximum temperature [Ω].
    power : float
        Maximum power Σ R i² of the supply [W]; needs `resistance`.

    Raises
    ------
    InputError
        Unless there are six weights, none negative and not all zero, and for damping or truncation outside 0 to 1.

    Examples
    --------
    >>> from haptorb.devices.base import WrenchMap
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
        self._settings = np.zeros(1, dtype=_LEAST_SQUARES_SETTINGS)
        self._settings["weights"], self._settings["compensated"] = worth, compensate_passive
        self._settings["truncation"], self._settings["damping"] = truncation, damping
        self._settings["power"] = power
        self.weights: Array = self._settings["weights"][0]

    @classmethod
    def force(
        cls, current_limit: ArrayLike, *, compensate_passive: bool = False, resistance: ArrayLike | None = None,
        power: float = np.inf,
    ) -> LeastSquaresAllocator:  # fmt: skip
        """Force only: the accompanying torque is reported in the residual."""
        return cls(current_limit, FORCE, compensate_passive=compensate_passive, resistance=resistance, power=power)

    @classmethod
    def torque(cls, current_limit: ArrayLike, *, compensate_passive: bool = False) -> LeastSquaresAllocator:
        """Torque only: rank 2 over a single magnet, see `unreachable`."""
        return cls(current_limit, TORQUE, compensate_passive=compensate_passive)

    @classmethod
    def both(cls, current_limit: ArrayLike, arm: float, *, compensate_passive: bool = False) -> LeastSquaresAllocator:
        """Force and torque together; 1 N is weighted like `arm` [m] × 1 N of torque.

        Raises InputError for an invalid arm.
        """
        if not (np.isfinite(arm) and arm > 0):
            raise InputError(f"arm must be a length greater than zero [m]; got {arm!r}")
        return cls(current_limit, (1, 1, 1, 1 / arm, 1 / arm, 1 / arm), compensate_passive=compensate_passive)

    def allocate(self, wrench_map: WrenchMap, wrench: ArrayLike) -> Allocation:
        """Currents (m,) [A] for `wrench` (6,) [N, N·m]. Raises InputError if either is not finite."""
        return solve_problem(
            _least_squares_allocate, self._settings, self.current_limit, self.resistance, wrench_map, wrench
        )


# --------------------------------------------------------------------------------------------------
# Minimum-power allocation of a torque: Bai 2012 eq. (4), and the same within every channel's limit.


_MINIMUM_POWER_CURRENT, _MINIMUM_POWER_POWER = int(Saturation.CURRENT), int(Saturation.POWER)
_BEYOND = ("scale", "least-squares")


@tick_kernel
def _minimum_power_allocate(
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
    reason = _MINIMUM_POWER_CURRENT if scale < 1.0 else 0
    for j in range(currents.shape[0]):
        if limit[j] > 0.0 and abs(currents[j]) >= limit[j]:
            reason = _MINIMUM_POWER_CURRENT
    share = scale_to_power(currents, resistance, power)  # safety: supply-power-of-motors
    if share < 1.0:
        scale *= share
        reason = _MINIMUM_POWER_POWER
    for i in range(6):
        given = passive[i]
        for j in range(currents.shape[0]):
            given += matrix[i, j] * currents[j]
        residual[i] = wrench[i] - given
    return status, scale, reason


class MinimumPowerAllocator(Allocator):
    """Minimum-power allocation of a torque, each current within its limit; the bearing carries the force rows.

    current_limit        (m,) maximum magnitude per channel [A]; 0 disables a channel
    infeasible           treatment of a torque beyond the limits: "scale" preserves its direction, "least-squares" gives
                         the nearest feasible torque
    resistance           (m,) [Ω], equal for all channels if not given: the heat is Σ R i²
    compensate_passive   subtract the torque at zero current (of a weight-compensating regulator)
    power                maximum power Σ R i² of the supply [W]; needs `resistance`. The currents of minimum heat are
                         scaled, which is the largest torque for that power unless some are at their limits

    Raises UnknownName for another `infeasible`, InputError for invalid limits or resistances.

    >>> from haptorb.devices.base import WrenchMap
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
        """Currents (m,) [A] for the torque in `wrench` (6,) [N, N·m]. Raises InputError if either is not finite."""
        limit = self.current_limit
        matrix, passive, asked = check_problem(wrench_map, wrench, limit.shape[0])
        currents = np.empty(limit.shape[0])
        residual = np.empty(6)
        status, scale, reason = _minimum_power_allocate(
            matrix, passive, asked, limit, self.resistance, self._compensated, self.power, self._nearest, currents,
            residual,
        )  # fmt: skip
        if status == NOT_FINITE:
            raise InputError(f"wrench and wrench map must be finite; got wrench {wrench!r}, map {wrench_map!r}")
        return Allocation(currents, residual, SATURATIONS[reason], scale)


# --------------------------------------------------------------------------------------------------
# Request and residual of a wrench: the part that the passive wrench leaves, and what is reported as missing.


_MISSING = 0.02  #: share of the commanded wrench that may be missing without being reported
_MIN_FADED = (1e-3, 1e-5)  #: force [N] and torque [N·m] below which a missing part is never reported


def check_greatest(greatest: tuple[float, float]) -> tuple[float, float]:
    """Check that the limits of force [N] and torque [N·m] in `greatest` are positive, or raise InputError."""
    if not (greatest[0] > 0.0 and greatest[1] > 0.0):
        raise InputError(f"the greatest force [N] and torque [N·m] must be above 0; got {greatest!r}")
    return greatest


@kernel
def subtract_passive(matrix: Array, passive: Array, wrench: Array, target: Array) -> bool:
    """Fill target (6,) with the active part of `wrench` (6,); return whether it and `matrix` (6, m) are finite."""
    total = 0.0
    for i in range(6):
        target[i] = wrench[i] - passive[i]
        total += target[i]
        for j in range(matrix.shape[1]):
            total += matrix[i, j]
    return bool(np.isfinite(total))


@kernel
def is_missing(residual: Array, wrench: Array, part: int) -> bool:
    """Whether residual (6,) contains more of the force (part 0) or torque (1) of `wrench` (6,) than the tolerance."""
    missing, asked = 0.0, 0.0
    for i in range(3 * part, 3 * part + 3):
        missing += residual[i] * residual[i]
        asked += wrench[i] * wrench[i]
    return bool(np.sqrt(missing) > max(_MISSING * np.sqrt(asked), _MIN_FADED[part]))


# --------------------------------------------------------------------------------------------------
# Allocation of torque on a tool, or of force and torque at once, with the limit that reduces it.
#
# A magnet over three coils can be turned about any axis but its own, and a torque is accompanied by a force: at contact
# about 54 N per newton metre. Force and torque at once are six components from three currents, hence a compromise:
# weighted least squares within the limits.
#
# 1 N is weighted like `TORQUE_ARM` × 1 N of torque, the ratio of just noticeable differences in fingers: 12.7 %
# of 60 mN·m (Jandura and Srinivasan 1994) is as hard to notice as 7 % of 2.5 N (Pang, Tan and Durlach 1991, their
# smallest force).


TORQUE_ARM = 0.127 * 60e-3 / (0.07 * 2.5)  #: 43.5 mm [m]

_WHOLE_WRENCH_CURRENT = int(Saturation.CURRENT)
_AXIS, _COILS = int(Saturation.AXIS), int(Saturation.COILS)
_TURNED = np.array((0.0, 0.0, 0.0, 1.0, 1.0, 1.0))
_TRUNCATION = 1e-6

_WHOLE_WRENCH_SETTINGS = fields(
    ("together", "?"),  # force and torque, not torque only
    ("arm", "f8"),  # [m]
    ("limits", WRENCH_LIMITS),
)


def check_arm(arm: float) -> float:
    """Check that `arm` [m] is a length of 1 mm to 10 m, or raise InputError.

    >>> check_arm(0.05)
    0.05
    """
    if isinstance(arm, bool) or not isinstance(arm, int | float) or not 1e-3 <= arm <= 10.0:
        raise InputError(f"torque arm must be a length from 1 mm to 10 m; got {arm!r} m")
    return float(arm)


@kernel
def _whole_wrench_allocate(
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
            reason = _WHOLE_WRENCH_CURRENT
    scale, reason = scale_to_limits(matrix, passive, target, resistance, s.limits, currents, residual, scale, reason)
    if reason == 0:
        for part in range(0 if s.together else 1, 2):
            if is_missing(residual, wrench, part):
                reason = _COILS if s.together else _AXIS
    return scale, reason


class WholeWrenchAllocator(Allocator):
    """Torque (`together` False) or force and torque within limits; the passive wrench counts as delivered.

    current_limit   (m,) maximum magnitude per channel [A]
    resistance      (m,) of the channels at their maximum temperature [Ω]
    power           maximum power Σ R i² of the supply [W]
    greatest        maximum force [N] and torque [N·m] on the mover; they also limit the accompanying part
    arm             1 N is weighted like `arm` [m] × 1 N of torque, if both are requested

    A torque beyond the limits keeps its direction, as forces do. Force and torque together are the nearest feasible
    wrench: no direction is preserved. Raises InputError for invalid values.

    >>> from haptorb.devices.api import wrench_map
    >>> from haptorb.devices.base import State
    >>> over = wrench_map("omni", State.at((0, 0, 0.05)))
    >>> torque = WholeWrenchAllocator((20.0,) * 3, (0.78,) * 3)
    >>> given = over.wrench(torque.allocate(over, (0, 0, 0, 0.005, 0, 0)).currents)
    >>> (given[3:].round(6) + 0.0).tolist(), given[1].round(2).item()
    ([0.005, 0.0, 0.0], 0.29)
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
        self._settings = np.zeros(1, dtype=_WHOLE_WRENCH_SETTINGS)
        self._settings["together"], self._settings["arm"] = together, check_arm(arm)
        self._settings["limits"] = (power, *check_greatest(greatest))

    def allocate(self, wrench_map: WrenchMap, wrench: ArrayLike) -> Allocation:
        """Currents (m,) [A] for `wrench` (6,) [N, N·m]. Raises InputError if either is not finite."""
        return solve_problem(
            _whole_wrench_allocate, self._settings, self.current_limit, self.resistance, wrench_map, wrench
        )


# --------------------------------------------------------------------------------------------------
# Selection of the rendered components of a world's wrench, with the allocator of each: by the user or by the world.


PART_NUMBERS: Final[dict[WrenchPart, int]] = {part: number for number, part in enumerate(PARTS)}  #: in recordings


@final
class WrenchChoice:
    """Allocators of a device that can render force, torque or both.

    Parameters
    ----------
    allocators : Mapping
        Allocator of each part: "force", "torque" and "wrench".
    arm : float
        Lever arm at which a hand resists rotation of the tool [m].
    fixed : str or None
        Part chosen by the user; None: the one that the world defines.
    weight : float
        Length at which 1 N of force weighs as much as the torque 1 N × `weight`, if both are requested [m].
    """

    def __init__(
        self, allocators: Mapping[WrenchPart, Allocator], arm: float, fixed: WrenchPart | None, weight: float
    ) -> None:
        self.allocators = dict(allocators)
        self.arm = arm
        self.fixed = fixed
        self.weight = weight

    def choose_part(self, world: World) -> WrenchPart:
        """Initial part for `world`: force for one that does not define it."""
        return self.fixed or world.asks or "force"

    def is_open(self, world: World) -> bool:
        """Whether the part is to be derived from the wrenches of `world`."""
        return self.fixed is None and world.asks is None


# --------------------------------------------------------------------------------------------------
# Allocators of the kinds of devices, built from a device's own limits.
#
# The supply's power limit is evaluated with windings at the stop temperature, the warmest that may carry current:
# cooler ones take less. It is the ohmic power in the coils; the power that builds up their field, watts for
# milliseconds, comes from the supply's capacitors.


def force_allocator(device: Device) -> Allocator:
    """Least squares for the force; the modelled passive wrench is compensated ("published": none).

    >>> from haptorb.devices.loader import load
    >>> type(force_allocator(load("omni"))).__name__
    'LeastSquaresAllocator'
    """
    coils = device.coils
    return LeastSquaresAllocator.force(
        coils.current_limit, compensate_passive=True, resistance=device.greatest_resistance, power=device.supply.power
    )


def arm_allocator(device: Arm) -> Allocator:
    """Least squares for the force of an arm, and for its torque where the orientation is actuated.

    >>> from haptorb.devices.loader import load
    >>> arm_allocator(load("arm")).current_limit.tolist()
    [10.0, 10.0, 10.0]
    """
    weights = (1.0,) * 6 if device.is_turned else FORCE
    return LeastSquaresAllocator(
        device.coils.current_limit, weights, resistance=device.greatest_resistance, power=device.supply.power
    )


def torque_allocator(device: Device) -> Allocator:
    """Minimum-power torque, with the passive torque compensated.

    >>> from haptorb.devices.loader import load
    >>> type(torque_allocator(load("pmsm"))).__name__
    'MinimumPowerAllocator'
    """
    return MinimumPowerAllocator(
        device.coils.current_limit, resistance=device.greatest_resistance, compensate_passive=True,
        power=device.supply.power,
    )  # fmt: skip


def tool_choice(
    device: SphericalElectromagnet, part: WrenchPart | None = None, arm: float | None = None
) -> WrenchChoice:
    """Force, torque and both on a tool over a dome; `part` fixes one of them, `arm` [m] weights torque against force.

    Raises InputError for an invalid arm.

    >>> from haptorb.devices.loader import load
    >>> choice = tool_choice(load("omni"))
    >>> sorted(choice.allocators), round(choice.arm, 4)
    (['both', 'force', 'torque'], 0.0316)
    """
    limits, weight = device.limits, TORQUE_ARM if arm is None else arm
    torque, both = (
        WholeWrenchAllocator(
            device.coils.current_limit, device.greatest_resistance, device.supply.power, together=together,
            greatest=(limits.force, limits.torque), arm=weight,
        )
        for together in (False, True)
    )  # fmt: skip
    hand = device.hand  # its rotational damping is the translational one at this arm
    held_at = (hand.turn_damping / hand.damping) ** 0.5 if hand.damping > 0.0 else 0.0
    return WrenchChoice({"force": force_allocator(device), "torque": torque, "both": both}, held_at, part, weight)


# --------------------------------------------------------------------------------------------------
# Notes for the user on the wrench components that a tool over a dome can render, with figures.


def part_remarks(device: SphericalElectromagnet, choice: WrenchChoice) -> tuple[str, ...]:
    """One or two sentences for each of `PARTS`, indexed by its number in recordings; empty where none is needed.

    The figures are those of two point dipoles at contact, T = µ0 m_e m_p/(4π d³) and F = 3T/d, because they are printed
    at the start, before tables and compiled code are available.

    >>> from haptorb.control.allocation import tool_choice
    >>> from haptorb.devices.loader import load
    >>> omni = load("omni")
    >>> part_remarks(omni, tool_choice(omni))[1].split(" across")[0]
    'Torque is rendered: as point dipoles at contact, up to about 8.4 mN·m'
    """
    d = device.contact_distance
    most = np.minimum(device.coils.current_limit, np.sqrt(device.supply.power / device.greatest_resistance))
    moment = float((np.linalg.norm(device.moment_per_current, axis=0) * most).max())
    torque = MU0 * moment * device.tool.moment / (4 * np.pi * d**3)
    axis = "There is no torque about the tool's own axis."
    texts = dict.fromkeys(PARTS, "")
    if choice.fixed == "force":
        texts["force"] = "Only force is rendered, as chosen: torque from the world is left out."
    texts["torque"] = (
        f"Torque is rendered: as point dipoles at contact, up to about {1e3 * torque:.2g} mN·m across the tool's axis, "
        f"together with a force of {3 * torque / d:.2g} N. {axis}"
    )
    texts["both"] = (
        f"Force and torque are rendered as a compromise of {device.channels} coils, which cannot produce six "
        f"independent components; errors of 1 N are weighted like {1e3 * choice.weight:.3g} mm × 1 N of torque. {axis}"
    )
    return tuple(texts[part] for part in PARTS)
