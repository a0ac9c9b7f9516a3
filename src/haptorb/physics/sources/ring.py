"""A ring magnet (a cylinder with a round hole), magnetized uniformly along its axis: exact field everywhere."""

from __future__ import annotations

from typing import final

import numpy as np
from numpy.typing import ArrayLike

from haptorb.errors import InputError
from haptorb.numerics.arrays import Array, check_finite
from haptorb.physics.sources import round_body
from haptorb.physics.sources.dipole import MU0
from haptorb.physics.sources.round_body import RoundBody, SheetStack

__all__ = ["RingMagnet"]


@final
class RingMagnet(RoundBody):
    """Ring between `inner_radius` and `outer_radius` [m], of `length` [m], with `polarization` J = μ0M [T] along +z.

    The difference of two cylinders' closed forms (see `current_sheet`). B is defined in the matter, in the hole and
    outside; on the two side walls B_z jumps by J and the mean is returned. Left out: the magnet's permeability.

    Raises InputError for radii or a length that make no ring.

    >>> ring = RingMagnet(outer_radius=0.006, inner_radius=0.0025, length=0.024, polarization=1.348)
    >>> round(float(ring.moment[2]), 3)
    2.406
    """

    def __init__(self, outer_radius: float, inner_radius: float, length: float, polarization: float) -> None:
        self.outer_radius = round_body.length(outer_radius, "outer_radius")
        self.inner_radius = round_body.length(inner_radius, "inner_radius")
        if self.inner_radius >= self.outer_radius:
            raise InputError(
                f"inner_radius must be below outer_radius; got {self.inner_radius} m and {self.outer_radius} m"
            )
        self.length = round_body.length(length, "length")
        self.polarization = float(check_finite(polarization, "polarization"))
        walls = [self.outer_radius, self.inner_radius]
        self._sheets = SheetStack(walls, 0.5 * self.length, [self.polarization, -self.polarization])

    def __repr__(self) -> str:
        return (
            f"RingMagnet(outer_radius={self.outer_radius}, inner_radius={self.inner_radius}, "
            f"length={self.length}, polarization={self.polarization})"
        )

    @property
    def moment(self) -> Array:
        """(3,) [A·m²]: M times the volume."""
        area = np.pi * (self.outer_radius**2 - self.inner_radius**2)
        return np.array([0.0, 0.0, self.polarization / MU0 * area * self.length])

    def field(self, points: ArrayLike) -> Array:
        """Flux density (..., 3) [T] at `points` (..., 3) [m]; GeometryError on an edge."""
        return self._sheets.field(points)

    def field_gradient(self, points: ArrayLike) -> Array:
        """(..., 3, 3) [T/m], [i, j] = ∂B_i/∂x_j; not defined on the side walls."""
        return self._sheets.field_gradient(points)

    def filaments(self, across: int, along: int) -> tuple[Array, Array, Array]:
        """The bound currents ±M on both side walls as `along` loops each: radii [m], heights [m], currents [A].

        Three arrays (loops,).
        """
        nodes, weights = np.polynomial.legendre.leggauss(along)
        currents = self.polarization / MU0 * 0.5 * self.length * weights
        radii = np.repeat([self.outer_radius, self.inner_radius], along)
        return radii, np.tile(0.5 * self.length * nodes, 2), np.concatenate([currents, -currents])
