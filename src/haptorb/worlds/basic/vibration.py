"""A vibration: a force that oscillates in time, at any position."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, sin
from typing import ClassVar

import numpy as np

from haptorb.devices.state import State
from haptorb.numerics.arrays import Array
from haptorb.worlds.parameter import parameter
from haptorb.worlds.world import World

__all__ = ["Vibration"]


@dataclass(frozen=True)
class Vibration(World):
    """Sinusoidal radial force F = a sin(2π f t) along the direction from the centre. Active: it can produce energy."""

    asks = "force"
    passive: ClassVar[bool] = False

    frequency: float = parameter(40.0, "Hz", 1, 250, "frequency of the force; the loop must run several times faster")
    amplitude: float = parameter(0.15, "N", 0, 0.5, "amplitude of the force")

    @property
    def bound(self) -> float:
        """[N]"""
        return self.amplitude

    def wrench(self, state: State) -> Array:
        """(6,) radial force at the state's time [N]."""
        wrench = np.zeros(6)
        d = state.distance
        if d > 0.0:
            wrench[:3] = self.amplitude * sin(2 * pi * self.frequency * state.t) / d * state.p
        return wrench
