"""The geometry of a device in numbers, for programs: plain JSON types, units in the keys."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import Any

import numpy as np

from haptorb.devices.device import Device
from haptorb.devices.geometry import Geometry

__all__ = ["describe_geometry"]

_UNITS = {
    **dict.fromkeys(("position", "inner_radius", "outer_radius", "length", "radius", "start", "end"), "m"),
    **dict.fromkeys(("nearest", "farthest"), "m"),
    "half_angle": "deg",
}


def describe_geometry(device: Device) -> dict[str, Any]:
    """Every body and place of `device`, the mover's as they are at rest; InputError for a kind without geometry."""
    geometry: Geometry = device.kind.require_part("geometry", device.name, "`haptorb show`")(device)
    return {
        "name": device.name,
        "digest": device.digest,
        "parts": [_describe(part) for part in geometry.round_parts],
        "balls": [_describe(ball) for ball in geometry.balls],
        "spots": [_describe(spot) for spot in geometry.spots],
        "rods": [_describe(rod) for rod in geometry.rods],
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
