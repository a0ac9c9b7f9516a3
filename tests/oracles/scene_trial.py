"""What a random hand gets out of a scene: the energy that it put in, less what the scene holds, over minutes.

Hand and mover are masses on springs and dampers whose middle wanders at random; forces are held from
tick to tick, as the loop holds them, so what sampling makes out of nothing is in the figure. All six coordinates move
at once where the scene has an attitude, which no motor's modes do: more than a device can ask.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from haptorb.control.clutch.gains import MOTOR_GAINS
from haptorb.control.stability.hand_grip import HandGrip
from haptorb.devices.device import Device
from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.devices.motor.spherical_motor import SphericalMotor
from haptorb.devices.state import State
from haptorb.numerics.arrays import Array
from haptorb.worlds.bound_world import bind_world
from haptorb.worlds.scene.scene import Scene

__all__ = ["SceneTrial", "try_random_hand"]

Springs = tuple[Array, Array, Array]  #: masses, dampers and springs

_WANDER = 0.15  #: time constant of the hand's wish, twice [s]


@dataclass(frozen=True)
class SceneTrial:
    """The lowest passivity energy, what was put in at the end, and the greatest force.

    lowest    the least of (energy put in by the hand − growth of what the scene holds) [J]; a passive scene: 0
    put_in    by the hand, to the end [J]
    greatest  force on the mover [N]
    """

    lowest: float
    put_in: float
    greatest: float


def try_random_hand(
    scene: Scene, device: Device, hand: HandGrip, seconds: float, rate: float = 1000.0, seed: int = 0
) -> SceneTrial:
    """Let a random `hand` alone hold the mover of `device` in `scene`, whose coupling was chosen, for `seconds` [s]."""
    fitted, dt, rng = scene.for_device(device), 1.0 / rate, np.random.default_rng(seed)
    bound = bind_world(fitted, dt)
    assert bound is not None
    masses, dampers, springs = _hold_tool(device, hand) if device.name == "omni" else _hold_rotor(device, hand)
    steps = [_solve(m, b, k, dt) for m, b, k in zip(masses, dampers, springs, strict=True)]
    on, push = np.array([one[0] for one in steps]), np.array([one[1] for one in steps])
    x, v, wish, slow = np.concatenate([device.rest_position, np.zeros(3)]), np.zeros(6), np.zeros(6), np.zeros(6)
    fade = math.exp(-dt / _WANDER)
    spread = 2.0 * math.sqrt((1 + fade) / (1 - fade))  # white noise, so that the wish has a deviation of 2
    put_in, lowest, greatest, first = 0.0, 0.0, 0.0, math.nan
    for n in range(round(seconds * rate)):
        wrench = bound.wrench(State(n * dt, _rotation(x[3:]), x[:3].copy(), v[3:].copy(), v[:3].copy()))
        held = bound.energy
        first = held if n == 0 else first
        lowest = min(lowest, put_in - (held - first))
        greatest = max(greatest, math.sqrt(float(wrench[:3] @ wrench[:3])))
        wish += (1 - fade) * (spread * rng.standard_normal(6) - wish)
        slow += (1 - fade) * (wish - slow)
        goal = _aim(device, np.tanh(slow))
        force = wrench + springs * goal
        after = on[:, 0, 0] * x + on[:, 0, 1] * v + push[:, 0] * force
        v = on[:, 1, 0] * x + on[:, 1, 1] * v + push[:, 1] * force
        put_in -= float(wrench @ (after - x))
        x = after
    return SceneTrial(lowest, put_in, greatest)


def _hold_tool(device: SphericalElectromagnet, hand: HandGrip) -> Springs:
    """(6,) each, along and about the axes in which the scene is felt [kg, kg·m²], [N·s/m, N·m·s], [N/m, N·m]."""
    return (
        np.array([hand.with_mass(device.tool.mass).mass] * 3 + [1e-4] * 3),
        np.array([hand.damping] * 3 + [device.hand.turn_damping] * 3),
        np.array([hand.stiffness] * 3 + [device.hand.turn_stiffness] * 3),
    )


def _hold_rotor(device: SphericalMotor, hand: HandGrip) -> Springs:
    """The same of a target that the handle moves by the default gains."""
    arm, gains = device.rotor.handle_length, MOTOR_GAINS
    inertia = float(device.rotor.inertia[0]) + hand.mass * arm**2
    motion = np.array([*gains.translate, *gains.rotate]) ** 2
    return inertia / motion, hand.damping * arm**2 / motion, hand.stiffness * arm**2 / motion


def _aim(device: Device, wish: Array) -> Array:
    """(6,) where the hand's own spring has its middle [m, rad], for a `wish` (6,) within ±1."""
    if device.name != "omni":
        return wish * np.array([0.009, 0.001, 0.001, 0.03, 0.03, 0.03])
    u = np.array([math.sin(0.6 * wish[0]), math.sin(0.6 * wish[1]), 1.0])
    u *= (device.contact_distance + 3e-3 * (1.0 + wish[2])) / np.linalg.norm(u)
    return np.concatenate([u, np.zeros(3)])


def _solve(m: float, b: float, k: float, dt: float) -> tuple[Array, Array]:
    """(2, 2) and (2,) place and speed after `dt` [s] from those before and a constant force: exact."""
    A = np.zeros((3, 3))
    A[0, 1], A[1] = 1.0, (-k / m, -b / m, 1 / m)
    step = expm(A * dt)
    return step[:2, :2], step[:2, 2]


def _rotation(turn: Array) -> Array:
    """(3, 3) of a rotation vector [rad]."""
    angle = math.sqrt(float(turn @ turn))
    x, y, z = turn
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    if angle < 1e-9:
        small: Array = np.eye(3) + K
        return small
    whole: Array = np.eye(3) + math.sin(angle) / angle * K + (1 - math.cos(angle)) / angle**2 * K @ K
    return whole
