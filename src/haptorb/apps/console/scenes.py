"""What the page draws of a device, in metres and radians: one description for each scene that `web/src/scene` knows."""

from __future__ import annotations

from typing import Any

import numpy as np

from haptorb.devices.device import Device
from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.devices.motor.spherical_motor import SphericalMotor

__all__ = ["axes_scene", "dome_scene", "motor_scene"]


def axes_scene(device: Device) -> dict[str, Any]:
    """Axes and a marker for the mover: for every device whose kind describes no scene."""
    return {"kind": "axes", "rest": device.rest_position.tolist()}


def dome_scene(device: SphericalElectromagnet) -> dict[str, Any]:
    """A tool over a dome."""
    axes = device.moment_per_current / np.linalg.norm(device.moment_per_current, axis=0)
    return {
        "kind": "dome",
        "dome_radius": device.dome_radius,
        "contact_distance": device.contact_distance,
        "shell_thickness": device.shell_thickness,
        "workspace": device.workspace_half_angle,
        "core_radius": device.core_radius,
        "magnet": {
            "outer_radius": device.tool.outer_radius,
            "length": device.tool.length,
            "tip_distance": device.tool.tip_distance,
        },
        "coil_axes": axes.T.tolist(),
    }


def motor_scene(device: SphericalMotor) -> dict[str, Any]:
    """A rotor with magnets over a stator with coils, and its handle."""
    return {
        "kind": "motor",
        "workspace": device.workspace_tilt,
        "handle_length": device.rotor.handle_length,
        "magnets": {
            "distance": device.magnets.distance,
            "directions": device.magnets.directions.tolist(),
            "polarity": np.asarray(device.polarity, dtype=np.float64).tolist(),
            "radius": device.magnet.radius,
            "length": device.magnet.length,
        },
        "stator": {
            "distance": device.electromagnets.distance,
            "directions": device.electromagnets.directions.tolist(),
            "outer_radius": device.electromagnet.outer_radius,
            "inner_radius": device.electromagnet.inner_radius,
            "length": device.electromagnet.length,
            "groups": np.asarray(device.groups, dtype=np.float64).tolist(),
        },
    }
