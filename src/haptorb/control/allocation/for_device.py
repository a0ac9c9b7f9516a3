"""The allocators that the kinds of devices name: made from a device's own limits."""

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
    return LeastSquaresAllocator.force(device.coils.current_limit, compensate_passive=True)


def torque_allocator(device: Device) -> Allocator:
    """Least heat for the torque, the passive torque taken out.

    >>> from haptorb.devices.loader import load
    >>> type(torque_allocator(load("pmsm"))).__name__
    'MinimumPowerAllocator'
    """
    coils = device.coils
    return MinimumPowerAllocator(coils.current_limit, resistance=coils.resistance, compensate_passive=True)
