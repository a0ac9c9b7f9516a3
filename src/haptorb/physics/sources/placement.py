"""Sources put somewhere, and put together: both are sources again."""

from __future__ import annotations

from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from haptorb.errors import InputError
from haptorb.numerics.arrays import Array, rotation, vectors
from haptorb.physics.sources.source import Source

__all__ = ["PlacedSource"]


@final
class PlacedSource(Source):
    """`source` with its centre at `position` (3,) [m], turned by `turn` (3, 3) (body vectors to common ones).

    Raises InputError for other shapes.

    >>> from haptorb.physics.sources.dipole import Dipole
    >>> turned = PlacedSource(Dipole((0, 0, 1.0)), (0, 0, 0.1), [[0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    >>> turned.moment.tolist()
    [1.0, 0.0, 0.0]
    """

    def __init__(self, source: Source, position: ArrayLike, turn: ArrayLike) -> None:
        self.source = source
        self.position = vectors(position, "position")
        self.turn = rotation(turn, "turn")
        if self.position.shape != (3,) or self.turn.shape != (3, 3):
            raise InputError(f"one place needs shapes (3,) and (3, 3); got {self.position.shape}, {self.turn.shape}")

    @property
    def moment(self) -> Array:
        """(3,) [A·m²] in the common frame."""
        moment: Array = self.turn @ self.source.moment
        return moment

    def field(self, points: ArrayLike) -> Array:
        """Flux density (..., 3) [T] at `points` (..., 3) [m], both in the common frame."""
        field: Array = self.source.field(self._to_own_frame(points)) @ self.turn.T
        return field

    def field_gradient(self, points: ArrayLike) -> Array:
        """(..., 3, 3) [T/m], [i, j] = ∂B_i/∂x_j, in the common frame."""
        gradient: Array = self.turn @ self.source.field_gradient(self._to_own_frame(points)) @ self.turn.T
        return gradient

    def contains(self, points: ArrayLike) -> NDArray[np.bool_]:
        """(...,) whether `points` (..., 3) [m] lie in the source's matter."""
        return self.source.contains(self._to_own_frame(points))

    def _to_own_frame(self, points: ArrayLike) -> Array:
        own: Array = (vectors(points, "points") - self.position) @ self.turn
        return own
