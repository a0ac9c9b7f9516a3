"""Server of `--serve foxglove[:PORT]`: live view over WebSocket for programs of this account on this computer.

The messages are encoded by foxglove-sdk; the server is haptorb's own, because that of the SDK (0.30.3) accepts pages of
any origin and drops messages for a slow reader without a count.
"""

from __future__ import annotations

import asyncio
import contextlib
import http
import json
import math
import socket
import struct
from base64 import b64encode
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from math import pi
from time import monotonic, monotonic_ns, time_ns
from typing import Any, TypeGuard, final

import numpy as np
from foxglove.messages import (
    ArrowPrimitive,
    Color,
    FrameTransform,
    FrameTransforms,
    LinePrimitive,
    LinePrimitiveLineType,
    Log,
    LogLevel,
    Point3,
    Pose,
    PoseInFrame,
    Quaternion,
    SceneEntity,
    SceneUpdate,
    SpherePrimitive,
    Timestamp,
    TriangleListPrimitive,
    Vector3,
)
from websockets.asyncio.server import Server, ServerConnection
from websockets.asyncio.server import serve as serve_websocket
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.typing import Subprotocol

from haptorb.arrays import Array
from haptorb.control.trip_reasons import CoilState, GuardState, Trip
from haptorb.devices.base import Device
from haptorb.devices.geometry import Ball, RoundPart, Spot
from haptorb.recording.row import RowLayout
from haptorb.runtime.trackers.pose_filter import describe_trip
from haptorb.serve.base import (
    ServedDevice,
    ServerPreparation,
    check_port,
    open_port,
)
from haptorb.web.access import LOOPBACK, Access, choose_serve_token, is_own_connection

__all__ = [
    "ARROW_LENGTH_M",
    "DESKTOP",
    "FORM",
    "MAX_QUEUED_MESSAGES",
    "MOVER",
    "PAGES",
    "PORT",
    "STATOR",
    "LiveView",
    "RowMessages",
    "RowTopic",
    "Topic",
    "ViewerConnection",
    "make_json_schema",
    "make_shape",
    "make_topic",
    "make_tube",
    "prepare",
    "serve",
    "turn_to",
]


# --------------------------------------------------------------------------------------------------
# Shape of the device as one SceneUpdate: fixed parts in frame "stator", moving parts in frame "mover".


STATOR, MOVER = "stator", "mover"  #: names of the frames

_TUBE_SIDES = 36  #: polygon sides of a round part
_SPOT_RADIUS_FRACTION = 0.01  #: radius of a sensor or mark, as a fraction of the device's size
_ROD_THICKNESS_FRACTION = 0.004  #: thickness of a rod of unknown thickness, as a fraction of the device's size
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
    """Describe every part of `device` with a known position as one entity, in metres; none for a kind without geometry.

    Parts of the mover are relative to its origin, in frame "mover".
    """
    geometry = device.geometry()
    if geometry is None:
        return SceneUpdate(entities=[])
    rest = np.asarray(device.rest_position, dtype=np.float64)
    entities = [_describe_part(part, rest, stamp) for part in geometry.round_parts]
    entities += [_describe_ball(ball, stamp) for ball in geometry.balls]
    entities += [_describe_spot(spot, _SPOT_RADIUS_FRACTION * geometry.size, stamp) for spot in geometry.spots]
    thickness = _ROD_THICKNESS_FRACTION * geometry.size
    entities += [_describe_line(rod.name, np.stack([rod.start, rod.end]) - rest, MOVER, thickness, stamp)
                 for rod in geometry.rods]  # fmt: skip
    entities += [_describe_line(edge.name, edge.points, STATOR, thickness, stamp) for edge in geometry.edges]
    return SceneUpdate(entities=entities)


