"""Table 3's hook by quadrature, from the printed sizes alone: what closed forms, beams and worlds are compared with.

Nothing of `haptorb.magnetics` is used: lengths are over h₀ as printed, integrals by scipy. The ramp rises at β to H_b
anda flat top joins it to the contact (erratum E8).
"""

from __future__ import annotations

import math

from scipy.integrate import quad

__all__ = [
    "BENDING",
    "END",
    "FRICTION",
    "L_B",
    "L_M",
    "MINUS_1",
    "MINUS_2",
    "SHEAR",
    "bend_hook",
    "bend_hook_root",
    "compute_pull_stiffness",
    "thickness",
]

L_B, L_M, H_B, TAN = 9.0, 16.0, 3.0, math.tan(math.radians(58.8))
FRICTION = 0.134
END = L_B + H_B / TAN  #: of the ramp
_SHEAR = 1.2 * 2.6  #: p E/G
_WIDTH, _MODULUS = 8e-3, 113e9  #: w [m]; E [Pa], erratum E7


def thickness(x: float) -> float:
    """h(x)/h₀ [1] at x/h₀ [1] from the root.

    >>> thickness(0.0), thickness(16.0)
    (1.0, 4.0)
    """
    return 1.0 + min(max((x - L_B) * TAN, 0.0), H_B)


BENDING = quad(lambda x: 12 * x**2 / thickness(x) ** 3, L_B, END)[0]  #: the integrals of (12) over the ramp
SHEAR = _SHEAR * quad(lambda x: 1 / thickness(x), L_B, END)[0]
_LEVER = 6 * L_M * (thickness(L_M) - 0.5)
MINUS_1 = _LEVER * L_B  #: the two terms of (13)
MINUS_2 = _LEVER * quad(lambda x: 1 / thickness(x) ** 3, L_B, END)[0]


def bend_hook(length: float = L_M, shear: float = _SHEAR) -> float:
    """Ω₊ [1] of Timoshenko's beam loaded at `length` [1] from its root.

    >>> round(bend_hook(9.0))
    2944
    """
    knots = [x for x in (L_B, END) if x < length]
    bending = quad(lambda x: 12 * (length - x) ** 2 / thickness(x) ** 3, 0, length, points=knots or None)[0]
    return float(bending + shear * quad(lambda x: 1 / thickness(x), 0, length, points=knots or None)[0])


def bend_hook_root(shear: float = _SHEAR) -> float:
    """Turn of the hook at the contact over its deflection there, times h₀ [1]."""
    slope = quad(lambda x: 12 * (L_M - x) / thickness(x) ** 3, 0, L_M, points=[L_B, END])[0]
    return float(slope / bend_hook(shear=shear))


def compute_pull_stiffness(surface: float = H_B) -> float:
    """E w/(Ω₊ + μΩ₋) [N/m] of (17), with (12), (13) and `surface` [1] for H_x (erratum E9: H_b).

    >>> round(compute_pull_stiffness() / 1e3)
    247
    """
    plus = 4 * (1 + 0.3 / L_B**2 * 2.6) * L_B**3 + BENDING + SHEAR
    minus = (MINUS_1 + MINUS_2) * (2 * surface + 1) / (2 * H_B + 1)
    return float(_MODULUS * _WIDTH / (plus + FRICTION * minus))
