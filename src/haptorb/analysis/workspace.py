"""Workspace of a device's mover, and the force field of a world in it, in the coordinates of the hand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import singledispatch
from typing import final

import numpy as np

from haptorb.analysis.stability import Field, HandGrip, Steepest, Steepness
from haptorb.arrays import Array
from haptorb.control.linkage import MOTOR_GAINS
from haptorb.devices.arm import Arm
from haptorb.devices.base import Device, State, device_function, rotation_to_axis, unsupported
from haptorb.devices.coil_array import CoilArray
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.devices.motor import SphericalMotor
from haptorb.errors import InputError
from haptorb.rotations import turn_by
from haptorb.worlds.base import World, WrenchPart, find_part, join_parts
from haptorb.worlds.dynamic import BoundWorld, DynamicWorld

__all__ = [
    "UNJUDGED",
    "Workspace",
    "WorkspaceMapping",
    "arm_workspace",
    "array_workspace",
    "find_asked_part",
    "list_quick_steepness",
    "map_workspaces",
    "shell_workspace",
    "steepest_turn",
    "tilt_workspace",
    "turn",
    "turning_workspace",
    "workspace",
]


_WORKSPACE_PLACES = 400
_POSES = 200
_LEAN = np.radians(70.0)  #: tilt of a tool from its usual orientation
_UPRIGHT, _WORKSPACE_STILL = np.eye(3), np.zeros(3)


@dataclass(frozen=True)
class Workspace:
    """Workspace of a device for the analysis.

    Parameters
    ----------
    places : ndarray, shape (n, 3)
        Sample of the workspace: positions of a tool [m], or ψ, λ, φ of a rotor [rad].
    inside : callable
        Returns whether a place (3,) belongs to it.
    force : str
        "N" or "N·m".
    length : str
        "m" or "rad".
    grip : callable
        Returns the impedance of a `HandGrip` in these coordinates, including the mover.
    field : callable
        Returns the force field of a world in these coordinates.
    poses : callable, optional
        Returns places (3,) [m] and rotations (3, 3) of a tool tilted in any direction, for the torque of a world.
    turning_grip : callable, optional
        Returns the rotational impedance of a `HandGrip` about the tool's magnet: at the lever arm of the fingers.
    """

    places: Array
    inside: Callable[[Array], bool]
    force: str
    length: str
    grip: Callable[[HandGrip], HandGrip]
    field: Callable[[World], Field]
    poses: Callable[[], list[tuple[Array, Array]]] | None = None
    turning_grip: Callable[[HandGrip], HandGrip] | None = None


@device_function
@singledispatch
def workspace(device: Device) -> Workspace:
    """Return the workspace of a device, by its kind; `haptorb check --world` needs it.

    Parameters
    ----------
    device : Device
        The device.

    Returns
    -------
    Workspace
        Places, field of a world and impedance of the hand.

    Raises
    ------
    InputError
        For a kind without one.
    """
    raise unsupported(device, "`haptorb check --world`", workspace)


@workspace.register(SphericalElectromagnet)
def shell_workspace(device: SphericalElectromagnet) -> Workspace:
    """Shell over a dome in which a hand moves a tool [m]."""
    return _go_over_dome(device, device.contact_distance, device.shell_thickness, device.workspace_half_angle)


@workspace.register(CoilArray)
def array_workspace(device: CoilArray) -> Workspace:
    """Workspace of the tool of a coil array [m]: radial over its dome, or upright over its plate."""
    surface, near = device.surface, device.contact_height
    if surface.is_dome:
        return _go_over_dome(device, near, surface.thickness, surface.half_angle)
    rng = np.random.default_rng(0)
    side, far = np.array(surface.half_width), near + surface.thickness
    places = np.column_stack(
        [rng.uniform(-side, side, (_WORKSPACE_PLACES, 2)), rng.uniform(near, far, _WORKSPACE_PLACES)]
    )
    places[::4, 2] = near  # a tool is mostly in contact

    def contains(p: Array) -> bool:
        return bool((np.abs(p[:2]) <= side).all() and near <= p[2] <= far)

    def poses() -> list[tuple[Array, Array]]:
        draw = np.random.default_rng(0)
        return [(p.copy(), turn(_draw_lean(draw), _UPRIGHT)) for p in places[:_POSES]]

    def field(world: World) -> Field:
        return _ask_force(world, device, lambda p: _UPRIGHT)

    return Workspace(places, contains, "N", "m", _hold(device), field, poses, _hold_turning(device))


@workspace.register(Arm)
def arm_workspace(device: Arm) -> Workspace:
    """Workspace of the end effector of an arm [m]; the arm's dry friction is neglected."""
    rng, half = np.random.default_rng(0), np.array(device.workspace.half)
    places = rng.uniform(-half, half, (8 * _WORKSPACE_PLACES, 3))
    ends = np.vstack([np.diag(half), -np.diag(half)])
    places = np.vstack([ends, places[device.workspace.contains(places)]])[:_WORKSPACE_PLACES]

    def contains(p: Array) -> bool:
        return bool(device.workspace.contains(p[None])[0])

    def grip(hand: HandGrip) -> HandGrip:
        return replace(hand.with_mass(device.effector.mass), damping=hand.damping + device.effector.viscous)

    def turning(hand: HandGrip) -> HandGrip:
        held = device.hand
        square = held.turn_damping / held.damping if held.damping > 0.0 else 0.0
        return HandGrip(device.effector.inertia, hand.damping * square, hand.stiffness * square)

    def field(world: World) -> Field:
        return _ask_force(world, device, lambda p: _UPRIGHT)

    def poses() -> list[tuple[Array, Array]]:
        draw = np.random.default_rng(0)
        return [(p.copy(), turn(_draw_lean(draw), _UPRIGHT)) for p in places[:_POSES]]

    if device.is_turned:
        return Workspace(places, contains, "N", "m", grip, field, poses, turning)
    return Workspace(places, contains, "N", "m", grip, field)


