"""Zárate 2020, Fig. 3: the code of the force map and its inverse, as printed and corrected (errata E13, E14, E19)."""

from __future__ import annotations

from math import cos, degrees, pi, radians, sin
from pathlib import Path

import numpy as np
from scipy.integrate import quad

from haptorb.arrays import Array
from haptorb.control.allocation import LeastSquaresAllocator
from haptorb.devices.api import electromagnet
from haptorb.devices.base import State
from haptorb.devices.loader import load
from haptorb.magnetics import dipole
from haptorb.magnetics.dipole import MU0
from haptorb.worlds.dome import Dome
from haptorb_papers.reproduce.citation import Citation
from haptorb_papers.reproduce.item import Item
from haptorb_papers.reproduce.registry import Drawing, Report

__all__ = ["items"]

_AT = Citation("zarate2020", "fig3", "Fig. 3")
_EXACT = "floating point"


def items(report: Report) -> tuple[tuple[Item, ...], Drawing]:
    """Force of the map along a meridian and outwards, and the result of the inverse."""
    device = electromagnet(load("omni"))
    dome = Dome(half_width_deg=18, cut_off_deg=54, moment=2.4).for_device(device)
    F0 = 3 * MU0 * 2.4 * dome.tool_moment / (4 * pi * dome.contact_distance**4)
    theta_1, d = radians(18.0), dome.contact_distance
    printed = 2 * theta_1 / pi
    found = [
        _AT.claim("summit", "F_r at the summit over F₀: 2", 2.0, _force(dome, 0.0, d)[0] / F0, "1", 1e-12, _EXACT,
                 erratum="E30"),
        _AT.claim("at-36", "F_r at 36° over the summit's: the valley around the hill", cos(printed * 2 * theta_1),
                 _force(dome, 36.0, d)[0] / (2 * F0), "1", 1e-12, _EXACT, erratum="E13", corrected=-1.0),
        _AT.claim("tangent-18", "F_t at 18° over F₀", sin(printed * theta_1), _force(dome, 18.0, d)[1] / F0, "1", 1e-12,
                 _EXACT, erratum="E13", corrected=1.0),
        _AT.claim("reach", "force at d_max, 70 mm", 0.0, np.hypot(*_force(dome, 0.0, 0.07)), "N", 1e-12, _EXACT),
        _AT.claim("fall", "F_r at 60 mm over that at contact: (|r₀|/|r_p|)⁴", (5 / 6) ** 4,
                 _force(dome, 0.0, 0.06)[0] / _force(dome, 0.0, d)[0], "1", 1e-9, _EXACT),
        *_inverse(device.tool.moment),
        _AT.compare("inverse-currents", "force of the allocator's currents against the one asked, relative", 0.0,
                _allocation_error(), "1", 1e-9, "any direction, dipole model in both"),
        _AT.claim("cycle", "work per cycle outward over the summit, sideways, inward and "
                           "back", 0.0, _round_trip(18.0), "mJ",
                 0.01, "the force along the path, against its curl over the area", erratum="E19",
                 corrected=_integrate_curl(F0 * d**4), where="§II.A"),
        _AT.compare("cycle-60", "the same at θ₁ = 60°, k = 1.5, the one map that is a gradient", 0.0, _round_trip(60.0),
                "mJ", 1e-6, "quadrature", where="§II.A"),
    ]  # fmt: skip
    report(1.0)
    return tuple(found), lambda path: _draw_figure(dome, F0, path)


def _radial(alpha: float, d: float) -> tuple[Array, Array, Array]:
    out = np.array([sin(alpha), 0.0, cos(alpha)])
    return d * out, out, np.array([cos(alpha), 0.0, -sin(alpha)])


def _force(dome: Dome, alpha_deg: float, d: float) -> tuple[float, float]:
    """F_r and F_t [N] at an angle from the summit and a distance."""
    p, out, away = _radial(radians(alpha_deg), d)
    force = dome.wrench(State.at(p))[:3]
    return float(force @ out), float(force @ away)


