"""Far field of a round body as a series of zonal harmonics, where closed forms cancel.

Outside a sphere around the body B = −∇Σ cₙ Pₙ(cosθ)/rⁿ⁺¹ with odd n only (the body is symmetric about its middle
plane). For a current sheet, seen as two charged discs, cₙ = ∫₀ᵃ rⁿPₙ(h/r) s ds with r² = s² + h², a polynomial that
Gauss's rule integrates exactly. From four bounding radii on, 16 terms leave less than 1e-14. Source: Jackson,
Classical Electrodynamics, sections 3.3 and 4.1. Left out: everything nearer than that; use the closed form there.
"""

from __future__ import annotations

import numpy as np

from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel

__all__ = ["FAR", "coefficients", "zonal", "zonal_gradient"]

FAR = 4.0  #: bounding radii from which the series is used
_TERMS = 16
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(_TERMS + 1)


def coefficients(radii: Array, half: float, densities: Array) -> Array:
    """(16,) cₙ for n = 1, 3, … 31 of concentric sheets (radii [m], half-length [m], μ0·current per length [T]).

    >>> c = coefficients(np.array([2.0]), 3.0, np.array([1.0]))
    >>> round(float(c[0]), 12)      # moment/(4π) over μ0: a²h/2
    6.0
    """
    squares = 0.5 * radii[:, None] ** 2 * (1 + _NODES)  # t = s², s ds = dt/2
    weights = 0.25 * densities[:, None] * radii[:, None] ** 2 * _WEIGHTS
    r2 = squares + half**2
    before, now = np.ones_like(r2), np.full_like(r2, half)
    out = np.empty(_TERMS)
    for n in range(1, 2 * _TERMS):
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
