"""Layout of the round parts of a spherical motor: directions from its centre, in rings of equal latitude."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from haptorb.arrays import Array
from haptorb.errors import InputError

__all__ = ["Layout", "PartRing", "alternate_signs", "spherical_frames"]


@dataclass(frozen=True, slots=True)
class PartRing:
    """`count` parts at one latitude, `step` apart in longitude from `first` on; angles in [rad]."""

    latitude: float
    count: int
    first: float
    step: float

    def directions(self) -> Array:
        """(count, 3) unit vectors.

        Bai 2012 (A.1) prints ϑ as a colatitude, but the angles of its Table A.1 are latitudes (erratum E2):
        r/R = (cosϑ cosφ, cosϑ sinφ, sinϑ).

        >>> PartRing(0.0, 2, 0.0, np.pi / 2).directions().round(12).tolist()
        [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
        """
        longitude = self.first + self.step * np.arange(self.count)
        out = np.empty((self.count, 3))
        out[:, 0] = np.cos(self.latitude) * np.cos(longitude)
        out[:, 1] = np.cos(self.latitude) * np.sin(longitude)
        out[:, 2] = np.sin(self.latitude)
        return out


@dataclass(frozen=True)
class Layout:
    """Parts on one sphere, their axes through its centre; numbered from 1 in messages, as papers do.

    distance     of every part's centre from the motor's centre [m]
    directions   (k, 3) unit vectors to the parts
    """

    distance: float
    directions: Array

    @classmethod
    def of_rings(cls, distance: float, rings: Sequence[PartRing]) -> Layout:
        """The parts of all rings, in order."""
        return cls(distance, np.concatenate([ring.directions() for ring in rings]))

    def __len__(self) -> int:
        return len(self.directions)

    @property
    def positions(self) -> Array:
        """(k, 3) centres [m]."""
        positions: Array = self.distance * self.directions
        return positions

    @property
    def frames(self) -> Array:
        """(k, 3, 3) rotation from a part's own frame (its axis +z) to the layout's frame."""
        return spherical_frames(self.directions)


def spherical_frames(directions: Array) -> Array:
    """(k, 3, 3) rotations whose columns are the directions ϑ̂ (southward), φ̂ (eastward) and r̂ at `directions` (k, 3).

    At the poles φ̂ = ŷ.

    >>> spherical_frames(np.array([[1.0, 0, 0]]))[0].tolist()
    [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]
    """
    r = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    east = np.stack([-r[:, 1], r[:, 0], np.zeros(len(r))], axis=1)
    length = np.linalg.norm(east, axis=1, keepdims=True)
    east = np.where(length > 1e-12, east / np.maximum(length, 1e-12), [0.0, 1.0, 0.0])
    frames: Array = np.stack([np.cross(east, r), east, r], axis=2) + 0.0
    return frames


def alternate_signs(counts: Sequence[int], pattern: str) -> Array:
    """(Σ counts,) signs ±1 of the magnets of neighbouring rings, the first of them outward.

    "checkerboard" alternates along a ring and from ring to ring, as the distances say (along a ring and across the two
    rings neighbours are equally far apart); "in-phase" alternates along every ring alike (erratum E4).

    Raises InputError for another pattern.

    >>> alternate_signs([4, 4], "checkerboard").tolist()
    [1.0, -1.0, 1.0, -1.0, -1.0, 1.0, -1.0, 1.0]
    """
    if pattern not in ("checkerboard", "in-phase"):
        raise InputError(f"polarity must be 'checkerboard', 'in-phase' or a list of +1 and −1; got {pattern!r}")
    rings = []
    for number, count in enumerate(counts):
        signs = 1.0 - 2.0 * (np.arange(count) % 2)
        rings.append(-signs if pattern == "checkerboard" and number % 2 else signs)
    return np.concatenate(rings)
