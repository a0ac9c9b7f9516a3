"""Geometry of a device: bodies with size and position, for drawings and the console."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields
from typing import Any, final

import numpy as np

from haptorb.arrays import Array

__all__ = ["Ball", "Edge", "Geometry", "Reach", "Rod", "RoundPart", "Spot", "describe_geometry", "list_assumed"]


@final
@dataclass(frozen=True)
class RoundPart:
    """A round body, solid or hollow, about its own axis: a coil's winding, or a magnet.

    Parts of the mover (`moves`) are given with the mover at its rest pose.
    """

    name: str  #: as messages call it
    role: str  #: "coil"; "magnet" that makes force or torque; "ring" that holds a rotor up
    position: Array  #: (3,) of its centre, stator frame [m]
    axis: Array  #: (3,) unit vector
    inner_radius: float  #: 0 for a solid one [m]
    outer_radius: float  #: [m]
    length: float  #: along the axis [m]
    channel: str = ""  #: of a coil: the name of the current that flows in it
    polarity: float = 0.0  #: of a magnet: positive where its north pole is at the axis' end, in shares of its strength
    moves: bool = False  #: whether it is a part of the mover
    stated: bool = True  #: False: its sizes are not in the device file and a drawing shows it not to scale


@final
@dataclass(frozen=True)
class Ball:
    """A sphere about the stator's origin."""

    name: str
    role: str  #: "core": solid; "dome": a surface that the tool touches
    radius: float  #: [m]
    inner_radius: float = 0.0  #: of a dome: where its wall ends inside; 0: no wall is stated [m]


@final
@dataclass(frozen=True)
class Spot:
    """A point on the stator."""

    name: str
    role: str  #: "sensor" or "mark"
    position: Array  #: (3,) stator frame [m]


@final
@dataclass(frozen=True)
class Rod:
    """A straight part of the mover with known ends but unknown thickness."""

    name: str
    start: Array  #: (3,) [m]
    end: Array  #: (3,) [m]


@final
@dataclass(frozen=True)
class Reach:
    """Range of a point of the mover: between two spheres about the origin, within a cone about +z."""

    name: str  #: of the point
    half_angle: float  #: [rad]
    nearest: float  #: [m]
    farthest: float  #: [m]


@final
@dataclass(frozen=True)
class Edge:
    """Line that bounds the workspace, fixed to the stator."""

    name: str
    points: Array  #: (n, 3) of the polygon [m]


@final
@dataclass(frozen=True)
class Geometry:
    """All parts of a device with size and position, as the console and `haptorb show` draw them.

    Parameters
    ----------
    round_parts : tuple of RoundPart
        Coils and magnets: rings and cylinders [m].
    balls : tuple of Ball
        Spheres, such as core and dome [m].
    spots : tuple of Spot
        Points, such as field sensors [m].
    rods : tuple of Rod
        Rods, such as a handle [m].
    edges : tuple of Edge
        Lines that bound a workspace that is no part of a sphere [m].
    reach : Reach, optional
        Workspace of the mover.
    notes : tuple of str
        What the device file does not state or assumes.
    """

    round_parts: tuple[RoundPart, ...]
    balls: tuple[Ball, ...] = ()
    spots: tuple[Spot, ...] = ()
    rods: tuple[Rod, ...] = ()
    edges: tuple[Edge, ...] = ()
    reach: Reach | None = None
    notes: tuple[str, ...] = ()

    def select_spots(self, role: str) -> tuple[Spot, ...]:
        """The points of that role, in order."""
        return tuple(spot for spot in self.spots if spot.role == role)

    @property
    def size(self) -> float:
        """Radius of a ball about the origin that contains every part [m]."""
        ends = [abs(ball.radius) for ball in self.balls]
        for part in self.round_parts:
            ends.append(float(np.linalg.norm(part.position)) + float(np.hypot(part.outer_radius, part.length / 2)))
        ends += [float(np.linalg.norm(spot.position)) for spot in self.spots]
        ends += [float(np.linalg.norm(point)) for rod in self.rods for point in (rod.start, rod.end)]
        ends += [float(np.linalg.norm(edge.points, axis=1).max()) for edge in self.edges]
        return max([*ends, self.reach.farthest if self.reach else 0.0, 1e-6])


def list_assumed(assumed: Mapping[str, str], keys: Collection[str]) -> tuple[str, ...]:
    """One note that names those of `keys` (a key, or a section) of the device file that are assumed; none for none.

    >>> list_assumed({"windings.turns": "…", "tool.mass": "…"}, ("windings",))
    ('assumed, not from the source: windings.turns',)
    """
    found = [name for name in assumed if any(name == key or name.startswith(f"{key}.") for key in keys)]
    return (f"assumed, not from the source: {', '.join(found)}",) if found else ()


# --------------------------------------------------------------------------------------------------
# A geometry in numbers, for programs: plain JSON types, units in the keys.


_UNITS = {
    **dict.fromkeys(("position", "inner_radius", "outer_radius", "length", "radius", "start", "end", "points"), "m"),
    **dict.fromkeys(("nearest", "farthest"), "m"),
    "half_angle": "deg",
}


def describe_geometry(geometry: Geometry) -> dict[str, Any]:
    """Every body and place of `geometry`, the mover's as they are at rest."""
    return {
        "parts": [_describe(part) for part in geometry.round_parts],
        "balls": [_describe(ball) for ball in geometry.balls],
        "spots": [_describe(spot) for spot in geometry.spots],
        "rods": [_describe(rod) for rod in geometry.rods],
        "edges": [_describe(edge) for edge in geometry.edges],
        "workspace": None if geometry.reach is None else _describe(geometry.reach),
        "notes": list(geometry.notes),
    }


def _describe(record: Any) -> dict[str, Any]:
    numbers = {}
    for one in fields(record):
        value = getattr(record, one.name)
        if isinstance(value, np.ndarray):
            value = value.tolist()
        elif one.name == "half_angle":
            value = math.degrees(value)
        unit = _UNITS.get(one.name)
        numbers[f"{one.name}_{unit}" if unit else one.name] = value
    return numbers
