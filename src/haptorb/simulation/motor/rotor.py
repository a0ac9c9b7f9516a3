"""A rotor on a ball joint as a rigid body: it falls, springs back, rubs, is held by a hand and stops at the edge.

The state is (7,): quaternion of R_SR (x, y, z, w), then the angular momentum in the rotor's frame [N·m·s]. A step is a
free turn for half of it, one kick by all torques, and the other half of the turn. The free turn is composed of turns
about the three principal axes, each exact: it keeps the angular momentum to rounding and its energy error does not
grow. Springs and weight have potentials; dampers and friction only ever take: a damper acts as the exponential that it
is, dry friction stops a motion within a step but cannot turn it round.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from haptorb.devices.motor.regulator import leaning
from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel
from haptorb.simulation.parts.hand import rotation_left

__all__ = ["ANGULAR", "Joint", "angular_velocity", "kick", "turn"]

ANGULAR = 4  #: where the angular momentum begins in a state


class Joint(NamedTuple):
    """The rotor, its bearing and the hand on its handle."""

    inertia: Array  #: (3,) principal moments about the centre, with the hand's mass, rotor frame [kg·m²]
    damping: Array  #: (3,) bearing and hand, about the rotor's axes [N·m·s/rad]
    friction: float  #: dry, of the bearing [N·m]
    grip: float  #: spring of the hand towards its goal [N·m/rad]
    leaning: Array  #: (n,) Chebyshev coefficients of the torque over sin(tilt), by cos(tilt) [N·m]
    least: float  #: the least cos(tilt) they hold for
    edge: float  #: cosine of the tilt at which the end stop begins
    stop: float  #: its stiffness [N·m/rad]
    stop_damping: float  #: [N·m·s/rad]


@kernel
def angular_velocity(state: Array, inertia: Array, R: Array, w: Array) -> None:
    """Fill w (3,) [rad/s], stator frame; inertia (3,) is `Joint.inertia`."""
    a, b, c = state[4] / inertia[0], state[5] / inertia[1], state[6] / inertia[2]
    for i in range(3):
        w[i] = R[i, 0] * a + R[i, 1] * b + R[i, 2] * c


@kernel
def _about(state: Array, axis: int, dt: float, inertia: Array) -> None:
    """Turn freely about one principal axis: the momentum, fixed in space, turns back in the rotor's frame."""
    angle = dt * state[4 + axis] / inertia[axis]
    c, s = np.cos(angle), np.sin(angle)
    j, k = (axis + 1) % 3, (axis + 2) % 3
    mj, mk = state[4 + j], state[4 + k]
    state[4 + j], state[4 + k] = c * mj + s * mk, c * mk - s * mj
    c, s = np.cos(0.5 * angle), np.sin(0.5 * angle)
    qi, qj, qk, qw = state[axis], state[j], state[k], state[3]
    state[axis], state[j], state[k], state[3] = c * qi + s * qw, c * qj + s * qk, c * qk - s * qj, c * qw - s * qi


@kernel
def turn(state: Array, inertia: Array, dt: float) -> None:
    """A free rigid body for `dt` [s]: Strang's composition of three exact turns, symplectic and of second order."""
    half = 0.5 * dt
    _about(state, 0, half, inertia)
    _about(state, 1, half, inertia)
    _about(state, 2, dt, inertia)
    _about(state, 1, half, inertia)
    _about(state, 0, half, inertia)
    size = np.sqrt(state[0] ** 2 + state[1] ** 2 + state[2] ** 2 + state[3] ** 2)
    for i in range(4):
        state[i] /= size


@kernel
def kick(state: Array, R: Array, joint: Joint, goal: Array, passive: Array, coils: Array, dt: float) -> float:
    """`dt` [s] of torque at the orientation R; returns how far the end stop is pressed [rad].

    passive (3,) is filled with the torque of weight and regulator; coils (3,) is that of the currents [N·m].
    """
    nx, ny, nz = R[0, 2], R[1, 2], R[2, 2]
    back = leaning(nz, joint.leaning, joint.least)
    passive[0], passive[1], passive[2] = back * ny, -back * nx, 0.0  # back · ẑ_R × Ẑ
    left = np.empty(3)
    rotation_left(state[:4], goal, left)
    total = np.empty(3)
    for i in range(3):
        total[i] = passive[i] + coils[i] + joint.grip * left[i]
    pressed = 0.0
    if nz < joint.edge:
        lean = np.sqrt(nx * nx + ny * ny)
        pressed = np.arctan2(lean, nz) - np.arccos(joint.edge)
        ux, uy = ny / lean, -nx / lean  # about this axis it turns upright
        w = np.empty(3)
        angular_velocity(state, joint.inertia, R, w)
        push = joint.stop * pressed - joint.stop_damping * (w[0] * ux + w[1] * uy)
        # A damper that would turn the motion round within a step is cut, and a stop never pulls.
        push = max(push, 0.0)
        total[0] += push * ux
        total[1] += push * uy
    for i in range(3):
        state[4 + i] += dt * (R[0, i] * total[0] + R[1, i] * total[1] + R[2, i] * total[2])
        state[4 + i] *= np.exp(-dt * joint.damping[i] / joint.inertia[i])
    a, b, c = state[4] / joint.inertia[0], state[5] / joint.inertia[1], state[6] / joint.inertia[2]
    rate = np.sqrt(a * a + b * b + c * c)
    if rate > 0.0:
        a, b, c = a / rate, b / rate, c / rate
        yielding = a * a / joint.inertia[0] + b * b / joint.inertia[1] + c * c / joint.inertia[2]
        rub = min(dt * joint.friction, rate / yielding)
        state[4] -= rub * a
        state[5] -= rub * b
        state[6] -= rub * c
    return pressed