def _go_over_dome(
    device: SphericalElectromagnet | CoilArray, near: float, thickness: float, half_angle: float
) -> Workspace:
    """Workspace of a radial tool at `near` to `near` + `thickness` [m] from the centre, up to `half_angle` [rad] from
    the summit."""
    rng = np.random.default_rng(0)
    far, lowest = near + thickness, float(np.cos(half_angle))
    z, around = rng.uniform(lowest, 1.0, _WORKSPACE_PLACES), rng.uniform(0, 2 * np.pi, _WORKSPACE_PLACES)
    flat = np.sqrt(1 - z * z)
    directions = np.column_stack([flat * np.cos(around), flat * np.sin(around), z])
    distances = np.where(
        np.arange(_WORKSPACE_PLACES) % 4 == 0, near, rng.uniform(near, far, _WORKSPACE_PLACES)
    )  # a tool is mostly in contact

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
    """Rotate R (3, 3) by the rotation vector q (3,) [rad]."""
    out = np.empty((3, 3))
    turn_by(float(q[0]), float(q[1]), float(q[2]), np.ascontiguousarray(R), out)
    return out


def _draw_lean(draw: np.random.Generator) -> Array:
    lean = draw.normal(size=3)
    lean *= draw.uniform(0.0, _LEAN) / np.linalg.norm(lean)
    return lean


def _ask_force(world: World, device: Device, stand: Callable[[Array], Array]) -> Field:
    """Force of `world` on a tool with the orientation `stand` at each place."""
    fitted = world.for_device(device)

    def force(p: Array, v: Array, t: float) -> Array:
        out: Array = fitted.wrench(State(t, stand(p), p, _WORKSPACE_STILL, v))[:3]
        return out

    return force


def _hold(device: SphericalElectromagnet | CoilArray) -> Callable[[HandGrip], HandGrip]:
    return lambda grip: grip.with_mass(device.tool.mass)


