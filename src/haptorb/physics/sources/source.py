"""The abstract source of magnetic field: what every magnet and coil provides, whatever its shape."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import ArrayLike, NDArray

from haptorb.numerics.arrays import Array

__all__ = ["Source"]


class Source(ABC):
    """A body in its own frame: its centre at the origin, its axis along +z. Coils answer per ampere.

    A new shape is one file with one final class and its name in the list that the laws in `tests/laws` run over.
    """

    @abstractmethod
    def field(self, points: ArrayLike) -> Array:
        """Flux density (..., 3) [T] (coils: [T/A]) at `points` (..., 3) [m]."""

    @abstractmethod
    def field_gradient(self, points: ArrayLike) -> Array:
        """(..., 3, 3) [T/m] (coils: [T/m/A]), [i, j] = ∂B_i/∂x_j, at `points` (..., 3) [m]."""

    @property
    @abstractmethod
    def moment(self) -> Array:
        """(3,) magnetic moment [A·m²] (coils: per ampere)."""

    def contains(self, points: ArrayLike) -> NDArray[np.bool_]:
        """(...,) whether `points` (..., 3) [m] lie in the body's matter; a source without a volume has no inside."""
        return np.zeros(np.asarray(points).shape[:-1], dtype=bool)
