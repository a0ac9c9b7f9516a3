"""What a person should know of the part of the wrench that a tool over a dome renders, with its figures."""

from __future__ import annotations

import numpy as np

from haptorb.control.allocation.wrench_choice import WrenchChoice
from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.physics.sources.dipole import MU0
from haptorb.worlds.wrench_part import PARTS

__all__ = ["part_remarks"]


def part_remarks(device: SphericalElectromagnet, choice: WrenchChoice) -> tuple[str, ...]:
    """A sentence or two for each of `PARTS`, by its number in recordings; empty where there is nothing to say.

    The figures are those of two point dipoles at contact, T = µ0 m_e m_p/(4π d³) and F = 3T/d: they are said at the
    start, where nothing may wait for tables or compiled code.

    >>> from haptorb.control.allocation.for_device import tool_choice
    >>> from haptorb.devices.loader import load
    >>> omni = load("omni")
    >>> part_remarks(omni, tool_choice(omni))[1].split(" across")[0]
    'Torque is rendered: as point dipoles at contact, up to about 8.4 mN·m'
    """
    d = device.contact_distance
    most = np.minimum(device.coils.current_limit, np.sqrt(device.supply.power / device.greatest_resistance))
    moment = float((np.linalg.norm(device.moment_per_current, axis=0) * most).max())
    torque = MU0 * moment * device.tool.moment / (4 * np.pi * d**3)
    axis = "There is no torque about the tool's own axis."
    texts = dict.fromkeys(PARTS, "")
    if choice.fixed == "force":
        texts["force"] = "Only force is rendered, as chosen: torque from the world is left out."
    texts["torque"] = (
        f"Torque is rendered: as point dipoles at contact, up to about {1e3 * torque:.2g} mN·m across the tool's axis, "
        f"together with a force of {3 * torque / d:.2g} N. {axis}"
    )
    texts["both"] = (
        f"Force and torque are rendered as a compromise of {device.channels} coils, which cannot produce six "
        f"independent components; errors of 1 N are weighted like {1e3 * choice.weight:.3g} mm × 1 N of torque. {axis}"
    )
    return tuple(texts[part] for part in PARTS)
