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
from haptorb.numerics.arrays import Array

__all__ = ["HeldMover", "hold_array", "hold_mover", "hold_rotor", "hold_tool"]


@dataclass(frozen=True)
class HeldMover:
    """Hand and mover together.

    grip            where the motion of the loop is counted: of a rotor, about its centre [kg·m², N·m·s, N·m]
    move, turn      what a stiffness along, or about, the axes of a scene counts there as; turn 0: no torque is felt
    strongest       force of the device on the mover, which a coupling must not reach too soon [N]; inf: does not matter
    masses, dampers, springs
                    (6,) along and about the axes in which the scene is felt [kg, kg·m²], [N·s/m, N·m·s], [N/m, N·m]
    rest            (6,) where the hand begins [m, rad]
    radii           (2,) a tool goes over the dome between these distances from the centre [m]; of others (0, 0)
    reach           (6,) how far others wander [m, rad]
    """

    grip: HandGrip
    move: float
    turn: float
    strongest: float
    masses: Array
    dampers: Array
    springs: Array
    rest: Array
    radii: tuple[float, float]
    reach: Array

    def aim(self, wish: Array) -> Array:
        """(6,) where the hand's own spring has its middle [m, rad], for a `wish` (6,) of about ±1."""
        bounded = np.tanh(wish)
        near, far = self.radii
        if not far:
            middle: Array = bounded * self.reach
            return middle
        u = np.array([math.sin(0.6 * bounded[0]), math.sin(0.6 * bounded[1]), 1.0])
        u *= (near + 0.5 * (far - near) * (1.0 + bounded[2])) / np.linalg.norm(u)
        return np.concatenate([u, np.zeros(3)])


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
        grip, 1.0, 0.0, device.limits.force,
        np.array([grip.mass] * 3 + [1e-4] * 3),
        np.array([hand.damping] * 3 + [device.hand.turn_damping] * 3),
        np.array([hand.stiffness] * 3 + [device.hand.turn_stiffness] * 3),
        np.concatenate([device.rest_position, np.zeros(3)]),
        (device.contact_distance, device.contact_distance + 6e-3),
        np.zeros(6),
    )  # fmt: skip


def hold_array(device: CoilArray, hand: HandGrip) -> HeldMover:
    """`hand` on the tool of a coil array: it feels forces, and wanders over the dome or over the plate."""
    grip, surface, contact = hand.with_mass(device.tool.mass), device.surface, device.contact_height
    return HeldMover(
        grip, 1.0, 0.0, device.limits.force,
        np.array([grip.mass] * 3 + [1e-4] * 3),
        np.array([hand.damping] * 3 + [device.hand.turn_damping] * 3),
        np.array([hand.stiffness] * 3 + [device.hand.turn_stiffness] * 3),
        np.concatenate([device.rest_position, np.zeros(3)]),
        (contact, contact + 6e-3) if surface.is_dome else (0.0, 0.0),
        np.array([*surface.half_width, 6e-3, 0.0, 0.0, 0.0]),
    )  # fmt: skip


def hold_rotor(device: SphericalMotor, hand: HandGrip) -> HeldMover:
    """`hand` on a handle: it moves a target in both modes, by the default gains."""
    arm, gains = device.rotor.handle_length, MOTOR_GAINS
    inertia = float(device.rotor.inertia[0]) + hand.mass * arm**2
    grip = HandGrip(inertia, hand.damping * arm**2, hand.stiffness * arm**2)
    motion = np.array([*gains.translate, *gains.rotate]) ** 2
    felt = motion * gains.torque_per_motion
    return HeldMover(
        grip, float(felt[:3].max()), float(felt[3:].max()), math.inf,
        inertia / motion, grip.damping / motion, grip.stiffness / motion,
        np.concatenate([device.rest_position, np.zeros(3)]), (0.0, 0.0),
        np.array([0.009, 0.001, 0.001, 0.03, 0.03, 0.03]),
    )  # fmt: skip
