"""A torque on a tool, as the stability of a loop meets it: how steeply it changes with the tool's orientation.

Orientations are looked at in small neighbourhoods of many, each with rotation vectors as coordinates: within 0.15 rad
they differ from angles by less than half a per cent.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from haptorb.apps.check.workspace import Workspace
from haptorb.control.stability.gradient import Field, Steepest, steepest
from haptorb.control.stability.hand_grip import HandGrip
from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.devices.state import State, rotation_to_axis
from haptorb.numerics.arrays import Array
from haptorb.numerics.so3 import turn_by
from haptorb.worlds.world import World
from haptorb.worlds.wrench_part import WrenchPart, find_part, join_parts

__all__ = ["UNJUDGED", "find_asked_part", "steepest_turn", "turning_workspace"]

#: what the analysis of a world that asks torque leaves out
UNJUDGED = (
    "the force that comes along with a torque, and what a compromise of force and torque changes",
    "a torque that changes with the place, and a force that changes with the orientation",
)

_NEAR = 0.15  #: size of a neighbourhood [rad]
_POSES, _TURNS = 16, 2
_CLIMBS, _STEPS = 3, 12  #: the steepest neighbourhoods from which it climbs on, and how far at most
_GROWN = 1.002  #: less is no growth
_LEAN = np.radians(70.0)  #: of a tool from the radial direction
_STILL = np.zeros(3)


def turning_workspace(device: SphericalElectromagnet) -> Workspace:
    """Orientations of a tool about its magnet [rad], in the coordinates of `steepest_turn`.

    A hand is met at the arm at which its fingers hold the tool: damping and stiffness times the arm squared.
    """
    hand = device.hand
    square = hand.turn_damping / hand.damping if hand.damping > 0.0 else 0.0
    inertia = float(device.tool.inertia[0])

    def grip_of(grip: HandGrip) -> HandGrip:
        return HandGrip(inertia + grip.mass * square, grip.damping * square, grip.stiffness * square)

    rng = np.random.default_rng(0)
    places = rng.uniform(-_NEAR, _NEAR, (_TURNS, 3))
    field = partial(_turn_field, device=device, pose=_poses(device)[0])
    return Workspace(places, _is_near, "N·m", "rad", grip_of, field)


def steepest_turn(device: SphericalElectromagnet, world: World, place: Workspace) -> Steepest:
    """What is steepest of the torque of `world` in all orientations; the places are directions of the tool's axis.

    From the steepest neighbourhoods it climbs on to neighbouring ones for as long as it grows.
    """
    poses = _poses(device)
    parts = [_look(world, device, pose, place, n) for n, pose in enumerate(poses)]
    found = [_name_axes(part, pose) for part, pose in zip(parts, poses, strict=True)]
    for n in sorted(range(len(parts)), key=lambda n: -_strength(parts[n]))[:_CLIMBS]:
        part, pose = parts[n], poses[n]
        for step in range(_STEPS):
            best = max(part.candidates, key=lambda one: abs(one.stiffness), default=None)
            if best is None:
                break
            pose = (pose[0], _turn(np.array(best.place), pose[1]))
            before, part = _strength(part), _look(world, device, pose, place, step)
            found.append(_name_axes(part, pose))
            if _strength(part) <= _GROWN * before:
                break
    candidates = tuple(one for part in found for one in part.candidates)
    return Steepest(candidates, max(one.away for one in found), max(one.jump for one in found))


def _look(
    world: World, device: SphericalElectromagnet, pose: tuple[Array, Array], place: Workspace, seed: int
) -> Steepest:
    return steepest(_turn_field(world, device, pose), place.places, _is_near, seed=seed)


def _strength(part: Steepest) -> float:
    return max((abs(one.stiffness) for one in part.candidates), default=0.0)


def _name_axes(part: Steepest, pose: tuple[Array, Array]) -> Steepest:
    """With the tool's axis as the place of each candidate."""
    named = []
    for one in part.candidates:
        x, y, z = _turn(np.array(one.place), pose[1])[:, 2].tolist()
        named.append(replace(one, place=(x, y, z)))
    return replace(part, candidates=tuple(named))


def find_asked_part(device: SphericalElectromagnet, world: World) -> WrenchPart:
    """What `world` asks: as it says, or what its wrenches show at many poses."""
    if world.asks is not None:
        return world.asks
    fitted = world.for_device(device)
    parts = [find_part(fitted.wrench(State(0.0, R, p, _STILL, _STILL))) for p, R in _poses(device)]
    moving = [find_part(fitted.wrench(State(0.0, R, p, np.ones(3), 0.1 * np.ones(3)))) for p, R in _poses(device)]
    return join_parts(part for part in parts + moving if part is not None) or "force"


def _poses(device: SphericalElectromagnet) -> list[tuple[Array, Array]]:
    """Places (3,) [m] over the shell with rotations (3, 3) of a tool that leans any way."""
    rng = np.random.default_rng(0)
    lowest = float(np.cos(device.workspace_half_angle))
    found = []
    for n in range(_POSES):
        u = rng.normal(size=3)
        u[2] = abs(u[2])
        u /= np.linalg.norm(u)
        if u[2] < lowest:
            u = np.array([0.0, 0.0, 1.0])
        far = 0.0 if n % 2 == 0 else rng.uniform(0.0, device.shell_thickness)
        lean = rng.normal(size=3)
        lean *= rng.uniform(0.0, _LEAN) / np.linalg.norm(lean)
        found.append(((device.contact_distance + far) * u, _turn(lean, rotation_to_axis(u))))
    return found


def _turn(q: Array, R: Array) -> Array:
    """(3, 3): R turned by the rotation vector q (3,) [rad]."""
    out = np.empty((3, 3))
    turn_by(float(q[0]), float(q[1]), float(q[2]), np.ascontiguousarray(R), out)
    return out


def _is_near(q: Array) -> bool:
    return bool(np.abs(q).max() <= _NEAR)


def _turn_field(world: World, device: SphericalElectromagnet, pose: tuple[Array, Array]) -> Field:
    fitted, (p, R) = world.for_device(device), pose

    def torque(q: Array, rate: Array, t: float) -> Array:
        """(3,) [N·m] with the tool turned by the rotation vector q (3,) [rad]."""
        out: Array = fitted.wrench(State(t, _turn(q, R), p, rate, _STILL))[3:]
        return out

    return torque
