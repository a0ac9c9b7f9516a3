"""From the Hall converter's range to field: linear sensors, three in each place or one that looks along its radius.

A DRV5055A2 (assumed) gives half its supply at zero field and 50 mV/mT at 5 V; the converter measures against the same
supply, so the range 0…1 stands for −50…+50 mT however far the 5 V are off. At 3.3 V it gives 30 mV/mT: −55…+55 mT.
"""

from __future__ import annotations

import numpy as np

from haptorb.errors import InputError
from haptorb.numerics.arrays import Array, vectors
from haptorb.numerics.compiled import kernel

__all__ = ["SPAN_3V3", "SPAN_5V", "HallSensors", "fill_field"]

SPAN_5V = 5.0 / 50.0  #: field over the converter's whole range [T], both on 5 V: a board
SPAN_3V3 = 3.3 / 30.0  #: the same, both on 3.3 V: a Raspberry Pi


@kernel
def fill_field(field: Array, radial: Array, axes: int, span: float, axis: int, first: int, shares: Array) -> None:
    """Write `shares` (n,) 0…1 of the range `span` [T], of sensors from `first` on, into `field` (k, 3) [T]: along
    `axis`, or where the sensors have only one, along radial (k, 3)."""
    for n in range(len(shares)):
        tesla = (shares[n] - 0.5) * span
        if axes == 3:
            field[first + n, axis] = tesla
        else:
            for i in range(3):
                field[first + n, i] = tesla * radial[first + n, i]


class HallSensors:
    """Sensors at `positions` (k, 3) [m]: three in each place, along the device's x, y, z, or one, outward.

    axes         3 or 1
    span         field over the converter's whole range [T]
    directions   (k, 3) in which one-axis sensors look; None for three axes

    Raises InputError if a position is not finite, no 3-vector, or at the centre, where no radius is; for other axes, or
    no positive span.

    >>> radial = HallSensors([[0.0, 0.0, -0.055]], axes=1)
    >>> field = radial.empty_field()
    >>> radial.put(field, 0, 0, (0.6,))                          # 10 mT outward: along −z
    >>> field.round(4).tolist()
    [[0.0, 0.0, -0.01]]
    """

    def __init__(self, positions: Array | list[list[float]], axes: int = 3, span: float = SPAN_5V) -> None:
        at = vectors(positions, "positions of the Hall sensors")
        distance = np.linalg.norm(at, axis=1, keepdims=True)
        if axes not in (1, 3):
            raise InputError(f"a Hall sensor has one axis or three; got {axes}")
        if (distance == 0).any():
            raise InputError("a Hall sensor at the centre has no radial direction")
        if not span > 0.0:
            raise InputError(f"the span of a Hall sensor must be above 0 T; got {span}")
        self.axes, self.span = axes, span
        self.radial: Array = np.ascontiguousarray(at / distance)  #: (k, 3) unit vectors, outward

    @property
    def directions(self) -> Array | None:
        """(k, 3) unit vectors, stator frame, of one-axis sensors; None: each measures all three."""
        return self.radial if self.axes == 1 else None

    def empty_field(self) -> Array:
        """(k, 3) NaN [T]: a field of which nothing was read."""
        return np.full(self.radial.shape, np.nan)

    def put(self, field: Array, axis: int, first: int, shares: tuple[float, ...]) -> None:
        """Write what sensors from `first` on read of `axis` into `field` (k, 3) [T]; shares 0…1 of the range [1].

        What sensors of one axis do not measure is zero: the tangential parts. An estimator must use the radial parts.
        """
        fill_field(field, self.radial, self.axes, self.span, axis, first, np.array(shares, dtype=np.float64))

    def shares(self, field: Array) -> Array:
        """(axes, k) of the converter's range 0…1 [1] at a true field (k, 3) [T], clipped as the sensor does."""
        visible = field.T if self.axes == 3 else np.einsum("ki,ki->k", field, self.radial)[None]
        shares: Array = np.clip(visible / self.span + 0.5, 0.0, 1.0)
        return shares
