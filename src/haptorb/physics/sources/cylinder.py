"""A full round magnet, magnetized uniformly along its axis: exact field inside and outside."""

from __future__ import annotations

from typing import final

import numpy as np
from numpy.typing import ArrayLike

from haptorb.numerics.arrays import Array, check_finite
from haptorb.physics.sources import round_body
from haptorb.physics.sources.dipole import MU0
from haptorb.physics.sources.round_body import RoundBody, SheetStack

__all__ = ["CylinderMagnet"]


@final
class CylinderMagnet(RoundBody):
    """Cylinder of `radius` [m] and `length` [m] with `polarization` J = μ0M [T] along +z (negative: along −z).

    Flux density by Callaghan & Maslen 1960 / Derby & Olbert 2010 (see `current_sheet`), relative error below 1e-12 of
    the local field except within a few rounding steps of the edges, where it grows without limit as ln(distance).
    B is defined inside too (it is what a thin slot across the axis would hold); H = (B − J)/μ0 there, and a force on a
    part of the magnet itself, are not given. On the side wall B_z jumps by J and the mean is returned. Left out:
    the magnet's own permeability (recoil about 1.05) and demagnetization.

    >>> magnet = CylinderMagnet(radius=0.01, length=0.02, polarization=1.0)
    >>> float(magnet.field((0, 0, 0))[2].round(12))     # J h/√(h² + a²)
    0.707106781187
    """

    inner_radius = 0.0

    def __init__(self, radius: float, length: float, polarization: float) -> None:
        self.outer_radius = round_body.length(radius, "radius")
        self.length = round_body.length(length, "length")
        self.polarization = float(check_finite(polarization, "polarization"))
        self._sheets = SheetStack([self.outer_radius], 0.5 * self.length, [self.polarization])

    def __repr__(self) -> str:
        return f"CylinderMagnet(radius={self.radius}, length={self.length}, polarization={self.polarization})"

    @property
    def radius(self) -> float:
        """[m]."""
        return self.outer_radius

    @property
    def moment(self) -> Array:
        """(3,) [A·m²]: M times the volume."""
        return np.array([0.0, 0.0, self.polarization / MU0 * np.pi * self.radius**2 * self.length])

    def field(self, points: ArrayLike) -> Array:
        """Flux density (..., 3) [T] at `points` (..., 3) [m]; GeometryError on an edge."""
        return self._sheets.field(points)

    def field_gradient(self, points: ArrayLike) -> Array:
        """(..., 3, 3) [T/m], [i, j] = ∂B_i/∂x_j; not defined on the side wall."""
        return self._sheets.field_gradient(points)

    def filaments(self, across: int, along: int) -> tuple[Array, Array, Array]:
        """The bound current M on the side wall as `along` loops: radii [m], heights [m], currents [A]."""
        nodes, weights = np.polynomial.legendre.leggauss(along)
        currents = self.polarization / MU0 * 0.5 * self.length * weights
        return np.full(along, self.radius), 0.5 * self.length * nodes, currents
