"""The view in three dimensions, without perspective: one millimetre is as long everywhere."""

from __future__ import annotations

from typing import Any

import numpy as np

from haptorb.apps.show.section import split_poles
from haptorb.apps.show.solid import ball_facets, part_facets, shade
from haptorb.apps.show.style import BODY, CORE, NORTH, SENSOR, SOUTH, choose_bar
from haptorb.devices.geometry import Geometry
from haptorb.numerics.arrays import Array

__all__ = ["draw_space"]

_ELEVATION, _AZIMUTH = 24.0, -62.0  #: of the view, as in the console [°]
_CLEAR = 0.35  #: opacity of many moving parts, which would hide the fixed ones


def draw_space(axes: Any, geometry: Geometry) -> None:
    """Draw `geometry` into matplotlib's `axes`, whose projection is 3d."""
    from matplotlib.colors import to_rgb
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    facets, colours = [], []
    many = sum(part.moves for part in geometry.round_parts) > 4

    def add(surface: Array, colour: str, opacity: float) -> None:
        facets.append(surface)
        colours.append(shade(surface, to_rgb(colour), opacity))

    for ball in geometry.balls:
        if ball.role == "core":
            add(ball_facets(ball.radius), CORE, 1.0)
        else:
            _draw_dome(axes, 1e3 * ball.radius)
    for part in geometry.round_parts:
        opacity = _CLEAR if part.moves and many else 1.0 if part.stated else 0.4
        if part.polarity:
            for half, colour in zip(split_poles(part), (NORTH, SOUTH), strict=True):
                add(part_facets(half), colour, opacity)
        else:
            add(part_facets(part), BODY[part.role], opacity)
    if facets:  # all in one, or they would not be sorted by their depth
        lit = np.concatenate(colours)
        solid = Poly3DCollection(1e3 * np.concatenate(facets), facecolors=lit, edgecolors=lit, linewidths=0.2)
        axes.add_collection3d(solid)
    for rod in geometry.rods:
        axes.plot(*(1e3 * np.stack([rod.start, rod.end])).T, color="0.2", lw=1.2, ls="-.")
    for role, marker, colour in (("sensor", "s", SENSOR), ("mark", "o", "k")):
        spots = geometry.select_spots(role)
        if spots:
            axes.plot(*(1e3 * np.stack([spot.position for spot in spots])).T, marker, ms=4, color=colour, ls="")
    _finish(axes, geometry, np.concatenate([surface.reshape(-1, 3) for surface in facets] or [np.zeros((1, 3))]))


def _draw_dome(axes: Any, radius: float) -> None:
    """Half a ball as a few circles: what is under it stays visible."""
    turn, rise = np.linspace(0.0, 2 * np.pi, 73), np.linspace(0.0, np.pi, 37)
    style = {"color": "0.45", "lw": 0.6}
    for height in np.radians([0.0, 30.0, 60.0]):
        ring = radius * np.cos(height)
        axes.plot(ring * np.cos(turn), ring * np.sin(turn), radius * np.sin(height), **style)
    for azimuth in np.radians([0.0, 45.0, 90.0, 135.0]):
        flat = radius * np.cos(rise)
        axes.plot(flat * np.cos(azimuth), flat * np.sin(azimuth), radius * np.sin(rise), **style)


def _finish(axes: Any, geometry: Geometry, corners: Array) -> None:
    points = [corners, *(spot.position[None] for spot in geometry.spots)]
    points += [np.stack([rod.start, rod.end]) for rod in geometry.rods]
    everything = 1e3 * np.concatenate(points)
    low, high = everything.min(axis=0), everything.max(axis=0)
    bar = 1e3 * choose_bar(geometry.size)
    low[2] -= 0.9 * bar  # room for the scale bar
    axes.set_proj_type("ortho")
    axes.view_init(_ELEVATION, _AZIMUTH)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set(xlabel="x [mm]", ylabel="y [mm]", zlabel="z [mm]")
    axes.set_box_aspect(high - low, zoom=1.0)
    axes.tick_params(labelsize=7)
    # To the right as the eye sees it, so that nothing of its length is lost.
    right = np.array([-np.sin(np.radians(_AZIMUTH)), np.cos(np.radians(_AZIMUTH)), 0.0])
    middle = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    ends = np.stack([middle - 0.5 * bar * right, middle + 0.5 * bar * right])
    axes.plot(*ends.T, color="k", lw=3, zorder=20)
    axes.text(
        middle[0], middle[1], middle[2] + 0.1 * bar, f"{bar:g} mm", ha="center", va="bottom", fontsize=8, zorder=20
    )
    axes.set_title("View from the front, without perspective", loc="left", fontsize=11)
