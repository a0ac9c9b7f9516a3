"""Complete elliptic integrals of the three kinds for fields of round bodies, free of cancellation.

With Δ² = cos²φ + k' ² sin²φ and m = 1 − k'², all integrals from 0 to π/2:

    K = ∫ dφ/Δ      D = ∫ sin²φ dφ/Δ = (K − E)/m      C = ∫ sin²φ cos²φ dφ/Δ³ = ((2 − m)K − 2E)/m²

The right-hand forms lose all digits for m → 0, which is the axis of the body. The arithmetic-geometric mean gives the
same numbers as sums of positive terms: with d₁ = 1/(2(1 + k')), dₙ₊₁ = m dₙ²/(4aₙ₊₁) and S = Σ 2ⁿ dₙ² (n ≥ 1), D =
K(1 + mS)/2 and C = K S. Source: Abramowitz & Stegun 17.6 (K − E through Σ 2ⁿcₙ², here with cₙ = m dₙ); the integral
of the third kind is Bulirsch's cel (Numer. Math. 7, 78, 1965) run along the same mean. Valid for 0 < k' ≤ 1.
"""

from __future__ import annotations

import math

from haptorb.compiled import kernel

__all__ = ["integrals", "third_kind"]

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
