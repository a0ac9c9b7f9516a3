"""Detents: clicks as the tool tilts away from an axis."""

from __future__ import annotations

from dataclasses import dataclass
from math import acos, pi, radians, sin, sqrt

import numpy as np

from haptorb.devices.state import State
from haptorb.errors import InputError
from haptorb.numerics.arrays import Array
from haptorb.worlds.parameter import parameter
from haptorb.worlds.world import World

__all__ = ["Detents"]


@dataclass(frozen=True)
class Detents(World):
    """Clicks every `spacing_deg` of tilt from the axis.

    The gradient of U = −E cos(nθ) with n clicks a turn: F = −(E n/d) sin(nθ) e_θ, `strength` where d = 50 mm.

    >>> bool(abs(Detents().wrench(State.at((0, 0, 0.05)))).max() == 0)
    True
    """

    asks = "force"

    axis: tuple[float, float, float] = parameter((0.0, 0.0, 1.0), "", -1, 1, "direction of zero tilt")
    spacing_deg: float = parameter(10.0, "deg", 2, 60, "tilt between two clicks")
    strength: float = parameter(0.2, "N", 0, 1, "maximum force, halfway up each side of a click")

    def __post_init__(self) -> None:
        World.__post_init__(self)
        if not any(self.axis):
            raise InputError("Detents.axis must be a direction; got the zero vector")

    @property
    def bound(self) -> float:
        """[N] for a tool that stays at least 10 mm from the centre."""
        return 5 * self.strength

    def wrench(self, state: State) -> Array:
        """(6,) tangential force towards the nearest ring [N]."""
        wrench = np.zeros(6)
        px, py, pz = state.p.tolist()
        d = sqrt(px * px + py * py + pz * pz)
        ax, ay, az = self.axis
        length = sqrt(ax * ax + ay * ay + az * az)
        if d == 0.0:
            return wrench
        c = (px * ax + py * ay + pz * az) / (d * length)
        theta = acos(min(1.0, max(-1.0, c)))
        tx, ty, tz = c * px / d - ax / length, c * py / d - ay / length, c * pz / d - az / length
        t = sqrt(tx * tx + ty * ty + tz * tz)  # sin θ: no direction at the poles
        if t < 1e-9:
            return wrench
        n = 2 * pi / radians(self.spacing_deg)
        push = -self.strength * (0.05 / d) * sin(n * theta) / t
        wrench[0], wrench[1], wrench[2] = push * tx, push * ty, push * tz
        return wrench
