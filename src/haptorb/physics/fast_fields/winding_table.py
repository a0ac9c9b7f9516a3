"""The field of a round winding as a table for a servo: cubic splines near it, a short series of harmonics far from it.

The table holds what `Coil` computes in closed form: B_ρ/ρ and B_z per ampere and turn at even steps in ρ and z, both
with their parity in ρ and z built in, within `FAR_RADII` bounding radii. A uniform cubic B-spline through the values is
smooth to the second derivative and misses a field that varies over the distance d by about 0.06 (step/d)⁴. Beyond, the
zonal series of `zonal` is cut at a term that leaves less. Both are checked against `Coil` in the tests; in the winding
itself and nearer to it than four steps the table is coarse.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel
from haptorb.physics.sources.coil import Coil

__all__ = ["FAR_RADII", "WindingTable", "table_field", "tabulate_winding"]

FAR_RADII = 2.5  #: bounding radii within which the table holds
_CELLS = 96  #: steps from the middle to the end of the table's range, along ρ and along z
_BEYOND = 8  #: steps that are tabulated beyond it, so that the spline's end conditions die out
_PRECISION = 1e-7  #: of the values in the table
_1, _2, _3, _4, _5, _6, _7 = (np.uint64(k) for k in range(1, 8))
_NEAR_TERMS, _MIDDLE_TERMS, _FAR_TERMS = 7, 4, 2  #: of the series beyond the table, and from 2.4 and 11 times as far


@kernel
def table_field(table: Array, scale: float, far2: float, series: Array, rho: float, z: float) -> tuple[float, float]:
    """B_ρ/ρ [T/m] and B_z [T] per ampere and turn at `rho` and `z` [m], of one `WindingTable`.

    table (n, n, 2): splines over z and ρ, with one coefficient before zero; scale: steps per metre [1/m]; far2: square
    of the distance up to which the table is read [m²]; series (2, 7, 8) for further away.
    """
    r2 = rho * rho + z * z
    if r2 > far2:
        terms = _NEAR_TERMS
        if r2 > 125.0 * far2:
            terms = _FAR_TERMS
        elif r2 > 6.0 * far2:
            terms = _MIDDLE_TERMS
        inverse = 1.0 / r2
        share, q = far2 * inverse, z * z * inverse
        over, axial = 0.0, 0.0
        for back in range(terms):
            k = terms - 1 - back
            first, second = series[0, k, k], series[1, k, k + 1]
            for j in range(k, 0, -1):
                first = first * q + series[0, k, j - 1]
                second = second * q + series[1, k, j]
            over = over * share + first
            axial = axial * share + second * q + series[1, k, 0]
        cube = inverse * np.sqrt(inverse)
        over *= cube * inverse * z
        axial *= cube
        return over, axial
    cells = table.reshape(-1)
    u, w = rho * scale, abs(z) * scale
    i, j = int(u), int(w)
    u -= i
    w -= j
    a, b = 1.0 - u, 1.0 - w
    u0, u3 = a * a * a / 6.0, u * u * u / 6.0
    u1, u2 = 2.0 / 3.0 - 0.5 * u * u * (1.0 + a), 2.0 / 3.0 - 0.5 * a * a * (1.0 + u)
    w0, w3 = b * b * b / 6.0, w * w * w / 6.0
    w1, w2 = 2.0 / 3.0 - 0.5 * w * w * (1.0 + b), 2.0 / 3.0 - 0.5 * b * b * (1.0 + w)
    width = 2 * table.shape[0]
    over, axial = 0.0, 0.0
    at = np.uint64(j * width + 2 * i)  # unsigned: an index that may be negative costs a test in each place
    for k in range(4):
        share = w0
        if k == 1:
            share = w1
        elif k == 2:
            share = w2
        elif k == 3:
            share = w3
        over += share * (u0 * cells[at] + u1 * cells[at + _2] + u2 * cells[at + _4] + u3 * cells[at + _6])
        axial += share * (u0 * cells[at + _1] + u1 * cells[at + _3] + u2 * cells[at + _5] + u3 * cells[at + _7])
        at += np.uint64(width)
    return (over if z >= 0.0 else -over), axial


@dataclass(frozen=True)
class WindingTable:
    """The field of one turn's ampere in a winding of a given size; multiply by the turns."""

    table: Array  #: (n, n, 2) spline coefficients over z and ρ: of B_ρ/ρ [T/m] and B_z [T]
    scale: float  #: steps per metre [1/m]
    far2: float  #: square of the distance of its range [m²]
    series: Array  #: (2, 7, 8) beyond it, of B_ρ/ρ and B_z: by degree and by power of cos²θ

    def field(self, points: Array) -> Array:
        """(n, 3) flux density per ampere and turn [T/A] at `points` (n, 3) [m] about the winding's own axis z."""
        out = np.empty((len(points), 3))
        _fill(self.table, self.scale, self.far2, self.series, np.ascontiguousarray(points), out)
        return out


