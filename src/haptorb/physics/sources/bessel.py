"""∫₀ˣ t J₁(t) dt without scipy, whose special functions take longer to load than a device file.

Sources: Abramowitz & Stegun 1964, 9.1.18 (Bessel's integral), 9.2.5 (Hankel's expansions), 11.1.7 (the integral by
Struve's functions) and 12.1.29 (their expansions).
"""

from __future__ import annotations

import numpy as np

from haptorb.numerics.arrays import Array

__all__ = ["integrate_bessel"]

_FAR = 30.0  #: from here on the expansions hold, with terms that fall below 1e-12
_NODES = 24  #: of the integral below it; its error is of the order of J₉₆(30)
_TERMS = 8


def integrate_bessel(x: Array) -> Array:
    """∫₀ˣ t J₁(t) dt = ∫₀ˣ J₀ dt − x J₀(x) for x ≥ 0, same shape, without dimension [1]; error below 1e-11.

    >>> float(integrate_bessel(np.array([1.0]))[0].round(8))
    0.15453272
    """
    x = np.asarray(x, dtype=float)
    out, near = np.empty(x.shape), x < _FAR
    s = np.sin(0.5 * np.pi * (np.arange(_NODES) + 0.5) / _NODES)
    phase = x[near][..., None] * s
    out[near] = (np.sin(phase) / s - x[near][..., None] * np.cos(phase)).mean(axis=-1)
    out[~near] = _expand(x[~near])
    return out


def _expand(x: Array) -> Array:
    """1 + (πx/2)(J₁ A₀ − J₀ A₁) with Aₙ = Hₙ − Yₙ, as J₁Y₀ − J₀Y₁ = 2/(πx)."""
    square = 1.0 / (x * x)
    a0, a1, term, other = np.ones_like(x), 1.0 + square, np.ones_like(x), square
    for k in range(1, _TERMS):
        term = -term * (2 * k - 1) ** 2 * square
        a0 = a0 + term
        other = -other * (2 * k + 1) * (2 * k - 1) * square
        a1 = a1 + other
    out: Array = 1.0 + _bessel(1, x) * a0 - x * _bessel(0, x) * a1
    return out


def _bessel(order: int, x: Array) -> Array:
    """J of that order by Hankel's expansion."""
    p, q, term = np.ones_like(x), np.zeros_like(x), np.ones_like(x)
    for k in range(1, 2 * _TERMS):
        term = term * (4 * order * order - (2 * k - 1) ** 2) / (8 * k * x)
        sign = -1.0 if k % 4 in (2, 3) else 1.0
        if k % 2:
            q = q + sign * term
        else:
            p = p + sign * term
    angle = x - (0.5 * order + 0.25) * np.pi
    out: Array = np.sqrt(2 / (np.pi * x)) * (p * np.cos(angle) - q * np.sin(angle))
    return out
