"""What the page draws of a device and of worlds with memory, in metres and radians.

There is one description for each scene that `web/src/scene` knows.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from haptorb.devices.coil_array.coil_array import CoilArray
from haptorb.devices.coil_array.geometry import array_geometry
from haptorb.devices.device import Device
from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.devices.electromagnet.geometry import electromagnet_geometry
from haptorb.devices.geometry import Geometry, RoundPart
from haptorb.devices.motor.geometry import motor_geometry
from haptorb.devices.motor.spherical_motor import SphericalMotor
from haptorb.worlds import World, find_world
from haptorb.worlds.dynamic_world import DynamicWorld
from haptorb.worlds.memory import find_number

__all__ = ["array_scene", "axes_scene", "describe_parts", "dome_scene", "list_shapes", "motor_scene"]


def axes_scene(device: Device) -> dict[str, Any]:
    """Axes and a marker for the mover, and the device's parts where its kind knows them: for every other device."""
    geometry = device.kind.part("geometry")
    return {
        "kind": "axes",
        "rest": device.rest_position.tolist(),
        **({} if geometry is None else describe_parts(geometry(device))),
    }


def dome_scene(device: SphericalElectromagnet) -> dict[str, Any]:
    """A tool over a dome, its coils about the core."""
    return {
        "kind": "dome",
        "dome_radius": device.dome_radius,
        "contact_distance": device.contact_distance,
        "shell_thickness": device.shell_thickness,
        "workspace": device.workspace_half_angle,
        "core_radius": device.core_radius,
        "magnet": {
            "worn": device.tool.worn,
            "outer_radius": device.tool.outer_radius,
            "length": device.tool.length,
            "tip_distance": device.tool.tip_distance,
        },
        **describe_parts(electromagnet_geometry(device)),
    }


def array_scene(device: CoilArray) -> dict[str, Any]:
    """Coils where they are: a stylus over a dome, or the tool and its magnets over a plate."""
    surface, magnet = device.surface, device.tool.magnets[0]
    if not surface.is_dome:
        return {
            "kind": "plate",
            "rest": device.rest_position.tolist(),
            "height": surface.height,
            "half_width": list(surface.half_width),
            "contact_height": device.contact_height,
            "thickness": surface.thickness,
            "tool": {"origin": [0.0, 0.0, device.contact_height], "tip_distance": device.tool.tip_distance},
            **describe_parts(array_geometry(device)),
        }
    return {
        "kind": "dome",
        "dome_radius": surface.dome_radius,
        "contact_distance": device.contact_height,
        "shell_thickness": surface.thickness,
        "workspace": surface.half_angle,
        "core_radius": 0.0 if device.core is None else device.core.radius,
        "magnet": {
            "worn": False,
            "outer_radius": magnet.outer_radius,
            "length": magnet.length,
            "tip_distance": device.tool.tip_distance,
        },
        **describe_parts(array_geometry(device)),
    }


def motor_scene(device: SphericalMotor) -> dict[str, Any]:
    """A rotor with magnets over a stator with coils, and its handle."""
    return {
        "kind": "motor",
        "gives": "torque",
        "workspace": device.workspace_tilt,
        "handle_length": device.rotor.handle_length,
        "groups": np.asarray(device.groups, dtype=np.float64).tolist(),
        **describe_parts(motor_geometry(device)),
    }


def describe_parts(geometry: Geometry) -> dict[str, Any]:
    """Round parts, field sensors and marks where they are, and what the device file does not state of them."""
    return {
        "parts": [_describe_part(part) for part in geometry.round_parts],
        "sensors": [spot.position.tolist() for spot in geometry.select_spots("sensor")],
        "marks": [spot.position.tolist() for spot in geometry.select_spots("mark")],
        "notes": list(geometry.notes),
    }


def _describe_part(part: RoundPart) -> dict[str, Any]:
    return {
        "name": part.name,
        "role": part.role,
        "channel": part.channel,
        "position": part.position.tolist(),
        "axis": part.axis.tolist(),
        "inner_radius": part.inner_radius,
        "outer_radius": part.outer_radius,
        "length": part.length,
        "polarity": part.polarity,
        "moves": part.moves,
        "stated": part.stated,
    }


def list_shapes(name: str, values: Mapping[str, Any], own: Mapping[str, World], device: Device) -> list[dict[str, Any]]:
    """Bodies of the world `name` with `values` on `device`, of the catalogue or of the `own` ones; none of any other.

    size [m] as `worlds.shape.SHAPES` says; place and attitude are indices in the row's memory.
    """
    try:
        world = own[name] if name in own else find_world(name)()
        if not isinstance(world, DynamicWorld):
            return []
        changed = world.replace(**values).for_device(device)
        assert isinstance(changed, DynamicWorld)
        fields = changed.memory_fields
        return [
            {
                "name": shape.name,
                "kind": shape.kind,
                "size": list(shape.size),
                "role": shape.role,
                "at": list(shape.at),
                "points": list(shape.points),
                "corners": list(shape.corners),
                "place": find_number(fields, shape.place, shape.row) if shape.place else None,
                "attitude": find_number(fields, shape.attitude, shape.row) if shape.attitude else None,
            }
            for shape in changed.shapes
        ]
    except Exception:  # a world that this process does not know by name, or the user's code: only its picture is lost
        return []
