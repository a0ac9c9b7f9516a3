"""From a device to the simulation that its kind names."""

from __future__ import annotations

from haptorb.devices.device import Device
from haptorb.errors import DeviceError
from haptorb.simulation.simulation import Simulation

__all__ = ["simulate"]


def simulate(device: Device, seed: int = 0) -> Simulation:
    """A simulation of `device` whose noise is that of `seed`; DeviceError if there is none for its kind.

    >>> from haptorb.devices.loader import load
    >>> simulate(load("omni")).device.name
    'omni'
    """
    make = device.kind.part("simulation")
    if make is None:
        raise DeviceError(
            f"device '{device.name}' is a {device.kind.title}, which cannot be simulated; choose a driver for the real "
            "device"
        )
    simulation: Simulation = make(device, seed)
    return simulation
