"""Wrench per ampere of every coil of an array on a mover with magnets: thick windings, magnets of their true size.

A magnet is modelled by the magnetic charge on its two faces (see `MoverMagnet.charges`), a coil by a table of its
winding's field (see `PlacedCoils.tables`): F = Σ q B and T = Σ (x − p) × q B. A magnet close to a winding needs many
charges, one far away few: each magnet has `RULES` of them, and each pair of coil and magnet uses the first that is
precise enough by the ratio of the magnet's face to its distance from the winding. For a soft core see `add_core`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from haptorb.arrays import Array, Record, Records, fields
from haptorb.compiled import kernel
from haptorb.magnetics.coil import table_field
from haptorb.magnetics.soft_sphere import add_response_wrench, harmonic_sums, response_to_charges

__all__ = [
    "CORE_RULE",
    "FREE",
    "IN_CORE",
    "IN_WINDING",
    "LIMITS",
    "MAGNET",
    "PLACED_COIL",
    "RULES",
    "WINDING",
    "ArrayMap",
    "add_core",
    "array_wrench",
    "place_charges",
]


FREE, IN_WINDING, IN_CORE = 0, 1, 2  #: where the magnets are

#: Radial Gauss nodes and steps of azimuth on each face, from few charges to many.
RULES = ((1, 4), (2, 6), (2, 8), (4, 14), (6, 22), (8, 38))
#: Radius of the face over its distance from the winding up to which each rule but the last is used.
LIMITS = np.array((0.14, 0.25, 0.36, 0.75, 1.1))
CORE_RULE = 2  #: the rule whose charges meet the core


PLACED_COIL = fields(
    ("centre", "f8", (3,)),  # [m]
    ("axis", "f8", (3,)),
    ("turns", "f8"),
    ("sort", "i8"),  # number of its WINDING
)
#: One sort of winding: its table and its body.
WINDING = fields(
    ("scale", "f8"),  # steps of the table per metre [1/m]
    ("far2", "f8"),  # square of the table's range [m²]
    ("inner_radius", "f8"),  # [m]
    ("outer_radius", "f8"),  # [m]
    ("half_length", "f8"),  # [m]
)
MAGNET = fields(
    ("centre", "f8", (3,)),  # mover frame [m]
    ("half_axis", "f8", (3,)),  # axis times half length, mover frame [m]
    ("radius", "f8"),  # [m]
)


class ArrayMap(NamedTuple):
    """Coils, core and magnets as compiled code takes them."""

    coils: Records  #: (m,) PLACED_COIL
    windings: Records  #: (k,) WINDING
    tables: Array  #: (k, n, n, 2) of each sort, see `WindingTable`
    series: Array  #: (k, 2, 7, 8) of each sort
    charges: Array  #: (4, n) of all magnets and rules, mover frame [m, A·m]
    spans: Array  #: (g, rules + 1) the first charge of each magnet's rules
    magnets: Records  #: (g,) MAGNET
    core_charges: Array  #: (4, n') of all magnets: what meets the core
    core_radius: float  #: [m]; 0: there is no core
    order: int  #: degree of the core's harmonics
    responses: Array  #: (m, k, 2) of the core to each coil [T·m/A]
    shares: Array  #: (k,) of the core's response to the magnets


@kernel
def place_charges(charges: Array, p: Array, R: Array, out: Array) -> None:
    """out (7, n): places (3) [m] of charges (4, n) turned by R (3, 3) at p (3,), their arms about p (3) [m], their
    strength [A·m]."""
    for n in range(charges.shape[1]):
        for i in range(3):
            arm = R[i, 0] * charges[0, n] + R[i, 1] * charges[1, n] + R[i, 2] * charges[2, n]
            out[i, n] = p[i] + arm
            out[3 + i, n] = arm
        out[6, n] = charges[3, n]


@kernel
def _measure_distance(coil: Record, winding: Record, x: float, y: float, z: float) -> float:
    """From a point to the winding's body [m]; 0 in it."""
    dx, dy, dz = x - coil.centre[0], y - coil.centre[1], z - coil.centre[2]
    along = dx * coil.axis[0] + dy * coil.axis[1] + dz * coil.axis[2]
    across = np.sqrt(max(dx * dx + dy * dy + dz * dz - along * along, 0.0))
    out = max(max(winding.inner_radius - across, across - winding.outer_radius), 0.0)
    up = max(abs(along) - winding.half_length, 0.0)
    return float(np.sqrt(out * out + up * up))


