"""The hand's motion while the pointer is not held: a path for each kind of device, and the way back to its end."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import final

import numpy as np

from haptorb.devices.device import Device
from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel
from haptorb.runtime.pointer.guided_motion import DURATION, position_on_path, upright_quaternion

__all__ = ["AtRest", "DomeMotion", "GuidedMotion", "dome_guide"]


class GuidedMotion(ABC):
    """A motion that begins at time zero and rests after `duration` [s]; a pure function of time."""

    duration: float

    @abstractmethod
    def at(self, t: float) -> tuple[Array, Array]:
        """(3,) position [m] and (4,) quaternion (x, y, z, w) at time `t` [s]."""

    @abstractmethod
    def pose_on_return(self, p: Array, q: Array, share: float) -> tuple[Array, Array]:
        """(3,) position [m] and (4,) quaternion on the way to rest from where a hand released it, `p` (3,) [m] and `q`
        (4,); `share` of the way runs from 0 to 1."""


@final
class DomeMotion(GuidedMotion):
    """A stylus slides over the dome and circles its summit: see `guide_calibration`."""

    duration = DURATION

    def __init__(self) -> None:
        self._rest = position_on_path(DURATION)
        self.pose_on_return(
            self._rest, upright_quaternion(self._rest), 1.0
        )  # compiled now, not when a hand releases it

    def at(self, t: float) -> tuple[Array, Array]:
        """(3,) the tool's magnet [m] and (4,) its turn as a quaternion (x, y, z, w), axis radial."""
        p = position_on_path(t)
        return p, upright_quaternion(p)

    def pose_on_return(self, p: Array, q: Array, share: float) -> tuple[Array, Array]:
        """(3,) position [m] on the way from `p` (3,) [m] along the sphere, not through the device, and (4,) quaternion.

        The axis is radial all the way, however it was released: `q` (4,) is ignored.
        """
        place = np.empty(3)
        _fill_arc(np.ascontiguousarray(p), self._rest, share, place)
        return place, upright_quaternion(place)


@kernel
def _fill_arc(start: Array, rest: Array, s: float, p: Array) -> None:
    r0 = np.sqrt(start[0] ** 2 + start[1] ** 2 + start[2] ** 2)
    r1 = np.sqrt(rest[0] ** 2 + rest[1] ** 2 + rest[2] ** 2)
    for i in range(3):
        p[i] = rest[i] / r1
        if r0 >= 1e-6:  # a hand inside the device has no direction; from there it goes straight
            p[i] = (1.0 - s) * start[i] / r0 + s * p[i]
    length = np.sqrt(p[0] ** 2 + p[1] ** 2 + p[2] ** 2)
    if length < 1e-6:  # exactly opposite: no way is the shortest
        for i in range(3):
            p[i] = rest[i] / r1
        length = 1.0
    for i in range(3):
        p[i] *= ((1.0 - s) * r0 + s * r1) / length


def dome_guide(device: Device) -> DomeMotion:
    """The guided motion over a dome; every dome's is the same."""
    return DomeMotion()


@final
class AtRest(GuidedMotion):
    """A hand that holds the mover where it rests: for devices of which no better motion is known."""

    duration = 0.0

    def __init__(self, device: Device) -> None:
        self._rest = np.array(device.rest_position, dtype=np.float64)
        self._upright = np.array([0.0, 0.0, 0.0, 1.0])

    def at(self, t: float) -> tuple[Array, Array]:
        """Always the same: (3,) the device's place of rest [m], and (4,) no turn."""
        return self._rest, self._upright

    def pose_on_return(self, p: Array, q: Array, share: float) -> tuple[Array, Array]:
        """From `p` (3,) [m] straight back, and from `q` (4,) the short way, (3,) and (4,)."""
        upright = self._upright if q[3] >= 0.0 else -self._upright
        turned = (1.0 - share) * q + share * upright
        length = float(turned @ turned) ** 0.5
        return (1.0 - share) * p + share * self._rest, turned / length if length > 1e-9 else self._upright
