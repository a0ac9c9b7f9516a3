"""Zárate 2020 beside its own assumption: what both inverses deliver, over the shell and over tool tilts (E16, E18).

Asked is a force of 300 mN, outwards or inwards, the worse of both; delivered is what `image_charges` says, which shares
neither formulas nor code with the models that both inverses use. The dipole inverse knows neither the magnet's length
nor the core's pull: outwards the two partly cancel, inwards they add up. Errors in millinewtons, and in just-noticeable
differences of force.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from haptorb.arrays import Array
from haptorb.control.allocation import LeastSquaresAllocator
from haptorb.devices.base import State
from haptorb.devices.electromagnet import FORCE_JND, SphericalElectromagnet, electromagnet
from haptorb_papers.reproduce.item import Item
from haptorb_papers.reproduce.zarate2020.image_charges import SecondWrench, compute_second_wrench

__all__ = ["GridPlace", "error_map", "items", "list_places"]

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
    """What both inverses err by, and what draws the maps."""
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
             "greatest error of the dipole inverse, magnet's length and core's pull together", None, 1e3 * worst,
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
