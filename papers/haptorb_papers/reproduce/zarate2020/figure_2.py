"""Zárate 2020, Fig. 2 (b, c, d): map of a permanent magnet, adjustable map, and a perceivable surface.

Asked is what the world says; given is what the exact inverse's currents really do to the ring magnet in a radial tool,
by the independent, finer computation. With the printed argument α·2θ1/π map (c) would vanish first at 450° and never be
cut at a zero (E13); with α·π/(2θ1) it is the map that the text describes.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from haptorb.arrays import Array
from haptorb.control.allocation import LeastSquaresAllocator
from haptorb.devices.api import electromagnet
from haptorb.devices.base import State
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.magnetics import dipole
from haptorb.worlds.base import World
from haptorb.worlds.dome import Dome
from haptorb.worlds.terrain import Terrain
from haptorb_papers.reproduce.item import Basis, Item
from haptorb_papers.reproduce.registry import Drawing
from haptorb_papers.reproduce.zarate2020.true_wrench import true_wrench

__all__ = ["compute_given_forces", "items", "radial_zero", "tilt_force_map"]

_NARROW, _CUT = 18.0, 54.0  #: θ1 = π/10 and θ2 = 3π/10 [°]
_EVERY = 4  #: along the meridian, what is given is computed at every fourth angle
_MOMENT = 2.4  #: of the electromagnet at the summit [A·m²]


def course(world: World, angles: Array, distance: float) -> Array:
    """(n, 2) [N] radial and tangential force of `world` at polar `angles` [rad] in the x–z plane."""
    found = []
    for a in angles:
        radial, aside = np.array([np.sin(a), 0.0, np.cos(a)]), np.array([np.cos(a), 0.0, -np.sin(a)])
        force = world.wrench(State.at(distance * radial))[:3]
        found.append((force @ radial, force @ aside))
    return np.array(found)


def compute_given_forces(device: SphericalElectromagnet, world: World, angles: Array) -> Array:
    """(n, 2) [N] the same, as the exact inverse's currents really give it to the tool in contact."""
    allocator = LeastSquaresAllocator.force(device.coils.current_limit, compensate_passive=True)
    found = []
    for a in angles:
        radial, aside = np.array([np.sin(a), 0.0, np.cos(a)]), np.array([np.cos(a), 0.0, -np.sin(a)])
        state = State.at(device.contact_distance * radial)
        currents = allocator.allocate(device.wrench_map(state, "exact"), world.wrench(state)).currents
        force = true_wrench(device, state, currents, radial=2, azimuth=12)[:3]
        found.append((force @ radial, force @ aside))
    return np.array(found)


def radial_zero(world: World, distance: float, top: float = np.pi) -> float:
    """The smallest polar angle [rad] at which the radial force of `world` changes its sign; NaN if it never does."""
    from scipy.optimize import brentq

    angles = np.linspace(1e-3, top, 721)
    radial = course(world, angles, distance)[:, 0]
    turns = np.flatnonzero(radial[:-1] * radial[1:] < 0)
    if not len(turns):
        return float("nan")
    low, high = angles[turns[0]], angles[turns[0] + 1]
    return float(brentq(lambda a: course(world, np.array([a]), distance)[0, 0], low, high))


def tilt_force_map(world: World, distance: float, half: float, size: int) -> tuple[Array, Array, Array]:
    """Tilt east and north (size,) [rad], radial force (size, size) [N], and force aside (size, size, 2) [N], seen from
    above with tilt as distance from the middle; to one and a half steps beyond `half` [rad], so that a picture can be
    cut round there, then NaN."""
    edge = half * (1 + 3 / (size - 1))
    axis = np.linspace(-half, half, size)
    radial, aside = np.full((size, size), np.nan), np.full((size, size, 2), np.nan)
    for j, v in enumerate(axis):
        for i, u in enumerate(axis):
            tilt, turn = np.hypot(u, v), np.arctan2(v, u)
            if tilt > edge:
                continue
            e_r = np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
            e_t = np.array([np.cos(tilt) * np.cos(turn), np.cos(tilt) * np.sin(turn), -np.sin(tilt)])
            e_p = np.array([-np.sin(turn), np.cos(turn), 0.0])
            force = world.wrench(State.at(distance * e_r))[:3]
            radial[j, i] = force @ e_r
            out, across = force @ e_t, force @ e_p
            aside[j, i] = (
                out * np.cos(turn) - across * np.sin(turn),
                out * np.sin(turn) + across * np.cos(turn),
            )
    return axis, radial, aside


