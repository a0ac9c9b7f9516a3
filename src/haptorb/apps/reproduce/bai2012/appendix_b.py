"""Bai 2012, eqs. (12), (13) and appendix B: compliances in closed form, by quadrature, and by a beam that is right."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from scipy.integrate import quad

from haptorb.apps.reproduce.citation import Citation
from haptorb.apps.reproduce.item import Item
from haptorb.apps.reproduce.registry import Drawing, Report
from haptorb.physics.beams import appendix_b, compliance
from haptorb.physics.hook import TABLE_3

__all__ = ["items"]

_AT = Citation("bai2012", "b", "App. B")
_H0, _LB, _LM, _TAN = 0.6e-3, 9.0, 16.0, math.tan(math.radians(58.8))
_CLOSED = "closed form against quadrature; no digits are printed"


def items(report: Report) -> tuple[tuple[Item, ...], Drawing]:
    """(B.1) to (B.5c) against the integrals that they stand for, and against Timoshenko."""
    hook = TABLE_3
    end = hook.ramp_end / hook.thickness
    closed, printed = appendix_b(hook), appendix_b(hook, deflection=0.75e-3)
    bending = quad(lambda x: 12 * x**2 / _h(x) ** 3, _LB, end)[0]
    shear = 1.2 * 2.6 * quad(lambda x: 1 / _h(x), _LB, end)[0]
    lever = 6 * _LM * (_h(_LM) - 0.5)
    minus_1, minus_2 = lever * _LB, lever * quad(lambda x: 1 / _h(x) ** 3, _LB, end)[0]
    table = appendix_b(hook, shear_ratio=hook.shear_ratio)
    report(0.4)
    ramp, flat = (float(compliance(one, hook.peak, shear_ratio=2.6).plus) for one in (hook.ramp_to_peak(), hook))
    base = float(compliance(hook, hook.base_length, shear_ratio=2.6).plus)
    softer = (printed.plus + 0.134 * printed.minus) / (closed.plus + 0.134 * closed.minus) - 1
    found = (
        _AT.claim("12-k", "K = 1 + 0.3/L_b² · E/G of (12)", 1 + 0.3 / 81 * 2.6, base / (4 * 9.0**3), "1", 1e-9,
                 "a Timoshenko beam of length ℓ_b loaded at its end", where="eq. (12)"),
        _AT.claim("b1-plus", "(B.1): Ω₊ of the three terms, and (12) by quadrature", closed.plus,
                 base + bending + shear, "1", 1e-6, _CLOSED, where="(B.1)"),
        _AT.claim("b1-minus", "(B.1): Ω₋ as printed, and (13) by quadrature", printed.minus, minus_1 + minus_2, "1",
                 0.01, _CLOSED, erratum="E9", corrected=3119.39, where="(B.1)"),
        _AT.claim("b2a", "(B.2a): ρ = 1/(1 + H_b), and h₀ over the hook's greatest thickness", 0.25,
                 hook.thickness / hook.section(hook.peak), "1", 1e-12, where="(B.2a)"),
        _AT.claim("b2b", "(B.2b): H_x = 1 + δ/h₀, and the H_x that makes (B.5b) equal (13)", 1 + 0.75 / 0.6,
                 (minus_1 / (3 * _LM * _LB) - 1) / 2, "1", 1e-9, _CLOSED, erratum="E9", corrected=3.0, where="(B.2b)"),
        _AT.item("b2c", "(B.2c): E/G, and 2(1 + ν) of Table 3", 2.6, hook.shear_ratio, "1", 1e-9,
                 "an isotropic metal", erratum="E21", corrected=2.82, where="(B.2c)"),
        _AT.claim("b2c-effect", "change of Ω₊ by that", 0.0, table.plus / closed.plus - 1, "1", 1e-3,
                 "a tenth of a per cent is not noticeable", erratum="E21", where="(B.2c)"),
        _AT.claim("b3", "(B.3): Ω₁₊, and (12)'s first term by a beam", closed.plus_1, base, "1", 1e-6, _CLOSED,
                 where="(B.3)"),
        _AT.claim("b4", "(B.4): Ω₂₊, with σ read as β, and (12)'s integral", closed.plus_2, bending, "1", 1e-6, _CLOSED,
                 erratum="E28", where="(B.4)"),
        _AT.claim("b5a", "(B.5a): Ω₃₊, with σ, k read as β, p, and (12)'s integral", closed.plus_3, shear, "1", 1e-8,
                 _CLOSED, erratum="E28", where="(B.5a)"),
        _AT.claim("b5b", "(B.5b): Ω₁₋ as printed, and (13)", printed.minus_1, minus_1, "1", 1e-6, _CLOSED, erratum="E9",
                 corrected=3024.0, where="(B.5b)"),
        _AT.claim("b5c", "(B.5c): Ω₂₋ as printed, and (13)", printed.minus_2, minus_2, "1", 0.01, _CLOSED, erratum="E9",
                 corrected=95.39, where="(B.5c)"),
        _AT.claim("e9-effect", "change of the force by that", 0.0, softer, "1", 1e-4, "from the terms above",
                 erratum="E9", corrected=-0.0244, where="(17)"),
        _AT.claim("12-load", "Ω₊ of (12), and of a beam loaded where the contact is, ramp straight to ℓ_m", closed.plus,
                 ramp, "1", 20.0, "Timoshenko, quadrature", erratum="E11", corrected=15490.0, where="eq. (12)"),
        _AT.claim("12-load-flat", "the same with the flat top of E8", closed.plus, flat, "1", 20.0,
                 "Timoshenko, quadrature", erratum="E11", corrected=15206.0, where="eq. (12)"),
        _AT.claim("12-softer", "how much softer: ratio of the two", 1.0, ramp / closed.plus, "1", 0.01,
                 "from the terms above", erratum="E11", corrected=4.77, where="eq. (12)"),
        _AT.claim("12-thickness", "'Δ₊ = δ₊/h': thickness at the contact over h₀, if h is read literally", 1.0,
                 hook.section(hook.peak) / hook.thickness, "1", 1e-9, "h₀ is meant; otherwise all is 4 times smaller",
                 erratum="E28", corrected=4.0, where="eq. (12)"),
    )  # fmt: skip
    report(1.0)
    return found, _draw_figure


def _h(x: float) -> float:
    """h(x)/h₀ of (12), with E8's flat top."""
    return float(TABLE_3.section(x * _H0)) / _H0


