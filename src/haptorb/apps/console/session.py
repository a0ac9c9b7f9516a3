"""What the page must know before the first frame: device, worlds and their sliders, limits, words for codes."""

from __future__ import annotations

from typing import Any

import numpy as np

from haptorb.apps.console.running_servo import RunningServo
from haptorb.apps.console.scenes import axes_scene
from haptorb.apps.console.target import target_scene
from haptorb.apps.console.wire import Columns
from haptorb.control.protection.trip import Trip
from haptorb.devices.device import Device
from haptorb.errors import InputError
from haptorb.runtime.trackers.tracker_registry import has_feed
from haptorb.version import __version__
from haptorb.worlds import CATALOGUE, World
from haptorb.worlds.parameter import parameters

__all__ = ["session", "world_now", "worlds"]

_KELVIN = 273.15


def worlds(device: Device) -> list[dict[str, Any]]:
    """Every world that `device` can render: name, what it is, and its parameters in their order."""
    return [
        {
            "name": name,
            "about": (kind.__doc__ or "").strip().splitlines()[0],
            "parameters": [
                {
                    "name": item.name,
                    "unit": item.unit,
                    "low": item.low,
                    "high": item.high,
                    "default": list(item.default) if isinstance(item.default, tuple) else item.default,
                    "about": item.about,
                }
                for item in parameters(kind).values()
            ],
        }
        for name, kind in CATALOGUE.items()
        if _is_renderable(device, kind)
    ]


def _is_renderable(device: Device, kind: type[World]) -> bool:
    try:
        kind().for_device(device)
    except InputError:
        return False
    return True


def _scene(device: Device) -> dict[str, Any]:
    """How the page draws the device: its kind's own scene, or axes."""
    describe = device.kind.part("scene")
    scene: dict[str, Any] = axes_scene(device) if describe is None else describe(device)
    return scene


#: what the header says for a trip; every other one is just "tripped"
_WORDS = {Trip.STOPPED: "stopped", Trip.POSE_LOST: "tracker lost"}


def session(servo: RunningServo, started: str) -> dict[str, Any]:
    """The JSON of /api/session but for the world; `started` tells one run of the server from another."""
    device = servo.device
    heat = device.coils.heat
    return {
        "version": __version__,
        "started": started,
        "simulated": servo.driver == "sim",
        "steered": not has_feed(servo.tracker),
        "device": {"name": device.name, "title": device.title, "source": device.source},
        "scene": _scene(device),
        "modes": list(servo.modes),
        "models": list(servo.models),
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
        "worlds": worlds(device),
        "trips": {
            str(int(trip)): {"word": _WORDS.get(trip, "tripped"), "text": trip.text}
            for trip in Trip
            if trip is not Trip.NONE
        },
    }


def world_now(servo: RunningServo) -> dict[str, Any]:
    """Name and values of the world that is felt now, the model that is inverted, and what there is to draw of it."""
    name, values = servo.world
    plain = {key: _to_json(value) for key, value in values.items()}
    return {
        "name": name,
        "values": plain,
        "model": servo.model,
        "scene": target_scene(name, values) if servo.modes else None,
    }


def _to_json(value: Any) -> Any:
    """`value` as JSON has it."""
    return list(value) if isinstance(value, tuple | list | np.ndarray) else value
