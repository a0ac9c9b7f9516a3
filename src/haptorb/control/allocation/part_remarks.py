"""What a person should know of the part of the wrench that a tool over a dome renders, with its figures."""

from __future__ import annotations

import numpy as np

from haptorb.control.allocation.wrench_choice import PART_NUMBERS, WrenchChoice
from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.devices.state import State
from haptorb.worlds.wrench_part import PARTS

__all__ = ["part_remarks"]


def part_remarks(device: SphericalElectromagnet, choice: WrenchChoice) -> tuple[str, ...]:
    """A sentence or two for each of `PARTS`, by its number in recordings; empty where there is nothing to say.

    >>> from haptorb.control.allocation.for_device import tool_choice
    >>> from haptorb.devices.loader import load
    >>> omni = load("omni")
    >>> part_remarks(omni, tool_choice(omni))[1].split(": ")[0]
    'Torque is rendered'
    """
    over = device.wrench_map(State.at((0.0, 0.0, device.contact_distance)), "published")
    most = choice.allocators["torque"].allocate(over, (0.0, 0.0, 0.0, 10.0, 0.0, 0.0)).currents
    given = over.matrix @ most
    torque, force = 1e3 * float(np.linalg.norm(given[3:])), float(np.linalg.norm(given[:3]))
    axis = "About the tool's own axis no current turns it."
    texts = dict.fromkeys(PARTS, "")
    if choice.fixed == "force":
        texts["force"] = "Only force is rendered, as chosen: a torque that the world asks is left out."
    texts["torque"] = (
        f"Torque is rendered: at contact up to about {torque:.2g} mN·m across the tool's axis, which brings "
        f"{force:.2g} N of force along. {axis}"
    )
    texts["both"] = (
        f"Force and torque are rendered as a compromise of {device.channels} coils: six numbers cannot be had at once, "
        f"1 N weighs as much as {1e3 * choice.weight:.3g} mm × 1 N of torque. {axis}"
    )
    return tuple(texts[part] for part in sorted(PARTS, key=PART_NUMBERS.__getitem__))
