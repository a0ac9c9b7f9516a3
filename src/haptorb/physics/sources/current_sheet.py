"""Field of a thin round sheet of circulating current: the one formula behind cylinder, ring and winding.

A uniformly and axially magnetized cylinder has the flux density of a current sheet of density M = J/μ0 on its side
wall, inside and outside alike. With ζ = z ± h the heights over the lower and the upper edge, s² = (a + ρ)² + ζ²,
q² = (a − ρ)² + ζ², m = 4aρ/s², k' = q/s, γ = (a − ρ)/(a + ρ), and for unit μ0 times current per length,

    B_z = [(ζ/2πs)(K + γΠ)] from ζ = z − h to z + h      B_ρ = −[(4a²ρ/πs³) C]

and its derivative by z is the field of the edges as current loops. These are Callaghan & Maslen (NASA TN D-465, 1960)
and Derby & Olbert (Am. J. Phys. 78, 229, 2010), with B_ρ rewritten through C (see `elliptic`) so that B_ρ/ρ and with it
the gradient keep all their digits on the axis. Singular (logarithmically) at the edges only; on the wall between
them B_z jumps by 1 and the mean is returned. Valid near and far, but it cancels far away: see `zonal`.
"""

from __future__ import annotations

import math

from haptorb.numerics.compiled import kernel
from haptorb.physics.sources.elliptic import integrals, third_kind

__all__ = ["sheet", "sheet_gradient"]


@kernel
def _edge(a: float, rho: float, zeta: float) -> tuple[float, float]:
    """B_ρ/ρ and B_z that one edge at height `zeta` below the point stands for."""
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
def _loop(a: float, rho: float, zeta: float) -> tuple[float, float]:
    """B_ρ/ρ and B_z of a current loop with μ0·current 1 T·m: Smythe, Static and Dynamic Electricity, 7.10."""
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
    shear, stretch = _loop(a, rho, z + h)
    shear_top, stretch_top = _loop(a, rho, z - h)
    return over - over_top, stretch - stretch_top, shear - shear_top
