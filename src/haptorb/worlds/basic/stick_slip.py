"""Dry friction with breakaway, without memory."""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, sqrt, tanh

import numpy as np

from haptorb.devices.state import State
from haptorb.numerics.arrays import Array
from haptorb.worlds.parameter import parameter
from haptorb.worlds.world import World

__all__ = ["StickSlip"]


@dataclass(frozen=True)
class StickSlip(World):
    """Stribeck friction against the velocity: F = −(F_c + (F_s − F_c) e^(−(v/v_s)²)) tanh(v/v_0) v̂.

    A force that decreases with speed is what makes fingers and bows stick and slip. It always opposes the motion,
    so it is passive; it has no memory, so below v_0 it creeps instead of sticking. Source: Armstrong-Hélouvry et al.
    1994, section 2.
    """

    asks = "force"

    sliding: float = parameter(0.1, "N", 0, 0.5, "F_c: friction while sliding fast")
    breakaway: float = parameter(0.25, "N", 0, 1, "F_s: friction at the start of sliding")
    fading: float = parameter(0.03, "m/s", 0.001, 0.5, "v_s: speed over which breakaway fades to sliding")
    creep: float = parameter(0.005, "m/s", 0.001, 0.1, "v_0: speed below which the friction rounds off")

    @property
    def bound(self) -> float:
        """[N]"""
        return max(self.sliding, self.breakaway)

    def wrench(self, state: State) -> Array:
        """(6,) force against the velocity [N]."""
        x, y, z = state.v.tolist()
        v = sqrt(x * x + y * y + z * z)
        wrench = np.zeros(6)
        if v > 0.0:
            level = self.sliding + (self.breakaway - self.sliding) * exp(-((v / self.fading) ** 2))
            brake = -level * tanh(v / self.creep) / v
            wrench[0], wrench[1], wrench[2] = brake * x, brake * y, brake * z
        return wrench
