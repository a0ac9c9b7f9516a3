"""The allocators that the kinds of devices name: made from a device's own limits.

The supply's power is reckoned with windings at the stop temperature, the warmest that may carry a current: cooler ones
take less. It is the power that the coils turn into heat; what builds up their field, watts for milliseconds, comes from
the supply's capacitors.
"""

from __future__ import annotations

from haptorb.control.allocation.allocator import Allocator
from haptorb.control.allocation.least_squares import LeastSquaresAllocator
from haptorb.control.allocation.minimum_power import MinimumPowerAllocator
from haptorb.control.allocation.whole_wrench import TORQUE_ARM, WholeWrenchAllocator
from haptorb.control.allocation.wrench_choice import WrenchChoice
from haptorb.devices.device import Device
from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.worlds.wrench_part import WrenchPart

__all__ = ["force_allocator", "tool_choice", "torque_allocator"]


def force_allocator(device: Device) -> Allocator:
    """Least squares for the force; the passive wrench that the model knows is taken out ("published": none).

    >>> from haptorb.devices.loader import load
    >>> type(force_allocator(load("omni"))).__name__
    'LeastSquaresAllocator'
    """
    coils = device.coils
    return LeastSquaresAllocator.force(
        coils.current_limit, compensate_passive=True, resistance=device.greatest_resistance, power=device.supply.power
    )


def torque_allocator(device: Device) -> Allocator:
    """Least heat for the torque, the passive torque taken out.

    >>> from haptorb.devices.loader import load
    >>> type(torque_allocator(load("pmsm"))).__name__
    'MinimumPowerAllocator'
    """
    return MinimumPowerAllocator(
        device.coils.current_limit, resistance=device.greatest_resistance, compensate_passive=True,
        power=device.supply.power,
    )  # fmt: skip


def tool_choice(
    device: SphericalElectromagnet, part: WrenchPart | None = None, arm: float | None = None
) -> WrenchChoice:
    """Force, torque and both on a tool over a dome; `part` fixes one of them, `arm` [m] is the weight of a torque.

    Raises InputError for an arm that is no length.

    >>> from haptorb.devices.loader import load
    >>> choice = tool_choice(load("omni"))
    >>> sorted(choice.allocators), round(choice.arm, 4)
    (['both', 'force', 'torque'], 0.0316)
    """
    limits, weight = device.limits, TORQUE_ARM if arm is None else arm
    torque, both = (
        WholeWrenchAllocator(
            device.coils.current_limit, device.greatest_resistance, device.supply.power, together=together,
            greatest=(limits.force, limits.torque), arm=weight,
        )
        for together in (False, True)
    )  # fmt: skip
    hand = device.hand  # its damping against turning is that against moving, at this arm
    held_at = (hand.turn_damping / hand.damping) ** 0.5 if hand.damping > 0.0 else 0.0
    return WrenchChoice({"force": force_allocator(device), "torque": torque, "both": both}, held_at, part, weight)
