"""What the sensors of a spherical electromagnet read: currents, coil boundaries, and the field at nine places.

The field at a Hall sensor is that of the electromagnet's dipole (coils and core, as calibrated, with what eddy currents
delay and what stays in the core), of the tool's ring as charges on its faces, and of what the core answers to the ring,
where the sensor really is. What the sensor makes of it is `simulation.parts.hall`'s; every reading has normal noise and
its converter's step.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from haptorb.numerics.arrays import Array, Record, Records, fields
from haptorb.numerics.compiled import kernel
from haptorb.numerics.packing import pack, part
from haptorb.physics.sources.charged_ring import charge_field
from haptorb.physics.sources.soft_sphere import add_induced_field
from haptorb.simulation.parts.hall import read_halls
from haptorb.simulation.parts.noise import fill_normal, quantise
from haptorb.simulation.parts.tool import matrix

__all__ = ["SENSES", "Magnets", "pack_magnets", "sense"]

#: How good the sensors of currents and temperatures are: standard deviation and step; the generator of all noise.
SENSES = fields(
    ("warming", "f8"),  # rise of the field sensors' temperature as a share of the coils' at their boundary
    ("current_noise", "f8"),  # [A]
    ("current_step", "f8"),  # [A]
    ("heat_noise", "f8"),  # [K]
    ("heat_step", "f8"),  # [K]
    ("generator", "u8", (4,)),
)


class Magnets(NamedTuple):
    """Where fields come from, and where they are read."""

    ring: Array  #: (4, n) charges of the tool's magnet, mover frame [m, A·m]
    coarse: Array  #: (4, n') the same magnet with fewer charges: enough for what the core answers
    core_radius: float  #: [m]
    response: Array  #: (L,) the core's answer by degree
    per_moment: Array  #: (3 k, 3) field of the electromagnet at the sensors [T/(A·m²)]
    moment_per_current: Array  #: (3, m) [m²]
    sensors: Array  #: (k, 3) where they really are [m]


def pack_magnets(magnets: Magnets) -> Array:
    """(n,) `magnets` as compiled code takes them, each number in the unit [..] of its field."""
    m = magnets
    return pack((m.core_radius,), m.ring, m.coarse, m.response, m.per_moment, m.moment_per_current, m.sensors)


@kernel
def _unpack_magnets(blob: Array) -> Magnets:
    return Magnets(
        part(blob, 1), part(blob, 2), part(blob, 0)[0, 0], part(blob, 3)[0], part(blob, 4), part(blob, 5),
        part(blob, 6),
    )  # fmt: skip


@kernel
def _place_charges(rows: Array, R: Array, p: Array, out: Array) -> None:
    for n in range(rows.shape[1]):
        for i in range(3):
            out[i, n] = p[i] + R[i, 0] * rows[0, n] + R[i, 1] * rows[1, n] + R[i, 2] * rows[2, n]
        out[3, n] = rows[3, n]


@kernel
def _fill_field(magnets: Magnets, coils: Records, extra: Array, R: Array, p: Array, out: Array) -> None:
    """out (k, 3) [T]: the field at the sensors with the coils' currents and the tool at R (3, 3), p (3,).

    extra (3,) [A·m²]: the electromagnet's moment beside that of its currents.
    """
    moment = np.empty(3)
    for a in range(3):
        moment[a] = extra[a]
        for j in range(coils.size):
            moment[a] += magnets.moment_per_current[a, j] * coils[j].current
    ring, coarse, sensors = np.empty_like(magnets.ring), np.empty_like(magnets.coarse), magnets.sensors
    _place_charges(magnets.ring, R, p, ring)
    _place_charges(magnets.coarse, R, p, coarse)
    for k in range(sensors.shape[0]):
        for i in range(3):
            total = 0.0
            for a in range(3):
                total += magnets.per_moment[3 * k + i, a] * moment[a]
            out[k, i] = total
        x, y, z = sensors[k, 0], sensors[k, 1], sensors[k, 2]
        charge_field(ring, x, y, z, out[k])
        add_induced_field(coarse, magnets.core_radius, magnets.response, x, y, z, out[k])


@kernel
def _is_finite(tool: Record) -> bool:
    """Whether pose and motion of a TOOL are numbers."""
    total = tool.q[3]
    for i in range(3):
        total += tool.p[i] + tool.q[i] + tool.v[i] + tool.w[i]
    return bool(np.isfinite(total))


@kernel
def sense(
    electromagnet: Records, coils: Records, halls: Records, magnets: Array, pose: Array, read: Array, field: Array
) -> bool:
    """One reading of each sensor, and the tool's true pose; False, and nothing read, if the tool is nowhere.

    electromagnet (1,) ELECTROMAGNET, coils (m,) COIL, halls (k,) HALL, magnets as `pack_magnets` made them; pose (6, 3)
    becomes R, p, v and w; read (2 m,) currents [A], then temperatures [K]; field (k, 3) [T].
    """
    tool, s = electromagnet[0].tool, electromagnet[0].senses
    if not _is_finite(tool):
        return False
    matrix(tool.q[:], pose[:3])
    for i in range(3):
        pose[3, i], pose[4, i], pose[5, i] = tool.p[i], tool.v[i], tool.w[i]
    count = coils.size
    draws = np.empty(2 * count)
    fill_normal(s.generator, draws)
    _fill_field(_unpack_magnets(magnets), coils, electromagnet[0].core.extra, pose[:3], pose[3], field)
    warmth = 0.0
    for k in range(count):
        read[k] = quantise(coils[k].current + s.current_noise * draws[k], s.current_step)
        read[count + k] = quantise(coils[k].body + s.heat_noise * draws[count + k], s.heat_step)
        warmth += s.warming * (coils[k].body - coils[k].ambient) / count
    read_halls(halls, s.generator, warmth, field)
    return True
