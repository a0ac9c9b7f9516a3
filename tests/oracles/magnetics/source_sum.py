"""Sum of several sources, such as a rotor's magnets, without tables."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from haptorb.arrays import Array, vectors
from haptorb.magnetics.source import Source

__all__ = ["SourceSum"]


@final
class SourceSum(Source):
    """Several sources at once: fields and moments add (there is no soft iron here)."""

    def __init__(self, sources: Sequence[Source]) -> None:
        self.sources = tuple(sources)

    @property
    def moment(self) -> Array:
        """(3,) [A·m²], the sum."""
        total = np.zeros(3)
        for source in self.sources:
            total += source.moment
        return total

    def field(self, points: ArrayLike) -> Array:
        """Flux density (..., 3) [T] at `points` (..., 3) [m], the sum."""
        total = np.zeros_like(vectors(points, "points"))
        for source in self.sources:
            total += source.field(points)
        return total

    def field_gradient(self, points: ArrayLike) -> Array:
        """(..., 3, 3) [T/m], [i, j] = ∂B_i/∂x_j, the sum."""
        at = vectors(points, "points")
        total = np.zeros((*at.shape, 3))
        for source in self.sources:
            total += source.field_gradient(at)
        return total

    def contains(self, points: ArrayLike) -> NDArray[np.bool_]:
        """(...,) whether `points` (..., 3) [m] lie in the matter of any of them."""
        inside = np.zeros(np.asarray(points).shape[:-1], dtype=bool)
        for source in self.sources:
            inside |= source.contains(points)
        return inside
