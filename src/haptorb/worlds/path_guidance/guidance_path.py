"""A path for guidance: a curve on or above the dome, parametrised by arc length."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from haptorb.devices.device import Device
from haptorb.errors import InputError
from haptorb.numerics.arrays import Array, vectors
from haptorb.worlds.path_guidance.path_checks import check_crossing, check_workspace

__all__ = ["GuidancePath", "make_path"]

_SPACING = 0.25e-3  #: between two stored places [m], finer than a hand can tell
_SHORTEST = 5e-3  #: a shorter path gives no guidance [m]
_LONGEST = 2.0  #: [m]
_MOST = 10_000  #: points that a person may give
_SAME = 1e-6  #: two points nearer to each other are one [m]


@final
@dataclass(frozen=True, eq=False)
class GuidancePath:
    """A curve at even steps of its arc length, in the stator frame.

    >>> path = make_path([(0, -0.02, 0.05), (0, 0, 0.055), (0, 0.02, 0.05)])
    >>> path.closed, 0.04 < path.length < 0.05
    (False, True)
    """

    places: Array  #: (n, 3) [m], the first again at the end where the path is closed
    tangents: Array  #: (n, 3) unit vectors along it
    spacing: float  #: arc length between two places [m]
    closed: bool  #: it ends where it begins

    @property
    def length(self) -> float:
        """[m]"""
        return self.spacing * (len(self.places) - 1)

    def find_place(self, arc: float) -> Array:
        """(3,) [m] the point at `arc` [m] along the path; its ends, beyond them."""
        at = min(max(arc / self.spacing, 0.0), len(self.places) - 1.0)
        k = min(int(at), len(self.places) - 2)
        place: Array = self.places[k] + (at - k) * (self.places[k + 1] - self.places[k])
        return place

    def check(self, device: Device) -> None:
        """Raise InputError unless `device` has a dome and the whole path is on or above it, within the workspace."""
        check_workspace(self.places, self.spacing, device)


def make_path(points: ArrayLike, *, closed: bool | None = None, smooth: bool = True) -> GuidancePath:
    """The path through `points` (k, 3) [m], k ≥ 2, in their order.

    smooth: a spline through the points; else arcs about the dome's centre from one to the next, with corners. Between
    points the distance from the centre changes evenly, so that points on a dome give a path on it. closed: the
    path continues from the last point to the first; None: closed if the last point equals the first.

    Raises InputError for fewer points, points that are not numbers or are at the centre, a length below 5 mm or
    above 2 m, and a path that crosses itself; the message states where.
    """
    corners = vectors(points, "points of the path")
    if corners.ndim != 2 or len(corners) < 2:
        raise InputError(f"a path needs at least two points, shape (k, 3); got shape {corners.shape}")
    if len(corners) > _MOST:
        raise InputError(f"a path may have at most {_MOST} points; got {len(corners)}: leave out every other one")
    ends_meet = bool(np.linalg.norm(corners[0] - corners[-1]) <= _SAME)
    closed = ends_meet if closed is None else closed
    if closed and not ends_meet:
        corners = np.vstack((corners, corners[:1]))
    steps = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    if (steps <= _SAME).any():
        twice = int(np.argmax(steps <= _SAME)) + 1
        raise InputError(f"points {twice} and {twice + 1} of the path are equal: leave one out")
    if closed and len(corners) < 4:
        raise InputError("a closed path needs at least three points")
    distances = np.linalg.norm(corners, axis=1)
    if distances.min() < 1e-3:
        raise InputError(
            f"point {int(distances.argmin()) + 1} of the path lies in the dome's centre: points are in metres"
        )
    total = float(steps.sum())
    if not 0.5 * _SHORTEST <= total <= 2 * _LONGEST:
        raise InputError(
            f"a path must be 5 mm to 2 m long; this one is {total:.4g} m: points are in metres, or mm in a file"
        )
    fine = _interpolate(corners, np.concatenate(([0.0], np.cumsum(steps))), closed, smooth)
    gone = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(fine, axis=0), axis=1))))
    if not _SHORTEST <= gone[-1] <= _LONGEST:
        raise InputError(f"a path must be 5 mm to 2 m long; this one is {gone[-1]:.4g} m")
    count = max(int(np.ceil(gone[-1] / _SPACING)), 20)
    places = _resample(fine, gone, np.linspace(0.0, gone[-1], count + 1))
    spacing = float(gone[-1] / count)
    check_crossing(places, spacing, closed)
    along = np.empty_like(places)
    along[1:-1] = places[2:] - places[:-2]
    if closed:
        along[0] = along[-1] = places[1] - places[-2]
    else:
        along[0], along[-1] = places[1] - places[0], places[-1] - places[-2]
    tangents = along / np.linalg.norm(along, axis=1, keepdims=True)
    return GuidancePath(np.ascontiguousarray(places), np.ascontiguousarray(tangents), spacing, closed)


def _interpolate(corners: Array, gone: Array, closed: bool, smooth: bool) -> Array:
    """(n, 3) many places between `corners` (k, 3), which lie at the chord lengths `gone` (k,) [m]."""
    at = np.unique(np.concatenate([gone, np.linspace(0.0, gone[-1], 2 + int(gone[-1] / (0.5 * _SPACING)))]))
    straight = _resample(corners, gone, at)
    if smooth and len(corners) > 2:
        from scipy.interpolate import CubicSpline  # loaded only where points are given

        straight = CubicSpline(gone, corners, bc_type="periodic" if closed else "natural")(at)
    lengths = np.linalg.norm(straight, axis=1, keepdims=True)
    if lengths.min() < 1e-3:
        raise InputError("the path goes through the dome's centre; give points on its way around")
    wanted = np.interp(at, gone, np.linalg.norm(corners, axis=1))
    places: Array = straight * (wanted[:, None] / lengths)
    return places


def _resample(places: Array, gone: Array, at: Array) -> Array:
    """(n, 3) what lies at the lengths `at` (n,) [m] of a line through `places`, which lie at `gone` [m]."""
    return np.column_stack([np.interp(at, gone, places[:, i]) for i in range(3)])
