"""The allocators that the kinds of devices name: made from a device's own limits.

The supply's power is reckoned with windings at the stop temperature, the warmest that may carry a current: cooler ones
take less. It is the power that the coils turn into heat; what builds up their field, watts for milliseconds, comes from
the supply's capacitors.
"""

from __future__ import annotations

from haptorb.control.allocation.allocator import Allocator
from haptorb.control.allocation.least_squares import LeastSquaresAllocator
from haptorb.control.allocation.minimum_power import MinimumPowerAllocator
from haptorb.devices.device import Device

__all__ = ["force_allocator", "torque_allocator"]


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
