"""A rough surface: bumps in space, felt during motion."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, pi

import numpy as np

from haptorb.devices.state import State
from haptorb.numerics.arrays import Array
from haptorb.worlds.parameter import parameter
from haptorb.worlds.world import World

__all__ = ["Texture"]


@dataclass(frozen=True)
class Texture(World):
    """Periodic bumps, fixed in space: the gradient of U = (a λ/2π) Σ sin(2π x_i/λ), F_i = −a cos(2π x_i/λ)."""

    asks = "force"

    wavelength: float = parameter(0.006, "m", 0.001, 0.05, "distance between two bumps")
    amplitude: float = parameter(0.12, "N", 0, 0.5, "maximum force along each axis")

    @property
    def bound(self) -> float:
        """[N]"""
        return 3**0.5 * self.amplitude

    def wrench(self, state: State) -> Array:
        """(6,) force of the bumps [N]."""
        k, a = 2 * pi / self.wavelength, self.amplitude
        x, y, z = state.p.tolist()
        wrench = np.zeros(6)
        wrench[0], wrench[1], wrench[2] = -a * cos(k * x), -a * cos(k * y), -a * cos(k * z)
        return wrench