def _draw_figure(path: Path) -> Path:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 4), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    hook = TABLE_3
    x = np.linspace(0.0, hook.tip, 300)
    straight = hook.ramp_to_peak()
    left.fill_between(1e3 * x, 0, 1e3 * hook.section(x), color="C0", alpha=0.25, label="58.8° and a flat top")
    left.plot(1e3 * x, 1e3 * straight.section(x), "C1--", label="straight to ℓ_m: 23.2°")
    left.set(xlabel="along the hook [mm]", ylabel="thickness [mm]")
    left.set_title("Table 3's hook, both readings (E8)", loc="left", fontsize=10)
    left.legend(frameon=False)
    at = np.linspace(hook.base_length, hook.peak, 60)
    for model, style, label in (("paper", "C3-", "eq. (12)"), ("timoshenko", "C0-", "loaded where the contact is")):
        right.plot(1e3 * at, compliance(hook, at, model, shear_ratio=2.6).plus, style, label=label)  # type: ignore[arg-type]
    right.set(xlabel="contact at [mm]", ylabel="Ω₊ [1]", ylim=(0, None))
    right.set_title("How far it gives way (E11)", loc="left", fontsize=10)
    right.grid(alpha=0.3)
    right.legend(frameon=False)
    figure.savefig(path, dpi=120)
    return path
