"""A wall: the reference object of every haptic paper."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np

from haptorb.devices.state import State
from haptorb.errors import InputError
from haptorb.numerics.arrays import Array
from haptorb.worlds.parameter import parameter
from haptorb.worlds.world import World

__all__ = ["Wall"]


@dataclass(frozen=True)
class Wall(World):
    """A stiff half-space: stiffness and damping along the normal, beyond `offset`.

    Damping acts only while the mover is in the wall and moves inward, so the wall never pulls.

    >>> Wall(normal=(0, 0, 1), offset=0.055, stiffness=100).wrench(State.at((0, 0, 0.052)))[2].round(3).item()
    0.3
    """

    asks = "force"

    normal: tuple[float, float, float] = parameter(
        (1.0, 0.0, 0.0), "", -1, 1, "direction of the outward normal of the wall"
    )
    offset: float = parameter(0.0, "m", -0.1, 0.1, "distance of the wall's face from the centre, along the normal")
    stiffness: float = parameter(150.0, "N/m", 0, 5000, "stiffness: force per depth")
    damping: float = parameter(0.5, "N·s/m", 0, 50, "damping: force per speed into the wall")
    greatest: float = parameter(1.0, "N", 0.05, 20, "limit of the force")

    def __post_init__(self) -> None:
        World.__post_init__(self)
        if not any(self.normal):
            raise InputError("Wall.normal must be a direction; got the zero vector")

    @property
    def bound(self) -> float:
        """[N]"""
        return self.greatest

    def wrench(self, state: State) -> Array:
        """(6,) push along the normal [N]."""
        x, y, z = self.normal
        length = sqrt(x * x + y * y + z * z)
        x, y, z = x / length, y / length, z / length
        px, py, pz = state.p.tolist()
        vx, vy, vz = state.v.tolist()
        wrench = np.zeros(6)
        depth = self.offset - (x * px + y * py + z * pz)
        if depth > 0.0:
            inward = -(x * vx + y * vy + z * vz)
            push = min(self.stiffness * depth + self.damping * max(inward, 0.0), self.greatest)
            wrench[0], wrench[1], wrench[2] = push * x, push * y, push * z
        return wrench
