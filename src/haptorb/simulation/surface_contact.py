"""Contact of the simulated tool's shaft with a dome or a level plate: spring, damper and friction."""

from __future__ import annotations

import numpy as np

from haptorb.arrays import Array, Record, fields
from haptorb.compiled import kernel

__all__ = ["DOME", "contact", "plate_contact"]


#: Sphere under the tip; or a level plate, with its height in place of the radius.
DOME = fields(
    ("radius", "f8"),  # [m]
    ("stiffness", "f8"),  # [N/m]
    ("damping", "f8"),  # [N·s/m]
    ("friction", "f8"),  # [1]
)


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
