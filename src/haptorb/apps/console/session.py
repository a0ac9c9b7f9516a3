"""What the page must know before the first frame: device, worlds and their sliders, limits, words for codes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from haptorb.apps.console.pointer_relay import patience_for
from haptorb.apps.console.running_servo import DescribedServo, RunningServo
from haptorb.apps.console.scenes import axes_scene, list_shapes
from haptorb.apps.console.target import target_scene, world_remarks
from haptorb.apps.console.wire import Columns
from haptorb.control.allocation.allocator import Saturation
from haptorb.control.protection.trip import Trip
from haptorb.devices.device import Device
from haptorb.errors import InputError
from haptorb.runtime.trackers.pose_source import describe_trip
from haptorb.runtime.trackers.tracker_registry import has_feed
from haptorb.version import __version__
from haptorb.worlds import CATALOGUE, World
from haptorb.worlds.parameter import parameters
from haptorb.worlds.parameter import values as parameter_values

__all__ = ["describe_world", "press_buttons", "read_world", "session", "world_now", "worlds", "worlds_now"]

_KELVIN = 273.15
_NAME = 64  #: of a world or a value [characters]
_VALUES = 64  #: of a world


def worlds(device: Device, own: Mapping[str, World]) -> list[dict[str, Any]]:
    """Every world that `device` can render, the user's `own` ones first: name, what it is, its parameters in order."""
    found = [(name, type(world), parameter_values(world)) for name, world in own.items()]
    for name, kind in CATALOGUE.items():
        if name not in own and _is_renderable(device, kind):
            found.append((name, kind, {}))
    return [
        {
            "name": name,
            "about": next(iter((kind.__doc__ or "").strip().splitlines()), ""),
            "parameters": [
                {
                    "name": item.name,
                    "unit": item.unit,
                    "low": item.low,
                    "high": item.high,
                    "default": _to_json(given.get(item.name, item.default)),
                    "about": item.about,
                }
                for item in parameters(kind).values()
            ],
        }
        for name, kind, given in found
    ]


def _is_renderable(device: Device, kind: type[World]) -> bool:
    try:
        kind().for_device(device)
    except InputError:
        return False
    return True


def _scene(device: Device) -> dict[str, Any]:
    """How the page draws the device: its kind's own scene, or axes; a scene that does not say what it gives shows
    force."""
    describe = device.kind.part("scene")
    return {"gives": "force", **(axes_scene(device) if describe is None else describe(device))}


def _word(trip: Trip, tracker: str) -> str:
    """What the header says for `trip`."""
    if trip is Trip.STOPPED:
        return "stopped"
    return "tracker lost" if trip is Trip.POSE_LOST and tracker != "pointer" else "tripped"


def session(servo: DescribedServo, started: str) -> dict[str, Any]:
    """The JSON of /api/session but for `worlds_now`; `started` distinguishes one run of the server from another."""
    device = servo.device
    heat = device.coils.heat
    return {
        "version": __version__,
        "started": started,
        "simulated": servo.driver == "sim",
        "steered": not has_feed(servo.tracker),
        "patience": patience_for(servo.driver).page,
        "device": {"name": device.name, "title": device.title, "source": device.source},
        "scene": _scene(device),
        "modes": list(servo.modes),
        "models": list(servo.models),
        "parts": list(servo.part_remarks),
        "saturations": [one.text for one in Saturation],
        "columns": Columns(servo.layout, bool(servo.modes)).describe(),
        "coils": list(device.coils.names),
        "limits": {
            "force": device.limits.force,
            "torque": device.limits.torque,
            "expiry": device.limits.expiry,
            "current": device.coils.current_limit.tolist(),
            "warn": heat.warn - _KELVIN,
            "derate": heat.derate - _KELVIN,
            "stop": heat.stop - _KELVIN,
        },
        "trips": {
            str(int(trip)): {"word": _word(trip, servo.tracker), "text": describe_trip(trip, servo.tracker)}
            for trip in Trip
            if trip is not Trip.NONE
        },
    }


def worlds_now(servo: RunningServo, *, shown: bool = True) -> dict[str, Any]:
    """The worlds that can be chosen, and the present one; nothing but its name unless it may be `shown`."""
    return {"worlds": worlds(servo.device, servo.own_worlds if shown else {}), "world": world_now(servo, shown=shown)}


def world_now(servo: RunningServo, *, shown: bool = True) -> dict[str, Any]:
    """Name and values of the world that is felt now, the model that is inverted, what there is to draw and to say."""
    name, values = servo.world
    plain = {key: _to_json(value) for key, value in values.items()}
    return describe_world(servo, name, plain, servo.model, shown=shown)


def describe_world(
    servo: RunningServo, name: str, values: Mapping[str, Any], model: str, *, shown: bool
) -> dict[str, Any]:
    """The world `name` with `values` as JSON has them, what there is to draw and to say; of one that is not `shown`
    nothing but the `model`."""
    if not shown:
        return {"name": "hidden", "values": {}, "model": model, "scene": None, "shapes": [], "remarks": []}
    return {
        "name": name,
        "values": dict(values),
        "model": model,
        "scene": target_scene(name, values) if servo.modes else None,
        "shapes": list_shapes(name, values, servo.own_worlds, servo.device),
        "remarks": world_remarks(name, values),
    }


def _to_json(value: Any) -> Any:
    """`value` as JSON has it."""
    return list(value) if isinstance(value, tuple | list | np.ndarray) else value


def press_buttons(servo: RunningServo, command: Mapping[str, Any]) -> None:
    """The buttons that a page holds down, for programs that are connected; InputError for what is no list of names."""
    pressed = command.get("pressed")
    if not isinstance(pressed, list) or not all(isinstance(name, str) for name in pressed[:_VALUES]):
        raise InputError("buttons are a list of names: a, b, c")
    servo.press([name[:_NAME] for name in pressed[:_VALUES]])


def read_world(command: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """Name and values of the world that a page asks for; InputError if they cannot be one's."""
    name, values = command.get("name"), command.get("values", {})
    if not isinstance(name, str) or not isinstance(values, dict):
        raise InputError("a world needs a name (text) and values (an object)")
    if len(name) > _NAME or len(values) > _VALUES or any(len(key) > _NAME for key in values):
        raise InputError(f"a world has a name of at most {_NAME} characters, and at most {_VALUES} values with such")
    for key, value in values.items():
        numbers = value if isinstance(value, list) else [value]
        if len(numbers) > _VALUES or not all(type(one) in (int, float) for one in numbers):
            raise InputError(f"a world's value is a number or a list of numbers; {key} is neither")
    return name, values
