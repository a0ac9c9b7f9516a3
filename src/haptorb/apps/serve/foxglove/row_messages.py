"""Rows as messages that Foxglove's panels know: frames, pose, wrench, currents, temperatures, state, and an arrow.

Poses, logs and scenes are Foxglove's own types (protobuf), numbers for plots JSON objects whose keys
end in the unit: _n newton, _nm newton metre, _a ampere, _c degree Celsius, _s second.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, final

import numpy as np
from foxglove.messages import (
    ArrowPrimitive,
    Color,
    FrameTransform,
    FrameTransforms,
    Pose,
    PoseInFrame,
    Quaternion,
    SceneEntity,
    SceneUpdate,
    Timestamp,
    Vector3,
)

from haptorb.apps.serve.foxglove.device_shape import MOVER, STATOR, turn_to
from haptorb.apps.serve.foxglove.topics import Topic, make_json_schema, make_topic
from haptorb.control.protection.trip import CoilState, GuardState, Trip
from haptorb.devices.device import Device
from haptorb.numerics.arrays import Array
from haptorb.runtime.row import RowLayout

__all__ = ["ARROW", "RowMessages", "RowTopic"]

ARROW = 0.01  #: length of the arrow of 1 N [m]
_ICE = 273.15  #: [K]
_AXES = ("x", "y", "z")
_WRENCHES = ("asked", "modelled", "given")


@final
@dataclass(frozen=True)
class RowTopic:
    """A topic, how often a message of it is sent [Hz], what it is `about`, and how a row (width,) with its stamp [ns]
    becomes a message."""

    topic: Topic
    rate: float
    about: str
    encode: Callable[[Array, int], bytes]


@final
class RowMessages:
    """The topics of rows of `layout` of `device`."""

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
                "mover, pointer target and a motor's object in `stator`",
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
                "wrenches asked, modelled and given",
                self._encode_wrench,
            ),
            RowTopic(
                make_json_schema(
                    "/currents",
                    "haptorb.Currents",
                    {"wanted_a": _make_object(coils), "measured_a": _make_object(coils)},
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

    def _take(self, row: Array, name: str) -> list[float]:
        return [float(number) for number in row[self._layout[name]]]

    def _number(self, row: Array, name: str) -> float:
        return float(row[self._layout[name].start])

    def _encode_frames(self, row: Array, stamp: int) -> bytes:
        frames = [(MOVER, "p", "q"), ("target", "target", "target_q")]
        if self._moded:
            frames.append(("object", "object", "object_q"))
        transforms = [
            FrameTransform(
                timestamp=make_stamp(stamp),
                parent_frame_id=STATOR,
                child_frame_id=name,
                translation=_make_vector(self._take(row, place)),
                rotation=_make_turn(self._take(row, turn)),
            )
            for name, place, turn in frames
            if np.isfinite(row[self._layout[place]]).all() and np.isfinite(row[self._layout[turn]]).all()
        ]
        return FrameTransforms(transforms=transforms).encode()

    def _encode_pose(self, row: Array, stamp: int) -> bytes:
        pose = Pose(position=_make_vector(self._take(row, "p")), orientation=_make_turn(self._take(row, "q")))
        return PoseInFrame(timestamp=make_stamp(stamp), frame_id=STATOR, pose=pose).encode()

    def _encode_arrow(self, row: Array, stamp: int) -> bytes:
        force, place = row[self._layout["modelled"]][:3], self._take(row, "p")
        size = float(np.linalg.norm(force))
        arrows = []
        if math.isfinite(size) and size > 1e-6 and all(map(math.isfinite, place)):
            pose = Pose(position=_make_vector(place), orientation=_make_turn(turn_to(force / size, (1.0, 0.0, 0.0))))
            length = ARROW * size
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
            numbers = self._take(row, name)
            found[name] = {"force_n": _by_name(_AXES, numbers[:3]), "torque_nm": _by_name(_AXES, numbers[3:])}
        return _to_json(found, stamp)

    def _encode_currents(self, row: Array, stamp: int) -> bytes:
        wanted, measured = (_by_name(self._coils, self._take(row, name)) for name in ("wanted", "currents"))
        return _to_json({"wanted_a": wanted, "measured_a": measured}, stamp)

    def _encode_temperatures(self, row: Array, stamp: int) -> bytes:
        found = {}
        for name in ("winding", "boundary"):
            found[f"{name}_c"] = _by_name(self._coils, [kelvin - _ICE for kelvin in self._take(row, name)])
        remaining = _to_plain(self._number(row, "remaining"))
        return _to_json({**found, "remaining_s": remaining}, stamp)

    def _encode_state(self, row: Array, stamp: int) -> bytes:
        found = {
            "guard": name_code(GuardState, self._number(row, "guard")),
            "trip": name_code(Trip, self._number(row, "trip")),
            "coils": name_code(CoilState, self._number(row, "coil_state")),
            "gain": _to_plain(self._number(row, "gain")),
            "valid": self._number(row, "valid") == 1.0,
            "tick": _to_plain(self._number(row, "tick")),
            "lateness_s": _to_plain(self._number(row, "lateness")),
            "age_s": _to_plain(self._number(row, "age")),
        }
        return _to_json(found, stamp)


def name_code(kind: Any, code: float) -> str:
    """The name of `code` among those of `kind`; "unknown" for no code of it.

    >>> name_code(GuardState, 2.0), name_code(Trip, float("nan"))
    ('running', 'unknown')
    """
    return next((one.name.lower().replace("_", " ") for one in kind if one.value == code), "unknown")


def _name_coils(device: Device) -> list[str]:
    """The names of the coils, as paths of Foxglove's plots can have them."""
    names = device.coils.names
    return [name if name.isidentifier() else f"coil_{name}" for name in names]


def make_stamp(nanoseconds: int) -> Timestamp:
    """A time since 1970-01-01 UTC [ns] as Foxglove has it."""
    return Timestamp(nanoseconds // 10**9, nanoseconds % 10**9)


def _make_object(properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "object", "properties": properties}


def _make_vector(numbers: list[float]) -> Vector3:
    x, y, z = numbers
    return Vector3(x=x, y=y, z=z)


def _make_turn(numbers: Any) -> Quaternion:
    x, y, z, w = numbers
    return Quaternion(x=x, y=y, z=z, w=w)


def _by_name(names: Any, numbers: list[float]) -> dict[str, float | None]:
    return {name: _to_plain(number) for name, number in zip(names, numbers, strict=True)}


def _to_plain(number: float) -> float | None:
    """`number`, or null, for JSON knows neither NaN nor infinity."""
    return number if math.isfinite(number) else None


def _to_json(found: dict[str, Any], stamp: int) -> bytes:
    timestamp = {"sec": stamp // 10**9, "nsec": stamp % 10**9}
    return json.dumps({"timestamp": timestamp, **found}, allow_nan=False, ensure_ascii=False).encode()
