"""The worlds of a recording, each as the page shows it: values, bodies, target scene, and what is missing."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from haptorb.apps.console.scenes import list_shapes
from haptorb.apps.console.session import worlds
from haptorb.apps.console.target import target_scene, world_remarks
from haptorb.devices.device import Device
from haptorb.worlds import CATALOGUE
from haptorb.worlds.parameter import parameters

__all__ = ["describe_world", "list_worlds", "read_worlds"]

_UNKNOWN = "its code is not part of haptorb: neither its force map nor its bodies can be drawn"


def read_worlds(notes: Sequence[Mapping[str, str]]) -> dict[int, tuple[str, dict[str, Any]]]:
    """Number of the change → name and values; notes that haptorb did not write are passed over."""
    found: dict[int, tuple[str, dict[str, Any]]] = {}
    for note in notes:
        try:
            world = json.loads(note["world"])
            name, values = world["name"], world["values"]
            if not isinstance(name, str) or not isinstance(values, dict):
                continue
            found[int(note["change"])] = name, _complete(name, values)
        except (KeyError, TypeError, ValueError, RecursionError):
            continue
    return found


def _complete(name: str, values: Mapping[str, Any]) -> dict[str, Any]:
    """The values of a world as this version knows it: another one may have had fewer parameters, or others."""
    known = {key: value for key, value in values.items() if _is_number(value) or _are_numbers(value)}
    if name not in CATALOGUE:
        return known
    defaults = {key: one.default for key, one in parameters(CATALOGUE[name]).items()}
    return {
        key: known[key] if key in known and isinstance(known[key], list) == isinstance(default, tuple) else default
        for key, default in defaults.items()
    }


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e300


def _are_numbers(value: Any) -> bool:
    return isinstance(value, list) and all(map(_is_number, value))


def list_worlds(device: Device, names: Sequence[str]) -> list[dict[str, Any]]:
    """The catalogue's worlds among `names`, with their parameters in their units; one of a user's own with none."""
    known = {one["name"]: one for one in worlds(device, {}) if one["name"] in names}
    return [known.get(name, {"name": name, "about": "", "parameters": []}) for name in names]


def describe_world(name: str, values: Mapping[str, Any], model: str, device: Device) -> dict[str, Any]:
    """What the console's event of a world says: parameters in their units, lengths of its picture [m]."""
    return {
        "name": name,
        "values": {key: list(value) if isinstance(value, tuple) else value for key, value in values.items()},
        "model": model,
        "scene": target_scene(name, values) if device.kind.modes else None,
        "shapes": list_shapes(name, values, {}, device),
        "remarks": world_remarks(name, values) if name in CATALOGUE else [f"'{name}': {_UNKNOWN}."],
    }
