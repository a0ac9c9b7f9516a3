"""Bai 2012, Table 3: the outlet's sizes and materials, and which of them cannot be (errata E7, E8, E21)."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.integrate import quad

from haptorb.apps.reproduce.citation import Citation
from haptorb.apps.reproduce.item import Item
from haptorb.apps.reproduce.registry import Report
from haptorb.devices.state import State
from haptorb.errors import GeometryError
from haptorb.physics.beams import SHEAR_COEFFICIENT
from haptorb.physics.hook import TABLE_3
from haptorb.worlds.snap_fit.outlet import Outlet, PublishedOutlet

__all__ = ["items"]

_AT = Citation("bai2012", "t3", "Table 3")
_AS = "rounding; as in the world"


def items(report: Report) -> tuple[tuple[Item, ...], None]:
    """Each entry as the world has it; the pull that the modulus gives; the ramp that contradicts itself."""
    hook, world, mm = TABLE_3, Outlet(), 1e3
    room = (hook.peak - hook.base_length) * mm
    entries = (
        ("lb", "ℓ_b", 5.4, hook.base_length * mm, "mm"), ("lm", "ℓ_m", 9.6, hook.peak * mm, "mm"),
        ("beta", "β", 58.8, math.degrees(hook.rear), "°"), ("hb", "h_b", 1.8, hook.height * mm, "mm"),
        ("h0", "h₀", 0.6, hook.thickness * mm, "mm"), ("w", "w", 8.0, hook.width * mm, "mm"),
        ("ws", "w_s", 4.8, world.opening * mm, "mm"), ("wp", "w_p", 6.3, world.plug_width * mm, "mm"),
        ("nu", "ν of the socket", 0.41, hook.poisson_ratio, "1"), ("mu", "μ", 0.134, world.friction, "1"),
    )  # fmt: skip
    found = [_AT.item(name, what, value, ours, unit, 1e-9, _AS) for name, what, value, ours, unit in entries]
    found += [
        _AT.item("e-socket", "E of phosphor bronze", 1.13, hook.youngs_modulus / 1e9, "GPa", 1.0,
                 "handbooks: 110 to 115 GPa", erratum="E7", corrected=113.0),
        _AT.claim("pull", "whole pull of the outlet by (17), untilted, H_x as printed", _pull(1.13e9), _pull(113e9),
                 "N",
                 0.1, "a household outlet holds tens of newtons", erratum="E7", corrected=50.8),
        _AT.item("p", "p of eq. (12), by integrating the shear over a rectangular section", 1.2, _shear_coefficient(),
                 "1", 1e-9),
        _AT.item("p-used", "p as in the beam models", 1.2, SHEAR_COEFFICIENT),
        _AT.item("ramp", "height that β gives over ℓ_m − ℓ_b", 1.8, room * math.tan(hook.rear), "mm", 0.01,
                 "three printed numbers exclude each other", erratum="E8", corrected=6.94),
        _AT.item("ramp-angle", "angle that h_b gives over ℓ_m − ℓ_b", 58.8, math.degrees(hook.ramp_to_peak().rear), "°",
                 0.05, "the same", erratum="E8", corrected=23.2),
        _AT.claim("ramp-end", "where the ramp of β reaches h_b, over h₀", 16.0, hook.ramp_end / hook.thickness, "1",
                 0.005, "the closed forms of appendix B end it there", erratum="E8",
                 corrected=10.82),
        _AT.claim("ramp-refused", "1 if a hook with these sizes and no flat top is refused", 1.0, float(_rejects()),
                 "1", 0.0, "what cannot be built must not be rendered", erratum="E8"),
        _AT.claim("delta", "δ of each hook with the plug in, (w_p − w_s)/2", 0.75, 1e3 * _bend_hook(), "mm", 1e-6,
                 "found by the outlet's contact"),
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


def _shear_coefficient() -> float:
    """A ∫ (Q/(I b))² dA over a unit square: what shear energy a rectangular section has beyond an even one."""
    return float(quad(lambda y: (12 * 0.5 * (0.25 - y * y)) ** 2, -0.5, 0.5)[0])  # I = 1/12, Q = (1/4 − y²)/2


def _rejects() -> bool:
    try:
        replace(TABLE_3, flat_top=False)
    except GeometryError:
        return True
    return False


def _bend_hook() -> float:
    contacts = Outlet().contacts(State(0.0, np.eye(3), np.array([1e-3, 0, 0]), np.zeros(3), np.zeros(3)))
    return contacts[0].deflection