@kernel
def _fill(table: Array, scale: float, far2: float, series: Array, points: Array, out: Array) -> None:
    for n in range(points.shape[0]):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        over, axial = table_field(table, scale, far2, series, np.sqrt(x * x + y * y), z)
        out[n, 0], out[n, 1], out[n, 2] = over * x, over * y, axial


@lru_cache(maxsize=64)
def tabulate_winding(inner_radius: float, outer_radius: float, length: float) -> WindingTable:
    """The table of a winding of these sizes [m]: about half a second, once for all windings alike.

    Raises InputError for sizes that make no winding.

    >>> thick = tabulate_winding(5e-3, 12e-3, 20e-3)
    >>> exact = Coil(1, 5e-3, 12e-3, 20e-3)
    >>> at = np.array([[8e-3, 0.0, 18e-3]])
    >>> bool(np.abs(thick.field(at) - exact.field(at)).max() < 1e-5 * np.abs(exact.field(at)).max())
    True
    """
    coil = Coil(1, inner_radius, outer_radius, length, precision=_PRECISION)
    reach = FAR_RADII * coil.bounding_radius
    step, count = reach / _CELLS, _CELLS + _BEYOND + 1
    even = step * np.arange(count)
    even[0] = 1e-6 * step  # B_ρ/ρ on the axis itself is the limit
    points = np.zeros((count, count, 3))
    points[..., 0], points[..., 2] = even[None, :], even[:, None]
    field = coil.field(points)
    over = field[..., 0] / even[None, :]
    over[0] = 0.0
    across = _spline_matrix(count, 1.0)
    splines = [
        _solve_both(over, _spline_matrix(count, -1.0), across),
        _solve_both(field[..., 2], across, across),
    ]
    # one coefficient before zero: the mirror image
    table = np.zeros((2, count + 1, count + 1))
    table[:, 1:, 1:] = splines
    table[:, 1:, 0] = table[:, 1:, 2]
    table[0, 0], table[1, 0] = -table[0, 2], table[1, 2]
    return WindingTable(
        np.ascontiguousarray(np.moveaxis(table, 0, 2)), 1.0 / step, reach * reach, _expand(coil.far_series, reach)
    )


def _expand(series: Array, reach: float) -> Array:
    """(2, 7, 8): B_ρ/ρ = z/r⁵ Σ_k s^k Σ_j [0, k, j] q^j and B_z = r⁻³ Σ_k s^k Σ_j [1, k, j] q^j with s = (reach/r)² and
    q = cos²θ, from the zonal `series` (16,): c_n P_{n+1}'/rⁿ⁺³ and c_n (n + 1) P_{n+1}/rⁿ⁺², n = 2k + 1."""
    out = np.zeros((2, _NEAR_TERMS, _NEAR_TERMS + 1))
    for k in range(_NEAR_TERMS):
        n = 2 * k + 1
        polynomial = np.polynomial.legendre.leg2poly(np.eye(n + 2)[n + 1])  # even: powers 0, 2 … n + 1
        slope = np.polynomial.polynomial.polyder(polynomial)  # odd: powers 1, 3 … n
        weight = series[k] / reach ** (2 * k)
        out[0, k, : k + 1] = weight * slope[1::2]
        out[1, k, : k + 2] = weight * (n + 1) * polynomial[::2]
    return out


def _spline_matrix(count: int, parity: float) -> Array:
    """Coefficients → values of a uniform cubic B-spline that is even (parity 1) or odd (−1) at its first node."""
    matrix = (np.diag(np.full(count, 4.0)) + np.diag(np.ones(count - 1), 1) + np.diag(np.ones(count - 1), -1)) / 6.0
    matrix[0, 1] *= 1.0 + parity
    matrix[-1] = 0.0  # straight at the end
    matrix[-1, -1] = 1.0
    return matrix


def _solve_both(values: Array, along: Array, across: Array) -> Array:
    half = np.linalg.solve(along, values)
    return np.asarray(np.linalg.solve(across, half.T).T, dtype=np.float64)
