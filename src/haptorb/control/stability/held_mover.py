"""A hand on a device's mover, as a scene's coupling meets it: one record for each kind of device."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from haptorb.control.clutch.gains import MOTOR_GAINS
from haptorb.control.stability.hand_grip import HandGrip
from haptorb.devices.coil_array.coil_array import CoilArray
from haptorb.devices.device import Device
from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.devices.motor.spherical_motor import SphericalMotor
from haptorb.errors import InputError

__all__ = ["HeldMover", "hold_mover", "hold_rotor", "hold_tool"]


@dataclass(frozen=True)
class HeldMover:
    """Hand and mover together.

    grip            where the motion of the loop is counted: of a rotor, about its centre [kg·m², N·m·s, N·m]
    move, turn      what a stiffness along, or about, the axes of a scene counts there as; turn 0: no torque is rendered
    strongest       force of the device on the mover, which a coupling must not reach too soon [N]; inf: does not matter
    """

    grip: HandGrip
    move: float = 1.0
    turn: float = 0.0
    strongest: float = math.inf


def hold_mover(device: Device, hand: HandGrip) -> HeldMover:
    """`hand` on the mover of `device`. Raises InputError for a kind of device that a scene cannot be coupled to."""
    hold = device.kind.part("hold")
    if hold is None:
        raise InputError(f"device '{device.name}' ({device.kind.title}) has neither a tool nor a rotor for a scene")
    held: HeldMover = hold(device, hand)
    return held


def hold_tool(device: SphericalElectromagnet | CoilArray, hand: HandGrip) -> HeldMover:
    """`hand` on a tool, on which forces are rendered."""
    return HeldMover(hand.with_mass(device.tool.mass), strongest=device.limits.force)


def hold_rotor(device: SphericalMotor, hand: HandGrip) -> HeldMover:
    """`hand` on a handle, which moves a target in both modes by the default gains."""
    arm, gains = device.rotor.handle_length, MOTOR_GAINS
    inertia = float(device.rotor.inertia[0]) + hand.mass * arm**2
    grip = HandGrip(inertia, hand.damping * arm**2, hand.stiffness * arm**2)
    rendered = np.array([*gains.translate, *gains.rotate]) ** 2 * gains.torque_per_motion
    return HeldMover(grip, float(rendered[:3].max()), float(rendered[3:].max()))
