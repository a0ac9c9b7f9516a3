"""Field of round current sheets, of which cylinder, ring and winding are made, and of current loops.

Near by in closed form with elliptic integrals, far away as a series of zonal harmonics. Sources: Callaghan & Maslen,
NASA TN D-465, 1960; Derby & Olbert, Am. J. Phys. 78, 229, 2010; Jackson, Classical Electrodynamics, sections 3.3 and
4.1. Each part below states its range of validity.
"""

from __future__ import annotations

import math

import numpy as np

from haptorb.arrays import Array, gauss_legendre
from haptorb.compiled import kernel
from haptorb.magnetics.elliptic_integrals import integrals, third_kind

__all__ = [
    "SERIES_RADII",
    "coefficients",
    "loop_field",
    "sheet",
    "sheet_gradient",
    "zonal",
    "zonal_gradient",
]


# --------------------------------------------------------------------------------------------------
# Field of a thin round sheet of circulating current: the formula for cylinder, ring and winding.
#
# A uniformly and axially magnetized cylinder has the flux density of a current sheet of density M = J/μ0 on its side
# wall, inside and outside alike. With ζ = z ± h the heights over the lower and the upper edge, s² = (a + ρ)² + ζ²,
# q² = (a − ρ)² + ζ², m = 4aρ/s², k' = q/s, γ = (a − ρ)/(a + ρ), and for unit μ0 times current per length,
#
#     B_z = [(ζ/2πs)(K + γΠ)] from ζ = z − h to z + h      B_ρ = −[(4a²ρ/πs³) C]
#
# and its derivative by z is the field of the edges as current loops. These are Callaghan & Maslen (NASA TN D-465, 1960)
# and Derby & Olbert (Am. J. Phys. 78, 229, 2010), with B_ρ rewritten through C (see `integrals`) so that B_ρ/ρ and with
# it the gradient keep all their digits on the axis. Singular (logarithmically) at the edges only; on the wall between
# them B_z jumps by 1 and the mean is returned. Valid near and far, but it cancels far away: see `zonal`.


@kernel
def _edge(a: float, rho: float, zeta: float) -> tuple[float, float]:
    """B_ρ/ρ and B_z contributed by one edge at height `zeta` below the point."""
    s2 = (a + rho) * (a + rho) + zeta * zeta
    s = math.sqrt(s2)
    kc = math.sqrt(((a - rho) * (a - rho) + zeta * zeta) / s2)
    k, _, c = integrals(kc, 4.0 * a * rho / s2)
    pi = third_kind(kc, (a - rho) / (a + rho))
    return -4.0 * a * a * c / (math.pi * s2 * s), zeta * (k + pi) / (2.0 * math.pi * s)


@kernel
def sheet(a: float, h: float, rho: float, z: float) -> tuple[float, float]:
    """B_ρ/ρ [T/m] and B_z [T] of the sheet of radius `a`, half-length `h` and μ0·current per length 1 T."""
    over, b_z = _edge(a, rho, z + h)
    over_top, b_z_top = _edge(a, rho, z - h)
    return over - over_top, b_z - b_z_top


@kernel
def loop_field(a: float, rho: float, zeta: float) -> tuple[float, float]:
    """B_ρ/ρ [T/m] and B_z [T] of a current loop of radius `a`, `zeta` above it, with μ0·current 1 T·m.

    Smythe, Static and Dynamic Electricity, §7.10.
    """
    s2 = (a + rho) * (a + rho) + zeta * zeta
    q2 = (a - rho) * (a - rho) + zeta * zeta
    s = math.sqrt(s2)
    m = 4.0 * a * rho / s2
    k, d, c = integrals(math.sqrt(q2 / s2), m)
    over = 4.0 * a * a * zeta * (d - c) / (math.pi * s2 * s * q2)
    b_z = (k + (a * a - rho * rho - zeta * zeta) / q2 * (k - m * d)) / (2.0 * math.pi * s)
    return over, b_z


@kernel
def sheet_gradient(a: float, h: float, rho: float, z: float) -> tuple[float, float, float]:
    """B_ρ/ρ, ∂B_z/∂z and (1/ρ)∂B_z/∂ρ = (1/ρ)∂B_ρ/∂z of the same sheet; ∂B_ρ/∂ρ follows from div B = 0."""
    over, _ = _edge(a, rho, z + h)
    over_top, _ = _edge(a, rho, z - h)
    shear, stretch = loop_field(a, rho, z + h)
    shear_top, stretch_top = loop_field(a, rho, z - h)
    return over - over_top, stretch - stretch_top, shear - shear_top


