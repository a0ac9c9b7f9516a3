"""Coils around a soft core, from their sizes: what an ampere makes before anybody has calibrated it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from haptorb.numerics.arrays import Array
from haptorb.physics.sources.coil import Coil
from haptorb.physics.sources.soft_sphere import SoftSphere

__all__ = ["Windings"]


@final
@dataclass(frozen=True)
class Windings:
    """Round coils about the core's centre, the first about x, the second about y, the third about z."""

    turns: Array  #: (3,)
    inner_radius: Array  #: (3,) [m]
    outer_radius: Array  #: (3,) [m]
    length: Array  #: (3,) along each coil's own axis [m]

    @property
    def coils(self) -> tuple[Coil, ...]:
        """Each coil, its axis along its own +z."""
        sizes = zip(self.turns, self.inner_radius, self.outer_radius, self.length, strict=True)
        return tuple(Coil(*map(float, size)) for size in sizes)

    def parts(self, core: SoftSphere) -> Array:
        """(3, 2) [m²] moment per ampere along its own axis: of the winding itself, and of the core that it magnetises.

        The core's part is exact: its moment follows from the field at its centre alone (`SoftSphere.moment_in`).
        """
        origin = np.zeros((1, 3))
        return np.array([(coil.moment[2], core.moment_in(coil.field(origin)[0])[2]) for coil in self.coils])

    def moment_per_current(self, core: SoftSphere) -> Array:
        """(3, 3) [m²] m_e per ampere; diagonal, as the coils are taken to stand square on each other."""
        return np.diag(self.parts(core).sum(axis=1))
