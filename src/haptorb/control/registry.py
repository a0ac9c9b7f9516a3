"""Allocators of each kind of device: for the wrench that it renders, and for force, torque or both."""

from __future__ import annotations

from functools import singledispatch

from haptorb.control.allocation import (
    Allocator,
    WrenchChoice,
    arm_allocator,
    force_allocator,
    part_remarks,
    tool_choice,
    torque_allocator,
)
from haptorb.control.array_allocation import array_allocator, array_choice, array_remarks
from haptorb.devices.arm import Arm
from haptorb.devices.base import Device, device_function, unsupported
from haptorb.devices.coil_array import CoilArray
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.devices.motor import SphericalMotor
from haptorb.errors import InputError
from haptorb.worlds.base import WrenchPart

__all__ = ["describe_choice", "has_choice", "make_allocator", "make_choice"]


@device_function
@singledispatch
def make_allocator(device: Device) -> Allocator:
    """Create the allocator of a device, by its kind; `haptorb run` needs it.

    Parameters
    ----------
    device : Device
        The device.

    Returns
    -------
    Allocator
        Allocator with the device's current and power limits.

    Raises
    ------
    InputError
        For a kind without one.
    """
    raise unsupported(device, "`haptorb run`", make_allocator)


@device_function
@singledispatch
def make_choice(device: Device, part: WrenchPart | None = None, arm: float | None = None) -> WrenchChoice | None:
    """Create the allocators of a device that renders force, torque or both, by its kind.

    Parameters
    ----------
    device : Device
        The device.
    part : str, optional
        Rendered part, "force", "torque" or "wrench", overriding the world's.
    arm : float, optional
        Length at which 1 N of force weighs as much as the torque 1 N × `arm` [m].

    Returns
    -------
    WrenchChoice or None
        None for a kind without that choice.

    Raises
    ------
    InputError
        For an invalid arm, and for a part or an arm on a device without that choice.
    """
    if part is None and arm is None:
        return None
    raise InputError(
        f"device '{device.name}' ({device.kind.title}) has no choice of force or torque: it always renders every "
        "component; leave out render and torque arm"
    )


def has_choice(device: Device) -> bool:
    """Whether `device` renders force, torque or both, as a world defines."""
    return make_choice.dispatch(device.__class__) is not make_choice.dispatch(object)


@device_function
@singledispatch
def describe_choice(device: Device, choice: WrenchChoice) -> tuple[str, ...]:
    """Describe how a device renders each part of a wrench, by its kind, for the person who runs it.

    Parameters
    ----------
    device : Device
        The device.
    choice : WrenchChoice
        Its allocators.

    Returns
    -------
    tuple of str
        One or two sentences for each part, indexed by its number in recordings; empty where none is needed.
    """
    return ()


make_allocator.register(SphericalElectromagnet, force_allocator)
make_allocator.register(SphericalMotor, torque_allocator)
make_allocator.register(CoilArray, array_allocator)
make_allocator.register(Arm, arm_allocator)
make_choice.register(SphericalElectromagnet, tool_choice)
make_choice.register(CoilArray, array_choice)
describe_choice.register(SphericalElectromagnet, part_remarks)
describe_choice.register(CoilArray, array_remarks)
