"""The bodies of a coil array: coils where they are, core, dome, and the tool in contact."""

from __future__ import annotations

import numpy as np

from haptorb.devices.coil_array.coil_array import CoilArray
from haptorb.devices.geometry import Ball, Geometry, Reach, Rod, RoundPart, list_assumed

__all__ = ["array_geometry"]

_SIZES = ("windings", "core.radius", "dome.radius", "plate.height", "tool.magnets", "tool.tip_distance")


def array_geometry(device: CoilArray) -> Geometry:
    """The parts of `device`, its tool upright and in contact in the middle."""
    coils, tool, surface = device.windings, device.tool, device.surface
    origin = np.array([0.0, 0.0, device.contact_height])
    windings = [
        RoundPart(
            name, "coil", coils.position[k], coils.axis[k], float(coils.inner_radius[k]), float(coils.outer_radius[k]),
            float(coils.length[k]), channel=name,
        )
        for k, name in enumerate(device.coils.names)
    ]  # fmt: skip
    magnets = [
        RoundPart(
            f"magnet {number}", "magnet", origin + magnet.position, magnet.axis, magnet.inner_radius,
            magnet.outer_radius, magnet.length, polarity=1.0, moves=True,
        )
        for number, magnet in enumerate(tool.magnets, 1)
    ]  # fmt: skip
    balls = [] if device.core is None else [Ball("core", "core", device.core.radius)]
    notes = ["not stated in the device file: the handle around the tool's magnets"]
    reach = None
    if surface.is_dome:
        balls.append(Ball("dome", "dome", surface.dome_radius))
        contact = device.contact_height
        reach = Reach("tool", surface.half_angle, contact, contact + surface.thickness)
    else:
        notes.append(f"not drawn: the plate at {surface.height * 1e3:g} mm that the tool touches")
    return Geometry(
        round_parts=(*windings, *magnets),
        balls=tuple(balls),
        rods=(Rod("tool axis", origin - np.array([0.0, 0.0, tool.tip_distance]), origin),),
        reach=reach,
        notes=(*notes, *list_assumed(device.assumed, _SIZES)),
    )