def make_tube(inner: float, outer: float, length: float, sides: int = _TUBE_SIDES) -> tuple[Array, list[int]]:
    """Triangulate a tube about z, or a solid cylinder if `inner` is 0: points (n, 3) [m], three indices per triangle.

    Radii and length in metres; triangles are counterclockwise seen from outside.
    """
    angles = 2.0 * pi * np.arange(sides) / sides
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    # One ring of points per corner of the profile, in order: up the outside, down the inside.
    profile = ((outer, -length / 2), (outer, length / 2), (inner, length / 2), (inner, -length / 2))
    points = np.concatenate([np.column_stack([radius * circle, np.full(sides, z)]) for radius, z in profile])
    indices: list[int] = []
    for edge in range(4):
        here, there = edge * sides, (edge + 1) % 4 * sides
        if inner == 0.0 and edge == 2:  # a solid cylinder has no inner wall
            continue
        for i in range(sides):
            j = (i + 1) % sides
            indices += [here + i, here + j, there + j, here + i, there + j, there + i]
    return points, indices


def turn_to(axis: Sequence[float] | Array, start: Sequence[float] = (0.0, 0.0, 1.0)) -> tuple[float, ...]:
    """Smallest rotation from the unit vector `start` to the unit vector `axis`, as a quaternion (x, y, z, w).

    >>> [round(number, 3) for number in turn_to((1.0, 0.0, 0.0))]
    [0.0, 0.707, 0.0, 0.707]
    """
    a, b = np.asarray(start, dtype=np.float64), np.asarray(axis, dtype=np.float64)
    w = 1.0 + float(a @ b)
    if w < 1e-9:  # opposite: 180° about any perpendicular axis
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


def _describe_line(name: str, points: Array, frame: str, thickness: float, stamp: Timestamp) -> SceneEntity:
    line = LinePrimitive(
        type=LinePrimitiveLineType.LineStrip,
        pose=_make_pose(np.zeros(3)),
        thickness=thickness,
        points=_make_points(points),
        color=_make_colour("rod"),
    )
    return SceneEntity(timestamp=stamp, frame_id=frame, id=name, frame_locked=True, lines=[line])


# --------------------------------------------------------------------------------------------------
# Topics as they are advertised to Foxglove: name, encoding and schema of the messages.


_TIME_SCHEMA = {
    "type": "object",
    "title": "time",
    "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}},
}


@final
@dataclass(frozen=True)
class Topic:
    """Topic: name, encoding of its messages, and their schema (text) with its own encoding."""

    name: str
    encoding: str
    schema_name: str
    schema_encoding: str
    schema: str

    def describe(self, number: int) -> dict[str, Any]:
        """Describe the topic as channel `number` of the protocol's message `advertise`."""
        return {
            "id": number,
            "topic": self.name,
            "encoding": self.encoding,
            "schemaName": self.schema_name,
            "schemaEncoding": self.schema_encoding,
            "schema": self.schema,
        }


def make_topic(name: str, kind: Any) -> Topic:
    """Make a topic with messages of one of Foxglove's types, a class of `foxglove.messages`."""
    schema = kind.get_schema()
    return Topic(name, "protobuf", schema.name, schema.encoding, b64encode(schema.data).decode())


def make_json_schema(name: str, title: str, properties: dict[str, Any]) -> Topic:
    """Make a topic of JSON objects with these `properties` and a `timestamp` (sec, nsec since 1970-01-01 UTC)."""
    schema = {"title": title, "type": "object", "properties": {"timestamp": _TIME_SCHEMA, **properties}}
    return Topic(name, "json", title, "jsonschema", json.dumps(schema, ensure_ascii=False))


# --------------------------------------------------------------------------------------------------
# Rows as messages for Foxglove's panels: frames, pose, wrench, currents, temperatures, state, and a force arrow.
#
# Poses, logs and scenes are Foxglove's own types (protobuf); numbers for plots are JSON objects whose keys
# end in the unit: _n newton, _nm newton metre, _a ampere, _c degree Celsius, _s second.


ARROW_LENGTH_M = 0.01  #: length of the arrow of 1 N [m]
_ZERO_CELSIUS_K = 273.15  #: 0 °C [K]
_AXES = ("x", "y", "z")
_WRENCHES = ("commanded", "model", "actual")


@final
@dataclass(frozen=True)
class RowTopic:
    """Topic derived from rows: `rate` of its messages [Hz], description `about`, and `encode` from a row (width,) and
    its time stamp [ns]."""

    topic: Topic
    rate: float
    about: str
    encode: Callable[[Array, int], bytes]


