"""The tool as a rigid body over the dome: pose, motion, and contact along its shaft.

A tool state is (13,): p (3) [m], quaternion of R_SR (4), v (3) [m/s], w (3) [rad/s], all in the stator frame. Steps are
linearly implicit in the hand's springs and dampers (stable at any step), explicit in the rest.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel
from haptorb.simulation.parts.hand import Grip

__all__ = ["GRAVITY", "Body", "DomeSurface", "contact", "matrix", "move"]

GRAVITY = 9.80665  #: [m/s²], along −z of the stator


class Body(NamedTuple):
    """The tool with whatever of the hand moves with it."""

    mass: float  #: tool and hand [kg]
    weight: float  #: of the tool, where no hand carries it [N]
    inertia_x: float  #: principal moments about the magnet's centre, mover frame [kg·m²]
    inertia_y: float
    inertia_z: float
    tip: float  #: distance of the tip from the magnet's centre, along −z of the mover [m]
    tail: float  #: how far behind the magnet's centre the shaft can touch, along +z [m]


class DomeSurface(NamedTuple):
    """The sphere under the tip."""

    radius: float  #: [m]
    stiffness: float  #: [N/m]
    damping: float  #: [N·s/m]
    friction: float  #: [1]


@kernel
def matrix(q: Array, R: Array) -> None:
    """Fill R (3, 3) from the unit quaternion q (4,), (x, y, z, w)."""
    x, y, z, w = q[0], q[1], q[2], q[3]
    R[0, 0], R[0, 1], R[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)
    R[1, 0], R[1, 1], R[1, 2] = 2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)
    R[2, 0], R[2, 1], R[2, 2] = 2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)


@kernel
def _yielding(body: Body, R: Array, rx: float, ry: float, rz: float, ux: float, uy: float, uz: float) -> float:
    """Inverse of the mass felt at arm r along the unit vector u [1/kg]: 1/m + (r×u)·I⁻¹(r×u)."""
    cx, cy, cz = ry * uz - rz * uy, rz * ux - rx * uz, rx * uy - ry * ux
    bx = R[0, 0] * cx + R[1, 0] * cy + R[2, 0] * cz
    by = R[0, 1] * cx + R[1, 1] * cy + R[2, 1] * cz
    bz = R[0, 2] * cx + R[1, 2] * cy + R[2, 2] * cz
    turning: float = bx * bx / body.inertia_x + by * by / body.inertia_y + bz * bz / body.inertia_z
    return 1.0 / body.mass + turning


@kernel
def contact(state: Array, R: Array, body: Body, dome: DomeSurface, dt: float, out: Array) -> float:
    """Add to out (6,) the dome's push on the tool: force [N] and torque about p [N·m]; returns the depth [m].

    The shaft is a line from the tip to behind the magnet; its point nearest to the centre touches. So a tool lying on
    the dome rests on its side, and no tilt brings the magnet into the dome. The push is a spring with a damper that
    never pulls; friction opposes sliding and, within one step, can stop it but not turn it round.
    """
    nx, ny, nz = R[0, 2], R[1, 2], R[2, 2]
    px, py, pz = state[0], state[1], state[2]
    s = min(max(-(px * nx + py * ny + pz * nz), -body.tip), body.tail)
    rx, ry, rz = s * nx, s * ny, s * nz
    x, y, z = px + rx, py + ry, pz + rz
    distance = np.sqrt(x * x + y * y + z * z)
    depth: float = dome.radius - distance
    if depth <= 0.0:
        return 0.0
    ux, uy, uz = 0.0, 0.0, 1.0
    if distance > 1e-9:
        ux, uy, uz = x / distance, y / distance, z / distance
    vx = state[7] + state[11] * rz - state[12] * ry
    vy = state[8] + state[12] * rx - state[10] * rz
    vz = state[9] + state[10] * ry - state[11] * rx
    speed = vx * ux + vy * uy + vz * uz
    # A damper that would turn the motion round within a step is cut to one that stops it.
    damping = min(dome.damping, 1.0 / (dt * _yielding(body, R, rx, ry, rz, ux, uy, uz)))
    push = max(dome.stiffness * depth - damping * speed, 0.0)
    fx, fy, fz = push * ux, push * uy, push * uz
    sx, sy, sz = vx - speed * ux, vy - speed * uy, vz - speed * uz
    slide = np.sqrt(sx * sx + sy * sy + sz * sz)
    if slide > 1e-12:
        sx, sy, sz = sx / slide, sy / slide, sz / slide
        stopping = slide / (dt * _yielding(body, R, rx, ry, rz, sx, sy, sz))
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
    return depth


@kernel
def move(state: Array, R: Array, body: Body, grip: Grip, goal_p: Array, turn: Array, wrench: Array, dt: float) -> None:
    """One step of `dt` [s] under `wrench` (6,), gravity and the grip; `turn` (3,) is the rotation left to the goal.

    Velocities first, then the pose with the new velocities; the grip is taken at the step's end:
    v' = [m v + dt (F + k (g − p))] / (m + dt c + dt² k), and so about every principal axis.
    """
    stiff, damp = grip.stiffness, grip.damping
    for i in range(3):
        force = wrench[i] - (body.weight if i == 2 else 0.0)
        v = body.mass * state[7 + i] + dt * (force + stiff * (goal_p[i] - state[i]))
        state[7 + i] = v / (body.mass + dt * damp + dt * dt * stiff)
        state[i] += dt * state[7 + i]
    ix, iy, iz = body.inertia_x, body.inertia_y, body.inertia_z
    wx = R[0, 0] * state[10] + R[1, 0] * state[11] + R[2, 0] * state[12]
    wy = R[0, 1] * state[10] + R[1, 1] * state[11] + R[2, 1] * state[12]
    wz = R[0, 2] * state[10] + R[1, 2] * state[11] + R[2, 2] * state[12]
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
        state[10 + i] = R[i, 0] * wx + R[i, 1] * wy + R[i, 2] * wz
    _turn(state, wx, wy, wz, dt)


@kernel
def _turn(state: Array, wx: float, wy: float, wz: float, dt: float) -> None:
    """Turn the quaternion state[3:7] by the mover-frame rate w over dt, exactly for a rate held in it."""
    rate = np.sqrt(wx * wx + wy * wy + wz * wz)
    half = 0.5 * rate * dt
    s = np.sin(half) / rate if half > 1e-8 else 0.5 * dt
    a, b, c, d = s * wx, s * wy, s * wz, np.cos(half)
    x, y, z, w = state[3], state[4], state[5], state[6]
    nx = w * a + x * d + y * c - z * b
    ny = w * b - x * c + y * d + z * a
    nz = w * c + x * b - y * a + z * d
    nw = w * d - x * a - y * b - z * c
    scale = 1.0 / np.sqrt(nx * nx + ny * ny + nz * nz + nw * nw)
    state[3], state[4], state[5], state[6] = nx * scale, ny * scale, nz * scale, nw * scale
