"""Path for guidance: a curve on or above the dome, parametrised by arc length."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from haptorb.arrays import Array, check_finite, vectors
from haptorb.devices.base import Device
from haptorb.errors import InputError, UnknownName, quote
from haptorb.file_kind import FileKind
from haptorb.files import read_text
from haptorb.worlds.base import Shape

__all__ = [
    "SHAPES",
    "GuidancePath",
    "check_crossing",
    "check_workspace",
    "draw_path",
    "load_path",
    "make_path",
    "make_shape",
]


# --------------------------------------------------------------------------------------------------
# Checks of a path: no crossing, and within the workspace.


_MIN_CLEARANCE_M = 1e-3  #: sections nearer to each other cannot be distinguished with a hand on the tool [m]
#: arc length within which points belong to one section, also around a corner of 20 degrees [m]
_SECTION_LENGTH_M = 6e-3
_CONTACT_TOLERANCE_M = 0.5e-3  #: tolerance of a path below contact, which only a tilted tool reaches [m]


def _write_place(p: Array) -> str:
    x, y, z = (1e3 * p + 0.0).round(1).tolist()
    return f"({x:g}, {y:g}, {z:g}) mm"


def check_crossing(places: Array, spacing: float, closed: bool) -> None:
    """Raise InputError where `places` (n, 3) [m], `spacing` [m] apart, come within 1 mm of an earlier section."""
    every = max(round(0.5 * _MIN_CLEARANCE_M / spacing), 1)
    points = places[::every]
    step, count = every * spacing, len(points)
    total = spacing * (len(places) - 1)
    for k in range(count):
        arcs = step * (np.arange(k + 1, count) - k)
        away = np.minimum(arcs, total - arcs) if closed else arcs
        gap = np.linalg.norm(points[k + 1 :] - points[k], axis=1)
        near = (away > _SECTION_LENGTH_M) & (gap < _MIN_CLEARANCE_M)
        if near.any():
            other = float(step * (k + 1 + int(np.argmax(near))))
            raise InputError(
                f"the path crosses itself, or comes within 1 mm of itself, near {_write_place(points[k])}: "
                f"{1e3 * k * step:.0f} mm and {1e3 * other:.0f} mm along it. Move its points apart, or guide along "
                "its parts one after the other"
            )


def check_workspace(places: Array, spacing: float, device: Device) -> None:
    """Raise InputError unless `places` (n, 3) [m], `spacing` [m] apart, are in the shell over the dome of `device`."""
    shell = device.shell
    if shell is None:
        raise InputError(
            f"guidance along a path is for a tool over a sphere; device '{device.name}' has none: choose omni or "
            "another spherical electromagnet"
        )
    distance = np.linalg.norm(places, axis=1)
    highest = shell.contact_distance + shell.thickness
    steepest = float(getattr(device, "workspace_half_angle", np.pi / 2))
    tilt = np.arccos(np.clip(places[:, 2] / distance, -1.0, 1.0))
    ways = (
        (shell.contact_distance - distance - _CONTACT_TOLERANCE_M, "inside the dome, where the tool cannot be", "m",
         f"keep every point at least {1e3 * shell.contact_distance:g} mm from the centre"),
        (distance - highest - 1e-6, "above the shell in which forces are rendered", "m",
         f"keep every point within {1e3 * highest:g} mm of the centre"),
        (tilt - steepest - 1e-6, "outside the workspace", "rad",
         f"keep every point within {np.degrees(steepest):.0f} deg of the summit"),
    )  # fmt: skip
    for beyond, where, unit, remedy in ways:
        worst = int(np.argmax(beyond))
        if beyond[worst] > 0.0:
            over = f"{1e3 * beyond[worst]:.3g} mm" if unit == "m" else f"{np.degrees(beyond[worst]):.3g} deg"
            raise InputError(
                f"the path leaves the workspace of device '{device.name}': {1e3 * worst * spacing:.0f} mm along it, at "
                f"{_write_place(places[worst])}, it is {over} {where}; {remedy}"
            )


_POINT_SPACING_M = 0.25e-3  #: spacing of the stored points [m], finer than a hand can distinguish
_MIN_LENGTH_M = 5e-3  #: minimum length for guidance [m]
_MAX_LENGTH_M = 2.0  #: [m]
_MAX_POINTS = 10_000  #: maximum number of given points
_MIN_POINT_DISTANCE_M = 1e-6  #: minimum distance of distinct points [m]
_MIN_CENTRE_DISTANCE_M = 1e-3  #: from the dome's centre, where directions are not defined [m]
_SPACINGS_M = (0.1e-3, 0.5e-3)  #: of the stored points: a search along the path visits those within 3 mm
_UNIT_TOLERANCE = 1e-6  #: of the length of a tangent
_SPACING_TOLERANCE = 1e-6  #: relative, by which a chord may be longer than the arc


@final
@dataclass(frozen=True, eq=False)
class GuidancePath:
    """Curve in the stator frame, sampled at equal steps of arc length.

    `make_path` and `load_path` make one.

    Parameters
    ----------
    places : ndarray, shape (n, 3)
        Points of the curve [m]; the first again at the end if it is closed.
    tangents : ndarray, shape (n, 3)
        Unit vectors along the curve.
    spacing : float
        Arc length between two points [m].
    closed : bool
        Whether the curve ends where it begins.

    Examples
    --------
    >>> path = make_path([(0, -0.02, 0.05), (0, 0, 0.055), (0, 0.02, 0.05)])
    >>> path.closed, 0.04 < path.length < 0.05
    (False, True)
    """

    places: Array
    tangents: Array
    spacing: float
    closed: bool

    def __post_init__(self) -> None:
        """Check everything: compiled code reads these arrays in every tick, and checks no index."""
        places, tangents = vectors(self.places, "places of a path"), vectors(self.tangents, "tangents of a path")
        spacing = check_finite(self.spacing, "spacing of a path")
        if places.ndim != 2 or len(places) < 2 or tangents.shape != places.shape:  # safety: path-shapes
            raise InputError(
                f"places and tangents of a path must have the same shape (n, 3); got {places.shape}, {tangents.shape}"
            )
        if spacing.ndim or not _SPACINGS_M[0] <= spacing <= _SPACINGS_M[1]:  # safety: path-spacing
            raise InputError(f"the spacing of a path must be 0.1 to 0.5 mm; got {quote(self.spacing)} m")
        if not isinstance(self.closed, bool):
            raise InputError(f"whether a path is closed must be True or False; got {quote(self.closed)}")
        if spacing * (len(places) - 1) > _MAX_LENGTH_M * (1.0 + _SPACING_TOLERANCE):
            raise InputError(f"a path must be 5 mm to 2 m long; this one has {len(places)} points")
        steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
        if steps.max() > spacing * (1.0 + _SPACING_TOLERANCE):
            raise InputError(f"two points of a path are {1e3 * steps.max():.4g} mm apart; its spacing is smaller")
        if np.linalg.norm(places, axis=1).min() < _MIN_CENTRE_DISTANCE_M / 2:
            raise InputError("the path goes through the dome's centre")
        if abs(np.linalg.norm(tangents, axis=1) - 1.0).max() > _UNIT_TOLERANCE:
            raise InputError("the tangents of a path must be unit vectors")
        if self.closed and np.linalg.norm(places[0] - places[-1]) > _MIN_POINT_DISTANCE_M:
            raise InputError("a closed path must end where it begins")
        for name, value in (("places", places), ("tangents", tangents)):
            object.__setattr__(self, name, np.ascontiguousarray(value))
        object.__setattr__(self, "spacing", float(spacing))

    @property
    def length(self) -> float:
        """[m]"""
        return self.spacing * (len(self.places) - 1)

    def find_place(self, arc: float) -> Array:
        """Compute the point at a distance along the path.

        Parameters
        ----------
        arc : float
            Distance from the start, along the path [m]; less than zero is the start, more than its length the end.

        Returns
        -------
        ndarray, shape (3,)
            The point in the stator frame [m].
        """
        at = min(max(arc / self.spacing, 0.0), len(self.places) - 1.0)
        k = min(int(at), len(self.places) - 2)
        place: Array = self.places[k] + (at - k) * (self.places[k + 1] - self.places[k])
        return place

    def check(self, device: Device) -> None:
        """Check that a device can guide along the path.

        Parameters
        ----------
        device : Device
            The device.

        Raises
        ------
        InputError
            Unless it has a dome, and the whole path is on or above it, within the workspace.
        """
        check_workspace(self.places, self.spacing, device)


def make_path(points: ArrayLike, *, closed: bool | None = None, smooth: bool = True) -> GuidancePath:
    """Make a guidance path through given points.

    Parameters
    ----------
    points : array_like, shape (k, 3)
        Two or more points in order, in the stator frame [m].
    closed : bool, optional
        Whether the path continues from the last point to the first; None: if the last point equals the first.
    smooth : bool
        True: a spline through the points. False: arcs about the dome's centre from one point to the next, with corners.

    Returns
    -------
    GuidancePath
        The path. Between points the distance from the centre changes evenly, so that points on a dome give a path on
        it.

    Raises
    ------
    InputError
        For fewer than two points, points that are not numbers or are at the centre, a length below 5 mm or above 2 m,
        and a path that crosses itself; the message states where.

    Examples
    --------
    >>> ring = make_path([(0.02, 0, 0.05), (0, 0.02, 0.05), (-0.02, 0, 0.05), (0, -0.02, 0.05)], closed=True)
    >>> ring.closed, bool((ring.places[0] == ring.places[-1]).all())
    (True, True)
    """
    corners = vectors(points, "points of the path")
    if corners.ndim != 2 or len(corners) < 2:
        raise InputError(f"a path needs at least two points, shape (k, 3); got shape {corners.shape}")
    if len(corners) > _MAX_POINTS:
        raise InputError(f"a path may have at most {_MAX_POINTS} points; got {len(corners)}: leave out every other one")
    ends_meet = bool(np.linalg.norm(corners[0] - corners[-1]) <= _MIN_POINT_DISTANCE_M)
    closed = ends_meet if closed is None else closed
    if closed and not ends_meet:
        corners = np.vstack((corners, corners[:1]))
    steps = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    if (steps <= _MIN_POINT_DISTANCE_M).any():
        twice = int(np.argmax(steps <= _MIN_POINT_DISTANCE_M)) + 1
        raise InputError(f"points {twice} and {twice + 1} of the path are equal: leave one out")
    if closed and len(corners) < 4:
        raise InputError("a closed path needs at least three points")
    distances = np.linalg.norm(corners, axis=1)
    if distances.min() < _MIN_CENTRE_DISTANCE_M:
        raise InputError(
            f"point {int(distances.argmin()) + 1} of the path lies in the dome's centre: points are in metres"
        )
    total = float(steps.sum())
    if not 0.5 * _MIN_LENGTH_M <= total <= 2 * _MAX_LENGTH_M:
        raise InputError(
            f"a path must be 5 mm to 2 m long; this one is {total:.4g} m: points are in metres, or mm in a file"
        )
    fine = _interpolate(corners, np.concatenate(([0.0], np.cumsum(steps))), closed, smooth)
    gone = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(fine, axis=0), axis=1))))
    if not _MIN_LENGTH_M <= gone[-1] <= _MAX_LENGTH_M:
        raise InputError(f"a path must be 5 mm to 2 m long; this one is {gone[-1]:.4g} m")
    count = max(int(np.ceil(gone[-1] / _POINT_SPACING_M)), 20)
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
    return GuidancePath(places, tangents, spacing, closed)


def _interpolate(corners: Array, gone: Array, closed: bool, smooth: bool) -> Array:
    """(n, 3) dense points between `corners` (k, 3), which have the chord lengths `gone` (k,) [m]."""
    at = np.unique(np.concatenate([gone, np.linspace(0.0, gone[-1], 2 + int(gone[-1] / (0.5 * _POINT_SPACING_M)))]))
    straight = _resample(corners, gone, at)
    if smooth and len(corners) > 2:
        from scipy.interpolate import CubicSpline  # imported only when points are given

        straight = CubicSpline(gone, corners, bc_type="periodic" if closed else "natural")(at)
    lengths = np.linalg.norm(straight, axis=1, keepdims=True)
    if lengths.min() < _MIN_CENTRE_DISTANCE_M:
        raise InputError("the path goes through the dome's centre; give points on its way around")
    wanted = np.interp(at, gone, np.linalg.norm(corners, axis=1))
    places: Array = straight * (wanted[:, None] / lengths)
    return places


def _resample(places: Array, gone: Array, at: Array) -> Array:
    """(n, 3) points at the lengths `at` (n,) [m] of a polyline through `places`, which have the lengths `gone` [m]."""
    return np.column_stack([np.interp(at, gone, places[:, i]) for i in range(3)])


# --------------------------------------------------------------------------------------------------
# Path in a table: one point per line, in millimetres.


_HEAD = "x_mm,y_mm,z_mm"


def load_path(file: str | Path, *, closed: bool | None = None, smooth: bool = True) -> GuidancePath:
    """Load a guidance path from a CSV file.

    Parameters
    ----------
    file : str or Path
        CSV file whose first line is x_mm,y_mm,z_mm: points in the stator frame [mm].
    closed : bool, optional
        As for `make_path`.
    smooth : bool
        As for `make_path`.

    Returns
    -------
    GuidancePath
        The path through the points.

    Raises
    ------
    InputError
        For a file that cannot be read, another header, or an invalid number, with the line; and as `make_path`.
    """
    path = Path(file).expanduser()
    # Spreadsheet programs write a byte order mark at the beginning of a file.
    lines = read_text(path, "path file", InputError, kind=FileKind.TABLE).splitlines()
    if not lines or "".join(lines[0].split()) != _HEAD:
        raise InputError(
            f"path file {path}, line 1: the header must be '{_HEAD}'; got "
            f"{quote(lines[0] if lines else 'an empty file')}"
        )
    points = []
    for number, line in enumerate(lines[1:], 2):
        if not line.strip():
            continue
        try:
            x, y, z = (1e-3 * float(cell) for cell in line.split(","))
            finite = math.isfinite(x + y + z)
        except ValueError:
            finite = False
        if not finite:
            raise InputError(f"path file {path}, line {number}: expected three numbers; got {quote(line)}")
        points.append((x, y, z))
    try:
        return make_path(points, closed=closed, smooth=smooth)
    except InputError as mistake:
        raise InputError(f"path file {path}: {mistake}") from mistake


# --------------------------------------------------------------------------------------------------
# Four paths on a sphere about the dome's centre: line, circle, square and spiral.


#: in the order of the world's parameter `shape`
SHAPES = ("line", "circle", "square", "spiral")
_FIRST_TILT_DEG = 6.0  #: start of the spiral [deg]
_TILT_PER_TURN_DEG = 9.0  #: increase of its tilt per turn [deg]


@lru_cache(maxsize=32)
def make_shape(name: str, size_deg: float = 25.0, radius: float = 0.05) -> GuidancePath:
    """The path `name` of SHAPES within `size_deg` [deg] of the summit, at `radius` [m] from the centre.

    line: over the summit, from `size_deg` on one side to the same on the other. circle: about the summit. square: its
    corners at `size_deg`. spiral: outward from 6°, 9° per turn. Raises UnknownName for another name.

    >>> make_shape("circle").closed, make_shape("spiral").closed
    (True, False)
    """
    if name not in SHAPES:
        raise UnknownName("path", name, SHAPES)
    if name == "line":
        return make_path(_place(np.linspace(-size_deg, size_deg, 9), np.zeros(9), radius), smooth=False)
    if name == "circle":
        turn = np.linspace(0.0, 2 * np.pi, 361)
        return make_path(_place(np.full(361, size_deg), turn, radius), closed=True, smooth=False)
    if name == "square":
        turn = np.radians([45.0, 135.0, 225.0, 315.0])
        return make_path(_place(np.full(4, size_deg), turn, radius), closed=True, smooth=False)
    turns = max((size_deg - _FIRST_TILT_DEG) / _TILT_PER_TURN_DEG, 0.5)
    turn = np.linspace(0.0, 2 * np.pi * turns, 1 + round(180 * turns))
    return make_path(_place(np.linspace(_FIRST_TILT_DEG, size_deg, len(turn)), turn, radius), smooth=False)


def _place(tilt_deg: Array, turn: Array, radius: float) -> Array:
    """(n, 3) [m] points at `tilt_deg` (n,) [deg] from the summit and azimuth `turn` (n,) [rad]."""
    tilt = np.radians(tilt_deg)
    return radius * np.column_stack([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])


# --------------------------------------------------------------------------------------------------
# Path as drawn in the console: a thin tube.


_TUBE_RADIUS_M = 0.35e-3  #: of the tube [m]
_RING_SPACING_M = 1.5e-3  #: spacing of the rings, up to `_MAX_RINGS` [m]
_MAX_RINGS = 320  #: limit for a path of 2 m, so that the page stays fast
_SIDES = 4


def draw_path(path: GuidancePath, lower: float = 0.0) -> Shape:
    """A tube along `path`, open at its ends, or closed as the path is; `lower` [m] nearer to the centre: the path
    of the tip below the tool's magnet.

    >>> from haptorb.worlds.path import make_shape
    >>> draw_path(make_shape("line")).kind
    'mesh'
    """
    last = len(path.places) - 1
    count = min(max(int(np.ceil(path.length / _RING_SPACING_M)), 2), _MAX_RINGS)
    rings = np.round(np.linspace(0, last, count + 1)).astype(int)
    centres, along = path.places[rings], path.tangents[rings]
    outward = centres / np.linalg.norm(centres, axis=1, keepdims=True)
    side = np.cross(along, outward)
    steep = np.linalg.norm(side, axis=1) < 0.1  # straight away from the centre: any normal direction is valid
    side[steep] = np.cross(along[steep], (0.6, 0.8, 0.0))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    turn = np.arange(_SIDES) * 2 * np.pi / _SIDES
    across = np.cos(turn)[:, None] * side[:, None] + np.sin(turn)[:, None] * np.cross(side, along)[:, None]
    points = (centres[:, None] - lower * outward[:, None] + _TUBE_RADIUS_M * across).round(5)
    here = _SIDES * np.arange(count)[:, None] + np.arange(_SIDES)
    beside = _SIDES * np.arange(count)[:, None] + (np.arange(_SIDES) + 1) % _SIDES
    corners = np.stack([here, beside, here + _SIDES, beside, beside + _SIDES, here + _SIDES], axis=-1)
    at = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    return Shape(
        "path", "mesh", (), "", at=at, role="path", points=tuple(points.ravel().tolist()),
        corners=tuple(corners.ravel().tolist()),
    )  # fmt: skip
