"""Closed forms and series of round bodies: elliptic integrals, ∫J₁, current sheets and zonal harmonics.

Sources: Abramowitz & Stegun 1964, 9.1.18, 9.2.5, 11.1.7, 12.1.29 and 17.6; Bulirsch, Numer. Math. 7, 78, 1965;
Jackson, Classical Electrodynamics, sections 3.3 and 4.1; Callaghan & Maslen, NASA TN D-465, 1960; Derby & Olbert,
Am. J. Phys. 78, 229, 2010. Each part below states which and its range of validity.
"""

from __future__ import annotations

import math

import numpy as np

from haptorb.arrays import Array
from haptorb.compiled import kernel

__all__ = [
    "FAR",
    "coefficients",
    "integrals",
    "integrate_bessel",
    "loop_field",
    "sheet",
    "sheet_gradient",
    "third_kind",
    "zonal",
    "zonal_gradient",
]


# --------------------------------------------------------------------------------------------------
# Three complete elliptic integrals for fields of round bodies, free of cancellation.
#
# With Δ² = cos²φ + k' ² sin²φ and m = 1 − k'², all integrals from 0 to π/2:
#
#     K = ∫ dφ/Δ      D = ∫ sin²φ dφ/Δ = (K − E)/m      C = ∫ sin²φ cos²φ dφ/Δ³ = ((2 − m)K − 2E)/m²
#
# The right-hand forms lose all digits for m → 0, which is the axis of the body. The arithmetic-geometric mean gives the
# same numbers as sums of positive terms: with d₁ = 1/(2(1 + k')), dₙ₊₁ = m dₙ²/(4aₙ₊₁) and S = Σ 2ⁿ dₙ² (n ≥ 1), D =
# K(1 + mS)/2 and C = K S. Source: Abramowitz & Stegun 17.6 (K − E through Σ 2ⁿcₙ², here with cₙ = m dₙ); the integral
# of the third kind is Bulirsch's cel (Numer. Math. 7, 78, 1965) run along the same mean. Valid for 0 < k' ≤ 1.


_CONVERGENCE = 2e-8  #: convergence: the relative difference of the mean's two sides is squared in one more step


@kernel
def integrals(kc: float, m: float) -> tuple[float, float, float]:
    """K, D and C for the complementary modulus kc = k' and m = 1 − kc² (given, as 1 − kc² would cancel)."""
    a = 0.5 * (1.0 + kc)
    g = math.sqrt(kc)
    d = 0.5 / (1.0 + kc)
    weight = 2.0
    total = weight * d * d
    while a - g > _CONVERGENCE * a:
        mean = 0.5 * (a + g)
        g = math.sqrt(a * g)
        a = mean
        d = m * d * d / (4.0 * a)
        weight += weight
        total += weight * d * d
    a = 0.5 * (a + g)
    k = 0.5 * math.pi / a
    return k, 0.5 * k * (1.0 + m * total), k * total


@kernel
def third_kind(kc: float, gamma: float) -> float:
    """γ ∫ dφ / ((cos²φ + γ² sin²φ) Δ): odd in γ, ±π/(2k') at γ → ±0 and, by choice, 0 (the mean) at γ = 0."""
    if gamma == 0.0:
        return 0.0
    p = abs(gamma)
    a = p
    b = 1.0
    em = 1.0
    e = kc
    while True:
        f = a
        a += b / p
        g = e / p
        b += f * g
        b += b
        p += g
        last = em
        em += kc
        if abs(last - kc) <= _CONVERGENCE * last:
            break
        kc = 2.0 * math.sqrt(e)
        e = kc * em
    whole = 0.5 * math.pi * (b + a * em) / (em * (em + p))
    return whole if gamma > 0.0 else -whole


# --------------------------------------------------------------------------------------------------
# ∫₀ˣ t J₁(t) dt without scipy, whose special functions take longer to import than a device file.
#
# Sources: Abramowitz & Stegun 1964, 9.1.18 (Bessel's integral), 9.2.5 (Hankel's expansions), 11.1.7 (the integral by
# Struve's functions) and 12.1.29 (their expansions).


_MIN_EXPANSION_ARGUMENT = 30.0  #: argument from which the expansions are used, with terms that fall below 1e-12
_BESSEL_NODES = 24  #: of the integral below it; its error is of the order of J₉₆(30)
_BESSEL_TERMS = 8


def integrate_bessel(x: Array) -> Array:
    """∫₀ˣ t J₁(t) dt = ∫₀ˣ J₀ dt − x J₀(x) for x ≥ 0, same shape, without dimension [1]; error below 1e-11.

    >>> float(integrate_bessel(np.array([1.0]))[0].round(8))
    0.15453272
    """
    x = np.asarray(x, dtype=float)
    out, near = np.empty(x.shape), x < _MIN_EXPANSION_ARGUMENT
    s = np.sin(0.5 * np.pi * (np.arange(_BESSEL_NODES) + 0.5) / _BESSEL_NODES)
    phase = x[near][..., None] * s
    out[near] = (np.sin(phase) / s - x[near][..., None] * np.cos(phase)).mean(axis=-1)
    out[~near] = _expand(x[~near])
    return out


def _expand(x: Array) -> Array:
    """1 + (πx/2)(J₁ A₀ − J₀ A₁) with Aₙ = Hₙ − Yₙ, as J₁Y₀ − J₀Y₁ = 2/(πx)."""
    square = 1.0 / (x * x)
    a0, a1, term, other = np.ones_like(x), 1.0 + square, np.ones_like(x), square
    for k in range(1, _BESSEL_TERMS):
        term = -term * (2 * k - 1) ** 2 * square
        a0 = a0 + term
        other = -other * (2 * k + 1) * (2 * k - 1) * square
        a1 = a1 + other
    out: Array = 1.0 + _bessel(1, x) * a0 - x * _bessel(0, x) * a1
    return out


def _bessel(order: int, x: Array) -> Array:
    """J of that order by Hankel's expansion."""
    p, q, term = np.ones_like(x), np.zeros_like(x), np.ones_like(x)
    for k in range(1, 2 * _BESSEL_TERMS):
        term = term * (4 * order * order - (2 * k - 1) ** 2) / (8 * k * x)
        sign = -1.0 if k % 4 in (2, 3) else 1.0
        if k % 2:
            q = q + sign * term
        else:
            p = p + sign * term
    angle = x - (0.5 * order + 0.25) * np.pi
    out: Array = np.sqrt(2 / (np.pi * x)) * (p * np.cos(angle) - q * np.sin(angle))
    return out


# --------------------------------------------------------------------------------------------------
# Far field of a round body as a series of zonal harmonics, where closed forms cancel.
#
# Outside a sphere around the body B = −∇Σ cₙ Pₙ(cosθ)/rⁿ⁺¹ with odd n only (the body is symmetric about its middle
# plane). For a current sheet, seen as two charged discs, cₙ = ∫₀ᵃ rⁿPₙ(h/r) s ds with r² = s² + h², a polynomial that
# Gauss's rule integrates exactly. From four bounding radii on, 16 terms leave less than 1e-14. Source: Jackson,
# Classical Electrodynamics, sections 3.3 and 4.1. Left out: everything nearer than that; use the closed form there.


FAR = 4.0  #: bounding radii from which the series is used
_ZONAL_TERMS = 16
_ZONAL_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(_ZONAL_TERMS + 1)


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
