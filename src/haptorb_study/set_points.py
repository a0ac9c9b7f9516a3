"""Set-points: numbered directions on the dome that participants are to find; 25 are built in."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from math import cos, radians, sin

import numpy as np

from haptorb.arrays import Array

__all__ = [
    "PUBLISHED_ERRORS",
    "SetPoint",
    "angles_between",
    "directions",
    "list_equal_rings",
    "list_published",
    "nearest",
]


#: θ [deg] → mean and standard deviation of the error [mm], Zárate 2020 §IV
PUBLISHED_ERRORS = {0.0: (2.5, 1.4), 18.0: (5.7, 4.6), 36.0: (6.5, 5.2), 54.0: (7.2, 5.1)}


@dataclass(frozen=True)
class SetPoint:
    """A numbered place on the dome."""

    number: int
    theta_deg: float  #: polar angle from the top [deg]
    phi_deg: float  #: azimuth from +x towards +y [deg]

    @property
    def direction(self) -> tuple[float, float, float]:
        """Unit vector from the centre, frame S."""
        theta, phi = radians(self.theta_deg), radians(self.phi_deg)
        return sin(theta) * cos(phi), sin(theta) * sin(phi), cos(theta)


@cache
def list_published() -> tuple[SetPoint, ...]:
    """The 25 set-points of Zárate 2020 Fig. 8: 1 + 4 + 8 + 12 at θ = 0, 18, 36 and 54 deg, neighbours 18.0 deg apart.

    This agrees with "25 evenly separated by 18°" and the four rings of Fig. 9. Their numbers are only in the figure;
    here they are counted from the top, ring by ring.

    >>> [sum(p.theta_deg == ring for p in list_published()) for ring in (0, 18, 36, 54)]
    [1, 4, 8, 12]
    """
    return _list_rings((4, 8, 12))


@cache
def list_equal_rings() -> tuple[SetPoint, ...]:
    """25 set-points in rings of 1 + 8 + 8 + 8: the "published" layout of haptorb until erratum E17 was withdrawn."""
    return _list_rings((8, 8, 8))


def _list_rings(counts: tuple[int, ...]) -> tuple[SetPoint, ...]:
    """One set-point at the top, then `counts` per ring, rings 18 deg apart, the first of each at φ = 0."""
    rings = [(18.0 * (n + 1), 360.0 * k / count) for n, count in enumerate(counts) for k in range(count)]
    return tuple(SetPoint(n + 1, theta, phi) for n, (theta, phi) in enumerate([(0.0, 0.0), *rings]))


def directions(points: tuple[SetPoint, ...]) -> Array:
    """(n, 3) unit vectors."""
    return np.array([point.direction for point in points]).reshape(-1, 3)


def angles_between(a: Array, b: Array) -> Array:
    """(n,) angles between directions (n, 3) and (n, 3) [deg]; NaN where either is."""
    cosine = np.sum(a * b, axis=-1) / np.linalg.norm(a, axis=-1) / np.linalg.norm(b, axis=-1)
    angles: Array = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    return angles


def nearest(points: tuple[SetPoint, ...], position: Array) -> int:
    """Number of the set-point nearest to the direction of `position` (3,).

    >>> nearest(list_published(), np.array([0.1, 0.0, 1.0]))
    1
    """
    return points[int(np.argmax(directions(points) @ position))].number
