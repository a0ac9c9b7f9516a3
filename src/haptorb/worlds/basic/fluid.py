"""A viscous fluid that is stirred: Zárate 2020's second example, drag of the liquid on the tool."""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, sqrt
from typing import ClassVar

import numpy as np

from haptorb.devices.state import State
from haptorb.numerics.arrays import Array
from haptorb.worlds.parameter import parameter
from haptorb.worlds.world import World

__all__ = ["Fluid"]


@dataclass(frozen=True)
class Fluid(World):
    """Drag in a fluid that rotates about +z: F = −b (v − u(p)), limited to `greatest`.

    The current u is a Lamb–Oseen vortex: solid rotation near the axis, 1/ρ outside `core`. With `stir` zero the
    fluid is at rest and only damps; a current can move the tool, so the world is declared active.
    """

    asks = "force"
    passive: ClassVar[bool] = False

    viscosity: float = parameter(2.0, "N·s/m", 0, 10, "b: drag coefficient, for the speed relative to the fluid")
    stir: float = parameter(0.1, "m/s", -0.5, 0.5, "maximum speed of the fluid, counter-clockwise from above")
    core: float = parameter(0.02, "m", 0.005, 0.1, "radius at which the fluid is fastest")
    greatest: float = parameter(0.5, "N", 0.05, 1, "limit of the drag")

    @property
    def bound(self) -> float:
        """[N]"""
        return self.greatest

    def wrench(self, state: State) -> Array:
        """(6,) drag [N]."""
        px, py, _ = state.p.tolist()
        vx, vy, vz = state.v.tolist()
        rho = sqrt(px * px + py * py)
        if rho > 1e-9:
            # Lamb–Oseen: (1 − e^(−1.2564 ρ²/a²)) a/ρ is 0.7153 at its greatest, ρ = a
            s = rho / self.core
            u = self.stir / 0.71533 * (1 - exp(-1.25643 * s * s)) / s
            vx, vy = vx + u * py / rho, vy - u * px / rho
        speed = sqrt(vx * vx + vy * vy + vz * vz)
        drag = -self.viscosity
        if self.viscosity * speed > self.greatest:
            drag = -self.greatest / speed
        wrench = np.zeros(6)
        wrench[0], wrench[1], wrench[2] = drag * vx, drag * vy, drag * vz
        return wrench
