"""The allocators of coil arrays, and what a person should know of the part of the wrench that they render."""

from __future__ import annotations

from haptorb.control.allocation.array.array_allocator import ArrayAllocator
from haptorb.control.allocation.whole_wrench import TORQUE_ARM
from haptorb.control.allocation.wrench_choice import WrenchChoice
from haptorb.devices.coil_array.coil_array import CoilArray
from haptorb.worlds.wrench_part import PARTS, WrenchPart

__all__ = ["array_allocator", "array_choice", "array_remarks"]


def array_allocator(device: CoilArray) -> ArrayAllocator:
    """Least heat for the force; the accompanying torque stays within the device's limit.

    >>> from haptorb.devices.loader import load
    >>> array_allocator(load("tetrahedron")).part
    'force'
    """
    return _make(device, "force", TORQUE_ARM)


def array_choice(device: CoilArray, part: WrenchPart | None = None, arm: float | None = None) -> WrenchChoice:
    """Force, torque and both; `part` fixes one of them, `arm` [m] is the weight of a torque.

    Raises InputError for an arm that is no length.

    >>> from haptorb.devices.loader import load
    >>> sorted(array_choice(load("planar")).allocators)
    ['both', 'force', 'torque']
    """
    weight = TORQUE_ARM if arm is None else arm
    hand = device.hand  # its damping against turning is that against moving, at this arm
    held_at = (hand.turn_damping / hand.damping) ** 0.5 if hand.damping > 0.0 else 0.0
    return WrenchChoice({one: _make(device, one, weight) for one in PARTS}, held_at, part, weight)


def array_remarks(device: CoilArray, choice: WrenchChoice) -> tuple[str, ...]:
    """A sentence or two for each of `PARTS`, by its number in recordings; empty where there is nothing to say.

    >>> from haptorb.devices.loader import load
    >>> planar = load("planar")
    >>> len(array_remarks(planar, array_choice(planar)))
    3
    """
    components = 5 if len(device.tool.magnets) == 1 else 6
    missing = " There is no torque about the magnet's own axis." if components == 5 else ""
    few = (
        f" {device.channels} coils for {components} components: the best approximation is given, with errors of 1 N "
        "weighted like "
        f"{1e3 * choice.weight:.3g} mm × 1 N of torque."
        if device.channels < components
        else ""
    )
    fixed = "Only force is rendered, as chosen: torque from the world is left out."
    texts: dict[WrenchPart, str] = {
        "force": fixed if choice.fixed == "force" else "",
        "torque": f"Torque is rendered; the accompanying force stays within {device.limits.force:g} N.{missing}",
        "both": f"Force and torque are rendered.{few}{missing}",
    }
    return tuple(texts[part] for part in PARTS)


def _make(device: CoilArray, part: WrenchPart, arm: float) -> ArrayAllocator:
    limits = device.limits
    return ArrayAllocator(
        device.coils.current_limit, device.greatest_resistance, part, power=device.supply.power,
        greatest=(limits.force, limits.torque), arm=arm,
    )  # fmt: skip
