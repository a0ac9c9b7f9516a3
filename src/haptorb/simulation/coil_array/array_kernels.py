"""A coil array's physics in compiled code: some steps of coils, core, tool, surface and hand.

The map of a hundred coils takes as long as all the rest of a tick. So it is computed at most once a millisecond, and
between two times it follows the mover's change from the last to the newest: its error is then of the
second order in that way. A loop that catches up some missed ticks in one call gets one map for them, or it would miss
the next ones, too.
"""

from __future__ import annotations

import numpy as np

from haptorb.devices.coil_array.array_wrench import ArrayMap, array_wrench
from haptorb.numerics.arrays import Array, Records, fields
from haptorb.numerics.compiled import kernel
from haptorb.simulation.parts.coils import coil_step
from haptorb.simulation.parts.hand import fill_remaining_rotation
from haptorb.simulation.parts.tool import TOOL, contact, matrix, move, plate_contact, set_goal

__all__ = ["COIL_ARRAY", "advance_array"]

_MOVED = 2e-5  #: the map is computed again when the mover has moved so far [m] …
_TURNED = 1e-3  #: … or an entry of its rotation has changed so much …
_APART = 4  #: … and not before so many steps …
_MANY = 32  #: … nor, in one call, more than once and once more for so many
_ARM = 0.02  #: at which a turn counts as a way [m]
_SHORT = 4e-3  #: a longer way between two maps says nothing of how they change [m]
_LEAST, _MOST = -1.0, 4.0  #: shares of that way by which the newest map may be continued

#: All that a simulated coil array remembers but its coils and its map.
COIL_ARRAY = fields(
    ("tool", TOOL),
    ("plate", "?"),  # the surface is a plate, not a dome
    ("dt", "f8"),  # of a step [s]
    ("steps", "i8"),  # in one call
    ("heat", "f8", (2, 3)),  # `TwoNode.step` of a step
    ("wrench", "f8", (6,)),  # of coils and core on the tool, mean of the last call [N, N·m]
    ("depth", "f8"),  # how far the surface gives way under the tool [m]
    ("age", "i8"),  # of the newest map [steps]
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
def _find_share(pose: Array, change: Array, R: Array, p: Array) -> float:
    """How far the mover, at R (3, 3) and p (3,) [m], is beyond `pose` (4, 3) as a share of its `change` (4, 3) before
    that."""
    along, square = 0.0, 0.0
    for j in range(3):
        along += (p[j] - pose[3, j]) * change[3, j]
        square += change[3, j] * change[3, j]
        for i in range(3):
            along += _ARM * _ARM * (R[i, j] - pose[i, j]) * change[i, j]
            square += _ARM * _ARM * change[i, j] * change[i, j]
    if not (1e-18 < square < _SHORT * _SHORT):
        return 0.0
    return float(min(max(along / square, _LEAST), _MOST))


@kernel
def _renew(magnetics: ArrayMap, R: Array, p: Array, newest: Array, change: Array) -> None:
    """The map at R (3, 3) and p (3,) [m] into `newest` (11, w), and what it has changed by into `change` (11, w)."""
    count = magnetics.coils.shape[0]
    pose, passive, matrix = np.empty((4, 3)), np.empty(6), np.empty((6, count))
    pose[:3], pose[3] = R, p
    array_wrench(magnetics, pose, matrix, passive)
    change[:] = -newest
    newest[:4, :3], newest[4, :6], newest[5:, :count] = pose, passive, matrix
    change += newest
    if not np.isfinite(change[3, 0]):  # the first
        change[:] = 0.0


@kernel
def advance_array(
    array: Records, coils: Records, duties: Array, wish_p: Array, wish_q: Array, magnetics: ArrayMap, held: Array
) -> None:
    """Some steps of coils, core, tool, surface and hand: `array` (1,) COIL_ARRAY and `coils` (m,) COIL advance.

    duties (m,); the hand goes to wish_p (3,) [m] and wish_q (4,) where they are numbers and a turn, else to where it
    went; held (2, 11, max(m, 6)): pose (4), passive (1) and matrix (6, m) of the newest map, and what they have changed
    by since the one before.
    """
    e = array[0]
    tool, truth, dt, count = e.tool, e.wrench, e.dt, coils.size
    set_goal(tool, wish_p, wish_q)
    R, turn = np.empty((3, 3)), np.empty(3)
    given, total, per_current = np.empty(6), np.empty(6), np.empty((6, count))
    newest, change = held[0], held[1]
    for k in range(count):
        coils[k].duty = duties[k]
    truth[:] = 0.0
    left = 1 + e.steps // _MANY
    for _ in range(e.steps):
        matrix(tool.q[:], R)
        e.age += 1
        if left > 0 and e.age >= _APART and _is_elsewhere(newest, R, tool.p):
            _renew(magnetics, R, tool.p, newest, change)
            e.age = 0
            left -= 1
        share = _find_share(newest, change, R, tool.p)
        for i in range(6):
            given[i] = newest[4, i] + share * change[4, i]
            for k in range(count):
                per_current[i, k] = newest[5 + i, k] + share * change[5 + i, k]
        for k in range(count):  # the power that leaves the coil's circuit is the power that the tool gets
            emf = 0.0
            for i in range(3):
                emf += per_current[i, k] * tool.v[i] + per_current[3 + i, k] * tool.w[i]
            coils[k].emf = emf
        coil_step(coils, e.heat, dt)
        for i in range(6):
            for k in range(count):
                given[i] += per_current[i, k] * coils[k].mean
            truth[i] += given[i] / e.steps
            total[i] = given[i]
        e.depth = plate_contact(tool, R, dt, total) if e.plate else contact(tool, R, dt, total)
        fill_remaining_rotation(tool.q, tool.goal_q, turn)
        move(tool, R, turn, total, dt)
