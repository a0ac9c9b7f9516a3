"""From the wrench a world asks for to the currents that give it: what every allocator answers."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import ArrayLike

from haptorb.devices.wrench_map import WrenchMap
from haptorb.errors import InputError
from haptorb.numerics.arrays import Array, check_finite
from haptorb.numerics.record import record

__all__ = ["Allocation", "Allocator", "check_limit", "check_problem"]


@record
class Allocation:
    """Currents, and an honest account of what they do not give.

    currents   (m,) [A]
    residual   (6,) wrench asked for less wrench given [N, N·m]; the passive wrench counts as given
    saturated  a current stands at its limit
    scale      the one factor by which the wrench was cut to respect the limits; 1 where it was not
    """

    currents: Array
    residual: Array
    saturated: bool
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
        raise InputError(f"current_limit must not be negative: it bounds a magnitude; got {value!r}")
    return np.ascontiguousarray(limit)


def check_problem(wrench_map: WrenchMap, wrench: ArrayLike, channels: int) -> tuple[Array, Array, Array]:
    """Matrix (6, m), passive wrench (6,) and wrench (6,) as contiguous float64 arrays of the right shape.

    Finiteness is left to the kernels, which look at every number anyway.

    Raises InputError for a wrench or a map of another shape, or that is no number.

    The matrix is in [N/A, N·m/A], the wrenches in [N, N·m].
    """
    try:
        asked = np.ascontiguousarray(wrench, dtype=np.float64)
    except (TypeError, ValueError) as cause:
        raise InputError(f"wrench must be numbers; got {wrench!r}") from cause
    if asked.shape != (6,):
        raise InputError(f"wrench must be force then torque, shape (6,); got shape {asked.shape}")
    matrix = np.ascontiguousarray(wrench_map.matrix, dtype=np.float64)
    passive = np.ascontiguousarray(wrench_map.passive, dtype=np.float64)
    if matrix.shape != (6, channels):
        raise InputError(
            f"the wrench map must have shape (6, {channels}), one column per channel of current_limit; "
            f"got {matrix.shape}"
        )
    if passive.shape != (6,):
        raise InputError(f"the passive wrench must have shape (6,); got {passive.shape}")
    return matrix, passive, asked
