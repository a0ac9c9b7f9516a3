"""Wrench of coils around a soft core on the tool: coils as dipoles and the magnet as a ring, or all at true size.

All return a map (6, m): force and torque about the magnet's centre per ampere, and what the core does by itself.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import NamedTuple, final

import numpy as np

from haptorb.arrays import Array
from haptorb.compiled import exact_kernel, kernel, pack, part, tick_kernel, vector_kernel
from haptorb.devices.base import Coils, rotation_to_axis
from haptorb.magnetics.coil import CentredCoil, Coil, coil_and_core
from haptorb.magnetics.core_attraction import PassivePull, pull
from haptorb.magnetics.dipole import MU0, MU0_OVER_4PI, fill_per_ampere
from haptorb.magnetics.magnets import dipole_on_charges
from haptorb.magnetics.soft_sphere import SoftSphere
from haptorb.magnetics.wire import overall_diameter, wind, wire_diameter

__all__ = [
    "Windings",
    "WoundCoils",
    "axis_frame",
    "fill_wound",
    "pack_wound_ring",
    "ring_per_ampere",
    "wound_per_ampere",
]


@kernel
def axis_frame(axis: Array, R: Array) -> None:
    """Fill R (3, 3) with the rotation that turns z to the unit vector `axis` by the shortest way."""
    x, y, z = axis[0], axis[1], axis[2]
    if z < -1.0 + 1e-12:
        R[:] = 0.0
        R[0, 0], R[1, 1], R[2, 2] = 1.0, -1.0, -1.0
        return
    k = 1.0 / (1.0 + z)
    R[0, 0], R[0, 1], R[0, 2] = 1.0 - k * x * x, -k * x * y, x
    R[1, 0], R[1, 1], R[1, 2] = -k * x * y, 1.0 - k * y * y, y
    R[2, 0], R[2, 1], R[2, 2] = -x, -y, z


@kernel
def _ring_map(rows: Array, p: Array, axis: Array, out: Array) -> None:
    R = np.empty((3, 3))
    axis_frame(axis, R)
    dipole_on_charges(rows, R, p, out)


@kernel
def _fill_ring(
    rows: Array, table: Array, nearest: float, moment_per_current: Array, p: Array, R: Array, out: Array, passive: Array
) -> None:
    axis, per_moment = np.empty(3), np.empty((6, 3))
    for i in range(3):
        axis[i] = R[i, 2]
        passive[i], passive[3 + i] = 0.0, 0.0
    _ring_map(rows, p, axis, per_moment)
    fill_per_ampere(per_moment, moment_per_current, out)
    pull(table, nearest, p, axis, passive)


@tick_kernel
def ring_per_ampere(
    rows: Array, table: Array, nearest: float, moment_per_current: Array, p: Array, R: Array, out: Array, passive: Array
) -> None:
    """Fill out (6, m) [N/A, N·m/A] and passive (6,) [N, N·m] for a ring magnet turned by R at p over a soft core.

    rows are the ring's charges, table and nearest its `PassivePull`; the magnet is round: only its axis matters.
    """
    _fill_ring(rows, table, nearest, moment_per_current, p, R, out, passive)


# --------------------------------------------------------------------------------------------------
# Coils around a soft core, from their sizes: moments per ampere before any calibration.


_ZONAL = 76  #: terms of `WoundCoils` at the most
_INVERSE = np.append(np.inf, 1.0 / np.arange(2, 2 * _ZONAL + 3))  #: 1/(n + 1) by n, from n = 0 on; n = 0 is not used
_ROUNDED = 1e-4  #: down to which the nearest place is rounded, so that an expansion serves more than once [m]
_OUTSIDE = 1.05  #: times the farthest corner of a winding: from there on harmonics converge within their terms
_LEFT_OUT = 1e-4  #: relative, of the terms that are left out where the magnet can be


class WoundCoils(NamedTuple):
    """Coils with the core's response, valid outside all windings, as kernels take them."""

    terms: Array  #: (m, k) [T·m/A] strengths of the odd zonal harmonics of each coil, lengths in units of `reach`
    reach: float  #: of the farthest winding, or the core [m]
    nearest: float  #: points nearer to a coil's centre count as being as far from it [m]
    axes: Array  #: (m, 3) unit vectors
    centres: Array  #: (m, 3) from where each coil's field comes [m]

    def with_moments(self, own: Array, moments: Array) -> WoundCoils:
        """The same coils, whose moments per ampere are `own` (3, m) [m²], turned and scaled to `moments` (3, m)."""
        sizes = np.linalg.norm(moments, axis=0)
        terms = self.terms * (sizes / np.linalg.norm(own, axis=0))[:, None]
        return self._replace(terms=terms, axes=np.ascontiguousarray((moments / sizes).T))


