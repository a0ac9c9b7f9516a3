"""An electromagnet's physics in compiled code: some steps of coils, core, tool, dome and hand."""

from __future__ import annotations

import numpy as np

from haptorb.devices.electromagnet.passive_pull import pull
from haptorb.devices.electromagnet.ring_tool import per_ampere
from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel
from haptorb.physics.sources.charged_ring import dipole_on_charges
from haptorb.simulation.parts.coils import CoilConstants, coil_step
from haptorb.simulation.parts.hand import Grip, rotation_left
from haptorb.simulation.parts.tool import Body, DomeSurface, contact, matrix, move

__all__ = ["advance"]


@kernel
def _want(wish_p: Array, wish_q: Array, goal: Array) -> None:
    """goal (7,): position and unit quaternion become the wish; what is not finite, or no turn, stays as it was."""
    square = 0.0
    for i in range(4):
        square += wish_q[i] * wish_q[i]
    if 0.0 < square < 1e12:  # false for NaN as well
        for i in range(4):
            goal[3 + i] = wish_q[i] / np.sqrt(square)
    if np.isfinite(wish_p[0] + wish_p[1] + wish_p[2]):
        for i in range(3):
            goal[i] = wish_p[i]


@kernel
def advance(
    tool: Array, coils: Array, duties: Array, wish_p: Array, wish_q: Array, goal: Array, numbers: Array,
    resistance: Array, inductance: Array, heat: Array, rows: Array, table: Array, moment_per_current: Array, dt: float,
    steps: int, truth: Array,
) -> float:  # fmt: skip
    """`steps` steps of `dt` [s]; fills truth (6,) with the mean wrench of coils and core; returns the dome's depth [m].

    tool (13,) and coils (3, m) are carried on. goal (7,) is where the hand goes: wish_p (3,) [m] and wish_q (4,) where
    they are numbers and a turn, else what it was. numbers (20,): what is one number of wires, body, dome, grip and
    core; a call with tuples takes twice as long.
    """
    _want(wish_p, wish_q, goal)
    goal_p, goal_q = goal[:3], goal[3:]
    n = numbers
    wires = CoilConstants(resistance, inductance, n[0], n[1], n[2], n[3])
    body = Body(n[4], n[5], n[6], n[7], n[8], n[9], n[10])
    dome = DomeSurface(n[11], n[12], n[13], n[14])
    grip = Grip(n[15], n[16], n[17], n[18])
    nearest = n[19]
    count = duties.shape[0]
    R = np.empty((3, 3))
    per_moment, per_current = np.empty((6, 3)), np.empty((6, count))
    emf, mean = np.empty(count), np.empty(count)
    given, total, passive = np.empty(6), np.empty(6), np.empty(6)
    turn, axis = np.empty(3), np.empty(3)
    truth[:] = 0.0
    depth = 0.0
    for _ in range(steps):
        matrix(tool[3:7], R)
        dipole_on_charges(rows, R, tool[:3], per_moment)
        per_ampere(per_moment, moment_per_current, per_current)
        for i in range(3):
            axis[i] = R[i, 2]
        passive[:] = 0.0
        pull(table, nearest, tool[:3], axis, passive)
        for k in range(count):  # the power that leaves the coil's circuit is the power that the tool gets
            emf[k] = 0.0
            for i in range(6):
                emf[k] += per_current[i, k] * tool[7 + i]
        coil_step(coils, wires, heat, duties, emf, dt, mean)
        for i in range(6):
            given[i] = passive[i]
            for k in range(count):
                given[i] += per_current[i, k] * mean[k]
            truth[i] += given[i] / steps
            total[i] = given[i]
        depth = contact(tool, R, body, dome, dt, total)
        rotation_left(tool[3:7], goal_q, turn)
        move(tool, R, body, grip, goal_p, turn, total, dt)
    return depth
