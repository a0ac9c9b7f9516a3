"""The bodies of a spherical electromagnet: core, windings, dome, field sensors, marks, and the tool in contact."""

from __future__ import annotations

import numpy as np

from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.devices.geometry import Ball, Geometry, Reach, Rod, RoundPart, Spot, list_assumed

__all__ = ["electromagnet_geometry"]

_SIZES = (
    "electromagnet.core_radius", "windings.inner_radius", "windings.outer_radius", "windings.length", "dome.radius",
    "dome.shell_thickness", "dome.workspace_half_angle", "tool.outer_radius", "tool.inner_radius", "tool.length",
    "tool.tip_distance", "hall.positions", "marks.positions",
)  # fmt: skip


def electromagnet_geometry(device: SphericalElectromagnet) -> Geometry:
    """The parts of `device`, its tool radial and in contact over the summit.

    A coil's axis is the direction of its moment per ampere: what a calibration measured of it.
    """
    tool, contact = device.tool, device.contact_distance
    place = np.array([0.0, 0.0, contact])
    magnet = RoundPart(
        "tool magnet", "magnet", place, np.array([0.0, 0.0, 1.0]), tool.inner_radius, tool.outer_radius, tool.length,
        polarity=1.0, moves=True,
    )  # fmt: skip
    notes = [
        f"not stated in the device file: the {'finger' if device.tool.worn else 'stylus'} around the tool's magnet"
    ]
    if device.windings is None:
        notes.insert(0, "not to scale: the windings' radii and lengths, as the device file has no [windings]")
    return Geometry(
        round_parts=(*_coils(device), magnet),
        balls=(Ball("core", "core", device.core_radius), Ball("dome", "dome", device.dome_radius)),
        spots=(
            *(Spot(f"sensor {number}", "sensor", at) for number, at in enumerate(device.hall.positions, 1)),
            *(() if device.marks is None else
              (Spot(name, "mark", at) for name, at in zip(device.marks.names, device.marks.positions, strict=True))),
        ),
        rods=(Rod("tool axis", np.array([0.0, 0.0, device.dome_radius]), place),),
        reach=Reach("tool magnet", device.workspace_half_angle, contact, contact + device.shell_thickness),
        notes=(*notes, *list_assumed(device.assumed, _SIZES)),
    )  # fmt: skip


def _coils(device: SphericalElectromagnet) -> tuple[RoundPart, ...]:
    axes = (device.moment_per_current / np.linalg.norm(device.moment_per_current, axis=0)).T
    centre, names, windings = np.zeros(3), device.coils.names, device.windings
    if windings is None:
        # nested in equal layers between core and dome: some size is needed to show the axes
        edges = np.linspace(device.core_radius, device.dome_radius, 2 * len(names) + 3)[1:-1]
        return tuple(
            RoundPart(
                name, "coil", centre, axis, float(edges[2 * k]), float(edges[2 * k + 1]), 0.6 * device.dome_radius,
                channel=name, stated=False,
            )
            for k, (name, axis) in enumerate(zip(names, axes, strict=True))
        )  # fmt: skip
    return tuple(
        RoundPart(
            name, "coil", centre, axis, float(windings.inner_radius[k]), float(windings.outer_radius[k]),
            float(windings.length[k]), channel=name,
        )
        for k, (name, axis) in enumerate(zip(names, axes, strict=True))
    )  # fmt: skip