# --------------------------------------------------------------------------------------------------
# Far field of a round body as a series of zonal harmonics, where closed forms cancel.
#
# Outside a sphere around the body B = −∇Σ cₙ Pₙ(cosθ)/rⁿ⁺¹ with odd n only (the body is symmetric about its middle
# plane). For a current sheet, seen as two charged discs, cₙ = ∫₀ᵃ rⁿPₙ(h/r) s ds with r² = s² + h², a polynomial that
# Gauss's rule integrates exactly. From four bounding radii on, 16 terms leave less than 1e-14. Source: Jackson,
# Classical Electrodynamics, sections 3.3 and 4.1. Left out: everything nearer than that; use the closed form there.


SERIES_RADII = 4.0  #: bounding radii from which the series is used
_ZONAL_TERMS = 16
_ZONAL_NODES, _WEIGHTS = gauss_legendre(_ZONAL_TERMS + 1)


def coefficients(radii: Array, half: float, densities: Array) -> Array:
    """(16,) cₙ for n = 1, 3, … 31 of concentric sheets (radii [m], half-length [m], μ0·current per length [T]).

    >>> c = coefficients(np.array([2.0]), 3.0, np.array([1.0]))
    >>> round(float(c[0]), 12)      # moment/(4π) over μ0: a²h/2
    6.0
    """
    squares = 0.5 * radii[:, None] ** 2 * (1 + _ZONAL_NODES)  # t = s², s ds = dt/2
    weights = 0.25 * densities[:, None] * radii[:, None] ** 2 * _WEIGHTS
    r2 = squares + half**2
    before, now = np.ones_like(r2), np.full_like(r2, half)
    out = np.empty(_ZONAL_TERMS)
    for n in range(1, 2 * _ZONAL_TERMS):
        if n % 2:
            out[n // 2] = np.sum(weights * now)
        before, now = now, ((2 * n + 1) * half * now - n * r2 * before) / (n + 1)
    return out


@kernel
def zonal(c: Array, rho2: float, z: float) -> tuple[float, float]:
    """B_ρ/ρ [T/m] and B_z [T] at ρ² = `rho2` and `z`."""
    inverse = 1.0 / (rho2 + z * z)
    v0, v1 = np.sqrt(inverse), z * inverse * np.sqrt(inverse)  # Pₙ/rⁿ⁺¹
    g0, g1 = 0.0, inverse * np.sqrt(inverse)  # Pₙ'/rⁿ⁺²
    over, b_z = 0.0, 0.0
    for n in range(1, 2 * len(c)):
        v2 = ((2 * n + 1) * z * v1 - n * v0) * inverse / (n + 1)
        g2 = (g0 + (2 * n + 1) * v1) * inverse
        if n % 2:
            over += c[n // 2] * g2
            b_z += c[n // 2] * (n + 1) * v2
        v0, v1, g0, g1 = v1, v2, g1, g2
    return over, b_z


@kernel
def zonal_gradient(c: Array, rho2: float, z: float) -> tuple[float, float, float]:
    """B_ρ/ρ, ∂B_z/∂z and (1/ρ)∂B_z/∂ρ [T/m, T/m, T/m²] at ρ² = `rho2` and `z`."""
    inverse = 1.0 / (rho2 + z * z)
    v0, v1 = np.sqrt(inverse), z * inverse * np.sqrt(inverse)
    g0, g1 = 0.0, inverse * np.sqrt(inverse)
    over, stretch, shear = 0.0, 0.0, 0.0
    for n in range(1, 2 * len(c) + 1):
        v2 = ((2 * n + 1) * z * v1 - n * v0) * inverse / (n + 1)
        g2 = (g0 + (2 * n + 1) * v1) * inverse
        if n % 2:
            over += c[n // 2] * g2
        else:
            j = (n - 1) // 2
            stretch -= c[j] * n * (n + 1) * v2
            shear -= c[j] * n * g2
        v0, v1, g0, g1 = v1, v2, g1, g2
    return over, stretch, shear
