"""The pose or path at which a program wants the hand, checked before the loop receives it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias, final

import numpy as np
from numpy.typing import ArrayLike

from haptorb.display.quantity_text import format_number
from haptorb.errors import InputError, quote
from haptorb.numerics.arrays import Array
from haptorb.runtime.pointer.guided_motion import upright_quaternion

__all__ = ["FARTHEST", "HandPose", "PathFunction", "SampledPath", "check_pose", "split_pose"]

FARTHEST = 1.0  #: distance from the device's centre at which no tool can be meant [m]

#: (3,) place [m] and (4,) quaternion (x, y, z, w)
HandPose: TypeAlias = tuple[Array, Array]
#: a path that a program computes: a pose from the time [s] since it began
PathFunction: TypeAlias = Callable[[float], Any]


def check_pose(
    p: ArrayLike, q: ArrayLike | None = None, farthest: float = FARTHEST, *, upright: bool = False
) -> HandPose:
    """(3,) `p` [m] and (4,) `q` as a quaternion of length 1; None: the tool's axis radial, or `upright`.

    Raises InputError for another shape, a number that is not finite, a place farther than `farthest` [m] from the
    device's centre, or a quaternion of zeros.
    """
    position = _check_numbers(p, 3, "p must be the position of the tool's magnet, 3 finite numbers [m]")
    distance = float(np.linalg.norm(position))
    if distance > farthest:
        raise InputError(
            f"p must be within {farthest:g} m of the device's centre; got {quote(p)}, {format_number(distance)} m from "
            "it. It is in metres: 50 mm are 0.05"
        )
    if q is None:
        return position, np.array([0.0, 0.0, 0.0, 1.0]) if upright else upright_quaternion(position)
    wanted = "q must be a quaternion (x, y, z, w), 4 finite numbers that are not all zero"
    turn = _check_numbers(q, 4, wanted)
    length = float(np.linalg.norm(turn))
    if length < 1e-6:
        raise InputError(f"{wanted}; got {quote(q)}. Leave it out for a radial axis")
    return position, turn / length


def split_pose(pose: Any) -> tuple[Any, Any]:
    """A place and a quaternion or None, from a place (3,) [m], a pair (place, quaternion), or both in one row (7,).

    >>> split_pose((0.0, 0.0, 0.05))
    ((0.0, 0.0, 0.05), None)
    >>> split_pose(np.arange(7.0))[1]
    array([3., 4., 5., 6.])
    """
    if isinstance(pose, tuple) and len(pose) == 2:
        return pose
    if isinstance(pose, np.ndarray | list | tuple) and len(pose) == 7:
        return pose[:3], pose[3:]
    return pose, None


@final
class SampledPath:
    """Poses at times, straight lines between them, and the last one from its time on.

    poses   (n, 3) places [m], or (n, 7) places and quaternions (x, y, z, w)
    times   (n,) when the hand is there [s] after the start, each later than the one before
    farthest   from the device's centre [m]
    upright    whether a place alone means an upright tool, not a radial one

    >>> path = SampledPath([(0, 0, 0.05), (0, 0, 0.06)], [0.0, 1.0])
    >>> path(0.5)[0].round(3).tolist(), path(9.0)[0].tolist()
    ([0.0, 0.0, 0.055], [0.0, 0.0, 0.06])
    """

    def __init__(
        self, poses: ArrayLike, times: ArrayLike, farthest: float = FARTHEST, *, upright: bool = False
    ) -> None:
        """Raises InputError for other shapes, times that do not grow, and poses as `check_pose` does."""
        rows = _check_numbers(poses, None, "path must be poses (n, 3) or (n, 7), finite numbers [m]")
        if rows.ndim != 2 or rows.shape[1] not in (3, 7) or not len(rows):
            raise InputError(
                f"path must be poses (n, 3), or (n, 7) with quaternions, or a function of time [s] that returns one; "
                f"got shape {rows.shape}"
            )
        self._times = _check_numbers(times, len(rows), f"times must be {len(rows)} numbers [s], one for each pose")
        if not (np.diff(self._times) > 0).all() or self._times[0] < 0:
            raise InputError(f"times must increase from pose to pose and begin at 0 s or later; got {quote(times)}")
        checked = []
        for number, row in enumerate(rows):
            try:
                checked.append(check_pose(*split_pose(row), farthest, upright=upright))
            except InputError as cause:
                raise InputError(f"pose {number} of the path: {cause}") from cause
        self._places = np.array([place for place, _ in checked])
        self._turns = np.array([turn for _, turn in checked])
        for before, turn in zip(self._turns, self._turns[1:], strict=False):
            if before @ turn < 0.0:  # the same turn, but the short way to it
                turn *= -1.0

    def __call__(self, t: float) -> HandPose:
        """(3,) place [m] and (4,) quaternion `t` [s] after the start."""
        place = np.array([np.interp(t, self._times, column) for column in self._places.T])
        turn = np.array([np.interp(t, self._times, column) for column in self._turns.T])
        length = float(np.linalg.norm(turn))
        return place, turn / length if length > 1e-6 else upright_quaternion(place)


def _check_numbers(value: ArrayLike, count: int | None, wanted: str) -> Array:
    """`value` as finite numbers; `count` of them in a row, None: any shape."""
    try:
        numbers = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as cause:
        raise InputError(f"{wanted}; got {quote(value)}") from cause
    if not np.isfinite(numbers).all() or (count is not None and numbers.shape != (count,)):
        raise InputError(f"{wanted}; got {quote(value)}")
    return numbers