_LANES = 24  #: charges computed together: those of the magnet in a tick


@exact_kernel
def _add_lanes(lanes: Array, j: int, out: Array) -> None:
    """Add the first six of `lanes` to column j of out (6, m), one charge after the other."""
    a, b, c, d, e, f = out[0, j], out[1, j], out[2, j], out[3, j], out[4, j], out[5, j]
    for s in range(_LANES):
        a, b, c = a + lanes[0, s], b + lanes[1, s], c + lanes[2, s]
        d, e, f = d + lanes[3, s], e + lanes[4, s], f + lanes[5, s]
    out[0, j], out[1, j], out[2, j], out[3, j], out[4, j], out[5, j] = a, b, c, d, e, f


@vector_kernel
def fill_wound(
    rows: Array, terms: Array, reach: float, nearest: float, axes: Array, centres: Array, p: Array, R: Array, out: Array
) -> float:
    """Fill out (6, m) [N/A, N·m/A] for a magnet's charges rows (4, n) turned by R at p in the field of `WoundCoils`.

    Torque about p. Returns the least distance of a charge from the origin [m].

    The field of a coil is Σ c_n grad-type terms of P_n(cos θ)/r^(n+1) with odd n about its centre
    (`current_sheets.zonal`). Each term follows from the one before, so that a processor waits; many charges side by
    side take a quarter of the time of one after the other.
    """
    out[:] = 0.0
    closest, least = 1e300, (nearest / reach) ** 2
    lanes = np.empty((16, _LANES))
    arms = lanes[12:]
    for first in range(0, rows.shape[1], _LANES):
        for s in range(_LANES):
            n = min(first + s, rows.shape[1] - 1)
            square = 0.0
            for i in range(3):
                arms[i, s] = R[i, 0] * rows[0, n] + R[i, 1] * rows[1, n] + R[i, 2] * rows[2, n]
                square += (p[i] + arms[i, s]) * (p[i] + arms[i, s])
            closest = min(closest, square)
            arms[3, s] = rows[3, n] / reach if first + s == n else 0.0  # lanes beyond the last charge add nothing
        for j in range(axes.shape[0]):
            for s in range(_LANES):
                x = (p[0] + arms[0, s] - centres[j, 0]) / reach
                y = (p[1] + arms[1, s] - centres[j, 1]) / reach
                z = (p[2] + arms[2, s] - centres[j, 2]) / reach
                square = x * x + y * y + z * z
                grow = np.sqrt(least / max(square, 1e-30)) if square < least else 1.0
                x, y, z, square = grow * x, grow * y, grow * z, least if square < least else square
                inverse = 1.0 / square
                root = np.sqrt(inverse)
                along = x * axes[j, 0] + y * axes[j, 1] + z * axes[j, 2]
                lanes[0, s], lanes[1, s], lanes[2, s], lanes[3, s] = x, y, z, along
                lanes[4, s], lanes[5, s] = inverse, along * inverse
                lanes[6, s], lanes[7, s] = root, along * inverse * root  # Pₙ/rⁿ⁺¹
                lanes[8, s], lanes[9, s] = 0.0, inverse * root  # Pₙ'/rⁿ⁺²
                lanes[10, s], lanes[11, s] = 0.0, 0.0
            for k in range(terms.shape[1]):
                odd = 2 * k + 1
                for s in range(_LANES):
                    inverse, z = lanes[4, s], lanes[5, s]
                    v0, v1, g0, g1 = lanes[6, s], lanes[7, s], lanes[8, s], lanes[9, s]
                    v2 = ((2 * odd + 1) * z * v1 - odd * inverse * v0) * _INVERSE[odd]
                    g2 = (g0 + (2 * odd + 1) * v1) * inverse
                    lanes[10, s] += terms[j, k] * g2
                    lanes[11, s] += terms[j, k] * (odd + 1) * v2
                    lanes[6, s], lanes[8, s] = v2, g2
                    lanes[7, s] = ((2 * odd + 3) * z * v2 - (odd + 1) * inverse * v1) * _INVERSE[odd + 1]
                    lanes[9, s] = (g1 + (2 * odd + 3) * v2) * inverse
            for s in range(_LANES):
                q, over = arms[3, s], lanes[10, s]
                straight = q * (lanes[11, s] - over * lanes[3, s])
                bx = q * over * lanes[0, s] + straight * axes[j, 0]
                by = q * over * lanes[1, s] + straight * axes[j, 1]
                bz = q * over * lanes[2, s] + straight * axes[j, 2]
                tx = arms[1, s] * bz - arms[2, s] * by
                ty = arms[2, s] * bx - arms[0, s] * bz
                tz = arms[0, s] * by - arms[1, s] * bx
                lanes[0, s], lanes[1, s], lanes[2, s] = bx, by, bz
                lanes[3, s], lanes[4, s], lanes[5, s] = tx, ty, tz
            _add_lanes(lanes, j, out)
    return float(np.sqrt(closest))


