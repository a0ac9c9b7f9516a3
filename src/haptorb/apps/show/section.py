"""Where a vertical plane through the origin cuts a round part: exact outlines, from circles and straight lines."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from haptorb.devices.geometry import RoundPart
from haptorb.numerics.arrays import Array

__all__ = ["SectionPlane", "cut_part", "split_poles"]

_STEPS = 121  #: points of one curve
_PARALLEL = 1e-12  #: a plane whose axis' share is below this is parallel, or square, to the part's axis

#: a closed outline (n, 2), and where it has one a hole in it
Outline = tuple[Array, ...]


@dataclass(frozen=True)
class SectionPlane:
    """The plane that contains the z axis and the direction at `azimuth` [rad] from +x towards +y."""

    azimuth: float = 0.0

    @property
    def axes(self) -> Array:
        """(3, 3) rows: to the right in the section, upwards (+z), and towards the eye."""
        c, s = np.cos(self.azimuth), np.sin(self.azimuth)
        return np.array([[c, s, 0.0], [0.0, 0.0, 1.0], [s, -c, 0.0]])

    def project(self, points: Array) -> Array:
        """(n, 3) to the right, upwards and towards the eye [m], of `points` (n, 3) [m]."""
        projected: Array = np.atleast_2d(points) @ self.axes.T
        return projected


def cut_part(part: RoundPart, plane: SectionPlane) -> list[Outline]:
    """Outlines [m] of what `plane` cuts of `part`: none, one, or two where the hole divides it.

    Along e, the axis' direction in the plane, and f beside it, the plane's points are r = x e + y f + z n from the
    part's centre, with z the same for all. A point belongs to the part where its height along the axis is within half
    the length, and its distance from the axis between the radii: for each x two intervals of y, which meet where the
    hole is not cut.
    """
    x_axis, z_axis, eye = plane.axes
    k = part.axis / np.linalg.norm(part.axis)
    steep = float(k @ eye)
    inside = k - steep * eye
    flat = float(np.linalg.norm(inside))
    e = inside / flat if flat > _PARALLEL else x_axis
    f = np.cross(eye, e)
    z = -float(part.position @ eye)

    def limit(radius: float) -> tuple[float, float]:
        """x between which the distance from the axis can be below `radius`, within the part's length."""
        low, high = -np.inf, np.inf
        for slope, offset, most in ((flat, z * steep, part.length / 2), (steep, -z * flat, radius)):
            if abs(slope) > _PARALLEL:
                ends = sorted(((-most - offset) / slope, (most - offset) / slope))
                low, high = max(low, ends[0]), min(high, ends[1])
            elif abs(offset) >= most:
                return 0.0, 0.0
        return low, high

    def curve(radius: float) -> Array:
        """(n, 2) x and y ≥ 0 at that distance from the axis."""
        low, high = limit(radius)
        x = 0.5 * (low + high) - 0.5 * (high - low) * np.cos(np.linspace(0.0, np.pi, _STEPS))
        return np.stack([x, np.sqrt(np.maximum(radius**2 - (x * steep - z * flat) ** 2, 0.0))], axis=1)

    low, high = limit(part.outer_radius)
    if not low < high:
        return []
    outer, below = curve(part.outer_radius), np.array([1.0, -1.0])
    hole_low, hole_high = limit(part.inner_radius) if part.inner_radius > 0 else (0.0, 0.0)
    loops: list[Outline]
    if not hole_low < hole_high:
        loops = [(np.concatenate([outer, outer[::-1] * below]),)]
    else:
        inner = curve(part.inner_radius)
        at_low, at_high = np.isclose([hole_low, hole_high], [low, high], rtol=0, atol=1e-9 * part.outer_radius)
        if at_low and at_high:
            upper = np.concatenate([outer, inner[::-1]])
            loops = [(upper,), (upper * below,)]
        elif at_low or at_high:  # a notch at one end
            way = 1 if at_high else -1
            notch = np.concatenate([inner[::-way], inner[::way] * below])
            loops = [(np.concatenate([outer[::way], notch, outer[::-way] * below]),)]
        else:
            closed = [np.concatenate([one, one[::-1] * below]) for one in (outer, inner)]
            loops = [(closed[0], closed[1][::-1])]
    middle = part.position + z * eye
    to_plane = np.array([[e @ x_axis, e @ z_axis], [f @ x_axis, f @ z_axis]])
    origin = np.array([middle @ x_axis, middle @ z_axis])
    return [tuple(origin + loop @ to_plane for loop in outline) for outline in loops]


def split_poles(part: RoundPart) -> tuple[RoundPart, RoundPart]:
    """North and south half of a magnet."""
    sign = 1.0 if part.polarity > 0 else -1.0
    step = 0.25 * part.length * part.axis / np.linalg.norm(part.axis)
    north, south = (
        replace(part, position=part.position + side * step, length=part.length / 2) for side in (sign, -sign)
    )
    return north, south
