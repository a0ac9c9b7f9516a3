"""Coils at any place and in any direction: sizes and places, for people and for compiled code, and gaps between them.

Two bodies are nearest where each point is the nearest one of its body to the other: projections to and fro (von
Neumann; Cheney and Goldstein 1959) lead there from a near start, which the best of many rim points is. Each winding
is taken as a cylinder without its hole: nothing is meant to go through it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import final

import numpy as np

from haptorb.arrays import Array, Records
from haptorb.devices.base import Coils, rotation_to_axis
from haptorb.devices.build_checks import BuildCheck, check_wire, compare_fill
from haptorb.devices.coil_array_wrench_map import (
    PLACED_COIL,
    WINDING,
)
from haptorb.devices.turning_clearance import AxialBody
from haptorb.magnetics.coil import Coil, tabulate_winding
from haptorb.magnetics.soft_sphere import (
    SoftSphere,
)
from haptorb.magnetics.source import PlacedSource
from haptorb.magnetics.wire import overall_diameter, wire_diameter

__all__ = [
    "PlacedCoils",
    "fill_points",
    "find_farthest",
    "find_overlap",
    "find_spacing",
    "measure_winding",
    "place_coils",
]


#: by which points lie inside the faces of their own winding: parts that touch do not overlap [m]
_FACE_TOLERANCE_M = 1e-6


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
    copper_share: float | None = None  #: of each section, if the file states it [1]

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
        """`coils` with what they lack (NaN) of resistance, inductance and heat capacity: those of these windings, of
        which copper fills `fill`.

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
        keep = np.isfinite([coils.resistance[0], coils.inductance[0], coils.heat.winding_capacity])
        return replace(
            coils,
            resistance=coils.resistance if keep[0] else resistance,
            inductance=coils.inductance if keep[1] else inductance,
            heat=coils.heat if keep[2] else replace(coils.heat, winding_capacity=capacity),
        )

    def fill(self, coils: Coils) -> Array:
        """(m,) share of each winding's section that copper must fill for the resistances of `coils`."""
        made = [self.coil(number) for number in range(len(self.position))]
        share: Array = np.array([one.resistance(1.0, coils.copper_resistivity) for one in made]) / coils.resistance
        return share

    def check_wires(self, coils: Coils, spread: float) -> list[BuildCheck]:
        """Whether the wire that gives the resistances of `coils` fits in layers in each winding, and whether they are
        those that a stated share of copper makes; one check for all that are alike.

        spread: relative standard uncertainty of the resistances.
        """
        kinds: dict[tuple[float, ...], list[str]] = {}
        for size, resistance, name in zip(self._sizes, coils.resistance.tolist(), coils.names, strict=True):
            kinds.setdefault((*map(float, size), resistance), []).append(name)
        found = []
        for names in kinds.values():
            number = coils.names.index(names[0])
            coil = self.coil(number)
            copper = wire_diameter(coil, float(coils.resistance[number]), coils.copper_resistivity)
            name = f"coil {names[0]}" if len(names) == 1 else f"coils {names[0]} to {names[-1]}"
            origin = ", the wire that gives coils.resistance"
            found.append(check_wire(name, coil, copper, overall_diameter(copper), origin)[0])
            if self.copper_share is not None:
                made = coil.resistance(self.copper_share, coils.copper_resistivity)
                found.append(compare_fill(name, made, float(coils.resistance[number]), spread))
        return found

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


def place_coils(windings: PlacedCoils) -> list[PlacedSource]:
    """Every coil of `windings` where it is, in the stator frame, per ampere."""
    return [
        PlacedSource(windings.coil(number), windings.position[number], rotation_to_axis(windings.axis[number]))
        for number in range(len(windings.position))
    ]


_STEPS = 64  #: points around each rim


_ROUNDS = 100


def find_farthest(coils: PlacedCoils) -> Array:
    """(m,) distance of the farthest point of each winding from the origin [m]: on an outer rim."""
    along = (coils.position * coils.axis).sum(axis=1)
    across = np.sqrt(np.maximum((coils.position**2).sum(axis=1) - along**2, 0.0))
    far: Array = np.hypot(across + coils.outer_radius, np.abs(along) + coils.length / 2)
    return far


def find_spacing(coils: PlacedCoils) -> float:
    """Least distance between two windings [m]; 0 where they touch or overlap, infinite for a single one."""
    reach = np.hypot(coils.outer_radius, coils.length / 2)
    first, second = np.triu_indices(len(coils.position), 1)
    least_gap = np.linalg.norm(coils.position[first] - coils.position[second], axis=1) - reach[first] - reach[second]
    found = np.inf
    for row in np.argsort(least_gap, kind="stable"):
        if least_gap[row] >= found:
            break
        found = min(found, _winding_gaps_distance(coils, int(first[row]), int(second[row])))
    return float(found)


