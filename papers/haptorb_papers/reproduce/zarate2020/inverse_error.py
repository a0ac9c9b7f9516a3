"""Zárate 2020: actual force of both inverses over the shell and tool tilts, against its assumption (E16, E18, E35).

Asked is a force of 300 mN, outwards or inwards, the worse of both; delivered is what loops, image charges and the
magnet's own currents say, which shares neither formulas nor code with the models that both inverses use. The dipole
inverse knows neither the size of coils and magnet nor the core's pull. Errors in millinewtons, and in just-noticeable
differences of force.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from haptorb.arrays import Array, gauss_legendre
from haptorb.control.allocation import LeastSquaresAllocator
from haptorb.devices.api import electromagnet
from haptorb.devices.base import State
from haptorb.devices.electromagnet import FORCE_JND, SphericalElectromagnet
from haptorb_papers.reproduce.item import Item
from haptorb_papers.reproduce.zarate2020.second_coils import compute_coil_fields

__all__ = ["GridPlace", "SecondWrench", "compute_second_wrench", "error_map", "items", "list_places"]


# --------------------------------------------------------------------------------------------------
# The wrench on an Omni's tool a second time: no code, no formula and no numbers of the package's models are used.
#
# The package takes the tool's ring magnet for charges on its faces, and the core's answer for a series in spherical
# harmonics. Here the ring is the current ±M that circulates on its two walls, F = ∮ I dl × B, in the field of the
# electromagnet's dipole and of the core's image charges. A charge q at s outside a sphere of radius a and relative
# permeability µ has the image −q k a/|s| at a²s/|s|², k = (µ−1)/(µ+1), and from there to the centre a line of as much
# charge in all, with the opposite sign and the density x^(−µ/(µ+1)) (C. Neumann 1883; I. V. Lindell, Am. J. Phys. 61,
# 39, 1993). For µ → ∞ all of the line's charge is at the centre.


_MU0 = 4e-7 * np.pi
_ACROSS, _ALONG, _AROUND, _LINE = 4, 10, 24, 8  #: nodes of the faces, along the walls, around both, of an image's line


class SecondWrench(NamedTuple):
    """Wrench on the tool about its magnet."""

    per_ampere: Array  #: (6, m) [N/A, N·m/A]
    passive: Array  #: (6,) from the core alone [N, N·m]


def compute_second_wrench(device: SphericalElectromagnet, state: State) -> SecondWrench:
    """The wrench of the coils per ampere, and of the core's images, on the currents of the tool's magnet.

    >>> from haptorb.devices.loader import load
    >>> second = compute_second_wrench(load("omni"), State.at((0, 0, 0.05)))
    >>> round(1e3 * float(second.passive[2]), 1)     # erratum E18
    -52.9
    """
    points, elements = _wall_currents(device, state)

    def wrench(field: Array) -> Array:
        forces = np.cross(elements, field)
        return np.concatenate([forces.sum(axis=0), np.cross(points - state.p, forces).sum(axis=0)])

    coils = compute_coil_fields(device, points)
    per_ampere = np.stack([wrench(coils[:, :, k]) for k in range(device.channels)], axis=1)
    places, charges = _core_images(device, state)
    return SecondWrench(per_ampere, wrench(_field(places, charges, points)))


def _wall_currents(device: SphericalElectromagnet, state: State) -> tuple[Array, Array]:
    """Points (n, 3) [m] on both walls and I dl (n, 3) [A·m] there, stator frame."""
    tool = device.tool
    node, weight = gauss_legendre(_ALONG)
    height, current = 0.5 * tool.length * node, 0.5 * tool.length * weight * tool.remanence / _MU0
    angle = 2 * np.pi * np.arange(_AROUND) / _AROUND
    points, elements = [], []
    for radius, sign in ((tool.outer_radius, 1.0), (tool.inner_radius, -1.0)):
        z, turn = (part.ravel() for part in np.meshgrid(height, angle, indexing="ij"))
        size = sign * np.repeat(current, _AROUND) * radius * 2 * np.pi / _AROUND
        points.append(np.stack([radius * np.cos(turn), radius * np.sin(turn), z], axis=1))
        elements.append(size[:, None] * np.stack([-np.sin(turn), np.cos(turn), np.zeros_like(turn)], axis=1))
    return np.concatenate(points) @ state.R_SR.T + state.p, np.concatenate(elements) @ state.R_SR.T


def _core_images(device: SphericalElectromagnet, state: State) -> tuple[Array, Array]:
    """Places (n, 3) [m] and charges (n,) [A·m] of the images in the core of what is on the magnet's faces."""
    tool, a, mu = device.tool, device.core_radius, device.core_permeability
    node, weight = gauss_legendre(_ACROSS)
    middle, half = 0.5 * (tool.outer_radius + tool.inner_radius), 0.5 * (tool.outer_radius - tool.inner_radius)
    rho, angle = middle + half * node, 2 * np.pi * (np.arange(_AROUND) + 0.5) / _AROUND
    charge = np.repeat(half * weight * rho, _AROUND) * 2 * np.pi / _AROUND * tool.remanence / _MU0
    x, y = np.outer(rho, np.cos(angle)).ravel(), np.outer(rho, np.sin(angle)).ravel()
    z = np.full_like(x, 0.5 * tool.length)
    faces = np.concatenate([np.stack([x, y, z], axis=1), np.stack([x, y, -z], axis=1)])
    at, q = faces @ state.R_SR.T + state.p, np.concatenate([charge, -charge])
    square = (at**2).sum(axis=1)
    kelvin = at * (a * a / square)[:, None]
    share = 1.0 if np.isinf(mu) else (mu - 1.0) / (mu + 1.0)
    image = share * q * a / np.sqrt(square)
    places, charges = [kelvin], [-image]
    for where, part in zip(*_line(mu), strict=True):
        places.append(where * kelvin)
        charges.append(part * image)
    return np.concatenate(places), np.concatenate(charges)


