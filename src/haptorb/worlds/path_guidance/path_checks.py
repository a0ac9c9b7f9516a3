"""Checks of a path: it must not cross itself or leave the workspace."""

from __future__ import annotations

import numpy as np

from haptorb.devices.device import Device
from haptorb.errors import InputError
from haptorb.numerics.arrays import Array

__all__ = ["check_crossing", "check_workspace"]

_CLOSE = 1e-3  #: parts nearer to each other cannot be distinguished with a hand on the tool [m]
_APART = 6e-3  #: along the path; nearer places belong to one part, also around a corner of 20 degrees [m]
_INSIDE = 0.5e-3  #: by which a path may lie below contact, where only a tilted tool gets [m]


def _write_place(p: Array) -> str:
    x, y, z = (1e3 * p + 0.0).round(1).tolist()
    return f"({x:g}, {y:g}, {z:g}) mm"


def check_crossing(places: Array, spacing: float, closed: bool) -> None:
    """Raise InputError where `places` (n, 3) [m], `spacing` [m] apart, come within 1 mm of an earlier section."""
    every = max(round(0.5 * _CLOSE / spacing), 1)
    points = places[::every]
    step, count = every * spacing, len(points)
    total = spacing * (len(places) - 1)
    for k in range(count):
        arcs = step * (np.arange(k + 1, count) - k)
        away = np.minimum(arcs, total - arcs) if closed else arcs
        gap = np.linalg.norm(points[k + 1 :] - points[k], axis=1)
        near = (away > _APART) & (gap < _CLOSE)
        if near.any():
            other = float(step * (k + 1 + int(np.argmax(near))))
            raise InputError(
                f"the path crosses itself, or comes within 1 mm of itself, near {_write_place(points[k])}: "
                f"{1e3 * k * step:.0f} mm and {1e3 * other:.0f} mm along it. Move its points apart, or guide along "
                "its parts one after the other"
            )


def check_workspace(places: Array, spacing: float, device: Device) -> None:
    """Raise InputError unless `places` (n, 3) [m], `spacing` [m] apart, are in the shell over the dome of `device`."""
    shell = device.shell
    if shell is None:
        raise InputError(
            f"guidance along a path is for a tool over a sphere; device '{device.name}' has none: choose omni or "
            "another spherical electromagnet"
        )
    distance = np.linalg.norm(places, axis=1)
    highest = shell.contact_distance + shell.thickness
    steepest = float(getattr(device, "workspace_half_angle", np.pi / 2))
    tilt = np.arccos(np.clip(places[:, 2] / distance, -1.0, 1.0))
    ways = (
        (shell.contact_distance - distance - _INSIDE, "inside the dome, where the tool cannot be", "m",
         f"keep every point at least {1e3 * shell.contact_distance:g} mm from the centre"),
        (distance - highest - 1e-6, "above the shell in which forces are rendered", "m",
         f"keep every point within {1e3 * highest:g} mm of the centre"),
        (tilt - steepest - 1e-6, "outside the workspace", "rad",
         f"keep every point within {np.degrees(steepest):.0f} deg of the summit"),
    )  # fmt: skip
    for beyond, where, unit, remedy in ways:
        worst = int(np.argmax(beyond))
        if beyond[worst] > 0.0:
            over = f"{1e3 * beyond[worst]:.3g} mm" if unit == "m" else f"{np.degrees(beyond[worst]):.3g} deg"
            raise InputError(
                f"the path leaves the workspace of device '{device.name}': {1e3 * worst * spacing:.0f} mm along it, at "
                f"{_write_place(places[worst])}, it is {over} {where}; {remedy}"
            )
