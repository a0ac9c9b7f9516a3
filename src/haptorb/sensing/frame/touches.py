"""What a tracker said while a person touched the device with the tool: poses of its rigid body, in its own frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from haptorb.errors import CalibrationError
from haptorb.numerics.arrays import Array, check_finite

__all__ = ["TouchSession", "Touches"]

_UNIT = 0.1  #: a quaternion's length may be off 1 by this


@final
@dataclass(frozen=True)
class Touches:
    """Poses of the body.

    p  (n, 3) where its origin was, tracker frame [m]
    q  (n, 4) unit quaternions (x, y, z, w) that turn the body's vectors into the tracker's
    """

    p: Array
    q: Array

    @classmethod
    def of(cls, p: ArrayLike, q: ArrayLike, what: str) -> Touches:
        """With the quaternions' lengths made one.

        Raises InputError for other shapes or what is not finite, CalibrationError for what is no rotation.
        """
        places, turns = check_finite(p, f"{what}: positions"), check_finite(q, f"{what}: quaternions")
        places, turns = places.reshape(-1, 3), turns.reshape(len(places), 4)
        length = np.linalg.norm(turns, axis=1)
        if (np.abs(length - 1.0) > _UNIT).any():
            worst = float(length[np.argmax(np.abs(length - 1.0))])
            raise CalibrationError(
                f"{what}: the tracker's quaternions must have length 1; one has {worst:.3g}. Angles or a matrix must "
                "be sent as a quaternion x y z w"
            )
        return cls(places, turns / length[:, None])

    def __len__(self) -> int:
        return len(self.p)

    @cached_property
    def R(self) -> Array:
        """(n, 3, 3) turns the body's vectors into the tracker's."""
        x, y, z, w = self.q.T
        rows = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
        return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)

    def point(self, at: Array) -> Array:
        """(n, 3) [m] where the body's point `at` (3,) [m] was, tracker frame."""
        places: Array = self.p + self.R @ at
        return places

    def select(self, which: Array) -> Touches:
        """Those of which `which` (n,) is true."""
        return Touches(self.p[which], self.q[which])


@final
@dataclass(frozen=True)
class TouchSession:
    """A whole session.

    dome   the tip anywhere on the dome, the tool tilted in all directions; it may have been lifted now and then
    marks  by mark: the tip in it, the tool tilted to all sides
    roll   the tool turned about its own axis, which was at rest
    """

    dome: Touches
    marks: Mapping[str, Touches]
    roll: Touches
