"""What a tick did, into its row: all that has a shape, in one compiled pass."""

from __future__ import annotations

import numpy as np

from haptorb.control.protection.guard_rules import GAIN, REASON, STATE
from haptorb.control.protection.heat_observer import REMAINING
from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel
from haptorb.runtime.row import RowLayout

__all__ = ["SHAPED", "fill_quaternion", "induced", "places", "tell"]

#: the fields that `tell` fills, in the order of its places
SHAPED = (
    "p", "q", "v", "w", "target", "asked", "modelled", "given", "wanted", "currents", "duties", "resistance",
    "boundary", "winding", "field", "share", "object", "object_q", "object_wrench", "contacts", "stages",
    "guard", "trip", "gain", "remaining", "energy",
)  # fmt: skip


def places(layout: RowLayout) -> Array:
    """(26,) the index [1] in a row at which each of SHAPED begins; `target_q` follows `target`, and what passivity
    control counts follows `energy`."""
    return np.array([layout[name].start for name in SHAPED], dtype=np.float64)


@kernel
def induced(matrix: Array, v: Array, w: Array, out: Array) -> None:
    """out (m,) [V]: what a mover with velocity v (3,) and w (3,) induces; matrix (6, m) wrench per ampere."""
    for j in range(out.shape[0]):
        out[j] = 0.0
        for i in range(3):
            out[j] += v[i] * matrix[i, j] + w[i] * matrix[3 + i, j]


@kernel
def _copied(row: Array, start: float, values: Array) -> None:
    at = int(start)
    for i in range(values.shape[0]):
        row[at + i] = values[i]


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


@kernel
def tell(
    row: Array, at: Array, p: Array, R: Array, v: Array, w: Array, target: Array, asked: Array, matrix: Array,
    given: Array, wanted: Array, currents: Array, duties: Array, resistance: Array, boundary: Array, winding: Array,
    field: Array, share: Array, object_p: Array, object_R: Array, object_wrench: Array, contacts: Array, stages: Array,
    guard: Array, heat: Array, energies: Array,
) -> None:  # fmt: skip
    """Fill the fields SHAPED of `row`, and those that follow; `modelled` is matrix (6, m) times the measured currents.

    guard and heat are the numbers of a `Guard` and of its heat observer, energies (3,) those of passivity control.
    """
    _copied(row, at[0], p)
    start = int(at[1])
    fill_quaternion(R, row[start : start + 4])
    _copied(row, at[2], v)
    _copied(row, at[3], w)
    _copied(row, at[4], target)
    _copied(row, at[5], asked)
    start = int(at[6])
    for i in range(6):
        total = 0.0
        for j in range(currents.shape[0]):
            total += matrix[i, j] * currents[j]
        row[start + i] = total
    _copied(row, at[7], given)
    _copied(row, at[8], wanted)
    _copied(row, at[9], currents)
    _copied(row, at[10], duties)
    _copied(row, at[11], resistance)
    _copied(row, at[12], boundary)
    _copied(row, at[13], winding)
    start = int(at[14])
    for k in range(field.shape[0]):
        for i in range(3):
            row[start + 3 * k + i] = field[k, i]
    _copied(row, at[15], share)
    _copied(row, at[16], object_p)
    start = int(at[17])
    fill_quaternion(object_R, row[start : start + 4])
    _copied(row, at[18], object_wrench)
    start = int(at[19])
    for k in range(contacts.shape[0]):
        for i in range(contacts.shape[1]):
            row[start + contacts.shape[1] * k + i] = contacts[k, i]
    _copied(row, at[20], stages)
    row[int(at[21])], row[int(at[22])], row[int(at[23])] = guard[STATE], guard[REASON], guard[GAIN]
    row[int(at[24])] = heat[REMAINING]
    _copied(row, at[25], energies)
