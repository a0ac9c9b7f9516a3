"""Rigid-body dynamics of the tool: the hand's grip, gravity, and contact of the shaft with dome or plate."""

from __future__ import annotations

import numpy as np

from haptorb.arrays import Array, Record, Records, fields
from haptorb.compiled import kernel
from haptorb.devices.base import State
from haptorb.devices.coil_array import ArrayMover
from haptorb.devices.electromagnet import DomeContact, Hand, Tool

__all__ = [
    "DOME",
    "GRAVITY",
    "GRIP",
    "TOOL",
    "contact",
    "fill_remaining_rotation",
    "fill_tool",
    "matrix",
    "move",
    "plate_contact",
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
# The tool as a rigid body over the dome: pose, motion, and contact along its shaft.
#
# Pose and motion are in the stator frame. Steps are linearly implicit in the hand's springs and dampers (stable for any
# step), explicit otherwise.


GRAVITY = 9.80665  #: [m/s²], along −z of the stator

#: Sphere under the tip; or a level plate, with its height in place of the radius.
DOME = fields(
    ("radius", "f8"),  # [m]
    ("stiffness", "f8"),  # [N/m]
    ("damping", "f8"),  # [N·s/m]
    ("friction", "f8"),  # [1]
)

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
def _inverse_mass(tool: Record, R: Array, rx: float, ry: float, rz: float, ux: float, uy: float, uz: float) -> float:
    """Inverse of the effective mass at arm r along the unit vector u [1/kg]: 1/m + (r×u)·I⁻¹(r×u)."""
    cx, cy, cz = ry * uz - rz * uy, rz * ux - rx * uz, rx * uy - ry * ux
    bx = R[0, 0] * cx + R[1, 0] * cy + R[2, 0] * cz
    by = R[0, 1] * cx + R[1, 1] * cy + R[2, 1] * cz
    bz = R[0, 2] * cx + R[1, 2] * cy + R[2, 2] * cz
    turning: float = bx * bx / tool.inertia[0] + by * by / tool.inertia[1] + bz * bz / tool.inertia[2]
    yielding: float = 1.0 / tool.mass + turning
    return yielding


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
def contact(tool: Record, R: Array, dt: float, out: Array) -> float:
    """Add to out (6,) the contact wrench on `tool`, a TOOL at R (3, 3): force [N] and torque about p [N·m]; returns the
    depth [m].

    The shaft is a line from the tip to behind the magnet; its point nearest to the centre is in contact. So a tool
    lying on the dome rests on its side, and no tilt brings the magnet into the dome. The contact is a spring with a
    damper that never pulls; friction opposes sliding and, within one step, can stop it but not reverse it.
    """
    nx, ny, nz = R[0, 2], R[1, 2], R[2, 2]
    px, py, pz = tool.p[0], tool.p[1], tool.p[2]
    s = min(max(-(px * nx + py * ny + pz * nz), -tool.tip), tool.tail)
    x, y, z = px + s * nx, py + s * ny, pz + s * nz
    distance = np.sqrt(x * x + y * y + z * z)
    depth: float = tool.dome.radius - distance
    if depth <= 0.0:
        return 0.0
    ux, uy, uz = 0.0, 0.0, 1.0
    if distance > 1e-9:
        ux, uy, uz = x / distance, y / distance, z / distance
    _push_back(tool, R, s, (ux, uy, uz), depth, dt, out)
    return depth


@kernel
def plate_contact(tool: Record, R: Array, dt: float, out: Array) -> float:
    """Contact with a level plate at z = `dome.radius`, as `contact`: the lower end of the shaft touches."""
    s = -tool.tip if R[2, 2] >= 0.0 else tool.tail
    depth: float = tool.dome.radius - (tool.p[2] + s * R[2, 2])
    if depth <= 0.0:
        return 0.0
    _push_back(tool, R, s, (0.0, 0.0, 1.0), depth, dt, out)
    return depth


@kernel
def _push_back(
    tool: Record, R: Array, s: float, normal: tuple[float, float, float], depth: float, dt: float, out: Array
) -> None:
    """Add to out (6,) the contact wrench at `s` [m] along the shaft's axis from p, at penetration `depth` [m]."""
    dome, v, w = tool.dome, tool.v, tool.w
    ux, uy, uz = normal
    rx, ry, rz = s * R[0, 2], s * R[1, 2], s * R[2, 2]
    vx = v[0] + w[1] * rz - w[2] * ry
    vy = v[1] + w[2] * rx - w[0] * rz
    vz = v[2] + w[0] * ry - w[1] * rx
    speed = vx * ux + vy * uy + vz * uz
    # A damper that would reverse the motion within a step is limited to one that stops it.
    damping = min(dome.damping, 1.0 / (dt * _inverse_mass(tool, R, rx, ry, rz, ux, uy, uz)))
    push = max(dome.stiffness * depth - damping * speed, 0.0)
    fx, fy, fz = push * ux, push * uy, push * uz
    sx, sy, sz = vx - speed * ux, vy - speed * uy, vz - speed * uz
    slide = np.sqrt(sx * sx + sy * sy + sz * sz)
    if slide > 1e-12:
        sx, sy, sz = sx / slide, sy / slide, sz / slide
        stopping = slide / (dt * _inverse_mass(tool, R, rx, ry, rz, sx, sy, sz))
        drag = min(dome.friction * push, stopping)
        fx -= drag * sx
        fy -= drag * sy
        fz -= drag * sz
    out[0] += fx
    out[1] += fy
    out[2] += fz
    out[3] += ry * fz - rz * fy
    out[4] += rz * fx - rx * fz
    out[5] += rx * fy - ry * fx


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