def _hold_turning(device: SphericalElectromagnet | CoilArray) -> Callable[[HandGrip], HandGrip]:
    """Damping and stiffness of a grip times the square of the lever arm of the fingers on the tool."""
    hand = device.hand
    square = hand.turn_damping / hand.damping if hand.damping > 0.0 else 0.0
    inertia = float(device.tool.inertia[0])
    return lambda grip: HandGrip(inertia + grip.mass * square, grip.damping * square, grip.stiffness * square)


@workspace.register(SphericalMotor)
def tilt_workspace(device: SphericalMotor) -> Workspace:
    """Workspace in mode translate with the default gains, eq. (6b): tilts move the object, its force is fed back."""
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
            x, y, z = fitted.wrench(State(t, _UPRIGHT, at, _WORKSPACE_STILL, moving))[:3]
            return np.array([eta_psi * y, eta_lam * x, eta_phi * z])

        return torque

    def grip_of(hand: HandGrip) -> HandGrip:
        return HandGrip(inertia + hand.mass * arm**2, hand.damping * arm**2, hand.stiffness * arm**2)

    def contains(q: Array) -> bool:
        return bool((np.abs(q) <= tilt).all())

    return Workspace(rng.uniform(-tilt, tilt, (_WORKSPACE_PLACES, 3)), contains, "N·m", "rad", grip_of, field)


# --------------------------------------------------------------------------------------------------
# Mapping from the workspace of one device to that of another: centre to centre, with one scale.


@final
@dataclass(frozen=True)
class WorkspaceMapping:
    """Mapping of positions of one device to those of another: p' = centre' + scale (p − centre)."""

    centre: Array  #: (3,) middle of the first workspace [m]
    other_centre: Array  #: (3,) of the second [m]
    scale: float  #: metres in the second workspace per metre in the first

    def place(self, p: Array) -> Array:
        """Map `p` (..., 3) [m] of the first device to places (..., 3) [m] of the second."""
        found: Array = self.other_centre + self.scale * (p - self.centre)
        return found


def map_workspaces(device: Device, other: Device) -> WorkspaceMapping | None:
    """Map the workspace of `device` to that of `other`; None if one of them has no positions.

    The scale is the largest at which the bounding box of the first workspace fits into that of the second. Forces are
    not scaled; the apparent stiffness is 1/scale as large, and so is a stability limit.
    """
    boxes = []
    for one in (device, other):
        if workspace.dispatch(one.__class__) is workspace.dispatch(object):
            return None
        found = workspace(one)
        if found.length != "m":
            return None
        low, high = found.places.min(axis=0), found.places.max(axis=0)
        boxes.append((0.5 * (low + high), 0.5 * (high - low)))
    (centre, half), (other_centre, other_half) = boxes
    return WorkspaceMapping(centre, other_centre, float((other_half / half).min()))


# --------------------------------------------------------------------------------------------------
# Stiffness of a world with memory against a small fast motion: bristles bend, a ball does not move.
#
# In its initial state such a world may have no slope. So it is held at a place until it has settled, and then displaced
# slightly from there, each time with the same memory.


_QUICK_STEEPNESS_PLACES = 120  #: number of places, the first ones of the workspace, which are in random order
_HOLD = 5  #: ticks at a place before it is moved
_QUICK_STEEPNESS_STEP = 2e-5  #: of the differences [m] or [rad]


@final
@dataclass(frozen=True)
class _SettledWorld(World):
    """World with memory, displaced from a settled state; to `Workspace.field` it is a world without memory."""

    bound_world: BoundWorld | None = None

    def hold(self, state: State) -> None:
        """Start the world, and hold it at `state` until it has settled."""
        assert self.bound_world is not None
        self.bound_world.restart()
        for _ in range(_HOLD):
            self.bound_world.wrench(state)

    def wrench(self, state: State) -> Array:
        """Return (6,) at `state` [N, N·m], one tick after the settled state, which is then restored."""
        assert self.bound_world is not None
        before = self.bound_world.numbers.copy()
        try:
            self.bound_world.wrench(state)
            return self.bound_world.wrench(state).copy()
        finally:
            self.bound_world.numbers[:] = before


