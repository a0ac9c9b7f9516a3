"""The torque table of a magnet around a coil from zonal harmonics: milliseconds where the exact wrench takes seconds.

A coil with its axis through the device's centre makes, outside the sphere that holds it, the scalar potential
Φ = Σ cₙ Pₙ(cosθ)/rⁿ⁺¹ about that centre. A magnet outside that sphere, its axis through the centre too, is a pair of
charged discs, and by the addition theorem its energy in that field is W(s) = μ0 Σ cₙ dₙ Pₙ(s), s = u·c. The torque per
ampere is then k u × c with k = −W′(s). Of one loop at r and cosα, cₙ = rⁿ⁺¹ sin²α Pₙ′(cosα)/(2 (n + 1)); of one disc of
radius a and charge density M, whose rim is at r and cosθ, dₙ = 2πM a² Pₙ₋₁′(cosθ)/(n (n − 1) rⁿ⁺¹) from n = 2 on, and
d₁ = 2πM (1 − cosθ). Source: Jackson, Classical Electrodynamics, sections 3.3, 3.6 and 4.1.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from haptorb.devices.tables.pair_table import PairTable, chord_pieces
from haptorb.errors import GeometryError
from haptorb.numerics.arrays import Array
from haptorb.physics.sources.coil import Coil
from haptorb.physics.sources.cylinder import CylinderMagnet
from haptorb.physics.sources.dipole import MU0

__all__ = ["series_torque", "series_torque_table"]

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
    series, left = _energy_series(magnet, magnet_distance, coil, coil_distance)
    cosines = np.cos(np.pi * (np.arange(len(series)) + 0.5) / len(series))
    cells, gap = chord_pieces(_chebyshev_series(_sum_slopes(series, cosines))[None], _CELLS)
    return PairTable(cells, 0.5 * _CELLS, gap + left)


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
    terms = int(np.clip(np.log(_LEFT * (1 - reach / rim)) / np.log(reach / rim), 24, _MOST))
    unit = np.sqrt(reach * rim)  # powers of lengths stay within the range of numbers
    radii, heights, turns = coil.filaments(_ACROSS, _ALONG)
    charge = magnet.polarization / MU0 * np.array([-1.0, 1.0])
    loops = _expand_loops(radii / unit, (coil_distance + heights) / unit, turns, terms)
    faces = _expand_discs(discs / unit, magnet.radius / unit, charge, terms)
    return -MU0 * unit * unit * loops * faces, (reach / rim) ** terms


def _sum_slopes(series: Array, cosines: Array) -> Array:
    """(k,) Σ series[n] Pₙ′(cosines)."""
    total = np.zeros_like(cosines)
    for n, slope in _slopes(cosines, len(series) - 1):
        total += series[n] * slope
    return total


def _chebyshev_series(values: Array) -> Array:
    from scipy.fft import dct  # a quarter of a second that only those who make tables should wait

    series: Array = dct(values, type=2) / len(values)
    series[0] *= 0.5
    return series


def _expand_loops(radii: Array, heights: Array, turns: Array, terms: int) -> Array:
    """(terms + 1,) cₙ of all loops per ampere."""
    r = np.hypot(radii, heights)
    scale = 0.5 * turns * radii * radii  # rⁿ⁺¹ sin²α at n = 1
    out = np.zeros(terms + 1)
    for n, slope in _slopes(heights / r, terms):
        out[n] = float(scale @ slope) / (n + 1)
        scale = scale * r
    return out


def _expand_discs(heights: Array, radius: float, charge: Array, terms: int) -> Array:
    """(terms + 1,) dₙ of the discs."""
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