@final
class RowMessages:
    """Encoders of the topics for rows of `layout` of `device`."""

    def __init__(self, device: Device, layout: RowLayout) -> None:
        self._layout, self._coils, self._moded = layout, _name_coils(device), bool(device.kind.modes)
        vector = {"type": "object", "properties": {axis: {"type": "number"} for axis in _AXES}}
        wrench = {"force_n": vector, "torque_nm": vector}
        coils = {name: {"type": "number"} for name in self._coils}
        number, text, truth = {"type": "number"}, {"type": "string"}, {"type": "boolean"}
        self.topics = (
            RowTopic(
                make_topic("/tf", FrameTransforms),
                100.0,
                "mover, hand goal and a motor's object in `stator`",
                self._encode_frames,
            ),
            RowTopic(make_topic("/pose", PoseInFrame), 100.0, "estimated pose of the mover", self._encode_pose),
            RowTopic(
                make_topic("/force", SceneUpdate),
                30.0,
                "the force of the measured currents as an arrow",
                self._encode_arrow,
            ),
            RowTopic(
                make_json_schema("/wrench", "haptorb.Wrench", {name: _make_object(wrench) for name in _WRENCHES}),
                100.0,
                "commanded, modelled and actual wrench",
                self._encode_wrench,
            ),
            RowTopic(
                make_json_schema(
                    "/currents",
                    "haptorb.Currents",
                    {"commanded_a": _make_object(coils), "measured_a": _make_object(coils)},
                ),
                100.0,
                "currents commanded and measured, by coil",
                self._encode_currents,
            ),
            RowTopic(
                make_json_schema(
                    "/temperatures",
                    "haptorb.Temperatures",
                    {"winding_c": _make_object(coils), "boundary_c": _make_object(coils), "remaining_s": number},
                ),
                10.0,
                "temperatures of windings and boundaries, time until derating",
                self._encode_temperatures,
            ),
            RowTopic(
                make_json_schema(
                    "/state",
                    "haptorb.State",
                    {"guard": text, "trip": text, "coils": text, "gain": number, "valid": truth, "tick": number}
                    | {"lateness_s": number, "age_s": number},
                ),
                20.0,
                "guard, last trip, coils, gain, tick, lateness, age of the pose",
                self._encode_state,
            ),
        )

    def _read_field(self, row: Array, name: str) -> list[float]:
        return [float(number) for number in row[self._layout[name]]]

    def _read_number(self, row: Array, name: str) -> float:
        return float(row[self._layout[name].start])

    def _encode_frames(self, row: Array, stamp: int) -> bytes:
        frames = [(MOVER, "p", "q"), ("hand_goal", "hand_goal", "hand_goal_q")]
        if self._moded:
            frames.append(("object", "object", "object_q"))
        transforms = [
            FrameTransform(
                timestamp=make_stamp(stamp),
                parent_frame_id=STATOR,
                child_frame_id=name,
                translation=_make_vector(self._read_field(row, place)),
                rotation=_make_quaternion(self._read_field(row, turn)),
            )
            for name, place, turn in frames
            if np.isfinite(row[self._layout[place]]).all() and np.isfinite(row[self._layout[turn]]).all()
        ]
        return FrameTransforms(transforms=transforms).encode()

    def _encode_pose(self, row: Array, stamp: int) -> bytes:
        pose = Pose(
            position=_make_vector(self._read_field(row, "p")), orientation=_make_quaternion(self._read_field(row, "q"))
        )
        return PoseInFrame(timestamp=make_stamp(stamp), frame_id=STATOR, pose=pose).encode()

    def _encode_arrow(self, row: Array, stamp: int) -> bytes:
        force, place = row[self._layout["wrench_model"]][:3], self._read_field(row, "p")
        size = float(np.linalg.norm(force))
        arrows = []
        if math.isfinite(size) and size > 1e-6 and all(map(math.isfinite, place)):
            pose = Pose(
                position=_make_vector(place), orientation=_make_quaternion(turn_to(force / size, (1.0, 0.0, 0.0)))
            )
            length = ARROW_LENGTH_M * size
            arrows.append(
                ArrowPrimitive(
                    pose=pose, shaft_length=0.8 * length, shaft_diameter=0.0015, head_length=0.2 * length,
                    head_diameter=0.003, color=Color(r=0.85, g=0.1, b=0.1, a=1.0),
                )
            )  # fmt: skip
        entity = SceneEntity(timestamp=make_stamp(stamp), frame_id=STATOR, id="force", arrows=arrows)
        return SceneUpdate(entities=[entity]).encode()

    def _encode_wrench(self, row: Array, stamp: int) -> bytes:
        found = {}
        for name in _WRENCHES:
            numbers = self._read_field(row, f"wrench_{name}")
            found[name] = {"force_n": _zip_names(_AXES, numbers[:3]), "torque_nm": _zip_names(_AXES, numbers[3:])}
        return _to_json(found, stamp)

    def _encode_currents(self, row: Array, stamp: int) -> bytes:
        wanted, measured = (
            _zip_names(self._coils, self._read_field(row, name)) for name in ("current_commanded", "current_measured")
        )
        return _to_json({"commanded_a": wanted, "measured_a": measured}, stamp)

    def _encode_temperatures(self, row: Array, stamp: int) -> bytes:
        found = {}
        for name in ("winding", "boundary"):
            found[f"{name}_c"] = _zip_names(
                self._coils, [kelvin - _ZERO_CELSIUS_K for kelvin in self._read_field(row, name)]
            )
        remaining = _to_plain(self._read_number(row, "remaining"))
        return _to_json({**found, "remaining_s": remaining}, stamp)

    def _encode_state(self, row: Array, stamp: int) -> bytes:
        found = {
            "guard": name_code(GuardState, self._read_number(row, "guard")),
            "trip": name_code(Trip, self._read_number(row, "trip")),
            "coils": name_code(CoilState, self._read_number(row, "coil_state")),
            "gain": _to_plain(self._read_number(row, "gain")),
            "valid": self._read_number(row, "valid") == 1.0,
            "tick": _to_plain(self._read_number(row, "tick")),
            "lateness_s": _to_plain(self._read_number(row, "lateness")),
            "age_s": _to_plain(self._read_number(row, "age")),
        }
        return _to_json(found, stamp)


