"""Tables of torque and field of one magnet with one coil or sensor over a single angle, from the exact model.

Where magnets and coils are bodies of revolution and every axis, the sensors' too, goes through the device's centre,
symmetry leaves three functions of one cosine: the torque of a magnet with axis u and a coil with axis c, per ampere,
is k(u·c) u × c on the magnet, and the magnet's field at a sensor in direction s is f(u·s) u + g(u·s) s. Each is
expanded in cosines of the angle (the exact model is asked a few hundred times, the series' tail is the error), then
laid out as quintic pieces over the chord |u − c| from 0 to 2, twice continuously differentiable, for kernels to read.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from haptorb.arrays import Array, check_finite
from haptorb.compiled import kernel, vector_kernel
from haptorb.errors import GeometryError, InputError, PrecisionError
from haptorb.magnetics.coil import Coil
from haptorb.magnetics.dipole import MU0
from haptorb.magnetics.interaction import wrench
from haptorb.magnetics.magnets import CylinderMagnet
from haptorb.magnetics.source import PlacedSource, RoundBody

__all__ = [
    "PairTable",
    "Progress",
    "chord_pieces",
    "expand_discs",
    "expand_loops",
    "field_table",
    "sensor_field",
    "sensor_field_gradient",
    "series_torque",
    "series_torque_table",
    "tabulate_slopes",
    "tabulate_values",
    "torque_characteristic",
    "torque_table",
]


Progress = Callable[[int, int], None]  #: called with (done, total) evaluations of the exact model

_FIRST, _LAST = 96, 3072  #: angles asked: first try, and the most that are tried
_MIN_CELLS, _MAX_CELLS = 256, 8192  #: cells of a table


@dataclass(frozen=True, slots=True)
class PairTable:
    """Functions of u·c as quintic pieces over the chord x = |u − c|, all pieces equally wide.

    cells   (n + 1, 6 q) coefficients of t⁰…t⁵ of q functions side by side; piece i covers x·scale from i to i + 1 and
            t = x·scale − i; the last row continues the one before, for chords a rounding error beyond 2
    scale   pieces per unit of chord
    bound   greatest error that was found, relative to each function's greatest magnitude
    """

    cells: Array
    scale: float
    bound: float

    @property
    def functions(self) -> int:
        """How many functions stand side by side: 1 (k) or 2 (f and g)."""
        return int(self.cells.shape[1]) // 6

    def values(self, cosine: Array) -> tuple[Array, Array]:
        """The functions (q, ...) and their derivatives by the cosine (q, ...), for cosines (...) in [−1, 1].

        >>> table = PairTable(np.array([[1.0, 2, 0, 0, 0, 0], [3, 2, 0, 0, 0, 0]]), 0.5, 0.0)    # 1 + x
        >>> value, slope = table.values(np.array([-1.0]))
        >>> value.tolist(), slope.tolist()
        ([[3.0]], [[-0.5]])
        """
        chord = np.sqrt(np.maximum(2 - 2 * check_finite(cosine, "cosine"), 1e-30))
        piece = np.minimum((chord * self.scale).astype(np.int64), len(self.cells) - 1)
        t = chord * self.scale - piece
        c = np.moveaxis(self.cells[piece].reshape(*piece.shape, self.functions, 6), -1, 0)
        c = np.moveaxis(c, -1, 1)
        value = c[0] + t * (c[1] + t * (c[2] + t * (c[3] + t * (c[4] + t * c[5]))))
        slope = c[1] + t * (2 * c[2] + t * (3 * c[3] + t * (4 * c[4] + t * 5 * c[5])))
        return value, -slope * self.scale / chord  # dx/d(cosine) = −1/x


def torque_table(
    magnet: RoundBody,
    magnet_distance: float,
    coil: Coil,
    coil_distance: float,
    *,
    precision: float = 1e-8,
    progress: Progress | None = None,
) -> PairTable:
    """k [N·m/A]: torque about the centre on a magnet with axis u is k(u·c) u × c for one ampere in a coil with axis c.

    The bodies' centres are `magnet_distance` and `coil_distance` [m] from the device's centre, their own z axes point
    outward. `precision` is relative to the greatest |k|. Raises PrecisionError, and GeometryError where they overlap.
    """
    at = np.array([0.0, 0.0, _distance(coil_distance, "coil_distance")])
    out = _distance(magnet_distance, "magnet_distance")
    upright = np.eye(3)

    def k(angles: Array, report: Callable[[], None]) -> Array:
        values = np.empty((1, len(angles)))
        for i, angle in enumerate(angles):
            c, s = np.cos(angle), np.sin(angle)
            turn = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
            on_coil = wrench(
                PlacedSource(magnet, out * turn[:, 2], turn),
                coil,
                at,
                upright,
                about=np.zeros(3),
                precision=0.1 * precision,
            )
            values[0, i] = on_coil.value[4] / s  # u × c = −s ŷ, and the magnet feels the opposite torque
            report()
        return values

    return _tabulate(k, precision, progress)


def field_table(
    magnet: RoundBody,
    magnet_distance: float,
    sensor_distance: float,
    *,
    precision: float = 1e-8,
    progress: Progress | None = None,
) -> PairTable:
    """f and g [T]: the field of a magnet with axis u at a sensor in direction s is f(u·s) u + g(u·s) s.

    The magnet's centre and the sensor are `magnet_distance` and `sensor_distance` [m] from the device's centre, the
    magnet's z axis points outward. `precision` is relative to the greatest |f| and |g|. Raises as `torque_table`.
    """
    out = _distance(magnet_distance, "magnet_distance")
    sensor = _distance(sensor_distance, "sensor_distance")

    def fg(angles: Array, report: Callable[[], None]) -> Array:
        c, s = np.cos(angles), np.sin(angles)
        points = np.stack([sensor * s, np.zeros_like(s), sensor * c - out], axis=1)
        if magnet.contains(points).any():
            raise GeometryError(
                f"sensors at {sensor} m from the centre pass through {magnet!r} at {out} m: move them apart"
            )
        field = magnet.field(points)
        for _ in angles:
            report()
        g = field[:, 0] / s  # B_ρ lies along (s − c u)/sinθ
        return np.array([field[:, 2] - g * c, g])

    return _tabulate(fg, precision, progress)


def _distance(value: float, what: str) -> float:
    number = check_finite(value, what)
    if number.ndim or number < 0:
        raise InputError(f"{what} must be one distance in metres, not negative; got {value!r}")
    return float(number)


def _tabulate(
    exact: Callable[[Array, Callable[[], None]], Array], precision: float, progress: Progress | None
) -> PairTable:
    if not 0 < float(check_finite(precision, "precision")) < 1:
        raise InputError(f"precision must be a relative error between 0 and 1; got {precision!r}")
    series, tail = _series(exact, precision, progress)
    cells, gap = chord_pieces(series, _MIN_CELLS)
    while gap > 0.5 * precision and len(cells) <= _MAX_CELLS:
        cells, gap = chord_pieces(series, 2 * (len(cells) - 1))
    bound = tail + gap + 0.1 * precision  # what the exact model itself may be off
    if bound > 2 * precision:
        raise PrecisionError(
            f"a table of {_MAX_CELLS} cells is precise to {bound:.1e} relative; {precision:.1e} was requested"
        )
    return PairTable(cells, 0.5 * (len(cells) - 1), float(bound))


def _series(
    exact: Callable[[Array, Callable[[], None]], Array], precision: float, progress: Progress | None
) -> tuple[Array, float]:
    """Chebyshev coefficients (q, n) in the cosine, and the size of the tail relative to the greatest value."""
    from scipy.fft import dct  # a quarter of a second that only those who make tables should wait

    count, done = _FIRST, 0
    while True:
        total = done + count

        def report(total: int = total) -> None:
            nonlocal done
            done += 1
            if progress is not None:
                progress(done, total)

        values = exact(np.pi * (np.arange(count) + 0.5) / count, report)
        series = dct(values, type=2, axis=1) / count
        series[:, 0] *= 0.5
        size = np.maximum(np.abs(values).max(axis=1), 1e-300)
        tail = float((np.abs(series[:, -count // 8 :]).max(axis=1) / size).max())
        if tail * 4 <= 0.25 * precision:  # coefficients fall geometrically: what follows is a few times the last ones
            return series, tail * 4
        if 2 * count > _LAST:
            raise PrecisionError(
                f"a table of {count} angles is precise to {4 * tail:.1e} relative; {precision:.1e} was requested: "
                "move the parts further apart, or request less"
            )
        count *= 2


def chord_pieces(series: Array, count: int) -> tuple[Array, float]:
    """(count + 1, 6 q) quintic pieces of q functions, laid out as `PairTable.cells`, and their error in between.

    series (q, n) are Chebyshev coefficients in the cosine; each piece takes value and two derivatives at its ends. The
    error is relative to each function's greatest magnitude.
    """
    step = 2.0 / count
    x = step * np.arange(count + 1)
    cosine = 1 - 0.5 * x**2
    first = chebyshev.chebder(series, axis=1)
    second = chebyshev.chebder(first, axis=1)
    value = chebyshev.chebval(cosine, series.T)
    by_cosine = chebyshev.chebval(cosine, first.T)
    y, d, dd = value, -x * by_cosine * step, (x**2 * chebyshev.chebval(cosine, second.T) - by_cosine) * step**2
    rise = y[:, 1:] - y[:, :-1]
    d0, d1, e0, e1 = d[:, :-1], d[:, 1:], dd[:, :-1], dd[:, 1:]
    pieces = np.stack(
        [
            y[:, :-1],
            d0,
            0.5 * e0,
            10 * rise - 6 * d0 - 4 * d1 - 1.5 * e0 + 0.5 * e1,
            -15 * rise + 8 * d0 + 7 * d1 + 1.5 * e0 - e1,
            6 * rise - 3 * (d0 + d1) - 0.5 * (e0 - e1),
        ],
        axis=-1,
    )
    gap = 0.0
    size = np.maximum(np.abs(value).max(axis=1), 1e-300)
    for t in (0.25, 0.5, 0.75):
        true = chebyshev.chebval(1 - 0.5 * (x[:-1] + t * step) ** 2, series.T)
        found = np.polynomial.polynomial.polyval(t, np.moveaxis(pieces, -1, 0))
        gap = max(gap, float((np.abs(found - true).max(axis=1) / size).max()))
    last = np.zeros((len(series), 1, 6))  # beyond x = 2 only rounding errors go
    last[:, 0, 0], last[:, 0, 1], last[:, 0, 2] = y[:, -1], d[:, -1], 0.5 * dd[:, -1]
    cells = np.concatenate([pieces, last], axis=1)
    return np.ascontiguousarray(np.moveaxis(cells, 0, 1).reshape(count + 1, -1)), gap


# --------------------------------------------------------------------------------------------------
# The torque table of a magnet around a coil from zonal harmonics: milliseconds where the exact wrench takes seconds.
#
# A coil with its axis through the device's centre makes, outside the sphere that holds it, the scalar potential Φ = Σ
# cₙ Pₙ(cosθ)/rⁿ⁺¹ about that centre. A magnet outside that sphere, its axis through the centre too, is a pair of
# charged discs, and by the addition theorem its energy in that field is W(s) = μ0 Σ cₙ dₙ Pₙ(s), s = u·c. The torque
# per ampere is then k u × c with k = −W′(s). Of one loop at r and cosα, cₙ = rⁿ⁺¹ sin²α Pₙ′(cosα)/(2 (n + 1)); of one
# disc of radius a and charge density M, whose rim is at r and cosθ, dₙ = 2πM a² Pₙ₋₁′(cosθ)/(n (n − 1) rⁿ⁺¹) from n = 2
# on, and d₁ = 2πM (1 − cosθ). Source: Jackson, Classical Electrodynamics, sections 3.3, 3.6 and 4.1.


_CELLS = 512  #: quintic pieces of the table
_ACROSS, _ALONG = 24, 12  #: filaments of a winding
_MAX_TERMS = 1200  #: terms
_LEFT = 1e-9  #: share of the first term that the terms which are left out may have


def series_torque_table(magnet: CylinderMagnet, magnet_distance: float, coil: Coil, coil_distance: float) -> PairTable:
    """Compute k [N·m/A] like `torque_table`, for magnets that move outside the coils; distances [m].

    The terms fall with the ratio of coil's and magnet's rim to the power n: 200 to 400 are summed for a gap of a few
    per cent of the radius. Valid where every part of the coil is nearer to the centre than every part of the magnet, as
    in a motor that can turn; GeometryError otherwise.
    """
    series, left = _energy_series(magnet, magnet_distance, coil, coil_distance)
    table = tabulate_slopes(series[None])
    return replace(table, bound=table.bound + left)


def tabulate_slopes(series: Array) -> PairTable:
    """The functions Σ series[q, n] Pₙ′(s), one for each row of `series` (q, terms + 1), of s = u·c."""
    count = series.shape[1]
    cosines = np.cos(np.pi * (np.arange(count) + 0.5) / count)
    values = np.zeros((len(series), count))
    for n, slope in _slopes(cosines, count - 1):
        values += np.outer(series[:, n], slope)
    return tabulate_values(values)


def tabulate_values(values: Array) -> PairTable:
    """Functions with `values` (q, n) at the cosines s of (i + ½) π/n."""
    cells, gap = chord_pieces(_chebyshev_series(values), _CELLS)
    return PairTable(cells, 0.5 * _CELLS, gap)


def series_torque(
    magnet: CylinderMagnet, magnet_distance: float, coil: Coil, coil_distance: float, cosines: Array
) -> Array:
    """(n,) k [N·m/A] itself at `cosines` (n,) of the angle between the axes; all else as in `series_torque_table`."""
    return _sum_slopes(_energy_series(magnet, magnet_distance, coil, coil_distance)[0], cosines)


def _energy_series(
    magnet: CylinderMagnet, magnet_distance: float, coil: Coil, coil_distance: float
) -> tuple[Array, float]:
    """(terms + 1,) −μ0 cₙ dₙ [J/A], and the share of the first term that the first one left out may have."""
    discs = magnet_distance + 0.5 * magnet.length * np.array([-1.0, 1.0])
    reach = float(np.hypot(coil_distance + 0.5 * coil.length, coil.outer_radius))
    if reach >= discs[0]:
        raise GeometryError(
            f"no gap between coils and magnets: coils reach {reach * 1e3:.2f} mm from the centre, magnets begin "
            f"at {discs[0] * 1e3:.2f} mm"
        )
    rim = float(np.hypot(discs[0], magnet.radius))
    terms = int(np.clip(np.log(_LEFT * (1 - reach / rim)) / np.log(reach / rim), 24, _MAX_TERMS))
    unit = np.sqrt(reach * rim)  # powers of lengths stay within the range of numbers
    radii, heights, turns = coil.filaments(_ACROSS, _ALONG)
    charge = magnet.polarization / MU0 * np.array([-1.0, 1.0])
    loops = expand_loops(radii / unit, (coil_distance + heights) / unit, turns, terms)
    faces = expand_discs(discs / unit, magnet.radius / unit, charge, terms)
    return -MU0 * unit * unit * loops * faces, (reach / rim) ** terms


def _sum_slopes(series: Array, cosines: Array) -> Array:
    """(k,) Σ series[n] Pₙ′(cosines)."""
    total = np.zeros_like(cosines)
    for n, slope in _slopes(cosines, len(series) - 1):
        total += series[n] * slope
    return total


def _chebyshev_series(values: Array) -> Array:
    """(…, n) coefficients in the cosine of `values` (…, n) at the cosines of (i + ½) π/n."""
    from scipy.fft import dct  # a quarter of a second that only those who make tables should wait

    series: Array = dct(values, type=2, axis=-1) / values.shape[-1]
    series[..., 0] *= 0.5
    return series


def expand_loops(radii: Array, heights: Array, turns: Array, terms: int) -> Array:
    """(terms + 1,) cₙ per ampere of all loops of `radii` and `turns` at `heights` over the device's centre, each (f,).

    Lengths in any unit [m].
    """
    r = np.hypot(radii, heights)
    scale = 0.5 * turns * radii * radii  # rⁿ⁺¹ sin²α at n = 1
    out = np.zeros(terms + 1)
    for n, slope in _slopes(heights / r, terms):
        out[n] = float(scale @ slope) / (n + 1)
        scale = scale * r
    return out


def expand_discs(heights: Array, radius: float, charge: Array, terms: int) -> Array:
    """(terms + 1,) dₙ of two discs of `radius` at `heights` (2,) over the device's centre, with `charge` (2,) per area.

    Lengths in any unit [m], the density in [A/m] of SI lengths.
    """
    r = np.hypot(heights, radius)
    scale = 2.0 * np.pi * charge * radius * radius / r**3
    out = np.zeros(terms + 1)
    out[1] = float(2.0 * np.pi * charge @ (1.0 - heights / r))
    for n, slope in _slopes(heights / r, terms - 1):
        out[n + 1] = float(scale @ slope) / (n * (n + 1))
        scale = scale / r
    return out


def _slopes(x: Array, terms: int) -> Iterator[tuple[int, Array]]:
    """n and Pₙ′(x) from n = 1 to `terms`; without compiled code, as device files are checked by it."""
    p0, p1, d0, d1 = np.ones_like(x), x, np.zeros_like(x), np.ones_like(x)
    for n in range(1, terms + 1):
        yield n, d1
        p2 = ((2 * n + 1) * x * p1 - n * p0) / (n + 1)
        p0, p1, d0, d1 = p1, p2, d1, d0 + (2 * n + 1) * p1


# --------------------------------------------------------------------------------------------------
# Torque characteristic and sensor field of a whole device from pair tables, at servo speed, with their derivatives.
#
# All kernels take many orientations R (n, 3, 3) at once and write into `out`. Axes are unit vectors: magnets (p, 3) in
# the rotor's frame, coils and sensors in the stator's; `strength` (p,) multiplies the table's magnet (−1 for one
# polarized inward). Derivatives are by a small rotation vector δ [rad] in the stator frame that turns the rotor on: R →
# exp(δ×) R. An orientation that is not finite gives NaN, never a look-up outside the table.


_NEAR = 1e-9  #: on the axis itself slope/x is 0/0: the slope vanishes there, and so does what it multiplies
Places: TypeAlias = NDArray[np.int32]


@kernel
def _turn_axes(R: Array, axes: Array, out: Array) -> None:
    """Structure of arrays: out[:, i] = R axes[i]."""
    for i in range(axes.shape[0]):
        x, y, z = axes[i, 0], axes[i, 1], axes[i, 2]
        out[0, i] = R[0, 0] * x + R[0, 1] * y + R[0, 2] * z
        out[1, i] = R[1, 0] * x + R[1, 1] * y + R[1, 2] * z
        out[2, i] = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z


@vector_kernel
def _locate_pieces(u: Array, x: float, y: float, z: float, scale: float, last: int, t: Array, piece: Places) -> None:
    """Piece and place in it for the chords from (x, y, z) to all u: a loop of its own, as it runs in SIMD so."""
    a = 2.0 * scale * scale
    bx, by, bz = a * x, a * y, a * z
    for i in range(u.shape[1]):
        chord = math.sqrt(abs(a - (u[0, i] * bx + u[1, i] * by + u[2, i] * bz)))
        where = min(max(np.int32(chord), np.int32(0)), np.int32(last))
        piece[i] = where
        t[i] = chord - where


@kernel
def torque_characteristic(
    cells: Array, scale: float, magnets: Array, strength: Array, coils: Array, R: Array, out: Array
) -> None:
    """out (n, 3, m) [N·m/A] = Σ strength k(u·c) u × c: torque on the rotor about the centre, Bai 2012 eq. (2)."""
    count, last = magnets.shape[0], cells.shape[0] - 1
    u, place, piece = np.empty((3, count)), np.empty(count), np.empty(count, np.int32)
    for n in range(R.shape[0]):
        _turn_axes(R[n], magnets, u)
        for j in range(coils.shape[0]):
            cx, cy, cz = coils[j, 0], coils[j, 1], coils[j, 2]
            _locate_pieces(u, cx, cy, cz, scale, last, place, piece)
            x, y, z = 0.0, 0.0, 0.0
            for i in range(count):
                p, t = piece[i], place[i]
                t2 = t * t
                high = cells[p, 2] + t * cells[p, 3] + t2 * (cells[p, 4] + t * cells[p, 5])
                k = strength[i] * (cells[p, 0] + t * cells[p, 1] + t2 * high)
                x += k * u[0, i]
                y += k * u[1, i]
                z += k * u[2, i]
            # Σ k (u × c) = (Σ k u) × c
            out[n, 0, j] = y * cz - z * cy
            out[n, 1, j] = z * cx - x * cz
            out[n, 2, j] = x * cy - y * cx


@kernel
def sensor_field(
    cells: Array, scale: float, magnets: Array, strength: Array, sensors: Array, R: Array, out: Array
) -> None:
    """out (n, k, 3) [T] = Σ strength [f(u·s) u + g(u·s) s]: flux density at every sensor, stator frame."""
    count, last = magnets.shape[0], cells.shape[0] - 1
    u, place, piece = np.empty((3, count)), np.empty(count), np.empty(count, np.int32)
    for n in range(R.shape[0]):
        _turn_axes(R[n], magnets, u)
        for j in range(sensors.shape[0]):
            sx, sy, sz = sensors[j, 0], sensors[j, 1], sensors[j, 2]
            _locate_pieces(u, sx, sy, sz, scale, last, place, piece)
            x, y, z, along = 0.0, 0.0, 0.0, 0.0
            for i in range(count):
                p, t = piece[i], place[i]
                t2 = t * t
                high = cells[p, 2] + t * cells[p, 3] + t2 * (cells[p, 4] + t * cells[p, 5])
                f = strength[i] * (cells[p, 0] + t * cells[p, 1] + t2 * high)
                high = cells[p, 8] + t * cells[p, 9] + t2 * (cells[p, 10] + t * cells[p, 11])
                along += strength[i] * (cells[p, 6] + t * cells[p, 7] + t2 * high)
                x += f * u[0, i]
                y += f * u[1, i]
                z += f * u[2, i]
            out[n, j, 0] = x + along * sx
            out[n, j, 1] = y + along * sy
            out[n, j, 2] = z + along * sz


@kernel
def sensor_field_gradient(
    cells: Array, scale: float, magnets: Array, strength: Array, sensors: Array, R: Array, field: Array, out: Array
) -> None:
    """field (n, k, 3) [T] as `sensor_field`, and out (n, k, 3, 3) [T/rad], [n, j, i, a] = ∂B_i/∂δ_a at sensor j.

    ∂B/∂δ = Σ strength [(f′ u + g′ s) wᵀ − f (u×)], w = u × s.
    """
    count, last = magnets.shape[0], cells.shape[0] - 1
    u, place, piece = np.empty((3, count)), np.empty(count), np.empty(count, np.int32)
    for n in range(R.shape[0]):
        _turn_axes(R[n], magnets, u)
        for j in range(sensors.shape[0]):
            sx, sy, sz = sensors[j, 0], sensors[j, 1], sensors[j, 2]
            _locate_pieces(u, sx, sy, sz, scale, last, place, piece)
            x, y, z, along = 0.0, 0.0, 0.0, 0.0
            # Σ f′ u uᵀ, from which Σ f′ u wᵀ = (Σ f′ u uᵀ) (s×)ᵀ; and Σ g′ u, from which Σ g′ w = (Σ g′ u) × s
            xx, yy, zz, xy, xz, yz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            gx, gy, gz = 0.0, 0.0, 0.0
            for i in range(count):
                ux, uy, uz, p, t = u[0, i], u[1, i], u[2, i], piece[i], place[i]
                by_cosine = -strength[i] * scale * scale / max(p + t, _NEAR)
                c1, c2, c3, c4, c5 = cells[p, 1], cells[p, 2], cells[p, 3], cells[p, 4], cells[p, 5]
                f = strength[i] * (cells[p, 0] + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * c5)))))
                df = by_cosine * (c1 + t * (2.0 * c2 + t * (3.0 * c3 + t * (4.0 * c4 + t * 5.0 * c5))))
                c1, c2, c3, c4, c5 = cells[p, 7], cells[p, 8], cells[p, 9], cells[p, 10], cells[p, 11]
                along += strength[i] * (cells[p, 6] + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * c5)))))
                dg = by_cosine * (c1 + t * (2.0 * c2 + t * (3.0 * c3 + t * (4.0 * c4 + t * 5.0 * c5))))
                x += f * ux
                y += f * uy
                z += f * uz
                gx += dg * ux
                gy += dg * uy
                gz += dg * uz
                xx += df * ux * ux
                yy += df * uy * uy
                zz += df * uz * uz
                xy += df * ux * uy
                xz += df * ux * uz
                yz += df * uy * uz
            field[n, j, 0] = x + along * sx
            field[n, j, 1] = y + along * sy
            field[n, j, 2] = z + along * sz
            wx, wy, wz = gy * sz - gz * sy, gz * sx - gx * sz, gx * sy - gy * sx
            out[n, j, 0, 0] = xy * sz - xz * sy + sx * wx
            out[n, j, 0, 1] = xz * sx - xx * sz + sx * wy + z
            out[n, j, 0, 2] = xx * sy - xy * sx + sx * wz - y
            out[n, j, 1, 0] = yy * sz - yz * sy + sy * wx - z
            out[n, j, 1, 1] = yz * sx - xy * sz + sy * wy
            out[n, j, 1, 2] = xy * sy - yy * sx + sy * wz + x
            out[n, j, 2, 0] = yz * sz - zz * sy + sz * wx + y
            out[n, j, 2, 1] = zz * sx - xz * sz + sz * wy - x
            out[n, j, 2, 2] = xz * sy - yz * sx + sz * wz
