"""The coils and the mover of a coil array: sizes and places as people give them, and as compiled code takes them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import final

import numpy as np

from haptorb.devices.coil_array.array_wrench import CORE_RULE, MAGNET, PLACED_COIL, RULES, WINDING
from haptorb.devices.device import Coils
from haptorb.devices.state import rotation_to_axis
from haptorb.numerics.arrays import Array, Records
from haptorb.physics.fast_fields.winding_table import tabulate_winding
from haptorb.physics.sources.charged_ring import ChargedRing
from haptorb.physics.sources.coil import COPPER_RESISTIVITY, Coil
from haptorb.physics.sources.dipole import MU0
from haptorb.physics.sources.soft_sphere import SoftSphere

__all__ = ["ArrayMover", "MoverMagnet", "PlacedCoils"]

_COPPER_AT = 293.15  #: temperature of COPPER_RESISTIVITY [K]


@final
@dataclass(frozen=True)
class PlacedCoils:
    """Round windings, each with its own place, axis and size; arrays have one entry per coil."""

    position: Array  #: (m, 3) of the centres, stator frame [m]
    axis: Array  #: (m, 3) unit vectors; a positive current is right-handed about them
    turns: Array  #: (m,)
    inner_radius: Array  #: (m,) [m]
    outer_radius: Array  #: (m,) [m]
    length: Array  #: (m,) along the axis [m]

    def coil(self, number: int) -> Coil:
        """Coil `number`, from 0, in its own frame."""
        sizes = (self.turns, self.inner_radius, self.outer_radius, self.length)
        return Coil(*(float(size[number]) for size in sizes))

    @property
    def nearest(self) -> Array:
        """(m,) distance of each winding's body from the origin [m]."""
        along = (self.position * self.axis).sum(axis=1)
        across = np.sqrt(np.maximum((self.position**2).sum(axis=1) - along**2, 0.0))
        out = np.maximum(np.maximum(self.inner_radius - across, across - self.outer_radius), 0.0)
        reach: Array = np.hypot(out, np.maximum(np.abs(along) - self.length / 2, 0.0))
        return reach

    def complete(self, coils: Coils, core: SoftSphere | None, fill: float) -> Coils:
        """`coils` with resistance, inductance and heat capacity of these windings, of which copper fills `fill`.

        A core adds what its moment m in the winding's field B at its centre sends back through the winding, m·B per
        ampere squared; its higher harmonics are left out. The heat capacity is the mean of all windings, as a device
        has one for all its channels.
        """
        made = [self.coil(number) for number in range(len(self.position))]
        inductance = np.array([one.inductance for one in made])
        if core is not None:
            for number, one in enumerate(made):
                field = one.field(-rotation_to_axis(self.axis[number]).T @ self.position[number])
                inductance[number] += float(core.moment_in(field) @ field)
        capacity = float(np.mean([one.heat_capacity(fill) for one in made]))
        resistance = self.fill(replace(coils, resistance=np.ones(len(made)))) / fill
        return replace(
            coils, resistance=resistance, inductance=inductance, heat=replace(coils.heat, winding_capacity=capacity)
        )

    def fill(self, coils: Coils) -> Array:
        """(m,) share of each winding's section that copper must fill for the resistances of `coils`."""
        warm = 1 + coils.temperature_coefficient * (coils.reference_temperature - _COPPER_AT)
        made = [self.coil(number) for number in range(len(self.position))]
        share: Array = np.array([one.resistance(1.0, COPPER_RESISTIVITY * warm) for one in made]) / coils.resistance
        return share

    @property
    def placed(self) -> Records:
        """(m,) PLACED_COIL."""
        coils = np.zeros(len(self.turns), dtype=PLACED_COIL)
        coils["centre"], coils["axis"], coils["turns"] = self.position, self.axis, self.turns
        coils["sort"] = [self._sorts.index(tuple(size)) for size in self._sizes]
        return coils

    @cached_property
    def tables(self) -> tuple[Records, Array, Array]:
        """Of each sort of winding: (k,) WINDING, tables (k, n, n, 2), series (k, 2, 7, 8), as `ArrayMap` says."""
        made = [tabulate_winding(*size) for size in self._sorts]
        windings = [
            (one.scale, one.far2, inner, outer, 0.5 * length)
            for one, (inner, outer, length) in zip(made, self._sorts, strict=True)
        ]
        return (
            np.array(windings, WINDING),
            np.stack([one.table for one in made]),
            np.stack([one.series for one in made]),
        )

    @property
    def _sizes(self) -> list[list[float]]:
        sizes: list[list[float]] = np.column_stack([self.inner_radius, self.outer_radius, self.length]).tolist()
        return sizes

    @cached_property
    def _sorts(self) -> list[tuple[float, ...]]:
        return list(dict.fromkeys(map(tuple, self._sizes)))


@final
@dataclass(frozen=True)
class MoverMagnet:
    """A round magnet, or a ring, in the mover."""

    position: Array  #: (3,) of its centre, mover frame [m]
    axis: Array  #: (3,) unit vector of its polarisation, mover frame
    outer_radius: float  #: [m]
    inner_radius: float  #: [m]
    length: float  #: [m]
    remanence: float  #: [T]

    @property
    def moment(self) -> float:
        """Magnetic moment [A·m²]: remanence times volume over μ0."""
        volume = np.pi * (self.outer_radius**2 - self.inner_radius**2) * self.length
        return float(self.remanence * volume / MU0)

    def charges(self, radial: int, azimuth: int) -> Array:
        """(4, n) places in the mover's frame [m] and charges [A·m]."""
        ring = ChargedRing(
            self.outer_radius, self.inner_radius, self.length, self.remanence, radial=radial, azimuth=azimuth
        )
        placed = rotation_to_axis(self.axis) @ ring.rows[:3] + self.position[:, None]
        return np.vstack([placed, ring.rows[3]])


@final
@dataclass(frozen=True)
class ArrayMover:
    """A tool or a plate with magnets; it touches the surface with its tip, at −z of the mover."""

    magnets: tuple[MoverMagnet, ...]
    tip_distance: float  #: from the mover's origin to the tip, along −z [m]
    mass: float  #: [kg]
    inertia: Array  #: (3,) principal moments about the mover's origin, mover frame [kg·m²]

    @property
    def moment(self) -> float:
        """Size of the magnets' moments together [A·m²]."""
        return float(np.linalg.norm(sum(magnet.moment * magnet.axis for magnet in self.magnets)))

    @property
    def reach(self) -> float:
        """Radius of a sphere about the mover's origin that holds all magnets [m]."""
        return max(
            float(np.linalg.norm(magnet.position) + np.hypot(magnet.outer_radius, 0.5 * magnet.length))
            for magnet in self.magnets
        )

    @cached_property
    def charge_map(self) -> tuple[Array, Array, Records, Array]:
        """charges (4, n), spans (g, rules + 1), (g,) MAGNET and core_charges (4, n'), as `ArrayMap` says."""
        parts, spans, places = [], [], []
        count = 0
        for magnet in self.magnets:
            row = [count]
            for radial, azimuth in RULES:
                parts.append(magnet.charges(radial, azimuth))
                count += parts[-1].shape[1]
                row.append(count)
            spans.append(row)
            places.append((magnet.position, 0.5 * magnet.length * magnet.axis, magnet.outer_radius))
        soft = np.hstack([magnet.charges(*RULES[CORE_RULE]) for magnet in self.magnets])
        return (
            np.ascontiguousarray(np.hstack(parts)),
            np.array(spans),
            np.array(places, MAGNET),
            np.ascontiguousarray(soft),
        )
