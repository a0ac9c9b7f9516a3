"""Bai 2012, Fig. 7 and eqs. (14) to (18): forces on a tilted plug between two hooks (errata E10, E20, E23, E24)."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from haptorb.arrays import Array
from haptorb.beams import TABLE_3, appendix_b
from haptorb.devices.base import State
from haptorb.worlds.base import World
from haptorb.worlds.snap_fit import Outlet, PublishedOutlet
from haptorb_papers.reproduce.citation import Citation
from haptorb_papers.reproduce.entry import Entry
from haptorb_papers.reproduce.hook_quadrature import compute_pull_stiffness
from haptorb_papers.reproduce.item import Item
from haptorb_papers.reproduce.registry import Report

__all__ = ["items"]

_AT = Citation("bai2012", "fig7", "Fig. 7, eqs. (14)–(18)")
_TILT, _ARM, _FRICTION = math.radians(2.0), 16e-3, 0.134  #: h is assumed
_WP, _WS = 6.3e-3, 4.8e-3
_X0 = 0.5 * _WP * math.sin(_TILT)
_FAST = 1e4  #: [m/s] so that friction is Coulomb's, not the creep of a smoothed sign


def items(report: Report) -> tuple[tuple[Item, ...], None]:
    """Δ by plain geometry, forces by quadrature and by the outlet's two worlds, and which of them energy allows."""
    published, rendered = PublishedOutlet(), Outlet(beam="paper")
    stiffness = compute_pull_stiffness()
    rows = rendered.contacts(_plug(1e-3, tilt=_TILT, y=0.1e-3))
    bent = [rows[1].deflection, rows[0].deflection]  # hook 1 pushes towards +Y': it stands at −Y'
    arm = _ARM - _X0 - 1e-3
    by_16 = [0.5 * _WP / math.cos(_TILT) + side * arm * math.tan(_TILT) - 0.5 * _WS - side * 0.1e-3 for side in (1, -1)]
    straight = rendered.contacts(_plug(1e-3, vx=_FAST))
    tilted = published.wrench(_plug(0.0, tilt=_TILT, vx=_FAST))
    report(0.3)
    area = 2 * math.tan(_TILT) * (_ARM - _X0) ** 2
    missing = rendered.wrench(_plug(0.0, tilt=_TILT, vx=_FAST))
    turning = [published.wrench(_plug(4e-3, tilt=math.radians(deg)))[5] for deg in (2.0, 1.0, 0.5, 0.0)]
    found = (
        *(
            _AT.claim(f"16-{n + 1}", f"(15a), (16): Δ_{n + 1} − w_s/2 ∓ y at 2°, x = 1 mm, y = 0.1 mm, and by contact",
                     1e3 * by_16[n], 1e3 * bent[n], "mm", 2e-3, "(16) takes h, not the place of the turned face",
                     erratum="E23", where="eq. (16)")
            for n in range(2)
        ),
        _AT.set_and_find("15b", "(15b): f_X' over f_Y' of one hook, pulled straight: μ", _FRICTION,
                         abs(straight[0].force[0] / straight[0].force[1]), "1", 1e-6,
                         "the outlet that conserves energy", where="eq. (15b)"),
        _AT.claim("14", "(14): F_X' of both hooks, pulled straight, and (17)", stiffness * _FRICTION * (_WP - _WS),
                 -rendered.wrench(_plug(1e-3, vx=_FAST))[0], "N", 1e-3, "the outlet that conserves energy",
                 erratum="E9", where="eq. (14)"),
        _AT.claim("17-x", "(17): F_X' at 2°, pull of the hand", stiffness * _FRICTION * (_WP / math.cos(_TILT) - _WS),
                 -tilted[0], "N", 1e-6, erratum="E9", where="eq. (17)"),
        _AT.claim("17-y", "(17): F_Y' at 2°, x = y = 0", stiffness * 2 * math.tan(_TILT) * (_ARM - _X0), tilted[1], "N",
                 1e-6, erratum="E9", where="eq. (17)"),
        _AT.claim("17-z", "(17), (18): F_Z', T_X' and T_Y'", 0.0,
                 Entry(float(np.abs(tilted[2:5]).max()), "world outlet-published: no such part"), "N, N·m", 1e-12,
                 where="eqs. (17), (18)"),
        _AT.claim("18-arm", "(18): T_Z' over F_Y', h − x − x₀", 1e3 * (_ARM - _X0), 1e3 * tilted[5] / tilted[1], "mm",
                 1e-6, where="eq. (18)"),
        _AT.claim("18-couple", "(18): T_Z' over F_Y'(h − x − x₀), straight plug 0.1 mm aside, pulled", 1.0,
                 _find_couple(rendered), "1", 1e-5, "friction at ±w_p/2, by statics; h is assumed", erratum="E32",
                 corrected=1.0 - _FRICTION * 0.5 * _WP / (_ARM - 1e-3), where="eq. (18)"),
        _AT.claim("18-factor", "(18): last member as printed, m², and the torque", area, tilted[5], "N·m", 1e-6,
                 "E w/(Ω₊ + μΩ₋) is missing", erratum="E10", corrected=stiffness * area, where="eq. (18)"),
        _AT.claim("18-falls", "phase 2: 1 if torque falls as the tilt falls (printed: rises)", -1.0,
                 float(all(a > b for a, b in pairwise(turning))) * 2 - 1, "1", 0.0,
                 "a direction", erratum="E20", corrected=1.0, where="§3.2"),
        _AT.claim("16-sense", "side force by energy over (17)'s, ε_z counted counter-clockwise", 1.0,
                 _compare_sense(stiffness), "1",
                 0.05, "the sign counts; small angles", erratum="E23", corrected=-1.0, where="eqs. (16)–(18)"),
        _AT.claim("17-tilted", "share of the pull at 2° that (17) has and energy has not", 0.0,
                 (tilted[0] - missing[0]) / tilted[0], "1", 0.02, "h is assumed", erratum="E24",
                 corrected=2 * math.tan(_TILT) ** 2 * (_ARM - _X0) / (_FRICTION * (_WP / math.cos(_TILT) - _WS)),
                 where="eq. (17)"),
        _AT.claim("17-curl", "∂F_Y'/∂x − ∂F_X'/∂y of (17) over E w/Ω₊, without friction", 0.0,
                 _curl(PublishedOutlet(friction=1e-12)), "1", 1e-4, "an energy's gradient would have none",
                 erratum="E24", corrected=-2 * math.tan(_TILT), where="eq. (17)"),
        _AT.compare("felt-curl", "the same of the outlet that is rendered", 0.0,
                 _curl(Outlet(friction=0.0, beam="paper")), "1", 1e-3, "finite differences", erratum="E24",
                 where="eq. (17)"),
        _AT.exempt("drawing", "CAD model, contact forces, kinematics", "drawings; equations (14) to (16) say so too",
                      "Fig. 7(a), (b)"),
        _AT.exempt("h", "h, from the plug's end to the hooks", "no value is printed; 16 mm is assumed, the length "
                      "of a flat plug's blade"),
    )  # fmt: skip
    report(1.0)
    return found, None


