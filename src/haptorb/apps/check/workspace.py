"""Where a device's mover can be, and what a world asks of it there, in the coordinates in which a hand holds it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from haptorb.control.clutch.linkage import MOTOR_GAINS
from haptorb.control.stability.gradient import Field
from haptorb.control.stability.hand_grip import HandGrip
from haptorb.devices.device import Device
from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.devices.motor.spherical_motor import SphericalMotor
from haptorb.devices.state import State, rotation_to_axis
from haptorb.numerics.arrays import Array
from haptorb.worlds.world import World

__all__ = ["Workspace", "shell_workspace", "tilt_workspace", "workspace"]

_PLACES = 400
_UPRIGHT, _STILL = np.eye(3), np.zeros(3)


@dataclass(frozen=True)
class Workspace:
    """What the analysis needs of a device.

    places   (n, 3) all over the workspace: [m] of a tool, ψ, λ, φ [rad] of a rotor
    inside   whether a place belongs to it
    force    "N" or "N·m"
    length   "m" or "rad"
    grip     a grip as it is met in these coordinates, with the mover in it
    """

    places: Array
    inside: Callable[[Array], bool]
    force: str
    length: str
    grip: Callable[[HandGrip], HandGrip]
    field: Callable[[World], Field]


def workspace(device: Device) -> Workspace:
    """The workspace of `device`; InputError where its kind does not say it."""
    found: Workspace = device.kind.require_part("workspace", device.name, "`haptorb check --world`")(device)
    return found


def shell_workspace(device: SphericalElectromagnet) -> Workspace:
    """The shell over a dome, where a hand moves a tool [m]."""
    rng = np.random.default_rng(0)
    near, far = device.contact_distance, device.contact_distance + device.shell_thickness
    lowest = float(np.cos(device.workspace_half_angle))
    z, turn = rng.uniform(lowest, 1.0, _PLACES), rng.uniform(0, 2 * np.pi, _PLACES)
    flat = np.sqrt(1 - z * z)
    directions = np.column_stack([flat * np.cos(turn), flat * np.sin(turn), z])
    distances = np.where(np.arange(_PLACES) % 4 == 0, near, rng.uniform(near, far, _PLACES))  # a tool mostly touches

    def contains(p: Array) -> bool:
        d = float(np.linalg.norm(p))
        return near <= d <= far and p[2] >= lowest * d

    def field(world: World) -> Field:
        fitted = world.for_device(device)

        def force(p: Array, v: Array, t: float) -> Array:
            out: Array = fitted.wrench(State(t, rotation_to_axis(p), p, _STILL, v))[:3]
            return out

        return force

    places = directions * distances[:, None]
    return Workspace(places, contains, "N", "m", lambda grip: grip.with_mass(device.tool.mass), field)


def tilt_workspace(device: SphericalMotor) -> Workspace:
    """Translational mode with the default gains, eq. (6b): the target moves with the tilts, its force comes back."""
    rng = np.random.default_rng(0)
    tilt = device.workspace_tilt
    zeta, (eta_psi, eta_lam, eta_phi) = MOTOR_GAINS.translate, MOTOR_GAINS.translate_torque or (0.0, 0.0, 0.0)
    arm = device.rotor.handle_length
    inertia = float(device.rotor.inertia[0])

    def field(world: World) -> Field:
        fitted = world.for_device(device)

        def torque(q: Array, rate: Array, t: float) -> Array:
            """(3,) about ψ, λ, φ [N·m]."""
            at, moving = (np.array([zeta[0] * x[1], zeta[1] * x[0], zeta[2] * x[2]]) for x in (q, rate))
            x, y, z = fitted.wrench(State(t, _UPRIGHT, at, _STILL, moving))[:3]
            return np.array([eta_psi * y, eta_lam * x, eta_phi * z])

        return torque

    def grip_of(hand: HandGrip) -> HandGrip:
        return HandGrip(inertia + hand.mass * arm**2, hand.damping * arm**2, hand.stiffness * arm**2)

    def contains(q: Array) -> bool:
        return bool((np.abs(q) <= tilt).all())

    return Workspace(rng.uniform(-tilt, tilt, (_PLACES, 3)), contains, "N·m", "rad", grip_of, field)
