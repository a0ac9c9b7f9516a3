"""The section: what the plane cuts, in millimetres, and what lies before or behind it in outline."""

from __future__ import annotations

from typing import Any

import numpy as np

from haptorb.apps.show.section import SectionPlane, cut_part, split_poles
from haptorb.apps.show.style import BODY, CORE, LABELS, NORTH, REACH, SENSOR, SOUTH, choose_bar
from haptorb.devices.geometry import Geometry, Reach, RoundPart, Spot
from haptorb.numerics.arrays import Array

__all__ = ["draw_section"]

_NEAR = 1.5e-3  #: a sensor or mark whose place is this near to the plane counts as in it [m]


def draw_section(axes: Any, geometry: Geometry, plane: SectionPlane) -> dict[str, Any]:
    """Draw `geometry` in `plane` into matplotlib's `axes`; what its signs mean, for a legend."""
    entries: dict[str, Any] = {}
    if geometry.reach is not None:
        entries[f"workspace of the {geometry.reach.name}"] = _draw_reach(axes, geometry.reach)
    for ball in geometry.balls:
        solid = ball.role == "core"
        style = (
            {"facecolor": CORE, "edgecolor": "0.3"} if solid else {"fill": False, "edgecolor": "0.2", "linewidth": 1.5}
        )
        entries[ball.name] = _add_circle(axes, 1e3 * ball.radius, style)
    for part in geometry.round_parts:
        _draw_part(axes, part, plane, entries)
    for rod in geometry.rods:
        ends = 1e3 * plane.project(np.stack([rod.start, rod.end]))
        (entries[rod.name],) = axes.plot(ends[:, 0], ends[:, 1], color="0.2", ls="-.", lw=1, label=rod.name)
    for role, marker, colour in (("sensor", "s", SENSOR), ("mark", "o", "k")):
        _draw_spots(axes, geometry.select_spots(role), plane, (role, marker, colour), entries)
    _finish(axes, geometry, plane)
    return entries


def _draw_part(axes: Any, part: RoundPart, plane: SectionPlane, entries: dict[str, Any]) -> None:
    loose = "" if part.stated else ", not to scale"
    whole = cut_part(part, plane)
    bodies = [(part, BODY[part.role], LABELS[part.role])]
    if part.polarity:
        north, south = split_poles(part)
        bodies = [(north, NORTH, "magnet: north end"), (south, SOUTH, "magnet: south end")]
    for body, colour, name in bodies:
        for outline in cut_part(body, plane):
            entries[name + loose] = _add_outline(axes, outline, colour, part)
    if part.role == "coil" and whole:
        _label_coil(axes, whole[0], part)


def _add_outline(axes: Any, outline: tuple[Array, ...], colour: str, part: RoundPart) -> Any:
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path

    path = Path.make_compound_path(*(Path(1e3 * loop, closed=True) for loop in map(_close, outline)))
    patch = PathPatch(
        path, facecolor=colour, edgecolor="0.15", linewidth=0.8, linestyle="-" if part.stated else "--",
        alpha=1.0 if part.stated else 0.5, hatch="////" if part.role == "coil" else None,
    )  # fmt: skip
    patch.set_gid(part.name)
    axes.add_patch(patch)
    return patch


def _close(loop: Array) -> Array:
    return np.concatenate([loop, loop[:1]])


def _label_coil(axes: Any, outline: tuple[Array, ...], part: RoundPart) -> None:
    """Its name and its channel: on the winding where they are short, otherwise on the side of the centre."""
    text = part.name if part.channel in ("", part.name) else f"{part.name} {part.channel}"
    loop = outline[0]
    place, side = loop.mean(axis=0), "center"
    if len(outline) > 1:  # a ring: its middle is empty
        radius = 0.5 * (np.abs(loop[:, 1]).max() + np.abs(outline[1][:, 1]).max())
        place = place + radius * np.array([-0.7, 0.7])
    elif len(text) > 2:
        right = place[0] > 0
        place, side = (
            np.array([loop[:, 0].min() if right else loop[:, 0].max(), place[1]]),
            "right" if right else "left",
        )
    box = {"boxstyle": "round,pad=0.12", "facecolor": "white", "edgecolor": "none", "alpha": 0.85}
    axes.text(*(1e3 * place), f" {text} ", fontsize=7, ha=side, va="center", bbox=box, zorder=6)


def _add_circle(axes: Any, radius: float, style: dict[str, Any]) -> Any:
    from matplotlib.patches import Circle

    patch = Circle((0.0, 0.0), radius, **style)
    axes.add_patch(patch)
    return patch


def _draw_reach(axes: Any, reach: Reach) -> Any:
    angle = np.linspace(-reach.half_angle, reach.half_angle, 121)
    rim = np.stack([np.sin(angle), np.cos(angle)], axis=1)
    if reach.farthest > reach.nearest:
        area = 1e3 * np.concatenate([reach.nearest * rim, reach.farthest * rim[::-1]])
        return axes.fill(*area.T, facecolor=REACH, alpha=0.2, edgecolor=REACH, zorder=0)[0]
    return axes.plot(*(1e3 * reach.farthest * rim).T, color=REACH, lw=3, alpha=0.6, zorder=0)[0]


def _draw_spots(
    axes: Any, spots: tuple[Spot, ...], plane: SectionPlane, style: tuple[str, str, str], entries: dict[str, Any]
) -> None:
    if not spots:
        return
    role, marker, colour = style
    name = "field sensor" if role == "sensor" else role
    places = plane.project(np.stack([spot.position for spot in spots]))
    inside = np.abs(places[:, 2]) <= _NEAR
    for chosen, face, label in ((inside, colour, name), (~inside, "none", f"{name} off this plane")):
        if chosen.any():
            entries[label] = axes.plot(
                *(1e3 * places[chosen, :2]).T, marker, ms=4, mfc=face, mec=colour, mew=0.9, ls="", zorder=5
            )[0]


def _finish(axes: Any, geometry: Geometry, plane: SectionPlane) -> None:
    from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar

    degrees = float(np.degrees(plane.azimuth))
    across = "x" if degrees == 0 else f"along {degrees:g}° from +x towards +y"
    axes.margins(0.08, 0.1)
    axes.autoscale_view()
    axes.set(aspect="equal", xlabel=f"{across} [mm]", ylabel="z [mm]")
    bar = 1e3 * choose_bar(geometry.size)
    axes.add_artist(AnchoredSizeBar(axes.transData, bar, f"{bar:g} mm", "lower left", size_vertical=bar / 40))
    axes.set_title("Section through the centre", loc="left", fontsize=11)
    axes.grid(alpha=0.2)
    axes.set_axisbelow(True)
