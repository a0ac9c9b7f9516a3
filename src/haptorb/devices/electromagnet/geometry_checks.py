"""Places of an electromagnet's file that cannot be, although every value by itself is well-formed."""

from __future__ import annotations

import numpy as np

from haptorb.numerics.arrays import Array

__all__ = ["list_geometry_mistakes"]

_ENGRAVED = 2e-3  #: how deep a dot in the dome may be [m]


def list_geometry_mistakes(
    core_radius: float, dome_radius: float, sensors: Array, mark_names: tuple[str, ...], marks: Array
) -> list[str]:
    """Sentences; none is a pass. Radii [m], sensors (n, 3) and marks (k, 3) in the stator frame [m]."""
    found = []
    for name, distance in zip(mark_names, np.linalg.norm(marks, axis=1), strict=True):
        if distance < dome_radius - _ENGRAVED:
            found.append(
                f"marks.positions: mark '{name}' is {distance * 1e3:.3g} mm from the centre, inside the dome "
                f"({dome_radius * 1e3:g} mm), where no tip can touch it; give the bottom of its dot, at most "
                f"{_ENGRAVED * 1e3:g} mm below the dome's surface, in the stator frame"
            )
    for number, distance in enumerate(np.linalg.norm(sensors, axis=1), 1):
        if distance < core_radius:
            found.append(
                f"hall.positions: sensor {number} is {distance * 1e3:.3g} mm from the centre, inside the core "
                f"({core_radius * 1e3:g} mm); state its position in the stator frame"
            )
    return found
