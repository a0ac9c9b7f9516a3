"""The capability card of each kind of device."""

from __future__ import annotations

from functools import singledispatch

from haptorb.cli.arm_card import ArmCard
from haptorb.cli.array_card import CoilArrayCard
from haptorb.cli.card import Card
from haptorb.cli.electromagnet_card import ElectromagnetCard
from haptorb.cli.motor_card import MotorCard
from haptorb.devices.arm import Arm
from haptorb.devices.base import Device, device_function, unsupported
from haptorb.devices.coil_array import CoilArray
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.devices.motor import SphericalMotor

__all__ = ["card"]


@device_function
@singledispatch
def card(device: Device) -> Card:
    """Create the capability card of a device, by its kind; `haptorb inspect` needs it.

    Parameters
    ----------
    device : Device
        The device.

    Returns
    -------
    Card
        The card.

    Raises
    ------
    InputError
        For a kind that has none.
    """
    raise unsupported(device, "`haptorb inspect`", card)


card.register(CoilArray, CoilArrayCard)
card.register(Arm, ArmCard)
card.register(SphericalElectromagnet, ElectromagnetCard)
card.register(SphericalMotor, MotorCard)