def name_code(kind: Any, code: float) -> str:
    """Name of `code` in the enumeration `kind`; "unknown" for a code that it lacks.

    >>> name_code(GuardState, 2.0), name_code(Trip, float("nan"))
    ('running', 'unknown')
    """
    return next((one.name.lower().replace("_", " ") for one in kind if one.value == code), "unknown")


def _name_coils(device: Device) -> list[str]:
    """Names of the coils, valid in message paths of Foxglove's plots."""
    names = device.coils.names
    return [name if name.isidentifier() else f"coil_{name}" for name in names]


def make_stamp(nanoseconds: int) -> Timestamp:
    """Convert a time since 1970-01-01 UTC [ns] to Foxglove's Timestamp."""
    return Timestamp(nanoseconds // 10**9, nanoseconds % 10**9)


def _make_object(properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "object", "properties": properties}


def _make_vector(numbers: list[float]) -> Vector3:
    x, y, z = numbers
    return Vector3(x=x, y=y, z=z)


def _make_quaternion(numbers: Any) -> Quaternion:
    x, y, z, w = numbers
    return Quaternion(x=x, y=y, z=z, w=w)


def _zip_names(names: Any, numbers: list[float]) -> dict[str, float | None]:
    return {name: _to_plain(number) for name, number in zip(names, numbers, strict=True)}


def _to_plain(number: float) -> float | None:
    """Replace NaN and infinity by None, because JSON has neither."""
    return number if math.isfinite(number) else None


def _to_json(found: dict[str, Any], stamp: int) -> bytes:
    timestamp = {"sec": stamp // 10**9, "nsec": stamp % 10**9}
    return json.dumps({"timestamp": timestamp, **found}, allow_nan=False, ensure_ascii=False).encode()


# --------------------------------------------------------------------------------------------------
# Connection of one viewer: its subscriptions and its message queue.


MAX_QUEUED_MESSAGES = 256  #: messages queued for a viewer; above it, the oldest are dropped and counted
_MAX_SUBSCRIPTIONS = 64  #: subscriptions of one viewer
_MESSAGE_HEADER = struct.Struct("<BIQ")  #: operation 1 (message data), subscription, time [ns]


@final
class ViewerConnection:
    """Subscriptions and message queue of one viewer; `name` is shown to the user."""

    def __init__(self, name: str, session: int, topics: int) -> None:
        self.name, self.session = name, session
        self._topics = topics
        self._subscriptions: dict[int, int] = {}  # subscription id of the viewer → topic
        self._queue: deque[bytes] = deque()
        self._arrival = asyncio.Event()
        self.sent = 0  #: messages passed to the connection
        self.dropped = 0  #: messages dropped because the viewer read too slowly

    def is_subscribed(self, topic: int) -> bool:
        """Whether the viewer subscribed to the topic with this number."""
        return topic in self._subscriptions.values()

    def enqueue(self, topic: int, data: bytes, stamp: int) -> None:
        """Enqueue the message `data` of a topic, time `stamp` [ns since 1970 UTC], once per subscription to it."""
        for number, wanted in self._subscriptions.items():
            if wanted == topic:
                if len(self._queue) >= MAX_QUEUED_MESSAGES:
                    self._queue.popleft()
                    self.dropped += 1
                self._queue.append(_MESSAGE_HEADER.pack(1, number, stamp) + data)
                self._arrival.set()

    async def dequeue(self) -> bytes:
        """Wait for the oldest queued message and remove it from the queue."""
        while not self._queue:
            self._arrival.clear()
            await self._arrival.wait()
        self.sent += 1
        return self._queue.popleft()

    def handle_message(self, text: str | bytes) -> list[int]:
        """Apply a subscription message of the viewer; returns the newly subscribed topics.

        Other messages are ignored: a viewer may request more than this server offers."""
        try:
            message = json.loads(text)
        except (ValueError, RecursionError):
            return []
        if not isinstance(message, dict):
            return []
        match message.get("op"):
            case "subscribe":
                return [topic for one in _read_entries(message.get("subscriptions")) for topic in self._subscribe(one)]
            case "unsubscribe":
                for number in _read_entries(message.get("subscriptionIds")):
                    if isinstance(number, int):
                        self._subscriptions.pop(number, None)
        return []

    def _subscribe(self, asked: Any) -> list[int]:
        number, topic = (asked.get("id"), asked.get("channelId")) if isinstance(asked, dict) else (None, None)
        if not _is_number(number) or not _is_number(topic):
            return []
        if not 1 <= topic <= self._topics or len(self._subscriptions) >= _MAX_SUBSCRIPTIONS:
            return []
        self._subscriptions[number] = topic
        return [topic]


def _read_entries(value: Any) -> list[Any]:
    return value[:_MAX_SUBSCRIPTIONS] if isinstance(value, list) else []


def _is_number(value: Any) -> TypeGuard[int]:
    """Whether `value` is a valid id of a subscription or channel (uint32)."""
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 1 << 32


# --------------------------------------------------------------------------------------------------
# Publisher for all viewers: rows at the rates of the topics, the device's shape, and a log.


_MAX_LOG_MESSAGES = 50  #: log messages sent to a new viewer
_LOG_SOURCE = "haptorb"


@final
class LiveView:
    """Topics of `served` and the viewers that are connected to them."""

    def __init__(self, served: ServedDevice) -> None:
        self._served = served
        self._rows = RowMessages(served.device, served.layout).topics
        self._due = [float("-inf")] * len(self._rows)
        self._utc = time_ns() - monotonic_ns()
        shape, log = make_topic("/shape", SceneUpdate), make_topic("/log", Log)
        #: in the order of their channel ids, which begin with 1
        self.topics: tuple[Topic, ...] = (*(one.topic for one in self._rows), shape, log)
        self._shape, self._log = len(self.topics) - 1, len(self.topics)
        self._past_log: deque[tuple[int, bytes]] = deque(maxlen=_MAX_LOG_MESSAGES)
        self._last_logged: tuple[float, float, float] | None = None  # guard, trip and world of the previous row
        self.viewers: set[ViewerConnection] = set()

    def enqueue_latched(self, viewer: ViewerConnection, topics: list[int]) -> None:
        """Enqueue for `viewer` the messages of its new `topics` that are not repeated: the shape and the past log."""
        stamp = time_ns()
        if self._shape in topics:
            viewer.enqueue(self._shape, make_shape(self._served.device, make_stamp(stamp)).encode(), stamp)
        if self._log in topics:
            for earlier, data in self._past_log:
                viewer.enqueue(self._log, data, earlier)

    def publish(self, rows: Array) -> None:
        """Publish `rows` (n, width), oldest first, to the subscribed viewers, each topic at its own rate."""
        t, wall = self._served.layout["t"].start, self._served.layout["wall"].start
        for row in rows:
            moment, stamp = float(row[t]), int(row[wall] * 1e9) + self._utc
            self._log_changes(row, stamp)
            for i, one in enumerate(self._rows):
                if moment < self._due[i] - 1e-6:
                    continue
                gap = 1.0 / one.rate
                self._due[i] = (self._due[i] if moment - self._due[i] < gap else moment) + gap
                listening = [viewer for viewer in self.viewers if viewer.is_subscribed(i + 1)]
                if listening:
                    data = one.encode(row, stamp)
                    for viewer in listening:
                        viewer.enqueue(i + 1, data, stamp)

    def _log_changes(self, row: Array, stamp: int) -> None:
        """Log a trip, a change of the guard's state, and a change of the world."""
        layout = self._served.layout
        guard, trip, world = (float(row[layout[name].start]) for name in ("guard", "trip", "world"))
        now, before = (guard, trip, world), self._last_logged
        if now == before:
            return
        self._last_logged = now
        if before is None or guard != before[0]:
            level = LogLevel.Error if guard == GuardState.TRIPPED else LogLevel.Info
            reason = next((one for one in Trip if one == trip), Trip.NONE)
            tripped = guard == GuardState.TRIPPED and reason is not Trip.NONE
            text = describe_trip(reason, self._served.facts["tracker"]) if tripped else name_code(GuardState, guard)
            self._publish_log(level, f"trip {reason.name}: {text}" if tripped else f"guard: {text}", stamp)
        if before is None or world != before[2]:
            name = self._served.world.get("name", "")
            self._publish_log(LogLevel.Info, f"world: {name}", stamp)

    def _publish_log(self, level: LogLevel, text: str, stamp: int) -> None:
        data = Log(timestamp=make_stamp(stamp), level=level, message=text, name=_LOG_SOURCE).encode()
        self._past_log.append((stamp, data))
        for viewer in self.viewers:
            viewer.enqueue(self._log, data, stamp)


FORM = "foxglove[:PORT]"
PORT = 8766  #: default port; Foxglove's own default, 8765, is used by the console

_PROTOCOLS = (Subprotocol("foxglove.sdk.v1"), Subprotocol("foxglove.websocket.v1"))
_POLL_INTERVAL_S = 0.005  #: polling interval of the rows [s]
_REPORT_INTERVAL_S = 0.25  #: between two reports [s]
_MAX_VIEWERS = 16  #: viewers at the same time
_MAX_MESSAGE_BYTES = 65536  #: longest message of a viewer [bytes]
_MAX_UNSENT_BYTES = 65536  #: write buffer of a connection [bytes]; further messages wait in the viewer's queue

PAGES = r"https://([a-z0-9-]+\.)*foxglove\.dev"  #: origins of Foxglove in a browser
#: Origin of Foxglove Studio and Lichtblick on the desktop, whose window is a page from a file. A browser sends the same
#: for any HTML file that somebody opens, so it needs the token.
DESKTOP = "file://"


def prepare(where: str) -> ServerPreparation:
    """Open the PORT. Raises InputError if it is not available."""
    token = choose_serve_token(LOOPBACK, always=True)
    opened = open_port(check_port(where, FORM) if where else PORT, f"--serve {FORM}")
    address = f"ws://{LOOPBACK}:{opened.getsockname()[1]}"
    remarks = (f"Foxglove's and Lichtblick's desktop program: open {address}/?token={token}",)
    return ServerPreparation({"address": address, "token": token}, address, [opened.detach()], remarks)


def serve(spec: dict[str, Any], descriptors: list[int], served: ServedDevice) -> None:
    """Serve until `served.over`; `spec` and `descriptors` are those of `prepare`."""
    asyncio.run(_FoxgloveServer(served, spec["address"], spec["token"]).run(socket.socket(fileno=descriptors[0])))


@final
class _FoxgloveServer:
    def __init__(self, served: ServedDevice, address: str, token: str) -> None:
        self._served, self._address, self._access = served, address, Access(token, PAGES, DESKTOP)
        self._view = LiveView(served)
        self._refused = self._dropped = 0
        self._last = monotonic()
        self._counts: dict[ViewerConnection, int] = {}

    async def run(self, opened: socket.socket) -> None:
        async with serve_websocket(
            self._serve_viewer, sock=opened, subprotocols=_PROTOCOLS, process_request=self._check, compression=None,
            max_size=_MAX_MESSAGE_BYTES, max_queue=4, write_limit=_MAX_UNSENT_BYTES, server_header=None,
            logger=_make_silent_logger(),
        ) as server:  # fmt: skip
            while not self._served.over:
                self._view.publish(self._served.read_rows())
                if monotonic() - self._last >= _REPORT_INTERVAL_S:
                    self._report()
                await asyncio.sleep(_POLL_INTERVAL_S)
            self._report()
            _abort(server)

    def _check(self, connection: ServerConnection, request: Request) -> Response | None:
        """Refuse pages of other sites, programs of other accounts, and viewers above the maximum."""
        names = {name.lower(): value for name, value in request.headers.raw_items()}
        transport = connection.transport
        own = is_own_connection(transport.get_extra_info("peername"), transport.get_extra_info("sockname"))
        repeated = any(len(request.headers.get_all(name)) > 1 for name in ("Origin", "Host"))
        refusal = self._access.refuse(LOOPBACK, names, request.path, own=own)
        if repeated or refusal:
            self._refused += 1
            return connection.respond(http.HTTPStatus.FORBIDDEN, f"{refusal or 'Origin or Host is there twice'}\n")
        if len(self._view.viewers) >= _MAX_VIEWERS:
            self._refused += 1
            return connection.respond(
                http.HTTPStatus.SERVICE_UNAVAILABLE, f"{_MAX_VIEWERS} viewers are already connected\n"
            )
        return None

    async def _serve_viewer(self, connection: ServerConnection) -> None:
        address = connection.remote_address or ("?", 0)
        viewer = ViewerConnection(f"{address[0]}:{address[1]}", self._served.open_session(), len(self._view.topics))
        with contextlib.suppress(ConnectionClosed):
            await connection.send(json.dumps(self._describe_server()))
            channels = [topic.describe(number) for number, topic in enumerate(self._view.topics, 1)]
            await connection.send(json.dumps({"op": "advertise", "channels": channels}))
            sending = asyncio.create_task(_send(connection, viewer))
            self._view.viewers.add(viewer)
            try:
                async for text in connection:
                    self._view.enqueue_latched(viewer, viewer.handle_message(text))
            finally:
                self._view.viewers.discard(viewer)
                self._dropped += viewer.dropped
                self._counts.pop(viewer, None)
                sending.cancel()

    def _describe_server(self) -> dict[str, Any]:
        facts = {key: str(self._served.facts.get(key, "")) for key in ("driver", "tracker", "haptorb")}
        return {
            "op": "serverInfo",
            "name": f"haptorb, {self._served.device.name}",
            "capabilities": [],
            "supportedEncodings": [],
            "metadata": facts,
            "sessionId": str(time_ns()),
        }

    def _report(self) -> None:
        now = monotonic()
        seconds, self._last = max(now - self._last, 1e-3), now
        clients, dropped = [], self._dropped
        for viewer in self._view.viewers:
            rate = (viewer.sent - self._counts.get(viewer, 0)) / seconds
            self._counts[viewer] = viewer.sent
            clients.append({"name": viewer.name, "session": viewer.session, "rate_hz": round(rate, 1), "holds": False})
            dropped += viewer.dropped
        self._served.report("foxglove", self._address, clients, not_sent=dropped, refused=self._refused)


async def _send(connection: ServerConnection, viewer: ViewerConnection) -> None:
    with contextlib.suppress(ConnectionClosed):
        while True:
            await connection.send(await viewer.dequeue())


def _abort(server: Server) -> None:
    """Abort all connections: an orderly close would wait for a viewer that does not read."""
    for connection in list(server.connections):
        connection.transport.abort()


def _make_silent_logger() -> Any:
    import logging

    silent = logging.getLogger("haptorb.foxglove")
    silent.addHandler(logging.NullHandler())
    silent.propagate = False
    return silent
