"""A tool that a person led over the dome, as the field sensors saw it: readings, first poses, and whether it went far.

Which motion separates a sensor's errors: the tool on every side, near and far, upright and leaning. What was not
visited is named, because a person can go there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.errors import CalibrationError
from haptorb.numerics.arrays import Array

__all__ = ["ToolTour", "check_tour", "choose_readings"]

_SECTORS = 6  #: of azimuth
_LEAST_READINGS = 120
_LEAST_IN_SECTOR = 5
_OUTER = 0.35  #: share of the workspace's angle from which a place belongs to a sector
_WIDE = 0.7  #: share of the workspace's angle that must be reached
_SPAN = 0.35  #: share of the shell's thickness that must lie between low and high readings
_LEAN = np.radians(8.0)  #: of a tenth of the readings at least


@dataclass(frozen=True)
class ToolTour:
    """n readings along the way: fields (n, k, 3) [T], coils off, and first estimates of places (n, 3) [m] and axes.

    noise: standard deviation of one of these readings, each axis [T].
    """

    fields: Array
    places: Array
    axes: Array
    noise: float


def check_tour(device: SphericalElectromagnet, tour: ToolTour) -> None:
    """CalibrationError that names what is missing, unless the tool went over the whole dome."""
    if len(tour.places) < _LEAST_READINGS:
        raise CalibrationError(
            f"the tool was found in {len(tour.places)} readings only, at least {_LEAST_READINGS} are needed: keep it "
            "within the shell above the dome, its tip towards the dome, for the whole time"
        )
    distance = np.linalg.norm(tour.places, axis=1)
    outward = tour.places / distance[:, None]
    polar = np.arccos(np.clip(outward[:, 2], -1.0, 1.0))
    half = device.workspace_half_angle
    azimuth = np.degrees(np.arctan2(outward[:, 1], outward[:, 0])) % 360
    sector = (azimuth // (360 / _SECTORS)).astype(int)
    lean = np.arccos(np.clip(np.einsum("ni,ni->n", outward, tour.axes), -1.0, 1.0))
    low, high = np.percentile(distance, (5, 95))
    missing = []
    visits = np.bincount(sector[polar > _OUTER * half], minlength=_SECTORS)
    empty = np.flatnonzero(visits < _LEAST_IN_SECTOR)
    if len(empty):
        wide = 360 // _SECTORS
        sides = ", ".join(f"{wide * one}° to {wide * (one + 1)}°" for one in empty)
        missing.append(f"it was not on these sides of the dome, counted from +x: {sides}")
    reached = float(np.percentile(polar, 98))
    if reached < _WIDE * half:
        missing.append(
            f"it reached {np.degrees(reached):.0f}° from the summit, at least {np.degrees(_WIDE * half):.0f}° are "
            "needed"
        )
    if high - low < _SPAN * device.shell_thickness:
        missing.append(
            f"its height varied by {1e3 * (high - low):.1f} mm, at least {1e3 * _SPAN * device.shell_thickness:.0f} mm "
            "are needed"
        )
    if float(np.percentile(lean, 90)) < _LEAN:
        missing.append(
            f"it was tilted by {np.degrees(np.percentile(lean, 90)):.0f}°, at least {np.degrees(_LEAN):.0f}° are needed"
        )
    if missing:
        raise CalibrationError(
            "the tool was not moved enough: " + "; ".join(missing) + ". Move it over the whole dome, down to the "
            "edge on every side, lift and lower it, and tilt it to all sides"
        )


def choose_readings(tour: ToolTour, most: int) -> ToolTour:
    """At most `most` of the readings, evenly along the way."""
    chosen = np.unique(np.linspace(0, len(tour.places) - 1, most).round().astype(int))
    return ToolTour(tour.fields[chosen], tour.places[chosen], tour.axes[chosen], tour.noise)