def _line(mu: float) -> tuple[Array, Array]:
    """Positions of an image's line charge, from 0 at the centre to 1, and its shares, which sum to 1."""
    if np.isinf(mu):
        return np.zeros(1), np.ones(1)
    from scipy.special import roots_jacobi

    node, weight = roots_jacobi(_LINE, 0.0, -mu / (mu + 1.0))
    return 0.5 * (node + 1.0), weight / weight.sum()


def _field(places: Array, charges: Array, points: Array) -> Array:
    """(n, 3) [T] at `points` of point charges."""
    x, y, z = (points[:, None, axis] - places[None, :, axis] for axis in range(3))
    square = x * x + y * y + z * z
    strength = _MU0 / (4 * np.pi) * charges / (square * np.sqrt(square))
    return np.stack([(strength * part).sum(axis=1) for part in (x, y, z)], axis=1)


_ASKED = 0.3  #: [N]
_TILTS = (0.0, 15.0, 30.0)  #: [°]


class GridPlace(NamedTuple):
    """A pose of the tool, and what currents really do to it there."""

    cell: tuple[int, int]  #: of the map: distance and angle
    up: Array  #: (3,) radially outwards
    state: State
    second: SecondWrench


def list_places(device: SphericalElectromagnet, tilt: float, distances: Array, angles: Array) -> list[GridPlace]:
    """Every distance [m] and polar angle [rad], the tool tilted by `tilt` [rad] in four ways."""
    found = []
    ways = np.arange(4) * np.pi / 2 if tilt else np.zeros(1)
    for (i, distance), (j, polar) in product(enumerate(distances), enumerate(angles)):
        u = np.array([np.sin(polar), 0.0, np.cos(polar)])
        e, f = np.array([np.cos(polar), 0.0, -np.sin(polar)]), np.array([0.0, 1.0, 0.0])
        for way in ways:
            axis = np.cos(tilt) * u + np.sin(tilt) * (np.cos(way) * e + np.sin(way) * f)
            state = State.at(distance * u, axis)
            found.append(GridPlace((i, j), u, state, compute_second_wrench(device, state)))
    return found


