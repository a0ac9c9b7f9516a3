"""Simulations of the kinds of devices."""

from __future__ import annotations

from functools import singledispatch

from haptorb.devices.arm import Arm
from haptorb.devices.base import Device, device_function
from haptorb.devices.coil_array import CoilArray
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.devices.motor import SphericalMotor
from haptorb.errors import DeviceError
from haptorb.simulation.arm import SimulatedArm
from haptorb.simulation.base import Simulation
from haptorb.simulation.coil_array import SimulatedCoilArray
from haptorb.simulation.electromagnet import SimulatedElectromagnet
from haptorb.simulation.motor import SimulatedMotor

__all__ = ["simulate"]


@device_function
@singledispatch
def simulate(device: Device, seed: int = 0) -> Simulation:
    """Create the simulation of a device, by its kind; `driver="sim"` needs it.

    Parameters
    ----------
    device : Device
        The device.
    seed : int
        Seed of the noise.

    Returns
    -------
    Simulation
        The simulation, in its initial state.

    Raises
    ------
    DeviceError
        For a kind without one.

    Examples
    --------
    >>> from haptorb.devices.loader import load
    >>> simulate(load("omni")).device.name
    'omni'
    """
    raise DeviceError(
        f"device '{device.name}' is a {device.kind.title}, which cannot be simulated; choose a driver for the real "
        "device"
    )


simulate.register(SphericalElectromagnet, SimulatedElectromagnet)
simulate.register(SphericalMotor, SimulatedMotor)
simulate.register(CoilArray, SimulatedCoilArray)
simulate.register(Arm, SimulatedArm)
