"""Bai 2012, Table 3: the outlet's sizes and materials, and the impossible ones among them (errata E7, E8, E29)."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from haptorb import beams as hooks
from haptorb.beams import TABLE_3
from haptorb.devices.base import State
from haptorb.errors import GeometryError
from haptorb.worlds.snap_fit import Outlet, PublishedOutlet
from haptorb_papers.reproduce.citation import Citation
from haptorb_papers.reproduce.entry import read_entry
from haptorb_papers.reproduce.hook_quadrature import L_M, bend_hook, compute_pull_stiffness
from haptorb_papers.reproduce.item import Item
from haptorb_papers.reproduce.registry import Report

__all__ = ["items"]

_AT = Citation("bai2012", "t3", "Table 3")


def items(report: Report) -> tuple[tuple[Item, ...], None]:
    """Each entry as the world has it; the pull that the modulus gives; the ramp that contradicts itself."""
    world, mm, degree = Outlet(), 1e3, math.degrees(1.0)
    room = (TABLE_3.peak - TABLE_3.base_length) * mm
    entries = (
        ("lb", "ℓ_b", 5.4, "base_length", mm, "mm"), ("lm", "ℓ_m", 9.6, "peak", mm, "mm"),
        ("beta", "β", 58.8, "rear", degree, "°"), ("hb", "h_b", 1.8, "height", mm, "mm"),
        ("h0", "h₀", 0.6, "thickness", mm, "mm"), ("w", "w", 8.0, "width", mm, "mm"),
        ("nu", "ν of the socket", 0.41, "poisson_ratio", 1.0, "1"),
    )  # fmt: skip
    found = [
        _AT.item(name, what, value, read_entry(hooks, f"TABLE_3.{entry}", per), unit)
        for name, what, value, entry, per, unit in entries
    ]
    found += [
        _AT.item("ws", "w_s", 4.8, read_entry(world, "opening", mm), "mm"),
        _AT.item("wp", "w_p", 6.3, read_entry(world, "plug_width", mm), "mm"),
        _AT.item("mu", "μ", 0.134, read_entry(world, "friction")),
        _AT.item("e-socket", "E of phosphor bronze", 1.13, read_entry(hooks, "TABLE_3.youngs_modulus", 1e-9), "GPa",
                 1.0, "handbooks: 110 to 115 GPa", erratum="E7", corrected=113.0),
        _AT.item("e-plug-list", "E of brass, in the list of materials", 0.93,
                 read_entry(hooks, "MATERIALS[brass].youngs_modulus", 1e-9), "GPa", 1.0, "handbooks: 90 to 105 GPa",
                 erratum="E7", corrected=93.0),
        _AT.claim("pull", "whole pull of the outlet by (17), untilted, H_x as printed, E as printed, and 113 GPa",
                 _pull(1.13e9), _pull(113e9), "N", 0.01, "a household outlet holds with tens of newtons; (12), (13) by "
                 "quadrature", erratum="E7", corrected=compute_pull_stiffness(1 + 0.75 / 0.6) * 0.134 * 1.5e-3),
        _AT.item("p-used", "p of eq. (12)", 1.2, read_entry(hooks, "SHEAR_COEFFICIENT"), "1", 1e-9,
                 "A ∫ (Q/(I b))² dA of a rectangle gives it too"),
        _AT.item("ramp", "height that β gives over ℓ_m − ℓ_b", 1.8, room * math.tan(TABLE_3.rear), "mm", 0.01,
                 "three printed numbers exclude each other", erratum="E8",
                 corrected=4.2 * math.tan(math.radians(58.8))),
        _AT.note("ramp-angle", "angle that h_b gives over ℓ_m − ℓ_b", math.degrees(TABLE_3.ramp_to_peak().rear), "°"),
        _AT.note("ramp-end", "where the ramp of β reaches h_b, over h₀", TABLE_3.ramp_end / TABLE_3.thickness, "1",
                 "the closed forms of appendix B end it there"),
        _AT.compare("ramp-refused", "1 if a hook with these sizes and no flat top is refused", 1.0, float(_rejects()),
                 "1", 0.0, "what cannot be built must not be rendered", erratum="E8"),
        _AT.claim("delta", "δ of each hook with the plug in, (w_p − w_s)/2", 0.75, 1e3 * _bend_hook(), "mm", 1e-6,
                 "found by the outlet's contact"),
        _AT.claim("yield", "yield stress of phosphor bronze over the stress at the root of the hooks, plug inserted: "
                 "1 or more, or the hooks stay bent", 1.0, _find_margin(), "1", 5e-3, "a beam loaded at the contact, "
                                                                                      "by quadrature; yield "
                 "0.53 GPa: CuSn6 R560", erratum="E29", corrected=_find_margin_by_quadrature()),
        _AT.exempt("e-plug", "E of brass, 0.93 GPa (93: E7), and its ν = 0.35", "the plug is rigid throughout"),
        _AT.exempt("thickness", "thickness of the plug, 1.5 mm", "it enters no equation; with w_p it names the plug "
                      "whose length h is assumed after"),
    ]  # fmt: skip
    report(1.0)
    return tuple(found), None


def _pull(modulus: float) -> float:
    world = PublishedOutlet(youngs_modulus=modulus, surface_height="printed")
    state = State(0.0, np.eye(3), np.array([1e-3, 0, 0]), np.zeros(3), np.array([1e4, 0, 0]))
    return -float(world.wrench(state)[0])


def _rejects() -> bool:
    try:
        replace(TABLE_3, flat_top=False)
    except GeometryError:
        return True
    return False


def _bend_hook() -> float:
    contacts = Outlet().contacts(State(0.0, np.eye(3), np.array([1e-3, 0, 0]), np.zeros(3), np.zeros(3)))
    return contacts[0].deflection


def _find_margin() -> float:
    plus = hooks.compliance(TABLE_3, TABLE_3.peak).plus
    bronze = hooks.MATERIALS["phosphor bronze"]
    strain = float(hooks.root_strain(TABLE_3, TABLE_3.peak, 0.75e-3, plus))
    return bronze.yield_strength / (strain * TABLE_3.youngs_modulus)


def _find_margin_by_quadrature() -> float:
    """F_y X is the moment at the root, h₀/2 from the middle: ε = 6 X Δ/Ω₊."""
    return 0.53 / (113.0 * 6 * L_M * (0.75 / 0.6) / bend_hook(shear=1.2 * 2 * 1.41))