@kernel
def _choose_rule(coil: Record, winding: Record, magnet: Record, p: Array, R: Array) -> int:
    """Number of the rule for `magnet` near `coil`."""
    nearest, centre, half = 1e300, magnet.centre, magnet.half_axis
    for side in (-1.0, 1.0):
        a, b, c = centre[0] + side * half[0], centre[1] + side * half[1], centre[2] + side * half[2]
        x = p[0] + R[0, 0] * a + R[0, 1] * b + R[0, 2] * c
        y = p[1] + R[1, 0] * a + R[1, 1] * b + R[1, 2] * c
        z = p[2] + R[2, 0] * a + R[2, 1] * b + R[2, 2] * c
        nearest = min(nearest, _measure_distance(coil, winding, x, y, z))
    rule = 0
    while rule < LIMITS.shape[0] and magnet.radius > LIMITS[rule] * nearest:
        rule += 1
    return rule


@kernel
def array_wrench(a: ArrayMap, pose: Array, out: Array, passive: Array) -> int:
    """Fill out (6, m) [N/A, N·m/A] and passive (6,) [N, N·m] for the mover at `pose` (4, 3), R above p; torque about p.

    FREE, or IN_WINDING or IN_CORE for a magnet where none can be.
    """
    R, p = pose[:3], pose[3]
    placed = np.empty((7, a.charges.shape[1]))
    place_charges(a.charges, p, R, placed)
    status = FREE
    for j in range(a.coils.shape[0]):
        coil = a.coils[j]
        winding, table, far = a.windings[coil.sort], a.tables[coil.sort], a.series[coil.sort]
        cx, cy, cz = coil.centre[0], coil.centre[1], coil.centre[2]
        ax, ay, az = coil.axis[0], coil.axis[1], coil.axis[2]
        fx, fy, fz, tx, ty, tz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for g in range(a.magnets.shape[0]):
            rule = _choose_rule(coil, winding, a.magnets[g], p, R)
            for n in range(a.spans[g, rule], a.spans[g, rule + 1]):
                x, y, z = placed[0, n] - cx, placed[1, n] - cy, placed[2, n] - cz
                along = x * ax + y * ay + z * az
                x -= along * ax
                y -= along * ay
                z -= along * az
                rho = np.sqrt(x * x + y * y + z * z)
                if winding.inner_radius < rho < winding.outer_radius and abs(along) < winding.half_length:
                    status = IN_WINDING
                over, axial = table_field(table, winding.scale, winding.far2, far, rho, along)
                q = placed[6, n]
                bx, by, bz = q * (over * x + axial * ax), q * (over * y + axial * ay), q * (over * z + axial * az)
                rx, ry, rz = placed[3, n], placed[4, n], placed[5, n]
                fx += bx
                fy += by
                fz += bz
                tx += ry * bz - rz * by
                ty += rz * bx - rx * bz
                tz += rx * by - ry * bx
        turns = coil.turns
        out[0, j], out[1, j], out[2, j] = turns * fx, turns * fy, turns * fz
        out[3, j], out[4, j], out[5, j] = turns * tx, turns * ty, turns * tz
    passive[:] = 0.0
    if a.core_radius > 0.0:
        return add_core(a, pose, out, passive, status)
    return status


@kernel
def add_core(a: ArrayMap, pose: Array, out: Array, passive: Array, status: int) -> int:
    """The response of the core to the coils, added to out (6, m), and to the magnets themselves, to passive (6,)."""
    p = pose[3]
    placed = np.empty((7, a.core_charges.shape[1]))
    place_charges(a.core_charges, p, pose[:3], placed)
    for n in range(placed.shape[1]):
        if placed[0, n] ** 2 + placed[1, n] ** 2 + placed[2, n] ** 2 < a.core_radius * a.core_radius:
            return IN_CORE
    sums = np.empty(((a.order + 2) * (a.order + 3) // 2, 2))
    harmonic_sums(placed, a.core_radius, a.order, sums)
    add_response_wrench(sums, a.responses, a.core_radius, a.order, p, out)
    own, pull = np.empty((1, a.shares.shape[0], 2)), np.zeros((6, 1))
    response_to_charges(sums, a.shares, own)
    add_response_wrench(sums, own, a.core_radius, a.order, p, pull)
    passive[:] = pull[:, 0]
    return status