def items(report: Callable[[float], None]) -> tuple[tuple[Item, ...], Drawing]:
    """The maps' angles, and what draws them."""
    from haptorb.devices.loader import load

    device = electromagnet(load("omni"))
    d = device.contact_distance
    plain = Dome(half_width_deg=90.0, cut_off_deg=180.0, moment=_MOMENT).for_device(device)
    sharp = Dome(half_width_deg=_NARROW, cut_off_deg=_CUT, moment=_MOMENT).for_device(device)
    angles = np.radians(np.linspace(0.5, 60.0, 60))
    asked, given = course(sharp, angles, d), compute_given_forces(device, sharp, angles[::_EVERY])
    report(0.4)
    ends = course(plain, np.array([1e-6, np.pi - 1e-6]), d)[:, 0]
    edge = _edge(sharp, d)
    found = (
        _angle("b-zero", "angle from the summit at which a permanent magnet's radial force vanishes, θ1 = 90° set",
               90.0, np.degrees(radial_zero(plain, d)), "", None, "set"),
        Item("fig2b-turn", "zarate2020", "Fig. 2b", "radial force after half a turn over that at the summit", -1.0,
             float(ends[1] / ends[0]), "1", 1e-6, why="switching needs α = π: eq. (1)",
             implied=True),
        Item("fig2b-magnet", "zarate2020", "Fig. 2b", "map with θ1 = π/2 against two point dipoles, greatest error",
             0.0, _compare_with_dipoles(device, plain), "N", 1e-9, why="the text: then we recover a permanent magnet",
             implied=True),
        _angle("c-zero", "angle at which the adjustable map's radial force vanishes first, θ1 = 18° set", 18.0,
               np.degrees(radial_zero(sharp, d)), "E13", 18.0, "set"),
        _angle("c-printed", "the same by the printed argument α·2θ1/π, found in the printed code", 18.0,
               np.degrees(_find_printed_zero()), "E13", 180.0 / _NARROW * 45.0),
        _angle("c-cut", "angle at which its forces are cut off, θ2 = 54° set", 54.0, np.degrees(edge), "", None, "set"),
        Item("fig2c-given", "zarate2020", "Fig. 2c",
             "largest error of that map in contact with the exact inverse", None,
             1e3 * float(np.abs(given - asked[::_EVERY]).max()), "mN", None),
    )  # fmt: skip
    surface = Terrain().for_device(device)
    report(0.6)
    maps = [tilt_force_map(world, d, np.radians(60.0), 41) for world in (plain, sharp, surface)]
    report(1.0)
    return found, lambda path: _draw_figure(maps, angles, asked, given, surface, path)


def _angle(
    name: str, what: str, published: float, computed: float, erratum: str, corrected: float | None,
    basis: Basis = "computed",
) -> Item:  # fmt: skip
    return Item(f"fig2{name}", "zarate2020", f"Fig. 2{name[0]}", what, published, float(computed), "°", 0.01, erratum,
                corrected, "a hundredth of a degree: found by bisection", basis=basis)  # fmt: skip


def _find_printed_zero() -> float:
    """The smallest angle [rad] at which F_r of the code of Fig. 3 as printed changes its sign."""
    from scipy.optimize import brentq

    def radial(alpha: float) -> float:
        return 2.0 * float(np.cos(alpha * 2 * np.radians(_NARROW) / np.pi))

    angles = np.linspace(0.0, 4 * np.pi, 1001)
    turns = np.flatnonzero(np.diff(np.sign([radial(a) for a in angles])))
    return float(brentq(radial, angles[turns[0]], angles[turns[0] + 1]))


def _edge(world: World, distance: float) -> float:
    """The angle [rad] beyond which there is no force, by bisection."""
    low, high = np.radians(30.0), np.radians(90.0)
    while high - low > 1e-9:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if course(world, np.array([middle]), distance).any() else (low, middle)
    return float(low)


