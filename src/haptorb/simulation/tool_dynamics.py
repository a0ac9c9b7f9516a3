"""Rigid-body dynamics of the simulated tool: the hand's grip, gravity and inertia."""

from __future__ import annotations

import numpy as np

from haptorb.arrays import Array, Record, Records, fields
from haptorb.compiled import kernel
from haptorb.devices.base import State
from haptorb.devices.coil_array import ArrayMover
from haptorb.devices.electromagnet import DomeContact, Hand, Tool
from haptorb.simulation.surface_contact import DOME

__all__ = [
    "GRAVITY",
    "GRIP",
    "TOOL",
    "fill_remaining_rotation",
    "fill_tool",
    "matrix",
    "move",
    "read_tool",
    "set_goal",
]


# --------------------------------------------------------------------------------------------------
# Hand on the tool: springs and dampers towards the hand's goal, in position and orientation.
#
# The hand moves with the tool (its effective mass is added) and carries the tool's weight: the observed deflection is
# caused by the device alone. The dampers act against the stator. Grips from the literature range from 0.1 kg, 2 N·s/m,
# 100 N/m (a pen, held lightly) to 0.8 kg, 10 N·s/m, 500 N/m.


#: Impedance of the grip; zeros: no hand.
GRIP = fields(
    ("stiffness", "f8"),  # [N/m]
    ("damping", "f8"),  # [N·s/m]
    ("turn_stiffness", "f8"),  # [N·m/rad]
    ("turn_damping", "f8"),  # [N·m·s/rad]
)


@kernel
def fill_remaining_rotation(q: Array, goal: Array, out: Array) -> None:
    """out (3,) [rad], stator frame: shortest rotation from the unit quaternion q to `goal` (both (x, y, z, w))."""
    x = -goal[3] * q[0] + goal[0] * q[3] - goal[1] * q[2] + goal[2] * q[1]
    y = -goal[3] * q[1] + goal[1] * q[3] - goal[2] * q[0] + goal[0] * q[2]
    z = -goal[3] * q[2] + goal[2] * q[3] - goal[0] * q[1] + goal[1] * q[0]
    w = goal[3] * q[3] + goal[0] * q[0] + goal[1] * q[1] + goal[2] * q[2]
    if w < 0.0:
        x, y, z, w = -x, -y, -z, -w
    s = np.sqrt(x * x + y * y + z * z)
    scale = 2.0 * np.arctan2(s, w) / s if s > 1e-12 else 2.0
    out[0], out[1], out[2] = scale * x, scale * y, scale * z


# --------------------------------------------------------------------------------------------------
# The tool as a rigid body over the dome: pose and motion.
#
# Pose and motion are in the stator frame. Steps are linearly implicit in the hand's springs and dampers (stable for any
# step), explicit otherwise.


GRAVITY = 9.80665  #: [m/s²], along −z of the stator


#: Tool with the effective mass of the hand, dome in contact with it, and the hand's goal.
TOOL = fields(
    ("mass", "f8"),  # tool and hand [kg]
    ("weight", "f8"),  # of the tool, if no hand carries it [N]
    ("inertia", "f8", (3,)),  # principal moments about the magnet's centre, mover frame [kg·m²]
    ("tip", "f8"),  # distance of the tip from the magnet's centre, along −z of the mover [m]
    ("tail", "f8"),  # extent of the shaft behind the magnet's centre that can touch, along +z [m]
    ("dome", DOME),
    ("grip", GRIP),
    ("goal", "f8", (3,)),  # position goal of the hand [m]
    ("goal_q", "f8", (4,)),  # orientation goal of the hand, quaternion
    ("p", "f8", (3,)),  # [m]
    ("q", "f8", (4,)),  # quaternion of R_SR
    ("v", "f8", (3,)),  # [m/s]
    ("w", "f8", (3,)),  # angular velocity [rad/s]
)


def fill_tool(state: Records, tool: Tool | ArrayMover, hand: Hand | None, surface: DomeContact) -> None:
    """Fill `state`, (1,) TOOL, with tool, hand and surface of the device file; without a hand the tool falls.

    A hand carries the tool's weight.
    """
    state["mass"] = tool.mass + (0.0 if hand is None else hand.mass)
    state["weight"] = tool.mass * GRAVITY if hand is None else 0.0
    state["inertia"], state["tip"] = tool.inertia, tool.tip_distance
    for name in ("stiffness", "damping", "friction"):
        state["dome"][name] = getattr(surface, name)
    if hand is not None:
        for name in ("stiffness", "damping", "turn_stiffness", "turn_damping"):
            state["grip"][name] = getattr(hand, name)