def pack_wound_ring(rows: Array, pulls: PassivePull, coils: WoundCoils) -> Array:
    """(n,) packed: a ring magnet's charges rows (4, k) [m], [A·m], the core's attraction and the coils, each in its own
    unit."""
    sizes = (pulls.nearest, coils.reach, coils.nearest)
    return pack(rows, pulls.table, sizes, coils.terms, coils.axes, coils.centres)


@kernel
def _fill_wound_ring(packed: Array, p: Array, R: Array, out: Array, passive: Array) -> None:
    axis, turned = np.empty(3), np.empty((3, 3))
    for i in range(3):
        axis[i] = R[i, 2]
        passive[i], passive[3 + i] = 0.0, 0.0
    axis_frame(axis, turned)
    sizes = part(packed, 2)[0]
    fill_wound(
        part(packed, 0), part(packed, 3), sizes[1], sizes[2], part(packed, 4), part(packed, 5), p, turned, out
    )  # fmt: skip
    for k in range(out.shape[1]):  # none about the axis of what is round: that of a dozen charges on a face is 1e-6
        about = out[3, k] * axis[0] + out[4, k] * axis[1] + out[5, k] * axis[2]
        for i in range(3):
            out[3 + i, k] -= about * axis[i]
    pull(part(packed, 1), sizes[0], p, axis, passive)


@tick_kernel
def wound_per_ampere(packed: Array, p: Array, R: Array, out: Array, passive: Array) -> None:
    """Fill out (6, m) [N/A, N·m/A] and passive (6,) [N, N·m] for a ring magnet turned by R at p over wound coils.

    packed is that of `pack_wound_ring`; the magnet is round: only its axis matters.
    """
    _fill_wound_ring(packed, p, R, out, passive)


@lru_cache(maxsize=64)
def _centre(turns: float, inner: float, outer: float, length: float, core: SoftSphere, nearest: float) -> CentredCoil:
    """The expansion of a coil: a calibration asks for the same one a hundred times."""
    return CentredCoil(Coil(turns, inner, outer, length), core, nearest)


