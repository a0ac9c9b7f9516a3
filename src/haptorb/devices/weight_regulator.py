"""The weight-compensating regulator of a spherical motor: two opposed magnet rings whose repulsion holds the rotor up.

Bai 2012 §3 describes it and gives no numbers. Here: one ring on the stator, one on the rotor, both about the z axes of
their parts. By symmetry the torque about the centre is τ(cos tilt) along ẑ_R × Ẑ: one function of one cosine, tabulated
once from the exact forces between the rings.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial import chebyshev

from haptorb.arrays import Array
from haptorb.compiled import kernel
from haptorb.magnetics.interaction import wrench
from haptorb.magnetics.magnets import RingMagnet

__all__ = ["Regulator", "torque_over_sine"]

_NODES = 14  #: tilts at which the exact torque is taken; the polynomial through them is good to 1e-6


@dataclass(frozen=True)
class Regulator:
    """Two coaxial magnet rings, polarized against each other; heights are along the z axis of the part they sit on."""

    stator_ring: RingMagnet
    stator_height: float  #: [m]
    rotor_ring: RingMagnet  #: polarized along the rotor's −z where the stator's is along +Z
    rotor_height: float  #: [m]
    greatest_tilt: float  #: [rad] up to which the torque is tabulated

    def torque(self, tilt: float) -> float:
        """Restoring torque [N·m] at `tilt` [rad], exact: positive where it turns the rotor back upright."""
        c, s = np.cos(tilt), np.sin(tilt)
        turn = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])  # the rotor's z leans towards X
        flipped = turn @ np.diag([1.0, -1.0, -1.0])
        above = np.array([0.0, 0.0, self.stator_height])
        place = self.rotor_height * turn[:, 2] - above
        on_rotor = wrench(self.stator_ring, self.rotor_ring, place, flipped, about=-above, precision=1e-7)
        return float(-on_rotor.value[4])

    @cached_property
    def series(self) -> tuple[Array, float]:
        """(14,) Chebyshev coefficients of torque over sin(tilt) [N·m], and the least cosine: for `torque_over_sine`."""
        low = float(np.cos(self.greatest_tilt))
        node = np.cos(np.pi * (np.arange(_NODES) + 0.5) / _NODES)
        cosine = 0.5 * (1 + low) + 0.5 * (1 - low) * node
        tilts = np.arccos(cosine)
        values = np.array([self.torque(tilt) for tilt in tilts]) / np.sin(tilts)
        return np.asarray(chebyshev.chebfit(node, values, _NODES - 1)), low


@kernel
def torque_over_sine(cosine: float, coefficients: Array, least: float) -> float:
    """Torque over sin(tilt) [N·m], positive where it turns the rotor back upright: Σ a_n T_n by Clenshaw's recurrence.

    coefficients (n,) [N·m] over cos(tilt) from `least` to 1; held constant beyond.
    """
    x = (2.0 * max(cosine, least) - (1.0 + least)) / (1.0 - least)
    value, carry = 0.0, 0.0
    for n in range(coefficients.shape[0] - 1, 0, -1):
        value, carry = coefficients[n] + 2.0 * x * value - carry, value
    return float(coefficients[0] + x * value - carry)
