"""A rotor on a ball joint as a rigid body: it falls, springs back, rubs, is held by a hand and stops at the edge.

A step is a free turn for half of it, one kick by all torques, and the other half of the turn. The free turn is composed
of turns about the three principal axes, each exact: it keeps the angular momentum to rounding and its energy error does
not grow. Springs and weight have potentials; dampers and friction only ever take: a damper acts as the exponential that
it is, dry friction stops a motion within a step but cannot turn it round.
"""

from __future__ import annotations

import numpy as np

from haptorb.devices.motor.regulator import torque_over_sine
from haptorb.numerics.arrays import Array, Record, fields
from haptorb.numerics.compiled import kernel
from haptorb.simulation.parts.hand import fill_remaining_rotation

__all__ = ["ROTOR", "angular_velocity", "kick", "turn"]

#: The rotor, its bearing and the hand on its handle.
ROTOR = fields(
    ("inertia", "f8", (3,)),  # principal moments about the centre, with the hand's mass, rotor frame [kg·m²]
    ("damping", "f8", (3,)),  # bearing and hand, about the rotor's axes [N·m·s/rad]
    ("friction", "f8"),  # dry, of the bearing [N·m]
    ("grip", "f8"),  # spring of the hand towards its goal [N·m/rad]
    ("least", "f8"),  # the least cos(tilt) that the torque of weight and regulator is known for
    ("edge", "f8"),  # cosine of the tilt at which the end stop begins
    ("stop", "f8"),  # its stiffness [N·m/rad]
    ("stop_damping", "f8"),  # [N·m·s/rad]
    ("goal", "f8", (4,)),  # quaternion to which the hand turns
    ("q", "f8", (4,)),  # quaternion of R_SR (x, y, z, w)
    ("momentum", "f8", (3,)),  # angular, rotor frame [N·m·s]
)


@kernel
def angular_velocity(momentum: Array, inertia: Array, R: Array, w: Array) -> None:
    """Fill w (3,) [rad/s], stator frame, for the momentum (3,) of a ROTOR at R (3, 3)."""
    a, b, c = momentum[0] / inertia[0], momentum[1] / inertia[1], momentum[2] / inertia[2]
    for i in range(3):
        w[i] = R[i, 0] * a + R[i, 1] * b + R[i, 2] * c


@kernel
def _rotate_about_axis(q: Array, momentum: Array, axis: int, dt: float, inertia: Array) -> None:
    """Turn freely about one principal axis: the momentum, fixed in space, turns back in the rotor's frame."""
    angle = dt * momentum[axis] / inertia[axis]
    c, s = np.cos(angle), np.sin(angle)
    j, k = (axis + 1) % 3, (axis + 2) % 3
    mj, mk = momentum[j], momentum[k]
    momentum[j], momentum[k] = c * mj + s * mk, c * mk - s * mj
    c, s = np.cos(0.5 * angle), np.sin(0.5 * angle)
    qi, qj, qk, qw = q[axis], q[j], q[k], q[3]
    q[axis], q[j], q[k], q[3] = c * qi + s * qw, c * qj + s * qk, c * qk - s * qj, c * qw - s * qi


@kernel
def turn(q: Array, momentum: Array, inertia: Array, dt: float) -> None:
    """A free rigid body for `dt` [s]: Strang's composition of three exact turns, symplectic and of second order."""
    half = 0.5 * dt
    _rotate_about_axis(q, momentum, 0, half, inertia)
    _rotate_about_axis(q, momentum, 1, half, inertia)
    _rotate_about_axis(q, momentum, 2, dt, inertia)
    _rotate_about_axis(q, momentum, 1, half, inertia)
    _rotate_about_axis(q, momentum, 0, half, inertia)
    size = np.sqrt(q[0] ** 2 + q[1] ** 2 + q[2] ** 2 + q[3] ** 2)
    for i in range(4):
        q[i] /= size


@kernel
def kick(rotor: Record, coefficients: Array, R: Array, passive: Array, coils: Array, dt: float) -> float:
    """`dt` [s] of torque on a ROTOR at the orientation R; returns how far the end stop is pressed [rad].

    passive (3,) is filled with the torque of weight and regulator, whose `coefficients` (n,) `torque_over_sine`
    takes; coils (3,) is that of the currents [N·m].
    """
    momentum, inertia = rotor.momentum, rotor.inertia
    nx, ny, nz = R[0, 2], R[1, 2], R[2, 2]
    back = torque_over_sine(nz, coefficients, rotor.least)
    passive[0], passive[1], passive[2] = back * ny, -back * nx, 0.0  # back · ẑ_R × Ẑ
    left = np.empty(3)
    fill_remaining_rotation(rotor.q, rotor.goal, left)
    total = np.empty(3)
    for i in range(3):
        total[i] = passive[i] + coils[i] + rotor.grip * left[i]
    pressed = 0.0
    if nz < rotor.edge:
        lean = np.sqrt(nx * nx + ny * ny)
        pressed = np.arctan2(lean, nz) - np.arccos(rotor.edge)
        ux, uy = ny / lean, -nx / lean  # about this axis it turns upright
        w = np.empty(3)
        angular_velocity(momentum, inertia, R, w)
        push = rotor.stop * pressed - rotor.stop_damping * (w[0] * ux + w[1] * uy)
        # A damper that would turn the motion round within a step is cut, and a stop never pulls.
        push = max(push, 0.0)
        total[0] += push * ux
        total[1] += push * uy
    for i in range(3):
        momentum[i] += dt * (R[0, i] * total[0] + R[1, i] * total[1] + R[2, i] * total[2])
        momentum[i] *= np.exp(-dt * rotor.damping[i] / inertia[i])
    a, b, c = momentum[0] / inertia[0], momentum[1] / inertia[1], momentum[2] / inertia[2]
    rate = np.sqrt(a * a + b * b + c * c)
    if rate > 0.0:
        a, b, c = a / rate, b / rate, c / rate
        yielding = a * a / inertia[0] + b * b / inertia[1] + c * c / inertia[2]
        rub = min(dt * rotor.friction, rate / yielding)
        momentum[0] -= rub * a
        momentum[1] -= rub * b
        momentum[2] -= rub * c
    return pressed