class _Holder:
    """World for `Workspace.field` that settles the world at each evaluated place."""

    def __init__(self, settled: _SettledWorld) -> None:
        self._settled = settled

    def for_device(self, device: Device) -> _Holder:
        return self

    def wrench(self, state: State) -> Array:
        self._settled.hold(state)
        return np.zeros(6)


def list_quick_steepness(device: Device, world: DynamicWorld, place: Workspace, dt: float) -> list[Steepness]:
    """Principal stiffnesses of `world` over the workspace of `device`, against a motion within one tick of `dt` [s];
    in the workspace's own coordinates, like those of `steepest`."""
    fitted = world.for_device(device)
    assert isinstance(fitted, DynamicWorld)
    settled = _SettledWorld(BoundWorld(fitted, dt))
    hold, field = place.field(_Holder(settled)), place.field(settled)  # type: ignore[arg-type]
    still, found = np.zeros(3), []
    for p in place.places[:_QUICK_STEEPNESS_PLACES]:
        hold(p, still, 0.0)
        gradient = np.zeros((3, 3))
        for j in range(3):
            step = np.zeros(3)
            step[j] = _QUICK_STEEPNESS_STEP
            gradient[:, j] = (field(p + step, still, 0.0) - field(p - step, still, 0.0)) / (2 * _QUICK_STEEPNESS_STEP)
        pulls = np.linalg.eigvalsh(-0.5 * (gradient + gradient.T))
        at = (float(p[0]), float(p[1]), float(p[2]))
        found += [Steepness(float(pull), 0.0, at) for pull in pulls if pull > 1e-9]
    return sorted(found, key=lambda one: -one.stiffness.real)


# --------------------------------------------------------------------------------------------------
# Rotational stiffness of a world's torque on a tool, for the stability of a loop.
#
# At each of many poses the coordinates are small rotations of the tool about its magnet.


#: effects that the analysis of a world with torque neglects
UNJUDGED = (
    "the force that accompanies a torque, and the errors of a compromise between force and torque",
    "a torque that changes with position, and a force that changes with orientation",
)

_CLIMBS, _MAX_CANDIDATES = 4, 4  #: poses that start a local search; candidates of each kind
_TURNING_STEP_RAD = 2e-4  #: of the differences [rad]
_RATE = 1e-2  #: of the differences by angular velocity [rad/s]
_MIN_TORQUE_STEP_NM = 1e-5  #: discontinuity below which it is not perceptible [N·m]
_TURNING_STILL = np.zeros(3)


def turning_workspace(device: Device) -> Workspace:
    """Workspace of small rotations of a tool about its magnet [rad]: units and grip; `steepest_turn` has the poses.

    The hand's damping and stiffness apply at the lever arm of the fingers: they are multiplied by its square.
    InputError for a kind of device whose workspace contains no poses of a tool.
    """
    grip = workspace(device).turning_grip
    if grip is None:
        raise _refuse(device)
    return Workspace(np.zeros((0, 3)), lambda q: True, "N·m", "rad", grip, _no_field)


def _refuse(device: Device) -> InputError:
    return InputError(
        f"device '{device.name}' is a {device.kind.title}; the rotational grip of a hand on its mover is not known"
    )


def _no_field(world: World) -> Field:
    raise InputError("the torque of a world is evaluated pose by pose: use `steepest_turn`")