def error_map(device: SphericalElectromagnet, model: str, places: list[GridPlace], asked: float = _ASKED) -> Array:
    """(distances, angles) [N] of force error by the inverse of `model`, the worst of all places of a cell and of
    `asked` [N] outwards and inwards."""
    allocator = LeastSquaresAllocator.force(1e3 * device.coils.current_limit, compensate_passive=True)
    out = np.zeros(np.max([place.cell for place in places], axis=0) + 1)
    for place in places:
        believed = device.wrench_map(place.state, model)
        for force in (asked * place.up, -asked * place.up):
            currents = allocator.allocate(believed, np.concatenate([force, np.zeros(3)])).currents
            given = place.second.per_ampere @ currents + place.second.passive
            out[place.cell] = max(out[place.cell], float(np.linalg.norm(given[:3] - force)))
    return out


def items(report: Callable[[float], None]) -> tuple[tuple[Item, ...], Callable[[Path], Path]]:
    """Errors of both inverses, and the function that draws the maps."""
    from haptorb.devices.loader import load

    device = electromagnet(load("omni"))
    distances = device.contact_distance + np.linspace(0, device.shell_thickness, 6)
    angles = np.linspace(0, device.workspace_half_angle, 7)
    maps: dict[str, list[Array]] = {"published": [], "exact": []}
    for n, tilt in enumerate(_TILTS):
        places = list_places(device, np.radians(tilt), distances, angles)
        for model, errors in maps.items():
            errors.append(error_map(device, model, places))
        report((n + 1) / len(_TILTS))
    found = []
    worst = max(float(errors.max()) for errors in maps["exact"])
    found.append(
        Item("inverse-exact", "zarate2020", "eq. (1)",
             "largest error of the exact inverse over shell and tilts to 30°, relative to the force asked", 0.0,
             100 * worst / _ASKED, "%", 1.0, why="a seventh of a just-noticeable difference", implied=True,
             basis="own")
    )  # fmt: skip
    worst = max(float(errors.max()) for errors in maps["published"])
    found.append(
        Item("inverse-dipole", "zarate2020", "eq. (1)",
             "greatest error of the dipole inverse: sizes of coils and magnet, core's pull", None, 1e3 * worst,
             "mN", None)
    )  # fmt: skip
    return tuple(found), lambda path: _draw_figure(maps, distances, angles, path)


def _draw_figure(maps: dict[str, list[Array]], distances: Array, angles: Array, path: Path) -> Path:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 6.5), layout="constrained")
    FigureCanvasAgg(figure)
    top = 1e3 * max(float(one.max()) for errors in maps.values() for one in errors)
    panels = figure.subplots(2, len(_TILTS), sharex=True, sharey=True)
    for row, (model, errors) in zip(panels, maps.items(), strict=True):
        for panel, one, tilt in zip(row, errors, _TILTS, strict=True):
            shown = panel.pcolormesh(
                np.degrees(angles), 1e3 * distances, 1e3 * one, vmin=0, vmax=top, shading="gouraud", cmap="viridis"
            )
            most = f"at most {1e3 * float(one.max()):.2g} mN"
            panel.set_title(f"{model} inverse, tool tilted {tilt:.0f}°: {most}", loc="left", fontsize=9)
        bar = figure.colorbar(shown, ax=row, label="error of the force [mN]")
        second = bar.ax.secondary_yaxis("left", functions=(_jnds, _millinewtons))
        second.set_ylabel("JND of 300 mN")
        row[0].set_ylabel("magnet from the centre [mm]")
    for panel in panels[-1]:
        panel.set_xlabel("angle from the summit [°]")
    figure.suptitle(
        "Error of the delivered force, 300 mN asked outwards or inwards, the larger of both: effect of the model"
    )
    figure.savefig(path, dpi=120)
    return path


def _jnds(millinewtons: Any) -> Any:
    return millinewtons / (1e3 * _ASKED * FORCE_JND)


def _millinewtons(jnds: Any) -> Any:
    return jnds * (1e3 * _ASKED * FORCE_JND)