def read_tool(state: Records, t: float) -> State:
    """Pose and motion at `t` [s] of the tool in `state`, (1,) TOOL."""
    R = np.empty((3, 3))
    p, q, v, w = (state[name][0].copy() for name in "pqvw")
    matrix(q, R)
    return State(t, R, p, w, v)


@kernel
def matrix(q: Array, R: Array) -> None:
    """Fill R (3, 3) from the unit quaternion q (4,), (x, y, z, w)."""
    x, y, z, w = q[0], q[1], q[2], q[3]
    R[0, 0], R[0, 1], R[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)
    R[1, 0], R[1, 1], R[1, 2] = 2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)
    R[2, 0], R[2, 1], R[2, 2] = 2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)


@kernel
def set_goal(tool: Record, goal_p: Array, goal_q: Array) -> None:
    """Set the hand's goal; non-finite values and invalid quaternions leave the last one."""
    square = 0.0
    for i in range(4):
        square += goal_q[i] * goal_q[i]
    if 0.0 < square < 1e12:  # false for NaN as well
        for i in range(4):
            tool.goal_q[i] = goal_q[i] / np.sqrt(square)
    if np.isfinite(goal_p[0] + goal_p[1] + goal_p[2]):
        for i in range(3):
            tool.goal[i] = goal_p[i]


@kernel
def move(tool: Record, R: Array, turn: Array, wrench: Array, dt: float) -> None:
    """Advance by one step of `dt` [s] under `wrench` (6,), gravity and grip; `turn` (3,) is the rotation to the goal.

    Velocities first, then the pose with the new velocities; the grip is taken at the step's end:
    v' = [m v + dt (F + k (g − p))] / (m + dt c + dt² k), and so about every principal axis.
    """
    grip, p, v, w = tool.grip, tool.p, tool.v, tool.w
    stiff, damp = grip.stiffness, grip.damping
    for i in range(3):
        force = wrench[i] - (tool.weight if i == 2 else 0.0)
        speed = tool.mass * v[i] + dt * (force + stiff * (tool.goal[i] - p[i]))
        v[i] = speed / (tool.mass + dt * damp + dt * dt * stiff)
        p[i] += dt * v[i]
    ix, iy, iz = tool.inertia[0], tool.inertia[1], tool.inertia[2]
    wx = R[0, 0] * w[0] + R[1, 0] * w[1] + R[2, 0] * w[2]
    wy = R[0, 1] * w[0] + R[1, 1] * w[1] + R[2, 1] * w[2]
    wz = R[0, 2] * w[0] + R[1, 2] * w[1] + R[2, 2] * w[2]
    tx, ty, tz = (
        wrench[3] + grip.turn_stiffness * turn[0],
        wrench[4] + grip.turn_stiffness * turn[1],
        wrench[5] + grip.turn_stiffness * turn[2],
    )
    bx = R[0, 0] * tx + R[1, 0] * ty + R[2, 0] * tz - (iz - iy) * wy * wz  # Euler's equations
    by = R[0, 1] * tx + R[1, 1] * ty + R[2, 1] * tz - (ix - iz) * wz * wx
    bz = R[0, 2] * tx + R[1, 2] * ty + R[2, 2] * tz - (iy - ix) * wx * wy
    held = dt * grip.turn_damping + dt * dt * grip.turn_stiffness
    wx = (ix * wx + dt * bx) / (ix + held)
    wy = (iy * wy + dt * by) / (iy + held)
    wz = (iz * wz + dt * bz) / (iz + held)
    for i in range(3):
        w[i] = R[i, 0] * wx + R[i, 1] * wy + R[i, 2] * wz
    _turn(tool.q, wx, wy, wz, dt)


@kernel
def _turn(q: Array, wx: float, wy: float, wz: float, dt: float) -> None:
    """Rotate the quaternion q (4,) by the mover-frame rate w over dt, exact for a constant rate."""
    rate = np.sqrt(wx * wx + wy * wy + wz * wz)
    half = 0.5 * rate * dt
    s = np.sin(half) / rate if half > 1e-8 else 0.5 * dt
    a, b, c, d = s * wx, s * wy, s * wz, np.cos(half)
    x, y, z, w = q[0], q[1], q[2], q[3]
    nx = w * a + x * d + y * c - z * b
    ny = w * b - x * c + y * d + z * a
    nz = w * c + x * b - y * a + z * d
    nw = w * d - x * a - y * b - z * c
    scale = 1.0 / np.sqrt(nx * nx + ny * ny + nz * nz + nw * nw)
    q[0], q[1], q[2], q[3] = nx * scale, ny * scale, nz * scale, nw * scale
