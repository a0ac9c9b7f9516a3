"""Which simulation stands behind which kind of device: a new one is one line."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from haptorb.devices.device import Device
from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.devices.motor.spherical_motor import SphericalMotor
from haptorb.errors import DeviceError
from haptorb.simulation.electromagnet.electromagnet import SimulatedElectromagnet
from haptorb.simulation.motor.motor import SimulatedMotor
from haptorb.simulation.simulation import Simulation

__all__ = ["SIMULATIONS", "simulated"]

#: class of device → what makes its simulation from (device, seed)
SIMULATIONS: dict[type[Device], Callable[[Any, int], Simulation]] = {
    SphericalElectromagnet: SimulatedElectromagnet,
    SphericalMotor: SimulatedMotor,
}


def simulated(device: Device, seed: int = 0) -> Simulation:
    """A simulation of `device` whose noise is that of `seed`; DeviceError if there is none for its kind.

    >>> from haptorb.devices.loader import load
    >>> simulated(load("omni")).device.name
    'omni'
    """
    for kind, make in SIMULATIONS.items():
        if isinstance(device, kind):
            return make(device, seed)
    known = ", ".join(sorted(kind.__name__ for kind in SIMULATIONS))
    raise DeviceError(
        f"device '{device.name}' is a {type(device).__name__}, which cannot be simulated (these can: {known}); "
        "choose a driver for the real device"
    )
