"""What the sensors of a spherical electromagnet read: currents, coil boundaries, and the field at nine places.

The field at a Hall sensor is that of the electromagnet's dipole (coils and core, as calibrated), of the tool's ring as
charges on its faces, and of what the core answers to the ring. Every reading has normal noise and its converter's step.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel
from haptorb.physics.sources.charged_ring import charge_field
from haptorb.physics.sources.soft_sphere import add_induced_field
from haptorb.simulation.parts.coils import BODY, CURRENT
from haptorb.simulation.parts.noise import Noise, fill_normal, quantise
from haptorb.simulation.parts.tool import matrix

__all__ = ["Magnets", "SensorNoise", "field_at", "sense"]


class Magnets(NamedTuple):
    """Where fields come from."""

    ring: Array  #: (4, n) charges of the tool's magnet, mover frame [m, A·m]
    coarse: Array  #: (4, n') the same magnet with fewer charges: enough for what the core answers
    core_radius: float  #: [m]
    response: Array  #: (L,) the core's answer by degree
    per_ampere: Array  #: (3 k, m) field of the electromagnet at the sensors [T/A]


class SensorNoise(NamedTuple):
    """How good the sensors are: standard deviation and step of each kind."""

    field_noise: float  #: [T]
    field_step: float  #: [T]
    current_noise: float  #: [A]
    current_step: float  #: [A]
    heat_noise: float  #: [K]
    heat_step: float  #: [K]


@kernel
def _place_charges(rows: Array, R: Array, p: Array, out: Array) -> None:
    for n in range(rows.shape[1]):
        for i in range(3):
            out[i, n] = p[i] + R[i, 0] * rows[0, n] + R[i, 1] * rows[1, n] + R[i, 2] * rows[2, n]
        out[3, n] = rows[3, n]


@kernel
def field_at(magnets: Magnets, positions: Array, currents: Array, R: Array, p: Array, out: Array) -> None:
    """out (k, 3) [T]: the field at the sensors with `currents` (m,) [A] and the tool at R (3, 3), p (3,)."""
    ring, coarse = np.empty_like(magnets.ring), np.empty_like(magnets.coarse)
    _place_charges(magnets.ring, R, p, ring)
    _place_charges(magnets.coarse, R, p, coarse)
    for k in range(positions.shape[0]):
        for i in range(3):
            total = 0.0
            for j in range(currents.shape[0]):
                total += magnets.per_ampere[3 * k + i, j] * currents[j]
            out[k, i] = total
        x, y, z = positions[k, 0], positions[k, 1], positions[k, 2]
        charge_field(ring, x, y, z, out[k])
        add_induced_field(coarse, magnets.core_radius, magnets.response, x, y, z, out[k])


@kernel
def sense(
    tool: Array, coils: Array, positions: Array, ring: Array, coarse: Array, response: Array, per_ampere: Array,
    numbers: Array, noise: Noise, pose: Array, read: Array, field: Array,
) -> bool:  # fmt: skip
    """One reading of each sensor, and the tool's true pose; False, and nothing read, if the tool is nowhere.

    pose (6, 3) becomes R, p, v and w; read (2 m,) currents [A], then temperatures [K]; field (k, 3) [T] at positions.
    The other arguments are `Magnets` and, in numbers (7,), `SensorNoise` and the core's radius: tuples are slower.
    """
    total = 0.0
    for i in range(tool.shape[0]):
        total += tool[i]
    if not np.isfinite(total):
        return False
    n = numbers
    senses = SensorNoise(n[0], n[1], n[2], n[3], n[4], n[5])
    magnets = Magnets(ring, coarse, n[6], response, per_ampere)
    matrix(tool[3:7], pose[:3])
    for i in range(3):
        pose[3, i], pose[4, i], pose[5, i] = tool[i], tool[7 + i], tool[10 + i]
    count, places = coils.shape[1], positions.shape[0]
    draws = np.empty(2 * count + 3 * places)
    fill_normal(noise, draws)
    field_at(magnets, positions, coils[CURRENT], pose[:3], pose[3], field)
    for k in range(count):
        read[k] = quantise(coils[CURRENT, k] + senses.current_noise * draws[k], senses.current_step)
        read[count + k] = quantise(coils[BODY, k] + senses.heat_noise * draws[count + k], senses.heat_step)
    for k in range(places):
        for i in range(3):
            reading = field[k, i] + senses.field_noise * draws[2 * count + 3 * k + i]
            field[k, i] = quantise(reading, senses.field_step)
    return True