def _compare_with_dipoles(device: SphericalElectromagnet, plain: World) -> float:
    """[N] the greatest difference from the force between two point dipoles: the electromagnet's points at the summit,
    the tool's radially inward, so that the summit pushes."""
    worst = 0.0
    for a in np.radians(np.linspace(0, 179.9, 37)):
        r = device.contact_distance * np.array([np.sin(a), 0.0, np.cos(a)])
        force = dipole.force(np.array([0, 0, _MOMENT]), -device.tool.moment * r / np.linalg.norm(r), r)
        worst = max(worst, float(np.abs(plain.wrench(State.at(r))[:3] - force).max()))
    return worst


def _draw_figure(maps: list[Any], angles: Array, asked: Array, given: Array, surface: Terrain, path: Path) -> Path:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patches import Circle

    figure = Figure(figsize=(13.5, 8), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(2, 3)
    titles = (
        "(b) permanent magnet: θ1 = 90°",
        "(c) adjustable: θ1 = 18°, θ2 = 54°",
        "(d) a haptic surface",
    )
    for panel, (axis, radial, aside), title in zip(panels[0], maps, titles, strict=True):
        degrees = np.degrees(axis)
        half = degrees[-1]
        east, north = np.meshgrid(degrees, degrees)
        inside = np.hypot(east, north) <= half + 1e-9
        most = 1e3 * float(np.abs(radial[inside]).max())
        image = panel.pcolormesh(degrees, degrees, 1e3 * radial, cmap="RdBu_r", vmin=-most, vmax=most, rasterized=True)
        # Whole cells at a round edge are a staircase with single ones ahead of it: the picture ends in a circle.
        image.set_clip_path(Circle((0, 0), half, transform=panel.transData))
        figure.colorbar(image, ax=panel, label="radial force [mN]; positive pushes", shrink=0.85)
        arrows = inside[::4, ::4]
        panel.quiver(east[::4, ::4][arrows], north[::4, ::4][arrows], *aside[::4, ::4][arrows].T, color="k",
                     pivot="mid", alpha=0.6, scale=14 * float(np.abs(aside[inside]).max()))  # fmt: skip
        panel.set(xlabel="tilt from the summit [°]", aspect="equal", xlim=(-half, half), ylim=(-half, half))
        panel.set_title(title, loc="left")
    panels[0, 0].set(ylabel="tilt from the summit [°]")
    a = np.degrees(angles)
    left, right, last = panels[1]
    full = np.radians(np.linspace(0.5, 179.5, 180))
    plain = np.column_stack([2 * np.cos(full), np.sin(full)])
    left.plot(np.degrees(full), plain, label=["radial", "tangential"])
    left.axvline(90, color="k", ls=":", lw=1)
    left.set(xlabel="α [°]", ylabel="force over F0", xlim=(0, 180))
    left.set_title("eqs. (1) and (2)", loc="left")
    right.plot(a, 1e3 * asked[:, 0], "C0", label="radial, asked")
    right.plot(a, 1e3 * asked[:, 1], "C1", label="tangential, asked")
    right.plot(a[::_EVERY], 1e3 * given[:, 0], "C0o", ms=4, label="given by the exact inverse")
    right.plot(a[::_EVERY], 1e3 * given[:, 1], "C1o", ms=4)
    for angle, name in ((_NARROW, "θ1"), (_CUT, "θ2")):
        right.axvline(angle, color="k", ls=":", lw=1)
        right.annotate(name, (angle, right.get_ylim()[1]), (3, -12), textcoords="offset points")
    right.set(xlabel="α [°]", ylabel="force in contact [mN]", xlim=(0, 60))
    right.set_title("along a meridian of (c)", loc="left")
    size = np.linspace(-surface.half_angle_deg, surface.half_angle_deg, len(surface.heights))
    image = last.contourf(size, size, surface.heights, 15, cmap="terrain")
    figure.colorbar(image, ax=last, label="height", shrink=0.85)
    last.set(xlabel="tilt from the summit [°]", aspect="equal")
    last.set_title("the surface behind (d)", loc="left")
    for panel, place in ((left, "upper right"), (right, "lower left")):
        panel.axhline(0, color="k", lw=0.5)
        panel.legend(frameon=False, loc=place, fontsize=8)
        panel.grid(alpha=0.3)
    figure.savefig(path, dpi=110)
    return path
