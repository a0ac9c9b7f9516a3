"""Table 3's hook by quadrature, from the printed sizes alone: reference for closed forms, beams and worlds.

Nothing of `haptorb.magnetics` is used: lengths are over h₀ as printed, integrals by scipy. The ramp rises at β to H_b
and a flat top joins it to the contact (erratum E8).
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
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
    "compute_pull_stiffness",
    "hold_hook",
    "pull_bends",
    "pull_over_stored",
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


def compute_pull_stiffness(surface: float = H_B) -> float:
    """E w/(Ω₊ + μΩ₋) [N/m] of (17), with (12), (13) and `surface` [1] for H_x (erratum E9: H_b).

    >>> round(compute_pull_stiffness() / 1e3)
    247
    """
    plus = 4 * (1 + 0.3 / L_B**2 * 2.6) * L_B**3 + BENDING + SHEAR
    minus = (MINUS_1 + MINUS_2) * (2 * surface + 1) / (2 * H_B + 1)
    return float(_MODULUS * _WIDTH / (plus + FRICTION * minus))


_TABLE_SHEAR = 1.2 * 2 * 1.41  #: p E/G of Table 3's Poisson's ratio


def hold_hook(length: float, bent: float, slope: float, friction: float) -> tuple[float, float, float, float, float]:
    """F_x, F_y [1], the turn of the face [rad], how far the contact moves along, and the energy, normalised.

    An edge at `length` bends the hook by `bent` and slides up a face of `slope` [rad], `friction` signed:
    statics on a face that both forces turn, and the compliances of Timoshenko's beam, all by quadrature.
    """
    knots = [x for x in (L_B, END) if x < length] or None
    top = thickness(length)

    def over(integrand: Callable[[float, float], float]) -> float:
        return float(quad(lambda x: integrand(x, thickness(x)), 0, length, points=knots)[0])

    plus = over(lambda x, h: 12 * (length - x) ** 2 / h**3 + _TABLE_SHEAR / h)
    minus = over(lambda x, h: 12 * (length - x) * (top - h / 2) / h**3)
    along = over(lambda _, h: 12 * (top - h / 2) ** 2 / h**3 + 1 / h)
    by_push = over(lambda x, h: 12 * (length - x) / h**3) + 0.5 * _TABLE_SHEAR / top
    by_pull = over(lambda _, h: 12 * (top - h / 2) / h**3)
    turn, push, ratio = 0.0, 0.0, 0.0
    for _ in range(40):
        ratio = math.tan(slope - turn + math.atan(friction))
        push = bent / (plus + ratio * minus)
        turn = math.atan(push * (by_push + ratio * by_pull))
    energy = 0.5 * push**2 * (plus + 2 * ratio * minus + ratio**2 * along)
    return ratio * push, push, turn, push * (minus + ratio * along), energy


def pull_bends() -> float:
    """Ω₋ [1] at the contact of a beam that carries the pull's moment where it acts: what (13) has to give.

    >>> round(pull_bends())
    4425
    """
    return float(
        quad(lambda x: 12 * (L_M - x) * (thickness(L_M) - thickness(x) / 2) / thickness(x) ** 3, 0, L_M,
             points=[L_B, END])[0]
    )  # fmt: skip


def pull_over_stored(friction: float) -> float:
    """Work of a slow pull up the rear face, foot to top, over the energy that the hook then stores; `friction` signed.

    >>> round(pull_over_stored(0.0), 3)
    1.0
    """
    beta = math.radians(58.8)
    rows = [(x, *hold_hook(x, thickness(x) - 1.0, beta, friction)) for x in np.linspace(L_B, END - 1e-9, 81).tolist()]
    pulls, places = [row[1] for row in rows], [row[0] + row[4] for row in rows]
    return float(np.trapezoid(pulls, places) / rows[-1][5])
