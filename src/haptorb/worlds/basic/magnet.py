"""A point that attracts the tool nearby, and not far away."""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, sqrt

import numpy as np

from haptorb.devices.state import State
from haptorb.numerics.arrays import Array
from haptorb.worlds.parameter import parameter
from haptorb.worlds.world import World

__all__ = ["Magnet"]

_PEAK = exp(-0.5)  #: of r/s e^(−r²/2s²), at r = s


@dataclass(frozen=True)
class Magnet(World):
    """Attraction to a point: the gradient of U = −E e^(−r²/2s²), maximum force `strength` at distance `width`.

    >>> bool(Magnet(place=(0, 0, 0.05)).wrench(State.at((0.01, 0, 0.05)))[0] < 0)
    True
    """

    asks = "force"

    place: tuple[float, float, float] = parameter((0.0, 0.0, 0.05), "m", -0.1, 0.1, "position of the point")
    width: float = parameter(0.01, "m", 0.001, 0.05, "distance of the maximum pull")
    strength: float = parameter(0.25, "N", -1, 1, "maximum force; negative pushes away")

    @property
    def bound(self) -> float:
        """[N]"""
        return abs(self.strength)

    def wrench(self, state: State) -> Array:
        """(6,) pull towards the point [N]."""
        px, py, pz = state.p.tolist()
        x, y, z = px - self.place[0], py - self.place[1], pz - self.place[2]
        r = sqrt(x * x + y * y + z * z) / self.width
        pull = -self.strength / (self.width * _PEAK) * exp(-0.5 * r * r)
        wrench = np.zeros(6)
        wrench[0], wrench[1], wrench[2] = pull * x, pull * y, pull * z
        return wrench
