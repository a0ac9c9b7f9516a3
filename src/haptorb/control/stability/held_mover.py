"""A hand on a device's mover, as a scene's coupling meets it: one record for each kind of device."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from haptorb.control.clutch.linkage import MOTOR_GAINS
from haptorb.control.stability.hand_grip import HandGrip
from haptorb.devices.coil_array.coil_array import CoilArray
from haptorb.devices.device import Device
from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.devices.motor.spherical_motor import SphericalMotor
from haptorb.errors import InputError
from haptorb.numerics.arrays import Array

__all__ = ["HeldMover", "hold_array", "hold_mover", "hold_rotor", "hold_tool"]


@dataclass(frozen=True)
class HeldMover:
    """Hand and mover together.

    grip            where the motion of the loop is counted: of a rotor, about its centre [kg·m², N·m·s, N·m]
    move, turn      what a stiffness along, or about, the axes of a scene counts there as; turn 0: no torque is felt
    strongest       force of the device on the mover, which a coupling must not reach too soon [N]; inf: does not matter
    radii           (2,) a tool goes over the dome between these distances from the centre [m]; of others (0, 0)
    reach           (3,) how far a tool goes over a plate [m]
    """

    grip: HandGrip
    move: float
    turn: float
    strongest: float
    radii: tuple[float, float]
    reach: tuple[float, float, float]

    @property
    def is_tool(self) -> bool:
        """Whether the hand holds a tool, and not a rotor's handle."""
        return self.turn == 0.0

    def aim(self, wish: Array) -> Array:
        """(3,) where a hand that wanders wants the tool [m], for a `wish` (3,) of about ±1."""
        bounded = np.tanh(wish)
        near, far = self.radii
        if not far:
            middle: Array = bounded * self.reach
            return middle
        u = np.array([math.sin(0.6 * bounded[0]), math.sin(0.6 * bounded[1]), 1.0])
        u *= (near + 0.5 * (far - near) * (1.0 + bounded[2])) / np.linalg.norm(u)
        return u


def hold_mover(device: Device, hand: HandGrip) -> HeldMover:
    """`hand` on the mover of `device`. Raises InputError for a kind of device that a scene cannot be coupled to."""
    hold = device.kind.part("hold")
    if hold is None:
        raise InputError(f"device '{device.name}' ({device.kind.title}) has neither a tool nor a rotor for a scene")
    held: HeldMover = hold(device, hand)
    return held


def hold_tool(device: SphericalElectromagnet, hand: HandGrip) -> HeldMover:
    """`hand` on a tool: it feels forces, and wanders over the dome."""
    grip = hand.with_mass(device.tool.mass)
    return HeldMover(
        grip, 1.0, 0.0, device.limits.force, (device.contact_distance, device.contact_distance + 6e-3), (0.0, 0.0, 0.0)
    )


def hold_array(device: CoilArray, hand: HandGrip) -> HeldMover:
    """`hand` on the tool of a coil array: it feels forces, and wanders over the dome or over the plate."""
    grip, surface, contact = hand.with_mass(device.tool.mass), device.surface, device.contact_height
    return HeldMover(
        grip, 1.0, 0.0, device.limits.force, (contact, contact + 6e-3) if surface.is_dome else (0.0, 0.0),
        (*surface.half_width, 6e-3),
    )  # fmt: skip


def hold_rotor(device: SphericalMotor, hand: HandGrip) -> HeldMover:
    """`hand` on a handle: it moves a target in both modes, by the default gains."""
    arm, gains = device.rotor.handle_length, MOTOR_GAINS
    inertia = float(device.rotor.inertia[0]) + hand.mass * arm**2
    grip = HandGrip(inertia, hand.damping * arm**2, hand.stiffness * arm**2)
    motion = np.array([*gains.translate, *gains.rotate]) ** 2
    felt = motion * gains.torque_per_motion
    return HeldMover(grip, float(felt[:3].max()), float(felt[3:].max()), math.inf, (0.0, 0.0), (0.0, 0.0, 0.0))
