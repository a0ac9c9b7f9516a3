"""Distances between round parts whose axes meet in one centre, over all angles at which the axes may stand.

A point of one part at the radius s, at the angle β from its axis, lies on a circle about that axis. Seen from another
part, whose axis stands at an angle between `low` and `high` to the first one, it takes every angle from
min |β − γ| to max (β + γ), folded at π: an arc in the meridian plane of the other part. So the distance over a whole
workspace is one between arcs and rectangles in a plane.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from haptorb.arrays import Array
from haptorb.rotations import rotation_from_euler

__all__ = ["AxialBody", "TiltedAxis", "find_clearance", "spread_angles", "tilted_axes"]

_ALONG = 24  #: points along each side of a section
_AROUND = 24  #: places along the arc of each point
_TILTS = 41  #: along each edge of the square of tilts


@final
@dataclass(frozen=True)
class AxialBody:
    """A cylinder, or a ring, about an axis through the centre; heights are along that axis."""

    low: float  #: [m]
    high: float  #: [m]
    inner_radius: float  #: [m]; 0: without a hole
    outer_radius: float  #: [m]

    @classmethod
    def of_length(cls, middle: float, length: float, inner_radius: float, outer_radius: float) -> AxialBody:
        """The one whose middle is at the height `middle`; all in [m]."""
        return cls(middle - length / 2, middle + length / 2, inner_radius, outer_radius)

    @property
    def border(self) -> tuple[Array, Array]:
        """Radius and height of points around the section [m], (n,) each; corners and nearest points among them."""
        if self.low == self.high and self.inner_radius == self.outer_radius:
            return np.array([self.outer_radius]), np.array([self.low])
        share = np.linspace(0.0, 1.0, _ALONG)
        level = float(np.clip(0.0, self.low, self.high))  # where a side is nearest to the centre
        heights = np.append(self.low + share * (self.high - self.low), level)
        radii = self.inner_radius + share * (self.outer_radius - self.inner_radius)
        rho = [radii, radii, np.full_like(heights, self.outer_radius), np.full_like(heights, self.inner_radius)]
        z = [np.full_like(radii, self.low), np.full_like(radii, self.high), heights, heights]
        return np.concatenate(rho), np.concatenate(z)

    def measure_distance(self, rho: Array, z: Array) -> Array:
        """(n,) distance [m] of points at radii `rho` and heights `z` (n,) from the section; negative: depth inside."""
        lowest = self.inner_radius if self.inner_radius > 0.0 else -self.outer_radius
        out = np.maximum(lowest - rho, rho - self.outer_radius)
        over = np.maximum(self.low - z, z - self.high)
        return np.where((out > 0.0) & (over > 0.0), np.hypot(out, over), np.maximum(out, over))


@final
@dataclass(frozen=True)
class TiltedAxis:
    """Angles between an axis and another one that a motion lets it take [rad]."""

    low: float
    high: float

    def of_part(self, angle: float) -> TiltedAxis:
        """Of a part whose own axis is at `angle` [rad] to the moving one, at any spin about it."""
        low, high = spread_angles(np.array([angle]), self)
        return TiltedAxis(float(low[0]), float(high[0]))


def spread_angles(beta: Array, axis: TiltedAxis) -> tuple[Array, Array]:
    """Least and greatest angle [rad] from another axis of what is at `beta` (n,) [rad] from an axis at `axis` to it."""
    low = np.maximum(np.maximum(axis.low - beta, beta - axis.high), 0.0)
    most = np.minimum(beta + axis.high, 2 * np.pi - (beta + axis.low))
    # between the two π itself is reached
    most = np.where((beta + axis.low <= np.pi) & (beta + axis.high >= np.pi), np.pi, most)
    return low, most


def tilted_axes(tilt: float, directions: Array) -> list[TiltedAxis]:
    """For each of `directions` (k, 3): the angles to the rotor's z axis, for tilts |ψ| and |λ| up to `tilt` [rad].

    Both tilts together, at any spin: the extremes are on the border, except for a direction that z itself can take.
    """
    edge = np.linspace(-tilt, tilt, _TILTS)
    ends = np.full_like(edge, tilt)
    psi, lam = np.concatenate([edge, edge, ends, -ends]), np.concatenate([ends, -ends, edge, edge])
    z = rotation_from_euler(psi, lam, np.zeros_like(psi))[:, :, 2]
    angles = np.arctan2(np.linalg.norm(np.cross(z[:, None], directions), axis=2), z @ directions.T)
    low = np.where(_within(tilt, directions), 0.0, angles.min(axis=0))
    high = np.where(_within(tilt, -directions), np.pi, angles.max(axis=0))
    return [TiltedAxis(*pair) for pair in zip(low.tolist(), high.tolist(), strict=True)]


def _within(tilt: float, directions: Array) -> NDArray[np.bool_]:
    """(k,) whether the rotor's z axis can take each of `directions` (k, 3): z = (sin λ, −sin ψ cos λ, cos ψ cos λ)."""
    lam, psi = np.arcsin(np.clip(directions[:, 0], -1.0, 1.0)), np.arctan2(-directions[:, 1], directions[:, 2])
    return np.asarray((np.abs(lam) <= tilt) & (np.abs(psi) <= tilt))


def find_clearance(one: AxialBody, other: AxialBody, axis: TiltedAxis) -> float:
    """Least distance [m] of two bodies over all angles of `axis` between their axes; negative: they overlap."""
    return min(_sweep(one, other, axis), _sweep(other, one, axis))


def _sweep(moved: AxialBody, still: AxialBody, axis: TiltedAxis) -> float:
    rho, z = moved.border
    s, beta = np.hypot(rho, z), np.arctan2(rho, z)
    low, high = spread_angles(beta, axis)
    theta = low + np.linspace(0.0, 1.0, _AROUND)[:, None] * (high - low)
    least = float(still.measure_distance(s * np.sin(theta), s * np.cos(theta)).min())
    if least <= 0.0:
        return least
    # where an arc passes over the other body, they are nearest along a radius
    rho, z = still.border
    met, at = np.arctan2(rho, z)[:, None], np.hypot(rho, z)[:, None]
    apart = np.where((met >= low) & (met <= high), np.abs(at - s), np.inf)
    return min(least, float(apart.min()))
