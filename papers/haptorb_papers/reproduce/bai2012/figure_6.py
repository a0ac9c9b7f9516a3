"""Bai 2012, Fig. 6 and eqs. (10), (11): a hook, its softening under tension, and face friction (E22, E25, E27)."""

from __future__ import annotations

import math

import numpy as np

from haptorb.beams import TABLE_3, appendix_b, balance_face, compliance, force_ratio
from haptorb_papers.reproduce.citation import Citation
from haptorb_papers.reproduce.hook_quadrature import END, hold_hook, pull_over_stored, thickness
from haptorb_papers.reproduce.item import Item
from haptorb_papers.reproduce.registry import Report

__all__ = ["items"]

_AT = Citation("bai2012", "fig6", "Fig. 6, eqs. (10)–(11)")
_FRICTION = 0.134


def items(report: Report) -> tuple[tuple[Item, ...], None]:
    """Normalised sizes, both senses of s, the friction formulas by statics, and the work of a pull."""
    hook, mm = TABLE_3, 1e3
    soft = appendix_b(hook)
    hard = soft.plus - _FRICTION * soft.minus
    turn, chord = _turn(), math.degrees(math.atan(hook.height / hook.ramp_end))
    found = (
        _AT.note("s", "(10): stiffness while pushed in over stiffness while pulled out, s = ∓1",
                 (soft.plus + _FRICTION * soft.minus) / hard, "1",
                 "from the printed Ω₊ and corrected Ω₋; a hand that moves back and forth gains energy", erratum="E25"),
        _AT.set_and_find("dwelling", "(11) on a level top: f_x/f_y = μ", 0.134, force_ratio(0.0, _FRICTION, True), "1",
                         1e-12),
        _AT.claim("insertion", "(11): f_x/f_y = tan(γ' + arctan μ) at γ' = 30°, and by the balance of forces",
                 _statics(math.radians(30), 1.0), force_ratio(math.radians(30), _FRICTION, True), "1", 1e-12),
        _AT.claim("retention-back", "(11): tan(γ' − arctan μ) at γ' = 58.8°, sliding down the face, the same",
                 _statics(math.radians(58.8), -1.0), force_ratio(math.radians(58.8), _FRICTION, False), "1", 1e-12,
                 erratum="E22"),
        _AT.claim("retention", "(11): work of the hand over energy stored, pulled up the rear face",
                 pull_over_stored(-_FRICTION), _work(_FRICTION), "1", 2e-3,
                 "an elastic hook whose face both forces turn, by statics and quadrature", erratum="E22",
                 corrected=pull_over_stored(_FRICTION)),
        _AT.claim("retention-frictionless", "the same without friction: all is stored", 1.0, _work(0.0), "1", 1e-3,
                 "energy; the sum of 400 steps"),
        _AT.claim("slope", "(11): turn of the rear face at the end of its ramp, pulled: δ/x as printed, and the hook's",
                 chord, math.degrees(turn), "°", 0.01, "both forces turn it; by statics and quadrature", erratum="E27",
                 corrected=math.degrees(hold_hook(END - 1e-9, thickness(END) - 1.0, hook.rear, _FRICTION)[2])),
        _AT.exempt("alpha", "front angle α and tip ℓ_t", f"no value is printed; α = {math.degrees(hook.front):.0f}° "
                      f"(ℓ_t = {hook.tip * mm:.1f} mm) is assumed, and the outlet never touches that face"),
    )  # fmt: skip
    report(1.0)
    return found, None


def _statics(slope: float, uphill: float) -> float:
    """f_x/f_y where the normal force and friction μN along the face hold the part: no tangent of a sum in it."""
    along, across = math.sin(slope), math.cos(slope)
    return (along + uphill * _FRICTION * across) / (across - uphill * _FRICTION * along)


def _work(friction: float) -> float:
    """Work of a slow pull from the foot of the rear face to its top, over the energy then stored in the hook."""
    hook = TABLE_3
    x = np.linspace(hook.base_length, hook.ramp_end - 1e-12, 400)
    held = balance_face(hook, x, hook.section(x) - hook.thickness, hook.rear, friction)
    soft = compliance(hook, x[-1])
    pull, push = float(held.pull[-1]), float(held.push[-1])
    stored = 0.5 * (soft.plus * push**2 + 2 * soft.minus * push * pull + soft.along * pull**2)
    return float(np.trapezoid(held.pull, x + held.shift) / stored * hook.youngs_modulus * hook.width)


def _turn() -> float:
    """Rotation of the rear face at the end of its ramp, where the pull is at its maximum [rad]."""
    return float(balance_face(TABLE_3, TABLE_3.ramp_end - 1e-12, TABLE_3.height, TABLE_3.rear, _FRICTION).turn)
