"""The point of a path nearest to the hand, searched near that of the previous tick."""

from __future__ import annotations

import numpy as np

from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel

__all__ = ["fill_frame", "find_arc", "follow_arc"]


@kernel
def _square(p: Array, places: Array, k: int) -> float:
    x, y, z = p[0] - places[k, 0], p[1] - places[k, 1], p[2] - places[k, 2]
    square: float = x * x + y * y + z * z
    return square


@kernel
def _refine(p: Array, places: Array, spacing: float, k: int) -> float:
    """The arc length [m] of the point nearest to p, near the place k, on the line through its neighbours."""
    first, last = max(k - 1, 0), min(k + 1, places.shape[0] - 1)
    along, square = 0.0, 0.0
    for i in range(3):
        step = places[last, i] - places[first, i]
        along += (p[i] - places[k, i]) * step
        square += step * step
    share = along / square * (last - first) if square > 0.0 else 0.0
    arc: float = spacing * min(max(k + min(max(share, -0.5), 0.5), 0.0), places.shape[0] - 1.0)
    return arc


@kernel
def find_arc(p: Array, places: Array, spacing: float) -> float:
    """Arc length [m] of the point of the path nearest to p (3,) [m], over the whole path."""
    best, nearest = 0, np.inf
    for k in range(places.shape[0]):
        square = _square(p, places, k)
        if square < nearest:
            best, nearest = k, square
    return _refine(p, places, spacing, best)


@kernel
def follow_arc(p: Array, places: Array, spacing: float, closed: bool, arc: float, reach: float) -> float:
    """Arc length [m] of the nearest point within `reach` [m] of `arc` [m] along the path, so that progress does not
    jump to another section nearby."""
    count = places.shape[0] - 1
    middle, window = round(arc / spacing), max(round(reach / spacing), 1)
    best, nearest = 0, np.inf
    for n in range(middle - window, middle + window + 1):
        k = n
        if closed:
            k = n % count
        elif n < 0 or n > count:
            continue
        square = _square(p, places, k)
        if square < nearest:
            best, nearest = k, square
    found = _refine(p, places, spacing, best)
    return found % (count * spacing) if closed else found


@kernel
def fill_frame(places: Array, tangents: Array, spacing: float, arc: float, frame: Array) -> None:
    """frame (4, 3): the point at `arc` [m], the tangent, the sideways direction and the outward direction there."""
    last = places.shape[0] - 1
    at = min(max(arc / spacing, 0.0), float(last))
    k = min(int(at), last - 1)
    share = at - k
    length, radius, along = 0.0, 0.0, 0.0
    for i in range(3):
        frame[0, i] = places[k, i] + share * (places[k + 1, i] - places[k, i])
        frame[1, i] = tangents[k, i] + share * (tangents[k + 1, i] - tangents[k, i])
        length += frame[1, i] * frame[1, i]
        radius += frame[0, i] * frame[0, i]
    length, radius = np.sqrt(length), np.sqrt(radius)
    for i in range(3):
        frame[1, i] /= length
        along += frame[1, i] * frame[0, i] / radius
    length = 0.0
    for i in range(3):
        frame[3, i] = frame[0, i] / radius - along * frame[1, i]
        length += frame[3, i] * frame[3, i]
    length = np.sqrt(length)
    if not length > 1e-6:  # straight away from the centre: any direction across will do
        x = 1.0 if abs(frame[1, 0]) < 0.7 else 0.0
        for i in range(3):
            frame[3, i] = (x if i == 0 else (1.0 - x if i == 1 else 0.0)) - (
                frame[1, 0] * x + frame[1, 1] * (1.0 - x)
            ) * frame[1, i]
        length = np.sqrt(frame[3, 0] ** 2 + frame[3, 1] ** 2 + frame[3, 2] ** 2)
    for i in range(3):
        frame[3, i] /= length
    frame[2, 0] = frame[3, 1] * frame[1, 2] - frame[3, 2] * frame[1, 1]
    frame[2, 1] = frame[3, 2] * frame[1, 0] - frame[3, 0] * frame[1, 2]
    frame[2, 2] = frame[3, 0] * frame[1, 1] - frame[3, 1] * frame[1, 0]
