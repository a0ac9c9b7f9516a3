"""A coil array's physics in compiled code: some steps of coils, core, tool, surface and hand."""

from __future__ import annotations

import numpy as np

from haptorb.devices.coil_array.array_wrench import ArrayMap, array_wrench
from haptorb.numerics.arrays import Array, Records, fields
from haptorb.numerics.compiled import kernel
from haptorb.simulation.parts.coils import coil_step
from haptorb.simulation.parts.hand import rotation_left
from haptorb.simulation.parts.tool import TOOL, contact, matrix, move, plate_contact, set_goal

__all__ = ["COIL_ARRAY", "advance_array"]

_MOVED = 2e-5  #: the map is computed anew when the mover has moved so far [m] …
_TURNED = 1e-3  #: … or an entry of its rotation has changed so much

#: All that a simulated coil array remembers but its coils and its map.
COIL_ARRAY = fields(
    ("tool", TOOL),
    ("plate", "?"),  # the surface is a plate, not a dome
    ("dt", "f8"),  # of a step [s]
    ("steps", "i8"),  # in one call
    ("heat", "f8", (2, 3)),  # `TwoNode.step` of a step
    ("wrench", "f8", (6,)),  # of coils and core on the tool, mean of the last call [N, N·m]
    ("depth", "f8"),  # how far the surface gives way under the tool [m]
)


@kernel
def _is_elsewhere(pose: Array, R: Array, p: Array) -> bool:
    square, turn = 0.0, 0.0
    for i in range(3):
        square += (pose[3, i] - p[i]) ** 2
        for j in range(3):
            turn = max(turn, abs(pose[i, j] - R[i, j]))
    return not (square <= _MOVED * _MOVED and turn <= _TURNED)


@kernel
def advance_array(
    array: Records, coils: Records, duties: Array, wish_p: Array, wish_q: Array, magnetics: ArrayMap, held: Array
) -> None:
    """Some steps of coils, core, tool, surface and hand: `array` (1,) COIL_ARRAY and `coils` (m,) COIL go on.

    duties (m,); the hand goes to wish_p (3,) [m] and wish_q (4,) where they are numbers and a turn, else to where it
    went; held (11, max(m, 3)): pose (4), passive (1) and matrix (6, m) of the last map, used until the mover has moved.
    """
    e = array[0]
    tool, truth, dt, count = e.tool, e.wrench, e.dt, coils.size
    set_goal(tool, wish_p, wish_q)
    R, turn = np.empty((3, 3)), np.empty(3)
    given, total = np.empty(6), np.empty(6)
    pose, passive, per_current = held[:4, :3], held[4, :6], np.ascontiguousarray(held[5:, :count])
    for k in range(count):
        coils[k].duty = duties[k]
    truth[:] = 0.0
    for _ in range(e.steps):
        matrix(tool.q[:], R)
        if _is_elsewhere(pose, R, tool.p):
            now = np.empty((4, 3))
            now[:3], now[3] = R, tool.p
            pose[:] = now
            array_wrench(magnetics, now, per_current, passive)
        for k in range(count):  # the power that leaves the coil's circuit is the power that the tool gets
            emf = 0.0
            for i in range(3):
                emf += per_current[i, k] * tool.v[i] + per_current[3 + i, k] * tool.w[i]
            coils[k].emf = emf
        coil_step(coils, e.heat, dt)
        for i in range(6):
            given[i] = passive[i]
            for k in range(count):
                given[i] += per_current[i, k] * coils[k].mean
            truth[i] += given[i] / e.steps
            total[i] = given[i]
        e.depth = plate_contact(tool, R, dt, total) if e.plate else contact(tool, R, dt, total)
        rotation_left(tool.q, tool.goal_q, turn)
        move(tool, R, turn, total, dt)
    held[5:, :count] = per_current
