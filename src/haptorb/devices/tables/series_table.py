"""The torque table of a magnet around a coil from zonal harmonics: milliseconds where the exact wrench takes seconds.

A coil with its axis through the device's centre makes, outside the sphere that holds it, the scalar potential
Φ = Σ cₙ Pₙ(cosθ)/rⁿ⁺¹ about that centre. A magnet outside that sphere, its axis through the centre too, is a pair of
charged discs, and by the addition theorem its energy in that field is W(s) = μ0 Σ cₙ dₙ Pₙ(s), s = u·c. The torque per
ampere is then k u × c with k = −W′(s). Of one loop at r and cosα, cₙ = rⁿ⁺¹ sin²α Pₙ′(cosα)/(2 (n + 1)); of one disc of
radius a and charge density M, whose rim is at r and cosθ, dₙ = 2πM a² Pₙ₋₁′(cosθ)/(n (n − 1) rⁿ⁺¹) from n = 2 on, and
d₁ = 2πM (1 − cosθ). Source: Jackson, Classical Electrodynamics, sections 3.3, 3.6 and 4.1.
"""

from __future__ import annotations

import numpy as np

from haptorb.devices.tables.pair_table import PairTable, chord_pieces
from haptorb.errors import GeometryError
from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel
from haptorb.physics.sources.coil import Coil
from haptorb.physics.sources.cylinder import CylinderMagnet
from haptorb.physics.sources.dipole import MU0

__all__ = ["series_torque_table"]

_CELLS = 512  #: quintic pieces of the table
_ACROSS, _ALONG = 24, 12  #: filaments of a winding
_MOST = 1200  #: terms
_LEFT = 1e-9  #: share of the first term that the terms which are left out may have


def series_torque_table(magnet: CylinderMagnet, magnet_distance: float, coil: Coil, coil_distance: float) -> PairTable:
    """k [N·m/A] as `pair_table.torque_table` has it, for magnets that move outside the coils; distances [m].

    The terms fall with the ratio of coil's and magnet's rim to the power n: 200 to 400 are summed for a gap of a few
    per cent of the radius. Valid where every part of the coil is nearer to the centre than every part of the magnet, as
    in a motor that can turn; GeometryError otherwise.
    """
    discs = magnet_distance + 0.5 * magnet.length * np.array([-1.0, 1.0])
    reach = float(np.hypot(coil_distance + 0.5 * coil.length, coil.outer_radius))
    if reach >= discs[0]:
        raise GeometryError(
            f"no gap between coils and magnets: coils reach {reach * 1e3:.2f} mm from the centre, magnets begin "
            f"at {discs[0] * 1e3:.2f} mm"
        )
    rim = float(np.hypot(discs[0], magnet.radius))
    terms = int(np.clip(np.log(_LEFT * (1 - reach / rim)) / np.log(reach / rim), 24, _MOST))
    unit = np.sqrt(reach * rim)  # powers of lengths stay within the range of numbers
    radii, heights, turns = coil.filaments(_ACROSS, _ALONG)
    charge = magnet.polarization / MU0 * np.array([-1.0, 1.0])
    loops, faces, values = np.zeros(terms + 1), np.zeros(terms + 1), np.empty(terms + 1)
    _expand_loops(radii / unit, (coil_distance + heights) / unit, turns, loops)
    _expand_discs(discs / unit, magnet.radius / unit, charge, faces)
    cosines = np.cos(np.pi * (np.arange(terms + 1) + 0.5) / (terms + 1))
    _sum_slopes(-MU0 * unit * unit * loops * faces, cosines, values)
    cells, gap = chord_pieces(_chebyshev_series(values)[None], _CELLS)
    return PairTable(cells, 0.5 * _CELLS, gap + (reach / rim) ** terms)


def _chebyshev_series(values: Array) -> Array:
    from scipy.fft import dct  # a quarter of a second that only those who make tables should wait

    series: Array = dct(values, type=2) / len(values)
    series[0] *= 0.5
    return series


@kernel
def _expand_loops(radii: Array, heights: Array, turns: Array, out: Array) -> None:
    """Add cₙ of all loops per ampere to out (n,)."""
    for i in range(radii.shape[0]):
        square = radii[i] * radii[i] + heights[i] * heights[i]
        r = np.sqrt(square)
        x = heights[i] / r
        scale = 0.5 * turns[i] * radii[i] * radii[i]  # rⁿ⁺¹ sin²α at n = 1
        p0, p1, d0, d1 = 1.0, x, 0.0, 1.0  # Pₙ₋₁, Pₙ and their derivatives
        for n in range(1, out.shape[0]):
            out[n] += scale * d1 / (n + 1)
            scale *= r
            p2 = ((2 * n + 1) * x * p1 - n * p0) / (n + 1)
            p0, p1, d0, d1 = p1, p2, d1, d0 + (2 * n + 1) * p1


@kernel
def _expand_discs(heights: Array, radius: float, charge: Array, out: Array) -> None:
    """Add dₙ of the discs to out (n,)."""
    for i in range(heights.shape[0]):
        r = np.sqrt(heights[i] * heights[i] + radius * radius)
        x = heights[i] / r
        scale = 2.0 * np.pi * charge[i] * radius * radius / (r * r * r)
        out[1] += 2.0 * np.pi * charge[i] * (1.0 - x)
        p0, p1, d0, d1 = x, 1.5 * x * x - 0.5, 1.0, 3.0 * x
        for n in range(2, out.shape[0]):
            out[n] += scale * d0 / (n * (n - 1))
            scale /= r
            p2 = ((2 * n + 1) * x * p1 - n * p0) / (n + 1)
            p0, p1, d0, d1 = p1, p2, d1, d0 + (2 * n + 1) * p1


@kernel
def _sum_slopes(series: Array, cosines: Array, out: Array) -> None:
    """out (k,) = Σ series[n] Pₙ′(cosines)."""
    for i in range(cosines.shape[0]):
        x = cosines[i]
        p0, p1, d0, d1 = 1.0, x, 0.0, 1.0
        total = 0.0
        for n in range(1, series.shape[0]):
            total += series[n] * d1
            p2 = ((2 * n + 1) * x * p1 - n * p0) / (n + 1)
            p0, p1, d0, d1 = p1, p2, d1, d0 + (2 * n + 1) * p1
        out[i] = total