_AROUND, _ACROSS, _UP = 48, 5, 7  #: points in and on a winding


def find_overlap(coils: PlacedCoils) -> tuple[float, int, int]:
    """Least distance of two windings' bodies [m], their holes free; negative: how deep they overlap; and which two."""
    reach = np.hypot(coils.outer_radius, coils.length / 2)
    first, second = np.triu_indices(len(coils.position), 1)
    apart = np.linalg.norm(coils.position[first] - coils.position[second], axis=1) - reach[first] - reach[second]
    found, points = (np.inf, 0, 1), {}
    for row in np.argsort(apart, kind="stable").tolist():
        if apart[row] >= max(found[0], 0.0):
            break
        i, j = int(first[row]), int(second[row])
        for one, other in ((i, j), (j, i)):
            if one not in points:
                points[one] = fill_points(coils, one)
            found = min(found, (float(measure_winding(coils, other, points[one]).min()), i, j))
    return found


def fill_points(coils: PlacedCoils, number: int) -> Array:
    """(n, 3) points in and on winding `number`, a hair inside its faces, stator frame [m]."""
    angle = 2 * np.pi * np.arange(_AROUND) / _AROUND
    inner, outer = (
        float(coils.inner_radius[number]) + _FACE_TOLERANCE_M,
        float(coils.outer_radius[number]) - _FACE_TOLERANCE_M,
    )
    half = 0.5 * float(coils.length[number]) - _FACE_TOLERANCE_M
    rho, z, phi = np.meshgrid(np.linspace(inner, outer, _ACROSS), np.linspace(-half, half, _UP), angle)
    own = np.stack([rho * np.cos(phi), rho * np.sin(phi), z], axis=-1).reshape(-1, 3)
    placed: Array = own @ rotation_to_axis(coils.axis[number]).T + coils.position[number]
    return placed


def measure_winding(coils: PlacedCoils, number: int, points: Array) -> Array:
    """(n,) distance of `points` (n, 3) from winding `number` [m]; negative: inside."""
    away = points - coils.position[number]
    along = away @ coils.axis[number]
    across = np.sqrt(np.maximum((away**2).sum(axis=1) - along**2, 0.0))
    half = float(coils.length[number]) / 2
    body = AxialBody(-half, half, float(coils.inner_radius[number]), float(coils.outer_radius[number]))
    return body.measure_distance(across, along)


def _winding_gaps_distance(coils: PlacedCoils, i: int, j: int) -> float:
    gaps, starts = [], []
    for one, other in ((i, j), (j, i)):
        points = _list_rims(coils, one)
        away = np.linalg.norm(points - _project(coils, other, points), axis=1)
        nearest = int(np.argmin(away))
        gaps.append(float(away[nearest]))
        starts.append(points[nearest])
    point, best = starts[int(np.argmin(gaps))], min(gaps)
    for _ in range(_ROUNDS):
        there = _project(coils, j, point[None])
        point = _project(coils, i, there)[0]
        gap = float(np.linalg.norm(point - there[0]))
        if gap > best - 1e-9:
            return min(gap, best)
        best = gap
    return best


def _list_rims(coils: PlacedCoils, number: int) -> Array:
    """(n, 3) points on the outer rims and between them, stator frame [m]."""
    angle = 2 * np.pi * np.arange(_STEPS) / _STEPS
    radius, half = float(coils.outer_radius[number]), float(coils.length[number]) / 2
    z, phi = np.meshgrid(np.linspace(-half, half, 5), angle)
    own = np.stack([radius * np.cos(phi), radius * np.sin(phi), z], axis=-1).reshape(-1, 3)
    placed: Array = own @ rotation_to_axis(coils.axis[number]).T + coils.position[number]
    return placed


def _project(coils: PlacedCoils, number: int, points: Array) -> Array:
    """(n, 3) the point of winding `number` that is nearest to each of `points` (n, 3)."""
    axis, half = coils.axis[number], coils.length[number] / 2
    away = points - coils.position[number]
    along = away @ axis
    across = away - along[:, None] * axis
    size = np.linalg.norm(across, axis=1, keepdims=True)
    across *= np.minimum(coils.outer_radius[number] / np.maximum(size, 1e-300), 1.0)
    inside: Array = coils.position[number] + across + np.clip(along, -half, half)[:, None] * axis
    return inside