def _inverse(m_p: float) -> list[Item]:
    """m_e = 4πd⁴/3μ₀ [1, 1, −½]·F given back to the dipoles, component by component."""
    p, out, away = _radial(0.6, 0.05)
    aside = np.cross(out, away)
    frame = np.stack([away, aside, out])
    rows = []
    for n, name in enumerate(("tangential", "sideways", "radial")):
        asked = 0.1 * frame[n]
        printed = 4 * pi * 0.05**4 / (3 * MU0) * np.array([1.0, 1.0, -0.5]) * (frame @ asked)
        forces = [float(dipole.force(frame.T @ moment, m_p * out, p) @ frame[n]) for moment in (printed, printed / m_p)]
        rows.append(
            _AT.claim(f"inverse-{name}", f"{name} force given over the one asked: as printed, and with 1/m_p",
                     forces[0] / 0.1, forces[1] / 0.1, "1", 1e-9, _EXACT, erratum="E14", corrected=1.0)
        )  # fmt: skip
    return rows


def _allocation_error() -> float:
    device = electromagnet(load("omni"))
    allocator = LeastSquaresAllocator.force(1e3 * device.coils.current_limit)
    worst, rng = 0.0, np.random.default_rng(3)
    for wanted in 0.2 * rng.normal(size=(20, 3)):
        u = rng.normal(size=3)
        u[2] = abs(u[2])
        known = device.wrench_map(State.at(0.055 * u / np.linalg.norm(u)), "published")
        given = known.force @ allocator.allocate(known, np.concatenate([wanted, np.zeros(3)])).currents
        worst = max(worst, float(np.linalg.norm(given - wanted) / np.linalg.norm(wanted)))
    return worst


def _round_trip(theta_1: float) -> float:
    """[mJ] out over the summit to 70 mm, down the far side, in, and back up the near side."""
    dome = Dome(half_width_deg=theta_1, cut_off_deg=180, moment=2.4, reach=1.0)
    near, far, edge = 0.05, 0.07, min(theta_1, 54.0)
    out = quad(lambda d: _force(dome, 0.0, d)[0] - _force(dome, edge, d)[0], near, far)[0]
    down, up = (quad(lambda a, d=d: _force(dome, degrees(a), d)[1] * d, 0, radians(edge))[0] for d in (far, near))
    return 1e3 * float(out + down - up)


def _integrate_curl(strength: float) -> float:
    """[mJ] (2k − 3) F₀d₀⁴ sin(kα)/d⁵ over 0 to 18° and 50 to 70 mm, k = 5; `strength` F₀d₀⁴ [N·m⁴]."""
    k = 5.0
    return 1e3 * (2 * k - 3) * strength * (1 - cos(k * radians(18.0))) / k * (0.05**-3 - 0.07**-3) / 3


def _draw_figure(dome: Dome, F0: float, path: Path) -> Path:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 4), layout="constrained")
    FigureCanvasAgg(figure)
    panel = figure.subplots()
    alpha = np.linspace(0, 60, 500)
    used = np.array([_force(dome, a, dome.contact_distance) for a in alpha]) / F0
    panel.plot(alpha, used[:, 0], "C0", label="F_r, argument α π/(2θ₁)")
    panel.plot(alpha, used[:, 1], "C2", label="F_t, the same")
    panel.plot(alpha, np.where(alpha < 54, 2 * np.cos(np.radians(alpha) * 0.2), 0), "C0--", label="F_r as printed")
    panel.plot(alpha, np.where(alpha < 54, np.sin(np.radians(alpha) * 0.2), 0), "C2--", label="F_t as printed")
    for angle, name in ((18, "θ₁"), (54, "θ₂")):
        panel.axvline(angle, color="k", lw=0.8, ls=":")
        panel.text(angle + 0.5, 2.1, name)
    panel.set(xlabel="angle from the summit [°]", ylabel="force over F₀", xlim=(0, 60), ylim=(-2.3, 2.4))
    panel.legend(frameon=False, loc="lower left")
    panel.grid(alpha=0.3)
    figure.savefig(path, dpi=120)
    return path
