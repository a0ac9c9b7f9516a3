"""The device's shape as one SceneUpdate: the fixed parts in frame "stator", the moving ones in frame "mover"."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import pi

import numpy as np
from foxglove.messages import (
    Color,
    LinePrimitive,
    LinePrimitiveLineType,
    Point3,
    Pose,
    Quaternion,
    SceneEntity,
    SceneUpdate,
    SpherePrimitive,
    Timestamp,
    TriangleListPrimitive,
    Vector3,
)

from haptorb.devices.device import Device
from haptorb.devices.geometry import Ball, Geometry, Rod, RoundPart, Spot
from haptorb.numerics.arrays import Array

__all__ = ["MOVER", "STATOR", "make_shape", "make_tube", "turn_to"]

STATOR, MOVER = "stator", "mover"  #: names of the frames

_SIDES = 36  #: of a round part
_SPOT = 0.01  #: radius of a sensor or mark, in shares of the device's size
_ROD = 0.004  #: thickness of a rod whose thickness is not known, the same
_COLOURS = {  # red, green, blue, opacity
    "coil": (0.80, 0.47, 0.24, 1.0),
    "magnet": (0.62, 0.64, 0.68, 1.0),
    "ring": (0.45, 0.48, 0.55, 1.0),
    "core": (0.30, 0.31, 0.34, 1.0),
    "dome": (0.55, 0.75, 0.95, 0.25),
    "sensor": (0.20, 0.65, 0.35, 1.0),
    "mark": (0.95, 0.75, 0.15, 1.0),
    "rod": (0.25, 0.25, 0.28, 1.0),
}


def make_shape(device: Device, stamp: Timestamp) -> SceneUpdate:
    """Every part of `device` whose place is known, one entity each, in metres; of a kind without geometry, none.

    Parts of the mover are at their places relative to the mover's origin, so that frame "mover" carries them.
    """
    describe = device.kind.part("geometry")
    if describe is None:
        return SceneUpdate(entities=[])
    geometry: Geometry = describe(device)
    rest = np.asarray(device.rest_position, dtype=np.float64)
    entities = [_describe_part(part, rest, stamp) for part in geometry.round_parts]
    entities += [_describe_ball(ball, stamp) for ball in geometry.balls]
    entities += [_describe_spot(spot, _SPOT * geometry.size, stamp) for spot in geometry.spots]
    entities += [_describe_rod(rod, rest, _ROD * geometry.size, stamp) for rod in geometry.rods]
    return SceneUpdate(entities=entities)


def make_tube(inner: float, outer: float, length: float, sides: int = _SIDES) -> tuple[Array, list[int]]:
    """(points (n, 3) [m], indices of triangles, three each) of a tube about z, or of a solid cylinder if `inner` is 0.

    Seen from outside, the corners of each triangle run counterclockwise. [m]
    """
    angles = 2.0 * pi * np.arange(sides) / sides
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    # A ring of points for each edge of the profile, in the order in which it is walked: outside up, inside down.
    profile = ((outer, -length / 2), (outer, length / 2), (inner, length / 2), (inner, -length / 2))
    points = np.concatenate([np.column_stack([radius * circle, np.full(sides, z)]) for radius, z in profile])
    indices: list[int] = []
    for edge in range(4):
        here, there = edge * sides, (edge + 1) % 4 * sides
        if inner == 0.0 and edge == 2:  # a solid one has no inner wall
            continue
        for i in range(sides):
            j = (i + 1) % sides
            indices += [here + i, here + j, there + j, here + i, there + j, there + i]
    return points, indices


def turn_to(axis: Sequence[float] | Array, start: Sequence[float] = (0.0, 0.0, 1.0)) -> tuple[float, ...]:
    """The least rotation that brings the unit vector `start` to the unit vector `axis`, as a quaternion (x, y, z, w).

    >>> [round(number, 3) for number in turn_to((1.0, 0.0, 0.0))]
    [0.0, 0.707, 0.0, 0.707]
    """
    a, b = np.asarray(start, dtype=np.float64), np.asarray(axis, dtype=np.float64)
    w = 1.0 + float(a @ b)
    if w < 1e-9:  # opposite: half a turn about any axis across
        across = np.cross(a, (1.0, 0.0, 0.0) if abs(a[0]) < 0.9 else (0.0, 1.0, 0.0))
        return (*(across / np.linalg.norm(across)).tolist(), 0.0)
    turn = np.array([*np.cross(a, b), w])
    return tuple((turn / np.linalg.norm(turn)).tolist())


def _make_pose(position: Array, turn: Sequence[float] = (0.0, 0.0, 0.0, 1.0)) -> Pose:
    x, y, z = (float(number) for number in position)
    qx, qy, qz, qw = turn
    return Pose(position=Vector3(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw))


def _make_colour(role: str) -> Color:
    r, g, b, a = _COLOURS.get(role, (0.6, 0.6, 0.6, 1.0))
    return Color(r=r, g=g, b=b, a=a)


def _make_points(points: Iterable[Array]) -> list[Point3]:
    return [Point3(x=float(x), y=float(y), z=float(z)) for x, y, z in points]


def _describe_part(part: RoundPart, rest: Array, stamp: Timestamp) -> SceneEntity:
    points, indices = make_tube(part.inner_radius, part.outer_radius, part.length)
    place = part.position - rest if part.moves else part.position
    mesh = TriangleListPrimitive(
        pose=_make_pose(place, turn_to(part.axis)),
        points=_make_points(points),
        color=_make_colour(part.role),
        indices=indices,
    )
    frame = MOVER if part.moves else STATOR
    return SceneEntity(timestamp=stamp, frame_id=frame, id=part.name, frame_locked=True, triangles=[mesh])


def _describe_ball(ball: Ball, stamp: Timestamp) -> SceneEntity:
    across = 2.0 * ball.radius
    sphere = SpherePrimitive(
        pose=_make_pose(np.zeros(3)), size=Vector3(x=across, y=across, z=across), color=_make_colour(ball.role)
    )
    return SceneEntity(timestamp=stamp, frame_id=STATOR, id=ball.name, frame_locked=True, spheres=[sphere])


def _describe_spot(spot: Spot, radius: float, stamp: Timestamp) -> SceneEntity:
    across = 2.0 * radius
    sphere = SpherePrimitive(
        pose=_make_pose(spot.position), size=Vector3(x=across, y=across, z=across), color=_make_colour(spot.role)
    )
    return SceneEntity(timestamp=stamp, frame_id=STATOR, id=spot.name, frame_locked=True, spheres=[sphere])


def _describe_rod(rod: Rod, rest: Array, thickness: float, stamp: Timestamp) -> SceneEntity:
    line = LinePrimitive(
        type=LinePrimitiveLineType.LineStrip,
        pose=_make_pose(np.zeros(3)),
        thickness=thickness,
        points=_make_points((rod.start - rest, rod.end - rest)),
        color=_make_colour("rod"),
    )
    return SceneEntity(timestamp=stamp, frame_id=MOVER, id=rod.name, frame_locked=True, lines=[line])
