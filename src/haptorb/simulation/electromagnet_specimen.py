"""Specimen of an electromagnet: parameters drawn from the tolerances of its file, field computed from filaments.

Windings have deviating sizes, positions and axes, and up to a turn more or less in each layer; the core is off-centre,
slightly ellipsoidal and of another permeability; the magnet has another remanence; the earth's field and, optionally, a
steel object nearby are included. Nothing is shared with the controller's model: a winding is current loops by elliptic
integrals (Smythe, Static and Dynamic Electricity, §7.10), the core's response is solid harmonics about its own centre,
the magnet is charges on its faces.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple
from zlib import crc32

import numpy as np

from haptorb.arrays import Array, gauss_legendre
from haptorb.compiled import kernel
from haptorb.devices.coil_array_wrench_map import place_charges
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.devices.placed_coils import PlacedCoils, place_coils
from haptorb.errors import GeometryError
from haptorb.magnetics.coil import InteriorCoil
from haptorb.magnetics.current_sheets import loop_field
from haptorb.magnetics.demagnetising import demagnetising_factors
from haptorb.magnetics.dipole import MU0, MU0_OVER_4PI
from haptorb.magnetics.magnets import ChargedRing, dipole_on_charges
from haptorb.magnetics.soft_sphere import (
    SoftSphere,
    add_response_wrench,
    harmonic_sums,
    response_to_source,
    weigh_charges,
)
from haptorb.magnetics.source import PlacedSource

__all__ = [
    "ElectromagnetSpecimen",
    "Steel",
    "TruthMap",
    "compute_fields",
    "draw_electromagnet",
    "fill_truth",
    "find_gauss_points",
]

_LOOPS = (2, 4)  #: of a winding, across and along, at Gauss points, for the tool's magnet …
_NEAR_LOOPS = (6, 16)  #: … and for sensors, which may be a few millimetres away
_ORDERS = (4, 16)  #: minimum and maximum degree of the core's harmonics
#: truncation: of the next degree at the nearest charges; of the total it is 1e-5, as the terms themselves decrease
_TRUNCATION = 1e-2
_FACE = {"radial": 2, "azimuth": 6}  #: charges on each face of the magnet
_TRIES = 100


@dataclass(frozen=True)
class Steel:
    """Ball of soft steel near the device: approximates any compact object of that volume."""

    place: Array  #: (3,) of its centre, stator frame [m]
    radius: float  #: [m]

    @property
    def share(self) -> float:
        """Moment per field [A·m²/T]: that of a ball of high permeability."""
        return 4 * np.pi / MU0 * self.radius**3


@dataclass(frozen=True)
class ElectromagnetSpecimen:
    """True coils, core and magnet of one specimen, with its surroundings."""

    coils: PlacedCoils | None  #: None: points, with `moments`
    moments: Array  #: (3, 3) [m²] per ampere of point coils, with the core's response
    core: SoftSphere
    core_place: Array  #: (3,) [m]
    core_axes: Array  #: (3, 3) columns: directions of the core's semi-axes
    core_stretch: Array  #: (3,) relative excess of each semi-axis over the radius
    ring: ChargedRing  #: the tool's magnet
    earth: Array  #: (3,) [T] uniform
    steel: Steel | None = None
    layers: tuple[Array, ...] = ()  #: turns of each layer of each coil, from inside, in proportion; (): even windings

    def compute_stretch(self) -> Array:
        """(3, 3) [A·m²/T] moment of the core in a uniform field minus that of a ball.

        The moment of an ellipsoid: V χ/(1 + N χ) H (Stratton, Electromagnetic Theory, §3.27). Its responses of higher
        degree are those of a ball: the relative error is `core_stretch` in these terms.
        """
        axes = self.core.radius * (1.0 + self.core_stretch)
        volume = 4 * np.pi / 3 * float(np.prod(axes))
        share = 1.0 / (demagnetising_factors(axes) + 1.0 / (self.core.permeability - 1.0))
        ball = self.core.moment_in(np.array([0.0, 0.0, 1.0]))[2]
        stretch: Array = (self.core_axes * (volume / MU0 * share - ball)) @ self.core_axes.T
        return stretch

    def compute_map(self, nearest: float) -> TruthMap:
        """Data for compiled code.

        Parameters
        ----------
        nearest : float
            Distance from the core's centre below which no charge of the tool's magnet comes [m].

        Returns
        -------
        TruthMap
            Loops, charges and responses of the core, for the functions of this module.
        """
        stretch, place = self.compute_stretch(), self.core_place
        count = 3 if self.coils is None else len(self.coils.turns)
        loops = self.list_loops(*_LOOPS)
        centres, axes = np.zeros((count, 3)), np.tile(np.array([0.0, 0.0, 1.0]), (count, 1))
        closest = self.core.radius
        if self.coils is not None:
            centres, axes = self.coils.position, self.coils.axis
            closest = max(float(self._about_core.nearest.min()), closest)
        ratio = self.core.radius**2 / (max(nearest, 1.05 * self.core.radius) * closest)
        order = int(np.clip(np.ceil(np.log(_TRUNCATION) / np.log(ratio)), *_ORDERS))
        responses = np.zeros((count, (order + 1) * (order + 2) // 2, 2))
        if self.coils is not None:
            for number, layer in self._place_layers(self.core_place):
                responses[number] += response_to_source(self.core, layer, order)
                more = -MU0_OVER_4PI / self.core.radius**2 * (stretch @ layer.field(np.zeros(3)))
                responses[number, 1, 0] -= more[2]
                responses[number, 2] += more[:2]
        earth_moment = self.core.moment_in(self.earth) + stretch @ self.earth
        made = TruthMap(
            self.ring.rows, np.ascontiguousarray(centres), np.ascontiguousarray(axes), loops, self.moments, place,
            self.core.radius, order, responses, weigh_charges(self.core, order), stretch, self.earth, earth_moment,
            np.zeros(3), 0.0, np.zeros((3, count)),
        )  # fmt: skip
        if self.steel is None:
            return made
        field = np.ascontiguousarray(compute_fields(made, self.steel.place[None])[0])
        return made._replace(steel=self.steel.place, steel_share=self.steel.share, steel_field=field)

    def list_loops(self, across: int, along: int) -> Array:
        """(m, f, 3) loops of the coils in the format of `TruthMap`; point coils have none."""
        if self.coils is None:
            return np.zeros((3, 0, 3))
        made = [self._list_loops(number, across, along) for number in range(len(self.coils.turns))]
        return np.stack([np.stack([radii, heights, MU0 * turns], axis=1) for radii, heights, turns in made])

    def _list_loops(self, number: int, across: int, along: int) -> tuple[Array, Array, Array]:
        """Radii [m], heights over the middle [m] and turns of loops of one coil.

        Turns that differ from layer to layer are at the Gauss points of their own density over the radius.
        """
        assert self.coils is not None
        coil = self.coils.coil(number)
        if not self.layers:
            return coil.filaments(across, along)
        node, weight = find_gauss_points(self.layers[number], across)
        height, share = gauss_legendre(along)
        radii = coil.inner_radius + node * (coil.outer_radius - coil.inner_radius)
        turns = 0.5 * coil.turns * np.outer(weight, share).ravel()
        return np.repeat(radii, along), np.tile(0.5 * coil.length * height, across), turns

    def compute_fields(self, truth: TruthMap, points: Array) -> Array:
        """(n, 3, m) [T/A] of coils, core and steel at `points` (n, 3) [m], which may be close to a winding."""
        return compute_fields(truth._replace(loops=self.list_loops(*_NEAR_LOOPS)), points)

    @property
    def _about_core(self) -> PlacedCoils:
        assert self.coils is not None
        return replace(self.coils, position=self.coils.position - self.core_place)

    def _place_layers(self, origin: Array) -> list[tuple[int, PlacedSource]]:
        """Every layer of every coil as a winding of its own, seen from `origin` (3,) [m], and the coil it is of."""
        assert self.coils is not None
        coils, layers = self.coils, self.layers or tuple(np.ones(1) for _ in self.coils.turns)
        owner = np.repeat(np.arange(len(layers)), [len(one) for one in layers])
        shares = np.concatenate([one / one.sum() for one in layers])
        edges = [np.linspace(0.0, 1.0, len(one) + 1) for one in layers]
        begin, end = (np.concatenate([one[part] for one in edges]) for part in (slice(None, -1), slice(1, None)))
        inner, depth = coils.inner_radius[owner], (coils.outer_radius - coils.inner_radius)[owner]
        each = PlacedCoils(
            coils.position[owner] - origin, coils.axis[owner], coils.turns[owner] * shares, inner + begin * depth,
            inner + end * depth, coils.length[owner],
        )  # fmt: skip
        placed = [
            PlacedSource(InteriorCoil(each.coil(number)), one.position, one.turn)
            for number, one in enumerate(place_coils(each))
        ]
        return list(zip(owner.tolist(), placed, strict=True))

    def compute_moments(self) -> Array:
        """(3, m) [m²] far-field moment per ampere of each coil with the core."""
        if self.coils is None:
            return self.moments
        own = np.zeros((3, len(self.coils.turns)))
        for number, layer in self._place_layers(np.zeros(3)):
            own[:, number] += layer.moment
        return own + self.compute_core_moments()

    def compute_core_moments(self) -> Array:
        """(3, m) [m²] moment of the core alone per ampere in each coil; zero for point coils, whose moments include
        it."""
        if self.coils is None:
            return np.zeros_like(self.moments)
        stretch, moments = self.compute_stretch(), np.zeros((3, len(self.coils.turns)))
        for number, layer in self._place_layers(self.core_place):
            field = layer.field(np.zeros(3))
            moments[:, number] += self.core.moment_in(field) + stretch @ field
        return moments


class TruthMap(NamedTuple):
    """An `ElectromagnetSpecimen` in the form that compiled code needs."""

    charges: Array  #: (4, n) of the tool's magnet, mover frame [m, A·m]
    centres: Array  #: (m, 3) of the coils [m]
    axes: Array  #: (m, 3)
    loops: Array  #: (m, f, 3) radius [m], height [m] and μ0 times turns [T·m/A]; f = 0: coils are points
    moments: Array  #: (3, m) [m²] of such coils, at the core's centre
    core: Array  #: (3,) its centre [m]
    radius: float  #: of the core [m]
    order: int  #: degree of the core's harmonics
    responses: Array  #: (m, k, 2) response of the core to each coil [T·m/A]
    shares: Array  #: (k,) factors of the core's response to the magnet
    stretch: Array  #: (3, 3) [A·m²/T] moment of the core minus that of a ball
    earth: Array  #: (3,) [T]
    earth_moment: Array  #: (3,) moment of the core in that field [A·m²]
    steel: Array  #: (3,) position of the steel object [m]
    steel_share: float  #: its moment per field [A·m²/T]; 0: none
    steel_field: Array  #: (3, m) [T/A] of coils and core there


@kernel
def _field_of_charges(placed: Array, x: float, y: float, z: float, out: Array) -> None:
    """out (3,) [T] at (x, y, z) of charges `placed` (7, n) in the format of `place_charges`."""
    out[:] = 0.0
    for n in range(placed.shape[1]):
        dx, dy, dz = x - placed[0, n], y - placed[1, n], z - placed[2, n]
        square = dx * dx + dy * dy + dz * dz
        q = MU0_OVER_4PI * placed[6, n] / (square * np.sqrt(square))
        out[0] += q * dx
        out[1] += q * dy
        out[2] += q * dz


@kernel
def _add_loops(t: TruthMap, placed: Array, out: Array) -> None:
    """Add to out (6, m) the wrench of the windings themselves on the charges `placed` (7, n)."""
    for j in range(t.loops.shape[0]):
        ax, ay, az = t.axes[j, 0], t.axes[j, 1], t.axes[j, 2]
        for n in range(placed.shape[1]):
            x, y, z = placed[0, n] - t.centres[j, 0], placed[1, n] - t.centres[j, 1], placed[2, n] - t.centres[j, 2]
            along = x * ax + y * ay + z * az
            x -= along * ax
            y -= along * ay
            z -= along * az
            rho = np.sqrt(x * x + y * y + z * z)
            over, axial = 0.0, 0.0
            for f in range(t.loops.shape[1]):
                a, b = loop_field(t.loops[j, f, 0], rho, along - t.loops[j, f, 1])
                over += t.loops[j, f, 2] * a
                axial += t.loops[j, f, 2] * b
            q = placed[6, n]
            bx, by, bz = q * (over * x + axial * ax), q * (over * y + axial * ay), q * (over * z + axial * az)
            rx, ry, rz = placed[3, n], placed[4, n], placed[5, n]
            out[0, j] += bx
            out[1, j] += by
            out[2, j] += bz
            out[3, j] += ry * bz - rz * by
            out[4, j] += rz * bx - rx * bz
            out[5, j] += rx * by - ry * bx


@kernel
def _add_moment(per_moment: Array, moment: Array, out: Array) -> None:
    for i in range(6):
        for k in range(3):
            out[i] += per_moment[i, k] * moment[k]


@kernel
def fill_truth(t: TruthMap, R: Array, p: Array, out: Array, passive: Array, per_moment: Array) -> None:
    """Fill out (6, m) [N/A, N·m/A], passive (6,) [N, N·m] and per_moment (6, 3) of a moment in the core.

    The tool is at R (3, 3) and p (3,) [m]; torque about p.
    """
    from_body, count = np.empty(3), out.shape[1]
    placed = np.empty((7, t.charges.shape[1]))
    place_charges(t.charges, p, R, placed)
    out[:] = 0.0
    passive[:] = 0.0
    _add_loops(t, placed, out)
    magnet, moment, field = np.zeros(3), np.empty(3), np.empty(3)
    for n in range(placed.shape[1]):
        for i in range(3):
            magnet[i] += placed[6, n] * placed[3 + i, n]
    for body in range(0 if t.steel_share > 0.0 else 1, 2):  # steel, then core; one call is compiled faster than two
        for i in range(3):
            centre = t.core[i] if body else t.steel[i]
            from_body[i] = p[i] - centre
            moment[i] = centre
        _field_of_charges(placed, moment[0], moment[1], moment[2], field)
        for i in range(3):
            if body:
                moment[i] = t.earth_moment[i]
                for k in range(3):
                    moment[i] += t.stretch[i, k] * field[k]
            else:
                moment[i] = t.steel_share * (field[i] + t.earth[i])
        dipole_on_charges(t.charges, R, from_body, per_moment)
        _add_moment(per_moment, moment, passive)
        if not body:
            for j in range(count):
                for i in range(6):
                    for k in range(3):
                        out[i, j] += t.steel_share * per_moment[i, k] * t.steel_field[k, j]
    for i in range(3):  # torque on the magnet in the earth's field
        a, b = (i + 1) % 3, (i + 2) % 3
        passive[3 + i] += magnet[a] * t.earth[b] - magnet[b] * t.earth[a]
    for n in range(placed.shape[1]):
        for i in range(3):
            placed[i, n] -= t.core[i]
    # The core's response to the magnet is that to one more coil: one call for all.
    sums, responses = np.empty(((t.order + 2) * (t.order + 3) // 2, 2)), np.empty((count + 1, t.shares.shape[0], 2))
    wrenches = np.zeros((6, count + 1))
    harmonic_sums(placed, t.radius, t.order, sums)
    for k in range(t.shares.shape[0]):
        for i in range(2):
            for j in range(count):
                responses[j, k, i] = t.responses[j, k, i]
            responses[count, k, i] = t.shares[k] * sums[k, i]
    add_response_wrench(sums, responses, t.radius, t.order, from_body, wrenches)
    for i in range(6):
        passive[i] += wrenches[i, count]
        for j in range(count):
            out[i, j] += wrenches[i, j]
    if not t.loops.shape[1]:
        for j in range(count):
            for i in range(6):
                for k in range(3):
                    out[i, j] += per_moment[i, k] * t.moments[k, j]


_UNIT = np.array([[0.0], [0.0], [0.0], [1.0]])  #: one unit charge: the force on it is the field


def compute_fields(t: TruthMap, points: Array) -> Array:
    """(n, 3, m) [T/A] of coils, core and steel at `points` (n, 3) [m] outside of them."""
    out, probe = np.empty((len(points), 3, t.loops.shape[0])), t._replace(charges=_UNIT)
    matrix, passive, per_moment, upright = np.empty((6, out.shape[2])), np.empty(6), np.empty((6, 3)), np.eye(3)
    for n, at in enumerate(np.ascontiguousarray(points)):
        fill_truth(probe, upright, at, matrix, passive, per_moment)
        out[n] = matrix[:3]
    return out


def find_gauss_points(layers: Array, count: int) -> tuple[Array, Array]:
    """Nodes (count,) from 0 to 1 and weights, of sum 1, for integrals over layers of equal depth with turns `layers`.

    Exact for polynomials of degree 2 count − 1 (Golub and Welsch, Math. Comp. 23, 1969); Gauss–Legendre for equal
    layers.

    >>> at, weight = find_gauss_points(np.array([20.0, 22.0]), 2)
    >>> bool(abs(weight @ at - (20 * 0.25 + 22 * 0.75) / 42) < 1e-12)
    True
    """
    node, share = gauss_legendre(count + 1)
    x = ((np.arange(len(layers))[:, None] + 0.5 + 0.5 * node) / len(layers)).ravel()
    w = np.outer(layers / layers.sum(), 0.5 * share).ravel()
    diagonal, beside = np.zeros(count), np.zeros(count)
    before, now, norm = np.zeros_like(x), np.ones_like(x), 1.0
    for k in range(count):  # Stieltjes' recurrence of the orthogonal polynomials
        size = float(w @ now**2)
        diagonal[k], beside[k] = float(w @ (x * now**2)) / size, size / norm if k else 0.0
        before, now, norm = now, (x - diagonal[k]) * now - beside[k] * before, size
    jacobi = np.diag(diagonal) + np.diag(np.sqrt(beside[1:]), 1) + np.diag(np.sqrt(beside[1:]), -1)
    places, vectors = np.linalg.eigh(jacobi)
    return places, vectors[0] ** 2


# --------------------------------------------------------------------------------------------------
# Drawing a specimen.


def draw_electromagnet(
    device: SphericalElectromagnet, specimen: int = 0, steel: Steel | None = None
) -> ElectromagnetSpecimen:
    """Draw specimen number `specimen` of the electromagnets within the tolerances of `device`; reproducible.

    Every value is uniform within √3 times its standard deviation of [tolerance] or [uncertainty]; moments per ampere
    that were measured deviate by [uncertainty] only, independent of the windings: an additional turn in one layer is
    balanced by the others. Without tolerances (`device.tolerance` is None) it is exactly the file's. GeometryError for
    windings that always intersect the core.
    """
    tool, known, tolerance = device.tool, device.uncertainty, device.tolerance
    size = (tool.outer_radius, tool.inner_radius, tool.length)
    core, coils, moments = device.core, None, device.moment_per_current
    layers: tuple[Array, ...] = ()
    draw = np.random.Generator(np.random.PCG64([crc32(device.digest.encode()), specimen, 0x7]))

    def spread(standard: float, *shape: int) -> Array:
        drawn: Array = standard * np.sqrt(3.0) * draw.uniform(-1.0, 1.0, shape)
        return drawn

    if tolerance is None:
        if device.windings is not None and device.has_sizes:
            coils = _scale_to_moments(device, _place_nominal(device, device.moment_per_current), core, moments)
        return ElectromagnetSpecimen(
            coils, np.array(device.far_moments), core, np.zeros(3), np.eye(3), np.zeros(3),
            ChargedRing(*size, tool.remanence, **_FACE), np.zeros(3), steel,
        )  # fmt: skip
    remanence = tool.remanence * (1.0 + float(spread(known.remanence)))
    columns = np.linalg.norm(moments, axis=0)
    measured = device.moments_from != "windings"
    radius = device.core_radius + float(spread(known.core_radius))
    place, stretch = spread(tolerance.core_position, 3), spread(tolerance.core_shape, 3)
    low, high = np.log(tolerance.core_permeability)
    core = SoftSphere(radius, float(np.exp(draw.uniform(low, high))))
    turned, earth = draw.standard_normal((3, 3)), draw.standard_normal(3)
    lean, wrong = spread(tolerance.tilt, 3, 3), spread(known.moments, 3, 3)
    axes = np.linalg.qr(turned)[0]
    if measured:
        moments = moments + columns * wrong
    else:
        moments = moments + np.cross(lean, moments.T).T
    if device.windings is not None and device.has_sizes:
        nominal = _place_nominal(device, moments)
        for _ in range(_TRIES):
            sizes, shift = spread(tolerance.winding, 3, 3), spread(tolerance.position, 3, 3)
            coils = replace(
                nominal,
                position=nominal.position + shift,
                inner_radius=nominal.inner_radius + sizes[0],
                outer_radius=np.maximum(nominal.outer_radius + sizes[1], nominal.inner_radius + sizes[0] + 1e-4),
                length=np.maximum(nominal.length + sizes[2], 1e-4),
            )
            about_core = replace(coils, position=coils.position - place)
            if (about_core.nearest > 1.001 * radius).all():
                break
        else:
            raise GeometryError(
                f"device '{device.name}': its windings do not clear the core within [tolerance]; make winding, "
                "position and core_position smaller, or windings.inner_radius greater"
            )
        more = np.zeros(3) if measured else spread(tolerance.turns, 3)
        nominal_layers = device.windings.list_layers(device.coils.resistance, device.coils.copper_resistivity)
        layers = tuple(np.maximum(one + spread(tolerance.turns_per_layer, len(one)), 0.0) for one in nominal_layers)
        counted = np.array([one.sum() for one in layers]) / nominal.turns
        coils = replace(coils, turns=nominal.turns * (counted + more))
        if measured:
            coils = _scale_to_moments(device, coils, core, moments, place, layers)
    return ElectromagnetSpecimen(
        coils, device.far_moments * (np.linalg.norm(moments, axis=0) / columns), core, place, axes,
        stretch - stretch.mean(), ChargedRing(*size, remanence, **_FACE),
        tolerance.earth_field * earth / np.linalg.norm(earth), steel, layers,
    )  # fmt: skip


def _place_nominal(device: SphericalElectromagnet, moments: Array) -> PlacedCoils:
    """Windings of `device` about the centre, each about its column of `moments` (3, 3)."""
    sizes = device.windings
    assert sizes is not None
    axes = (moments / np.linalg.norm(moments, axis=0)).T
    return PlacedCoils(
        np.zeros((3, 3)), np.ascontiguousarray(axes), np.array(sizes.turns, dtype=float), sizes.inner_radius,
        sizes.outer_radius, sizes.length,
    )  # fmt: skip


def _scale_to_moments(
    device: SphericalElectromagnet, coils: PlacedCoils, core: SoftSphere, moments: Array, place: Array | None = None,
    layers: tuple[Array, ...] = (),
) -> PlacedCoils:  # fmt: skip
    """Return `coils` with the number of turns for which the fields on their axes match `moments` (3, 3) [m²].

    Measured at the device's `moments_at` from its centre; far away, the moments themselves.
    """
    c, away, tool = np.zeros(3) if place is None else place, device.moments_at, device.tool
    ring = ChargedRing(tool.outer_radius, tool.inner_radius, tool.length, tool.remanence, **_FACE)
    made = ElectromagnetSpecimen(coils, moments, core, c, np.eye(3), np.zeros(3), ring, np.zeros(3), layers=layers)
    if np.isinf(away):
        found = (made.compute_moments() * coils.axis.T).sum(axis=0)
    else:
        fields = compute_fields(made.compute_map(device.dome_radius), away * coils.axis)
        found = np.einsum("jij,ji->j", fields, coils.axis) * away**3 / (2 * MU0_OVER_4PI)
    return replace(coils, turns=coils.turns * np.linalg.norm(moments, axis=0) / found)