def steepest_turn(device: Device, world: World) -> Steepest:
    """Find the steepest torque of `world` over all orientations; the places are directions of the tool's axis.

    Difference quotients at many poses, followed by a random local search from the steepest ones.
    """
    fitted, rng = world.for_device(device), np.random.default_rng(1)
    found: list[Steepness] = []
    away, jump = 0.0, 0.0

    def linearize_at(p: Array, R: Array, t: float, moving: bool) -> float:
        """Append the stiffness and damping at a pose; returns its strongest spring [N·m/rad]."""
        nonlocal away, jump

        def torque(q: Array, rate: Array) -> Array:
            out: Array = fitted.wrench(State(t, turn(q, R), p, rate, _TURNING_STILL))[3:]
            return out

        G, leap = _turn_gradient(torque)
        jump = max(jump, leap)
        pull, u = np.linalg.eigh(-0.5 * (G + G.T))
        away = max(away, -float(pull[0]))
        D = np.zeros((3, 3))
        for j in range(3 if moving else 0):
            D[:, j] = (torque(_TURNING_STILL, -_RATE * np.eye(3)[j]) - torque(_TURNING_STILL, _RATE * np.eye(3)[j])) / (
                2 * _RATE
            )
        x, y, z = R[:, 2].tolist()
        for j in range(3):
            found.append(Steepness(float(pull[j]), float(u[:, j] @ D @ u[:, j]), (x, y, z)))
        return float(np.abs(pull).max())

    poses = _list_poses(device)
    times = rng.uniform(0.0, 10.0, len(poses)).tolist()
    sizes = [linearize_at(p, R, t, True) for (p, R), t in zip(poses, times, strict=True)]
    for n in np.argsort(sizes)[::-1][:_CLIMBS].tolist():
        (p, R), best, reach = poses[n], sizes[n], 0.3
        while reach > _TURNING_STEP_RAD:
            tried = [turn(reach * rng.normal(size=3), R) for _ in range(6)]
            grown = [linearize_at(p, turned, times[n], False) for turned in tried]
            m = int(np.argmax(grown))
            if grown[m] > best * (1 + 1e-3):
                R, best = tried[m], grown[m]
            else:
                reach *= 0.5
        linearize_at(p, R, times[n], True)
    keys: tuple[Callable[[Steepness], float], ...] = (
        lambda one: one.stiffness.real,
        lambda one: one.damping,
        lambda one: -one.damping,
    )
    chosen = {
        one: None for key in keys for one in sorted(found, key=key, reverse=True)[:_MAX_CANDIDATES] if key(one) > 1e-9
    }
    return Steepest(tuple(chosen), away, jump)


def _turn_gradient(torque: Callable[[Array, Array], Array]) -> tuple[Array, float]:
    """(3, 3) ∂T/∂angle [N·m/rad] without discontinuous axes, and the largest discontinuity [N·m]."""
    G, jump = np.zeros((3, 3)), 0.0
    for j in range(3):
        step = _TURNING_STEP_RAD * np.eye(3)[j]
        wide = torque(step, _TURNING_STILL) - torque(-step, _TURNING_STILL)
        near = torque(step / 4, _TURNING_STILL) - torque(-step / 4, _TURNING_STILL)
        if np.linalg.norm(near) > 0.6 * np.linalg.norm(wide) > _MIN_TORQUE_STEP_NM:
            jump = max(jump, float(np.linalg.norm(wide)))
        else:
            G[:, j] = near / (_TURNING_STEP_RAD / 2)
    return G, jump


def find_asked_part(device: Device, world: World) -> WrenchPart:
    """Find the rendered part of `world`: as it defines, or inferred from its wrenches at many poses."""
    if world.asks is not None:
        return world.asks
    fitted = world.for_device(device)
    poses = _list_poses(device)
    parts = [find_part(fitted.wrench(State(0.0, R, p, _TURNING_STILL, _TURNING_STILL))) for p, R in poses]
    moving = [find_part(fitted.wrench(State(0.0, R, p, np.ones(3), 0.1 * np.ones(3)))) for p, R in poses]
    return join_parts(part for part in parts + moving if part is not None) or "force"


def _list_poses(device: Device) -> list[tuple[Array, Array]]:
    poses = workspace(device).poses
    if poses is None:
        raise _refuse(device)
    return poses()
