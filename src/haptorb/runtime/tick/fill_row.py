"""What a tick did, into its row: all that has a shape, in two compiled passes."""

from __future__ import annotations

import numpy as np

from haptorb.numerics.arrays import Array, Records
from haptorb.numerics.compiled import kernel, tick_kernel

__all__ = ["fill_object", "fill_pose", "fill_quaternion", "fill_row"]


@kernel
def _copy(row: Array, start: int, values: Array) -> None:
    for i in range(values.size):
        row[start + i] = values[i]


@kernel
def _copy_table(row: Array, start: int, values: Array) -> None:
    width = values.shape[1]
    for k in range(values.shape[0]):
        for i in range(width):
            row[start + width * k + i] = values[k, i]


@kernel
def fill_quaternion(R: Array, q: Array) -> None:
    """q (4,) becomes the quaternion (x, y, z, w) of R (3, 3), by the largest of four candidates (Shepperd's method)."""
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    pick, best = 3, trace
    for i in range(3):
        if R[i, i] > best:
            pick, best = i, R[i, i]
    if pick == 3:
        s = 2.0 * np.sqrt(max(1.0 + trace, 0.0))
        q[3] = 0.25 * s
        q[0] = (R[2, 1] - R[1, 2]) / s
        q[1] = (R[0, 2] - R[2, 0]) / s
        q[2] = (R[1, 0] - R[0, 1]) / s
    else:
        i, j, k = pick, (pick + 1) % 3, (pick + 2) % 3
        s = 2.0 * np.sqrt(max(1.0 + R[i, i] - R[j, j] - R[k, k], 0.0))
        q[i] = 0.25 * s
        q[j] = (R[j, i] + R[i, j]) / s
        q[k] = (R[k, i] + R[i, k]) / s
        q[3] = (R[k, j] - R[j, k]) / s


@tick_kernel
def fill_row(
    row: Array, places: Records, state: Records, coils: Records, target: Array, given: Array, applied: Array,
    field: Array, stages: Array,
) -> None:  # fmt: skip
    """Fill the fields of `row` (width,) that tell of device and protection, at the `places` of the `RowLayout`.

    state (1,) PROTECTION and coils (m,) COIL; target (7,) position [m] and quaternion of the pointer's goal; given (6,)
    [N, N·m]; applied (m,) duties; field (k, 3) [T]; stages (7,) [s].
    """
    at, s = places[0], state[0]
    e, g, heat, passivity = s.estimate, s.guard, s.heat, s.passivity
    row[at.t], row[at.valid], row[at.age] = s.clock.time, e.valid, e.age
    _copy(row, at.p, e.position[:])
    fill_quaternion(e.rotation[:], row[at.q : at.q + 4])
    _copy(row, at.v, e.velocity[:])
    _copy(row, at.w, e.angular_velocity[:])
    _copy(row, at.target, target)  # and target_q, which follows
    _copy(row, at.asked, g.asked[:])
    _copy(row, at.given, given)
    _copy(row, at.duties, applied)
    for i in range(6):
        row[at.modelled + i] = 0.0
    for j in range(coils.size):
        c = coils[j]
        row[at.wanted + j], row[at.currents + j] = c.held, c.current
        row[at.resistance + j], row[at.drive + j] = c.resistance, c.duty
        row[at.boundary + j], row[at.winding + j] = c.boundary, c.winding
        for i in range(6):
            row[at.modelled + i] += c.wrench[i] * c.current
    _copy_table(row, at.field, field)
    _copy(row, at.stages, stages)
    row[at.guard], row[at.trip], row[at.gain], row[at.remaining] = g.state, g.reason, g.gain, heat.remaining
    row[at.energy], row[at.balance], row[at.injected] = passivity.energy, passivity.balance, passivity.damping


@tick_kernel
def fill_pose(
    row: Array, at: int, R: Array, p: Array, v: Array, w: Array, t: float, valid: bool, currents_age: float,
    field_age: float,
) -> None:  # fmt: skip
    """Fill the fields of `row` (width,) from `at` on, which is where `currents_age` begins: how old the readings were
    [s], then what the tracker said, the pose of a `Sample`, p [m], v [m/s], w [rad/s], t [s].

    One number instead of the places of all fields: it is looked at three times faster.
    """
    row[at], row[at + 1], row[at + 2], row[at + 3] = currents_age, field_age, t, valid
    for i in range(3):
        row[at + 4 + i], row[at + 16 + i], row[at + 19 + i] = p[i], v[i], w[i]
        for j in range(3):
            row[at + 7 + 3 * i + j] = R[i, j]


@tick_kernel
def fill_object(
    row: Array, places: Records, share: Array, p: Array, R: Array, wrench: Array, contacts: Array, memory: Array,
    held: Array,
) -> None:  # fmt: skip
    """Fill the fields of `row` (width,) that tell of what the world acts on, at the `places` of the `RowLayout`.

    share (2,), p (3,) [m], R (3, 3), wrench (6,) [N, N·m] and contacts (n, 8) as a `RenderedWrench` has them: the row
    takes as many as it has room for, and those that are missing are zero. memory (n,) of a world, in its own units: as
    much as there is room for, and NaN behind it. held (14 + …,) becomes share, p, R and contacts.
    """
    at = places[0]
    for i in range(2):
        held[i] = share[i]
    for i in range(3):
        held[2 + i] = p[i]
        for j in range(3):
            held[5 + 3 * i + j] = R[i, j]
    for i in range(held.size - 14):
        held[14 + i] = contacts[i // 8, i % 8] if i < contacts.size else 0.0
    _copy(row, at.share, share)
    _copy(row, at.object, p)
    fill_quaternion(R, row[at.object_q : at.object_q + 4])
    _copy(row, at.object_wrench, wrench)
    for i in range(at.energy - at.contacts):  # the field that follows
        row[at.contacts + i] = contacts[i // 8, i % 8] if i < contacts.size else 0.0
    for i in range(row.size - at.memory):  # the last field
        row[at.memory + i] = memory[i] if i < memory.size else np.nan
