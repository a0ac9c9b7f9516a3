"""Bai 2012, Fig. 6 and eqs. (10), (11): a hook, how pulling softens it, and friction on its faces (errata E22, E25)."""

from __future__ import annotations

import math

from scipy.integrate import quad

from haptorb.beams import TABLE_3, appendix_b, compliance, compute_bent_shape, force_ratio
from haptorb_papers.reproduce.citation import Citation
from haptorb_papers.reproduce.hook_quadrature import BENDING, END, L_B, L_M, MINUS_1, MINUS_2, SHEAR, bend_hook_root
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
    chord, slope = _slopes()
    found = (
        _AT.note("s", "(10): stiffness while pushed in over stiffness while pulled out, s = ∓1",
                 (soft.plus + _FRICTION * soft.minus) / hard, "1",
                 "from the printed Ω₊ and corrected Ω₋; a hand that moves back and forth gains energy", erratum="E25"),
        _AT.claim("dwelling", "(11) on a level top: f_x/f_y = μ", 0.134, force_ratio(0.0, _FRICTION, True), "1", 1e-12),
        _AT.claim("insertion", "(11): f_x/f_y = tan(γ' + arctan μ) at γ' = 30°, and by the balance of forces",
                 _statics(math.radians(30), 1.0), force_ratio(math.radians(30), _FRICTION, True), "1", 1e-12),
        _AT.claim("retention-back", "(11): tan(γ' − arctan μ) at γ' = 58.8°, sliding down the face, the same",
                 _statics(math.radians(58.8), -1.0), force_ratio(math.radians(58.8), _FRICTION, False), "1", 1e-12,
                 erratum="E22"),
        _AT.claim("retention", "(11): work of the hand over energy stored, pulled up the rear face",
                 _work(loading=False), _work(loading=True), "1", 1e-3,
                 "stored energy and the work of friction along the face, by statics", erratum="E22",
                 corrected=1.0 + _lose_to_friction()),
        _AT.claim("retention-frictionless", "the same without friction: all is stored", 1.0, _work(True, 0.0), "1",
                 1e-6,
                 "quadrature"),
        _AT.claim("slope", "(11): turn of the face at the peak per deflection: δ/x as printed, and the beam's slope",
                 chord, slope, "rad/m", 0.05, "difference of the bent shape, against a quadrature", erratum="E27",
                 corrected=bend_hook_root(shear=1.2 * 2 * 1.41) / hook.thickness),
        _AT.exempt("alpha", "front angle α and tip ℓ_t", f"no value is printed; α = {math.degrees(hook.front):.0f}° "
                      f"(ℓ_t = {hook.tip * mm:.1f} mm) is assumed, and the outlet never touches that face"),
    )  # fmt: skip
    report(1.0)
    return found, None


def _statics(slope: float, uphill: float) -> float:
    """f_x/f_y where the normal force and friction μN along the face hold the part: no tangent of a sum in it."""
    along, across = math.sin(slope), math.cos(slope)
    return (along + uphill * _FRICTION * across) / (across - uphill * _FRICTION * along)


def _work(loading: bool, friction: float = _FRICTION) -> float:
    """Of a slow pull from the foot of the rear face to its top, over the energy that the hook then stores."""
    hook = TABLE_3
    at_top = compliance(hook, hook.ramp_end, "paper")
    kappa = float(at_top.minus / at_top.plus)
    stiffness = hook.youngs_modulus * hook.width / float(at_top.plus)
    ratio = float(force_ratio(hook.rear, friction, loading))
    # corner at X = x + κ δ(x), δ = (x − ℓ_b) tan β; f_y + κ f_x = k δ by (10)
    stretch = 1.0 / math.tan(hook.rear) + kappa
    done = quad(lambda bent: ratio * stiffness * bent / (1 + kappa * ratio) * stretch, 0.0, hook.height)[0]
    return float(done / (0.5 * stiffness * hook.height**2))


def _lose_to_friction() -> float:
    """Work of friction μN along the rear face while the hook is bent to its top, over the energy it then stores.

    f_y + κ f_x = k δ by (10), f_x and f_y from N and μN by statics, and the part slides dδ/sin β.
    """
    beta, ratio = math.radians(58.8), 2 * 1.41 / 2.6
    plus = 4 * (1 + 0.3 / L_B**2 * 2.6 * ratio) * L_B**3 + BENDING + SHEAR * ratio
    kappa = (MINUS_1 + MINUS_2) * END / L_M / plus
    across = math.cos(beta) - _FRICTION * math.sin(beta)
    along = math.sin(beta) + _FRICTION * math.cos(beta)
    return float(_FRICTION / (across + kappa * along) / math.sin(beta))


def _slopes() -> tuple[float, float]:
    """Turn of the hook at its peak per deflection [rad/m]: the chord that (11) takes, and the beam's own slope."""
    hook = TABLE_3
    shape = compute_bent_shape(hook, hook.peak, 1e-3, points=4001)
    beyond = shape[shape[:, 0] > hook.peak]
    return 1 / hook.peak, float((beyond[-1, 1] - beyond[0, 1]) / (beyond[-1, 0] - beyond[0, 0]) / 1e-3)
