"""What the page draws of a device, in metres and radians: one description for each scene that `web/src/scene` knows."""

from __future__ import annotations

from typing import Any

import numpy as np

from haptorb.devices.device import Device
from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.devices.electromagnet.geometry import electromagnet_geometry
from haptorb.devices.geometry import Geometry, RoundPart
from haptorb.devices.motor.geometry import motor_geometry
from haptorb.devices.motor.spherical_motor import SphericalMotor

__all__ = ["axes_scene", "describe_parts", "dome_scene", "motor_scene"]


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


def motor_scene(device: SphericalMotor) -> dict[str, Any]:
    """A rotor with magnets over a stator with coils, and its handle."""
    return {
        "kind": "motor",
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
