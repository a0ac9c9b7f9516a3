"""How a person leads the tool over the dome when the field sensors calibrate themselves: for simulated devices."""

from __future__ import annotations

import numpy as np

from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.devices.state import rotation_to_axis
from haptorb.numerics.arrays import Array
from haptorb.numerics.quaternions import quaternion

__all__ = ["lead_tool"]

_LEAN = 0.4  #: greatest slope of a tool that is led, each way


def lead_tool(device: SphericalElectromagnet, now: float, reach: float = 1.0) -> tuple[Array, Array]:
    """Position (3,) [m] and quaternion (4,) that a person who leads the tool over the whole dome wants at `now` [s].

    Round and up and down, up to `reach` of the workspace's angle, lifted and leaning to all sides; three to thirteen
    seconds for each of these motions.
    """
    turn = 2 * np.pi * now / 4.7
    polar = device.workspace_half_angle * reach * (0.52 - 0.46 * np.cos(2 * np.pi * now / 13.1))
    lift = device.shell_thickness * (0.45 - 0.40 * np.cos(2 * np.pi * now / 3.1))
    outward = np.array([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)])
    lean = _LEAN * np.array([np.sin(2 * np.pi * now / 5.3), np.sin(2 * np.pi * now / 7.9 + 1.0)])
    R = rotation_to_axis(outward)
    axis = outward + lean[0] * R[:, 0] + lean[1] * R[:, 1]
    return (device.contact_distance + lift) * outward, quaternion(rotation_to_axis(axis / np.linalg.norm(axis)))
