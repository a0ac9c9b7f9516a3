"""From the Hall converter's range to field: linear sensors that look along their own radius.

A DRV5055A2 (assumed) gives half its supply at zero field and 50 mV/mT at 5 V; the converter measures against the same
supply, so the range 0…1 stands for −50…+50 mT whatever the supply really is.
"""

from __future__ import annotations

import numpy as np

from haptorb.errors import InputError
from haptorb.physics.arrays import Array, vectors

__all__ = ["HALL_SPAN", "RadialHallSensors"]

HALL_SPAN = 0.1  #: field over the converter's whole range [T]


class RadialHallSensors:
    """Sensors at `positions` (k, 3) [m], each measuring the field's component along its own radius.

    What they do not measure is zero in `field`: the tangential parts. An estimator must use the radial parts only.

    Raises InputError if a position is not finite, no 3-vector, or at the centre, where no radius is.

    >>> sensors = RadialHallSensors([[0.0, 0.0, -0.055]])
    >>> sensors.field(np.array([0.6])).round(4).tolist()        # 10 mT outward: along −z
    [[0.0, 0.0, -0.01]]
    """

    def __init__(self, positions: Array | list[list[float]]) -> None:
        at = vectors(positions, "positions of the Hall sensors")
        distance = np.linalg.norm(at, axis=1, keepdims=True)
        if (distance == 0).any():
            raise InputError("a Hall sensor at the centre has no radius to look along")
        self.directions: Array = at / distance

    def field(self, share: Array) -> Array:
        """(k, 3) [T] from the converter's range (k,) 0…1 [1]."""
        field: Array = ((share - 0.5) * HALL_SPAN)[:, None] * self.directions
        return field

    def share(self, field: Array) -> Array:
        """(k,) the converter's range 0…1 [1] at a true field (k, 3) [T], clipped as the sensor does."""
        radial = np.einsum("ki,ki->k", field, self.directions)
        share: Array = np.clip(radial / HALL_SPAN + 0.5, 0.0, 1.0)
        return share
