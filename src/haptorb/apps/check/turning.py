"""A torque on a tool, as the stability of a loop meets it: how steeply it changes with the tool's orientation.

At each of many poses the coordinates are small turns of the tool about its magnet.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from haptorb.apps.check.workspace import Workspace, turn, workspace
from haptorb.control.stability.gradient import Field, Steepest, Steepness
from haptorb.devices.device import Device
from haptorb.devices.state import State
from haptorb.errors import InputError
from haptorb.numerics.arrays import Array
from haptorb.worlds.world import World
from haptorb.worlds.wrench_part import WrenchPart, find_part, join_parts

__all__ = ["UNJUDGED", "find_asked_part", "steepest_turn", "turning_workspace"]

#: what the analysis of a world that asks torque leaves out
UNJUDGED = (
    "the force that accompanies a torque, and the errors of a compromise between force and torque",
    "a torque that changes with position, and a force that changes with orientation",
)

_CLIMBS, _MOST = 4, 4  #: of the steepest poses, from which it climbs on; of candidates of each kind
_STEP = 2e-4  #: of the differences [rad]
_RATE = 1e-2  #: of the differences by angular velocity [rad/s]
_NOTHING = 1e-5  #: a smaller jump is nothing to be felt [N·m]
_STILL = np.zeros(3)


def turning_workspace(device: Device) -> Workspace:
    """Small turns of a tool about its magnet [rad]: units and grip; the poses are those of `steepest_turn`.

    A hand is met at the arm at which its fingers hold the tool: damping and stiffness times the arm squared.
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
    raise InputError("the torque of a world is looked at pose by pose: `steepest_turn`")


def steepest_turn(device: Device, world: World) -> Steepest:
    """What is steepest of the torque of `world` in all orientations; the places are directions of the tool's axis.

    Differences at many poses, and from the steepest on by random steps for as long as it grows.
    """
    fitted, rng = world.for_device(device), np.random.default_rng(1)
    found: list[Steepness] = []
    away, jump = 0.0, 0.0

    def look(p: Array, R: Array, t: float, moving: bool) -> float:
        """The steepness at a pose; its strongest spring [N·m/rad]."""
        nonlocal away, jump

        def torque(q: Array, rate: Array) -> Array:
            out: Array = fitted.wrench(State(t, turn(q, R), p, rate, _STILL))[3:]
            return out

        G, leap = _turn_gradient(torque)
        jump = max(jump, leap)
        pull, u = np.linalg.eigh(-0.5 * (G + G.T))
        away = max(away, -float(pull[0]))
        D = np.zeros((3, 3))
        for j in range(3 if moving else 0):
            D[:, j] = (torque(_STILL, -_RATE * np.eye(3)[j]) - torque(_STILL, _RATE * np.eye(3)[j])) / (2 * _RATE)
        x, y, z = R[:, 2].tolist()
        for j in range(3):
            found.append(Steepness(float(pull[j]), float(u[:, j] @ D @ u[:, j]), (x, y, z)))
        return float(np.abs(pull).max())

    poses = _list_poses(device)
    times = rng.uniform(0.0, 10.0, len(poses)).tolist()
    sizes = [look(p, R, t, True) for (p, R), t in zip(poses, times, strict=True)]
    for n in np.argsort(sizes)[::-1][:_CLIMBS].tolist():
        (p, R), best, reach = poses[n], sizes[n], 0.3
        while reach > _STEP:
            tried = [turn(reach * rng.normal(size=3), R) for _ in range(6)]
            grown = [look(p, turned, times[n], False) for turned in tried]
            m = int(np.argmax(grown))
            if grown[m] > best * (1 + 1e-3):
                R, best = tried[m], grown[m]
            else:
                reach *= 0.5
        look(p, R, times[n], True)
    keys: tuple[Callable[[Steepness], float], ...] = (
        lambda one: one.stiffness.real,
        lambda one: one.damping,
        lambda one: -one.damping,
    )
    chosen = {one: None for key in keys for one in sorted(found, key=key, reverse=True)[:_MOST] if key(one) > 1e-9}
    return Steepest(tuple(chosen), away, jump)


def _turn_gradient(torque: Callable[[Array, Array], Array]) -> tuple[Array, float]:
    """(3, 3) ∂T/∂angle [N·m/rad], axes about which it jumps left out, and the greatest jump [N·m]."""
    G, jump = np.zeros((3, 3)), 0.0
    for j in range(3):
        step = _STEP * np.eye(3)[j]
        wide = torque(step, _STILL) - torque(-step, _STILL)
        near = torque(step / 4, _STILL) - torque(-step / 4, _STILL)
        if np.linalg.norm(near) > 0.6 * np.linalg.norm(wide) > _NOTHING:
            jump = max(jump, float(np.linalg.norm(wide)))
        else:
            G[:, j] = near / (_STEP / 2)
    return G, jump


def find_asked_part(device: Device, world: World) -> WrenchPart:
    """What `world` asks: as it says, or what its wrenches show at many poses."""
    if world.asks is not None:
        return world.asks
    fitted = world.for_device(device)
    poses = _list_poses(device)
    parts = [find_part(fitted.wrench(State(0.0, R, p, _STILL, _STILL))) for p, R in poses]
    moving = [find_part(fitted.wrench(State(0.0, R, p, np.ones(3), 0.1 * np.ones(3)))) for p, R in poses]
    return join_parts(part for part in parts + moving if part is not None) or "force"


def _list_poses(device: Device) -> list[tuple[Array, Array]]:
    poses = workspace(device).poses
    if poses is None:
        raise _refuse(device)
    return poses()
