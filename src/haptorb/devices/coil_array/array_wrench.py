"""What every coil of an array does to a mover with magnets, per ampere: the real winding on magnets of their true size.

A magnet is the magnetic charge on its two faces (see `charged_ring`), a coil is its winding's field from a table (see
`winding_table`): F = Σ q B and T = Σ (x − p) × q B. A magnet close to a winding needs many charges, one far away few:
each magnet has `RULES` of them, and each pair of coil and magnet uses the first that is precise enough by the ratio of
the magnet's face to its distance from the winding.
"""

from __future__ import annotations

import numpy as np

from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel
from haptorb.physics.sources.winding_table import table_field

__all__ = ["LIMITS", "RULES", "array_per_ampere", "place_charges"]

#: Radial Gauss nodes and steps of azimuth on each face, from few charges to many.
RULES = ((1, 4), (2, 6), (2, 8), (4, 14), (6, 22), (8, 38))
#: Radius of the face over its distance from the winding up to which each rule but the last is used.
LIMITS = np.array((0.14, 0.25, 0.36, 0.75, 1.1))


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
def _distance(coil: Array, shape: Array, x: float, y: float, z: float) -> float:
    """From a point to the winding's body [m]; 0 in it."""
    dx, dy, dz = x - coil[0], y - coil[1], z - coil[2]
    along = dx * coil[3] + dy * coil[4] + dz * coil[5]
    across = np.sqrt(max(dx * dx + dy * dy + dz * dz - along * along, 0.0))
    out = max(max(shape[2] - across, across - shape[3]), 0.0)
    up = max(abs(along) - shape[4], 0.0)
    return float(np.sqrt(out * out + up * up))


@kernel
def _choose_rule(coil: Array, shape: Array, magnet: Array, p: Array, R: Array) -> int:
    """Number of the rule for a magnet (7,): centre (3) [m], axis times half length (3) [m], radius [m], mover frame."""
    nearest = 1e300
    for side in (-1.0, 1.0):
        a, b, c = magnet[0] + side * magnet[3], magnet[1] + side * magnet[4], magnet[2] + side * magnet[5]
        x = p[0] + R[0, 0] * a + R[0, 1] * b + R[0, 2] * c
        y = p[1] + R[1, 0] * a + R[1, 1] * b + R[1, 2] * c
        z = p[2] + R[2, 0] * a + R[2, 1] * b + R[2, 2] * c
        nearest = min(nearest, _distance(coil, shape, x, y, z))
    rule = 0
    while rule < LIMITS.shape[0] and magnet[6] > LIMITS[rule] * nearest:
        rule += 1
    return rule


@kernel
def array_per_ampere(
    coils: Array, shapes: Array, tables: Array, series: Array, charges: Array, spans: Array, magnets: Array, pose: Array,
    out: Array,
) -> bool:  # fmt: skip
    """Fill out (6, m) [N/A, N·m/A]; False where a charge is inside a winding.

    coils (m, 8): centre [m], axis, turns, number of the winding's sort; shapes (k, 5) of each sort: steps per metre,
    square of the table's range [m²], inner and outer radius, half length [m]; tables and series of each sort as in
    `WindingTable`; charges (4, n), spans (g, rules + 1) the first charge of each magnet's rules, magnets (g, 7);
    pose (4, 3): R and p.
    """
    R, p = pose[:3], pose[3]
    placed = np.empty((7, charges.shape[1]))
    place_charges(charges, p, R, placed)
    free = True
    for j in range(coils.shape[0]):
        coil = coils[j]
        sort = int(coil[7])
        shape, table, far = shapes[sort], tables[sort], series[sort]
        ax, ay, az = coil[3], coil[4], coil[5]
        fx, fy, fz, tx, ty, tz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for g in range(magnets.shape[0]):
            rule = _choose_rule(coil, shape, magnets[g], p, R)
            for n in range(spans[g, rule], spans[g, rule + 1]):
                x, y, z = placed[0, n] - coil[0], placed[1, n] - coil[1], placed[2, n] - coil[2]
                along = x * ax + y * ay + z * az
                x -= along * ax
                y -= along * ay
                z -= along * az
                rho = np.sqrt(x * x + y * y + z * z)
                if shape[2] < rho < shape[3] and abs(along) < shape[4]:
                    free = False
                over, axial = table_field(table, shape[0], shape[1], far, rho, along)
                q = placed[6, n]
                bx, by, bz = q * (over * x + axial * ax), q * (over * y + axial * ay), q * (over * z + axial * az)
                rx, ry, rz = placed[3, n], placed[4, n], placed[5, n]
                fx += bx
                fy += by
                fz += bz
                tx += ry * bz - rz * by
                ty += rz * bx - rx * bz
                tz += rx * by - ry * bx
        turns = coil[6]
        out[0, j], out[1, j], out[2, j] = turns * fx, turns * fy, turns * fz
        out[3, j], out[4, j], out[5, j] = turns * tx, turns * ty, turns * tz
    return free
