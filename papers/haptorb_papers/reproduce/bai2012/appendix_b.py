"""Bai 2012, eqs. (12), (13) and appendix B: compliances in closed form, by quadrature, and by a correct beam."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from haptorb.beams import TABLE_3, appendix_b, compliance
from haptorb_papers.reproduce.citation import Citation
from haptorb_papers.reproduce.hook_quadrature import (
    BENDING,
    L_B,
    L_M,
    MINUS_1,
    MINUS_2,
    SHEAR,
    bend_hook,
    pull_bends,
    thickness,
)
from haptorb_papers.reproduce.item import Item
from haptorb_papers.reproduce.registry import Drawing, Report

__all__ = ["items"]

_AT = Citation("bai2012", "b", "App. B")
_CLOSED = "closed form against quadrature; no digits are printed"


def items(report: Report) -> tuple[tuple[Item, ...], Drawing]:
    """(B.1) to (B.5c) against the integrals that they stand for, and against Timoshenko."""
    hook = TABLE_3
    closed, printed = appendix_b(hook), appendix_b(hook, deflection=0.75e-3)
    table = appendix_b(hook, shear_ratio=hook.shear_ratio)
    report(0.4)
    ramp, flat = (float(compliance(one, hook.peak, shear_ratio=2.6).plus) for one in (hook.ramp_to_peak(), hook))
    base = 4 * (1 + 0.3 / L_B**2 * 2.6) * L_B**3
    softer = (printed.plus + 0.134 * printed.minus) / (closed.plus + 0.134 * closed.minus) - 1
    found = (
        _AT.claim("12-k", "4 K L_b³ with K = 1 + 0.3/L_b² · E/G of (12)", base,
                 float(compliance(hook, hook.base_length, shear_ratio=2.6).plus), "1", 1e-6,
                 "a Timoshenko beam of length ℓ_b loaded at its end", where="eq. (12)"),
        _AT.claim("b2a", "(B.2a): ρ = 1/(1 + H_b), and h₀ over the hook's greatest thickness", 0.25,
                 hook.thickness / hook.section(hook.peak), "1", 1e-12, where="(B.2a)"),
        _AT.item("b2c", "(B.2c): E/G, and 2(1 + ν) of Table 3", 2.6, hook.shear_ratio, "1", 1e-9,
                 "an isotropic metal", erratum="E21", corrected=2 * (1 + 0.41), where="(B.2c)"),
        _AT.note("b2c-effect", "change of Ω₊ by that", table.plus / closed.plus - 1, "1", "not noticeable (E21)",
                 where="(B.2c)"),
        _AT.claim("b3", "(B.3): Ω₁₊, and (12)'s first term by a beam", bend_hook(L_B), closed.plus_1, "1", 1e-6,
                 _CLOSED, where="(B.3)"),
        _AT.claim("b4", "(B.4): Ω₂₊, with σ read as β, and (12)'s integral", BENDING, closed.plus_2, "1", 1e-6, _CLOSED,
                 erratum="E28", where="(B.4)"),
        _AT.claim("b5a", "(B.5a): Ω₃₊, with σ, k read as β, p, and (12)'s integral", SHEAR, closed.plus_3, "1", 1e-8,
                 _CLOSED, erratum="E28", where="(B.5a)"),
        _AT.claim("b5b", "(B.5b): Ω₁₋ with H_x of (B.2b), and with H_x = H_b", printed.minus_1, closed.minus_1, "1",
                 1e-6, "(13) by quadrature", erratum="E9", corrected=MINUS_1, where="(B.2b), (B.5b)"),
        _AT.claim("b5c", "(B.5c): Ω₂₋, the same", printed.minus_2, closed.minus_2, "1", 1e-6, "(13) by quadrature",
                 erratum="E9", corrected=MINUS_2, where="(B.2b), (B.5c)"),
        _AT.note("e9-effect", "change of the force by that", softer, "1", "E9", where="(17)"),
        _AT.claim("12-load-flat", "Ω₊ of (12), and of a beam loaded where the contact is", closed.plus, flat, "1", 1.0,
                 "Timoshenko, by another quadrature", erratum="E11", corrected=bend_hook(), where="eq. (12)"),
        _AT.note("12-load", "the same, ramp straight to ℓ_m (E8)", ramp, "1", where="eq. (12)"),
        _AT.note("12-softer", "how much softer that is: ratio of the two", ramp / closed.plus, "1", "E11",
                 where="eq. (12)"),
        _AT.claim("13-load", "Ω₋ of (13), with E9's H_x, and of a beam that carries the pull's moment from root to "
                  "contact", closed.minus, float(compliance(hook, hook.peak).minus), "1", 0.5,
                  "6X stands for 12(X − ξ); by another quadrature", erratum="E11",
                  corrected=pull_bends(), where="eq. (13)"),
        _AT.claim("12-thickness", "'Δ₊ = δ₊/h': thickness at the contact over h₀, if h is read literally", 1.0,
                 hook.section(hook.peak) / hook.thickness, "1", 1e-9, "h₀ is meant; otherwise all is 4 times smaller",
                 erratum="E28", corrected=thickness(L_M), where="eq. (12)"),
    )  # fmt: skip
    report(1.0)
    return found, _draw_figure


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
    right.set_title("Deflection (E11)", loc="left", fontsize=10)
    right.grid(alpha=0.3)
    right.legend(frameon=False)
    figure.savefig(path, dpi=120)
    return path
