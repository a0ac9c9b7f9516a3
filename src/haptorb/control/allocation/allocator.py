"""From the wrench a world asks for to the currents that give it: what every allocator answers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from enum import IntEnum

import numpy as np
from numpy import ascontiguousarray
from numpy.typing import ArrayLike

from haptorb.devices.wrench_map import WrenchMap
from haptorb.errors import InputError
from haptorb.numerics.arrays import Array, Records, check_finite
from haptorb.numerics.record import record

__all__ = [
    "SATURATIONS",
    "Allocation",
    "Allocator",
    "Saturation",
    "check_limit",
    "check_power",
    "check_problem",
    "solve_problem",
]


class Saturation(IntEnum):
    """Which limit holds a wrench back; the numbers stand in recordings and never change."""

    NONE = 0
    CURRENT = 1  #: a coil's current limit
    POWER = 2  #: the supply's power limit
    ALONG = 3  #: the guard's limit of the accompanying force or torque
    AXIS = 4  #: no current turns a tool about its magnet's own axis
    COILS = 5  #: too few coils for force and torque at once: a compromise

    @property
    def text(self) -> str:
        """What holds it back, in words; empty for none.

        >>> Saturation.POWER.text
        "the supply's power limit"
        """
        return _TEXTS[self]

    @property
    def is_limit(self) -> bool:
        """Whether more of the same would be given if a limit were higher.

        >>> Saturation.CURRENT.is_limit, Saturation.COILS.is_limit
        (True, False)
        """
        return self in (Saturation.CURRENT, Saturation.POWER, Saturation.ALONG)


_TEXTS = (
    "",
    "a coil's current limit",
    "the supply's power limit",
    "the limit of the accompanying force",
    "the magnet's own axis, about which there is no torque",
    "the number of coils, too few for force and torque together",
)
SATURATIONS = tuple(Saturation)  #: by number: many times faster than a call of the class
_FLOAT = np.dtype(np.float64)  #: to name the type takes longer than to see that an array has it


@record
class Allocation:
    """Currents, and an honest account of what they do not give.

    currents   (m,) [A]
    residual   (6,) wrench asked for less wrench given [N, N·m]; the passive wrench counts as given
    saturated  what holds it back: the limit at which a current stands, or what no current gives; false for nothing
    scale      the one factor by which the wrench was cut to respect the limits; 1 where it was not cut by one factor
    """

    currents: Array
    residual: Array
    saturated: Saturation
    scale: float


class Allocator(ABC):
    """Chooses currents for a wrench. One final class per way of choosing; none remembers anything."""

    @abstractmethod
    def allocate(self, wrench_map: WrenchMap, wrench: ArrayLike) -> Allocation:
        """Currents (m,) [A] for `wrench` (6,) [N, N·m] at the pose of `wrench_map`.

        Raises InputError if shapes do not fit or a number is not finite.
        """


def check_limit(value: ArrayLike) -> Array:
    """(m,) current limits [A], or InputError: they are magnitudes, one per channel; zero turns a channel off.

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
    """(m,) resistances [Ω] for the heat Σ R i², all alike where None are given, and a `power` [W] that can limit it.

    Raises InputError for another shape, for what is not positive, and for a power without resistances.
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
    """Matrix (6, m), passive wrench (6,) and wrench (6,) as contiguous float64 arrays of the right shape.

    Finiteness is left to the kernels, which look at every number anyway.

    Raises InputError for a wrench or a map of another shape, or that is no number.

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
    """The allocation that the kernel `solve` finds with `settings`, current limits (m,) [A] and resistances (m,) [Ω].

    `solve` fills currents (m,) [A] and residual (6,) [N, N·m]; it returns the scale, NaN for what is not finite, and
    the number of the saturation.

    Raises InputError for a wrench (6,) [N, N·m] or a map of another shape, or where either is not finite.
    """
    matrix, passive, asked = check_problem(wrench_map, wrench, limit.shape[0])
    currents, residual = np.empty(limit.shape[0]), np.empty(6)
    scale, reason = solve(settings, matrix, passive, asked, limit, resistance, currents, residual)
    if scale != scale:
        raise InputError(f"wrench and wrench map must be finite; got wrench {wrench!r}, map {wrench_map!r}")
    return Allocation(currents, residual, SATURATIONS[reason], scale)