@final
@dataclass(frozen=True)
class Windings:
    """Round coils about the core's centre, the first about x, the second about y, the third about z."""

    turns: Array  #: (3,)
    inner_radius: Array  #: (3,) [m]
    outer_radius: Array  #: (3,) [m]
    length: Array  #: (3,) along each coil's own axis [m]
    wire: Array | None = None  #: (3,) diameter of the copper [m]; None: that which gives the coils' resistance
    wire_overall: Array | None = None  #: (3,) diameter over the enamel [m]; None: grade 1 of the standard
    copper_share: float | None = None  #: of the section, if the file states that instead of the wire [1]

    @cached_property
    def coils(self) -> tuple[Coil, ...]:
        """Each coil, its axis along its own +z."""
        sizes = zip(self.turns, self.inner_radius, self.outer_radius, self.length, strict=True)
        return tuple(Coil(*map(float, size)) for size in sizes)

    def parts(self, core: SoftSphere) -> Array:
        """(3, 2) [m²] moment per ampere along its own axis: of the winding itself, and of the core that it magnetises.

        N π (rₒ² + rₒrᵢ + rᵢ²)/3, and 4π/μ0 a³ (µ−1)/(µ+2) B(0), where a and µ are the core's and B(0) the winding's own
        field at the centre: the response of a sphere to any field has the moment that its value at the centre gives
        (`SoftSphere.moment_in`; Jackson, Classical Electrodynamics, §5.11). With half the length h,

            B(0) = μ0 N/(2 (rₒ − rᵢ)) ln[(rₒ + √(rₒ² + h²))/(rᵢ + √(rᵢ² + h²))]

        (Montgomery, Solenoid Magnet Design, §1). Exact for windings that fill their section evenly and a core that does
        not saturate.
        """
        ri, ro, h = self.inner_radius, self.outer_radius, self.length / 2
        middle = MU0 * self.turns / (2 * (ro - ri)) * np.log((ro + np.hypot(ro, h)) / (ri + np.hypot(ri, h)))
        fields = np.stack([np.zeros(3), np.zeros(3), middle], axis=1)
        own = [coil.moment[2] for coil in self.coils]
        return np.stack([own, core.moment_in(fields)[:, 2]], axis=1)

    def response_shift(self, core: SoftSphere) -> Array:
        """(3, 3, 3) by which vector the middle of the core's response to each winding moves, beside the core itself,
        per vector of the core's centre from the winding's.

        Off the winding's middle the core is in a field gradient, and responds with a second harmonic, which is that of
        a dipole elsewhere: with the winding's own field b₁ + 3 b₃ z² on its axis, 3/2 (β₂/β₁) a² b₃/b₁ of the way along
        the axis and −2/3 of that across it (`SoftSphere`).
        """
        first, second = core.response(2)
        eye, found = np.eye(3), np.empty((3, 3, 3))
        for number, coil in enumerate(self.coils):
            radii, heights, turns = coil.filaments(8, 8)
            s = radii**2 + heights**2
            weights = turns * radii**2
            curved = weights @ (15 * heights**2 * s**-3.5 - 3 * s**-2.5) / 6
            along = 1.5 * second / first * core.radius**2 * curved / (weights @ s**-1.5)
            own = np.outer(eye[number], eye[number])
            found[number] = along * own - 2 / 3 * along * (eye - own)
        return found

    def moment_per_current(self, core: SoftSphere, measured_at: float = np.inf) -> Array:
        """(3, 3) [m²] m_e per ampere; diagonal, as the coils are taken to stand square on each other.

        That of the dipole with the same field on the coil's axis at the distance `measured_at` [m]. Left out:
        saturation, leads, and the core's response to the tool (`PassivePull`).
        """
        return np.diag(self._measure(core, measured_at))

    def wound(
        self, core: SoftSphere, per_ampere: Array, measured_at: float, nearest: float, closest: float,
        centres: Array | None = None,
    ) -> WoundCoils:  # fmt: skip
        """The coils and their core, for points outside `nearest` [m], which must lie outside them all.

        per_ampere (3, m) [m²]: the coils' axes, and the moment of the dipole that has the coil's field on its axis at
        the distance `measured_at` [m] from its centre; inf: far away. Terms that do not matter from `closest` [m] on
        are left out. centres (m, 3) [m]: from where each coil's field comes; None: all from the origin.
        """
        moments = np.linalg.norm(per_ampere, axis=0)
        made = [CentredCoil(coil, core, nearest) for coil in self.coils]
        reach = max(float(self.corners.max()), core.radius)
        terms = np.stack([one.terms(reach, _ZONAL) for one in made])
        terms *= (moments / self._measure(core, measured_at))[:, None]
        used = np.abs(terms * (reach / closest) ** (2 * np.arange(_ZONAL))).max(axis=0)
        kept = int(np.flatnonzero(used > _LEFT_OUT * used[0])[-1]) + 1
        axes = np.ascontiguousarray((per_ampere / moments).T)
        middle = np.zeros_like(axes) if centres is None else np.array(centres, dtype=np.float64)
        return WoundCoils(np.ascontiguousarray(terms[:, :kept]), reach, nearest, axes, middle)

    def _measure(self, core: SoftSphere, distance: float) -> Array:
        """(3,) [m²] moment per ampere of the dipole that has each coil's field on its axis at `distance` [m]."""
        far: Array = self.parts(core).sum(axis=1)
        if np.isinf(distance):
            return far
        place = np.array([[0.0, 0.0, distance]])
        axial = [one[0, 2] for one in self._fields(core, [place] * len(self.coils))]
        return np.array(axial) * distance**3 / (2 * MU0_OVER_4PI)

    def _fields(self, core: SoftSphere, places: list[Array], *, closed: bool = False) -> list[Array]:
        """(n, 3) [T/A] of each coil with the core at its `places` (n, 3) [m], in the coil's own frame.

        By harmonics where all places are outside the coils, else, or if `closed`, by the windings' closed form.
        """
        nearest = min(float(np.linalg.norm(at, axis=1).min()) for at in places)
        if closed or nearest < _OUTSIDE * max(float(self.corners.max()), core.radius):
            return [coil_and_core(coil, core, at) for coil, at in zip(self.coils, places, strict=True)]
        rounded = float(np.floor(nearest / _ROUNDED) * _ROUNDED)
        sizes = [(one.turns, one.inner_radius, one.outer_radius, one.length) for one in self.coils]
        return [_centre(*size, core, rounded).field(at) for size, at in zip(sizes, places, strict=True)]

    def field(
        self, core: SoftSphere, per_ampere: Array, measured_at: float, points: Array, *, closed: bool = False,
        centres: Array | None = None,
    ) -> Array:  # fmt: skip
        """(n, 3, m) [T/A] at `points` (n, 3) [m] outside the core; `per_ampere`, `measured_at` and `centres` as in
        `wound`. closed: by the windings' closed form, wherever the points are.
        """
        moments = np.linalg.norm(per_ampere, axis=0)
        scale = moments / self._measure(core, measured_at)
        turns = [rotation_to_axis(axis) for axis in (per_ampere / moments).T]
        middle = np.zeros((len(turns), 3)) if centres is None else centres
        made = self._fields(core, [(points - c) @ turn for turn, c in zip(turns, middle, strict=True)], closed=closed)
        return np.stack([size * one @ turn.T for size, one, turn in zip(scale, made, turns, strict=True)], axis=2)

    def far_moments(self, core: SoftSphere, per_ampere: Array, measured_at: float) -> Array:
        """(3, m) [m²] moments per ampere as they are seen from far away; the other two as in `wound`."""
        far: Array = per_ampere * (self.parts(core).sum(axis=1) / self._measure(core, measured_at))
        return far

    def inductance(self, core: SoftSphere) -> Array:
        """(3,) [H] of each winding with the core.

        The winding's own, and what the core's moment m adds to its flux: m·B(0) per ampere squared, by reciprocity.
        Left out: the core's higher harmonics, some per cent of the second part.
        """
        own = np.array([coil.inductance for coil in self.coils])
        moments = self.parts(core)[:, 1]
        per_field = core.moment_in(np.array([0.0, 0.0, 1.0]))[2]  # A·m² per tesla
        whole: Array = own + moments**2 / per_field
        return whole

    def complete(self, coils: Coils, core: SoftSphere, fill: float | None) -> Coils:
        """`coils` with what they lack (NaN) of resistance, inductance and heat capacity: those of these windings.

        Copper fills the share `fill` of the section; without it, copper is the `wire`.
        The heat capacity is the mean of the three, as a device has one for all its channels. ValueError for a wire that
        does not fit between the flanges.
        """
        resistivity = coils.copper_resistivity
        if fill is not None:
            resistance = np.array([coil.resistance(fill, resistivity) for coil in self.coils])
            capacity = np.array([coil.heat_capacity(fill) for coil in self.coils])
        else:
            wires = self.wires(coils.resistance, resistivity).tolist()
            layers = [wind(one.turns, one.inner_radius, one.length, thick) for one, (_, thick) in
                      zip(self.coils, wires, strict=True)]  # fmt: skip
            known = [(rows, copper) for rows, (copper, _) in zip(layers, wires, strict=True) if rows is not None]
            if len(known) < len(layers):
                raise ValueError("windings.length is too short for one turn of windings.wire")
            resistance = np.array([rows.resistance(copper, resistivity) for rows, copper in known])
            capacity = np.array([rows.heat_capacity(copper) for rows, copper in known])
        keep = np.isfinite([coils.resistance[0], coils.inductance[0], coils.heat.winding_capacity])
        mean = float(capacity.mean())
        return replace(
            coils,
            resistance=coils.resistance if keep[0] else resistance,
            inductance=coils.inductance if keep[1] else self.inductance(core),
            heat=coils.heat if keep[2] else replace(coils.heat, winding_capacity=mean),
        )

    def list_layers(self, resistance: Array, resistivity: float) -> tuple[Array, ...]:
        """Turns of each layer of each coil, from inside; one layer where the wire does not fit between the flanges.

        resistance (3,) [Ω] and `resistivity` [Ω·m] tell the wire where the file does not.
        """
        found = []
        for coil, (_, thick) in zip(self.coils, self.wires(resistance, resistivity).tolist(), strict=True):
            made = wind(coil.turns, coil.inner_radius, coil.length, thick)
            found.append(np.array([coil.turns]) if made is None else made.count_turns(coil.turns))
        return tuple(found)

    def wires(self, resistance: Array, resistivity: float) -> Array:
        """(3, 2) [m] each coil's wire, its copper and over its enamel; where the wire is not known, that with which the
        coil has `resistance` (3,) [Ω]."""
        copper = self.wire
        if copper is None:
            known = zip(self.coils, resistance, strict=True)
            copper = np.array([wire_diameter(coil, float(one), resistivity) for coil, one in known])
        overall = self.wire_overall
        if overall is None:
            overall = np.array([overall_diameter(float(one)) for one in copper])
        return np.stack([copper, overall], axis=1)

    @property
    def corners(self) -> Array:
        """(3,) distance of each winding's farthest points from the centre [m]."""
        return np.hypot(self.outer_radius, self.length / 2)

    def fill(self, resistance: Array, resistivity: float) -> Array:
        """(3,) share of each winding's section that conductor of `resistivity` [Ω·m] must fill for `resistance` [Ω].

        Round wire fills at most π/√12 = 0.907; more than that cannot be wound.
        """
        least = np.array([coil.resistance(1.0, resistivity) for coil in self.coils])
        share: Array = least / resistance
        return share
