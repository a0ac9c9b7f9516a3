"""Where a device's mover can be, and what a world asks of it there, in the coordinates in which a hand holds it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from haptorb.control.clutch.gains import MOTOR_GAINS
from haptorb.control.stability.gradient import Field
from haptorb.control.stability.hand_grip import HandGrip
from haptorb.devices.coil_array.coil_array import CoilArray
from haptorb.devices.device import Device
from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.devices.motor.spherical_motor import SphericalMotor
from haptorb.devices.state import State, rotation_to_axis
from haptorb.numerics.arrays import Array
from haptorb.numerics.so3 import turn_by
from haptorb.worlds.world import World

__all__ = ["Workspace", "array_workspace", "shell_workspace", "tilt_workspace", "turn", "workspace"]

_PLACES = 400
_POSES = 200
_LEAN = np.radians(70.0)  #: of a tool from how it mostly stands
_UPRIGHT, _STILL = np.eye(3), np.zeros(3)


@dataclass(frozen=True)
class Workspace:
    """What the analysis needs of a device.

    places   (n, 3) all over the workspace: [m] of a tool, ψ, λ, φ [rad] of a rotor
    inside   whether a place belongs to it
    force    "N" or "N·m"
    length   "m" or "rad"
    grip     a grip as it is met in these coordinates, with the mover in it
    field    what a world asks at a place
    poses    () → places (3,) [m] and rotations (3, 3) of a tool that leans any way, where a world's torque is looked at
    turning_grip
             a grip as a tool meets it that turns about its magnet: at the arm at which its fingers hold it
    """

    places: Array
    inside: Callable[[Array], bool]
    force: str
    length: str
    grip: Callable[[HandGrip], HandGrip]
    field: Callable[[World], Field]
    poses: Callable[[], list[tuple[Array, Array]]] | None = None
    turning_grip: Callable[[HandGrip], HandGrip] | None = None


def workspace(device: Device) -> Workspace:
    """The workspace of `device`; InputError where its kind does not say it."""
    found: Workspace = device.kind.require_part("workspace", device.name, "`haptorb check --world`")(device)
    return found


def shell_workspace(device: SphericalElectromagnet) -> Workspace:
    """The shell over a dome, where a hand moves a tool [m]."""
    return _go_over_dome(device, device.contact_distance, device.shell_thickness, device.workspace_half_angle)


def array_workspace(device: CoilArray) -> Workspace:
    """Where a hand moves the tool of a coil array [m]: over its dome, radially, or over its plate, upright."""
    surface, near = device.surface, device.contact_height
    if surface.is_dome:
        return _go_over_dome(device, near, surface.thickness, surface.half_angle)
    rng = np.random.default_rng(0)
    side, far = np.array(surface.half_width), near + surface.thickness
    places = np.column_stack([rng.uniform(-side, side, (_PLACES, 2)), rng.uniform(near, far, _PLACES)])
    places[::4, 2] = near  # a tool mostly touches

    def contains(p: Array) -> bool:
        return bool((np.abs(p[:2]) <= side).all() and near <= p[2] <= far)

    def poses() -> list[tuple[Array, Array]]:
        draw = np.random.default_rng(0)
        return [(p.copy(), turn(_draw_lean(draw), _UPRIGHT)) for p in places[:_POSES]]

    def field(world: World) -> Field:
        return _ask_force(world, device, lambda p: _UPRIGHT)

    return Workspace(places, contains, "N", "m", _hold(device), field, poses, _hold_turning(device))


def _go_over_dome(
    device: SphericalElectromagnet | CoilArray, near: float, thickness: float, half_angle: float
) -> Workspace:
    """A radial tool at `near` to `near` + `thickness` [m] from the centre, up to `half_angle` [rad] from the summit."""
    rng = np.random.default_rng(0)
    far, lowest = near + thickness, float(np.cos(half_angle))
    z, around = rng.uniform(lowest, 1.0, _PLACES), rng.uniform(0, 2 * np.pi, _PLACES)
    flat = np.sqrt(1 - z * z)
    directions = np.column_stack([flat * np.cos(around), flat * np.sin(around), z])
    distances = np.where(np.arange(_PLACES) % 4 == 0, near, rng.uniform(near, far, _PLACES))  # a tool mostly touches

    def contains(p: Array) -> bool:
        d = float(np.linalg.norm(p))
        return near <= d <= far and p[2] >= lowest * d

    def poses() -> list[tuple[Array, Array]]:
        draw, found = np.random.default_rng(0), []
        for n in range(_POSES):
            u = draw.normal(size=3)
            u[2] = abs(u[2])
            u /= np.linalg.norm(u)
            if u[2] < lowest:
                u = np.array([0.0, 0.0, 1.0])
            above = 0.0 if n % 2 == 0 else draw.uniform(0.0, thickness)
            found.append(((near + above) * u, turn(_draw_lean(draw), rotation_to_axis(u))))
        return found

    def field(world: World) -> Field:
        return _ask_force(world, device, rotation_to_axis)

    places = directions * distances[:, None]
    return Workspace(places, contains, "N", "m", _hold(device), field, poses, _hold_turning(device))


def turn(q: Array, R: Array) -> Array:
    """(3, 3): R turned by the rotation vector q (3,) [rad]."""
    out = np.empty((3, 3))
    turn_by(float(q[0]), float(q[1]), float(q[2]), np.ascontiguousarray(R), out)
    return out


def _draw_lean(draw: np.random.Generator) -> Array:
    lean = draw.normal(size=3)
    lean *= draw.uniform(0.0, _LEAN) / np.linalg.norm(lean)
    return lean


def _ask_force(world: World, device: Device, stand: Callable[[Array], Array]) -> Field:
    """The force of `world` on a tool that stands at each place as `stand` says."""
    fitted = world.for_device(device)

    def force(p: Array, v: Array, t: float) -> Array:
        out: Array = fitted.wrench(State(t, stand(p), p, _STILL, v))[:3]
        return out

    return force


def _hold(device: SphericalElectromagnet | CoilArray) -> Callable[[HandGrip], HandGrip]:
    return lambda grip: grip.with_mass(device.tool.mass)


def _hold_turning(device: SphericalElectromagnet | CoilArray) -> Callable[[HandGrip], HandGrip]:
    """Damping and stiffness of a grip times the square of the arm at which fingers hold the tool."""
    hand = device.hand
    square = hand.turn_damping / hand.damping if hand.damping > 0.0 else 0.0
    inertia = float(device.tool.inertia[0])
    return lambda grip: HandGrip(inertia + grip.mass * square, grip.damping * square, grip.stiffness * square)


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