def _plug(x: float, *, y: float = 0.0, tilt: float = 0.0, vx: float = 0.0) -> State:
    """The plug with o' at x₀ + x, tilted by ε_z, which (16) counts clockwise about Z' (E23)."""
    c, s = math.cos(tilt), math.sin(tilt)
    R = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    lift = 0.5 * _WP * math.sin(tilt)
    return State(0.0, R, np.array([lift + x, y, 0.0]), np.zeros(3), np.array([vx, 0.0, 0.0]))


def _find_couple(world: Outlet) -> float:
    wrench = world.wrench(_plug(1e-3, y=0.1e-3, vx=_FAST))
    return float(wrench[5] / wrench[1] / (_ARM - 1e-3))


def _compare_sense(stiffness: float) -> float:
    """Minus the gradient of the springs' energy, plug turned counter-clockwise by a little, over (17)'s side force for
    that ε_z; both springs of `stiffness` [N/m]."""
    theta, step = 0.01, 1e-7

    def energy(y: float) -> float:
        c, s = math.cos(theta), math.sin(theta)
        total = 0.0
        for side in (1.0, -1.0):
            start = np.array([-s, c]) * side * 0.5 * _WP + np.array([0.0, y])
            total += 0.5 * (side * (start[1] + s / c * (_ARM - start[0])) - 0.5 * _WS) ** 2
        return total

    by_energy = -stiffness * (energy(step) - energy(-step)) / (2 * step)
    return by_energy / float(PublishedOutlet().wrench(_plug(0.0, tilt=theta, vx=_FAST))[1])


def _curl(world: World) -> float:
    stiffness = TABLE_3.youngs_modulus * TABLE_3.width / appendix_b(TABLE_3).plus
    step = 1e-6

    def force(x: float, y: float) -> Array:
        return world.wrench(_plug(x, y=y, tilt=_TILT))

    by_x = force(4e-3 + step, 0.0)[1] - force(4e-3 - step, 0.0)[1]
    by_y = force(4e-3, step)[0] - force(4e-3, -step)[0]
    return float((by_x - by_y) / (2 * step) / stiffness)
