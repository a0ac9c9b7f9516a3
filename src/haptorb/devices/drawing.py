"""Scale drawings of a device: a section in a vertical plane, and a 3-D view, each with millimetre axes."""

from __future__ import annotations

import math
import textwrap
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from haptorb.arrays import Array
from haptorb.devices.geometry import Geometry, Reach, RoundPart, Spot
from haptorb.devices.motor_layout import spherical_frames
from haptorb.errors import InputError, UnknownName
from haptorb.figure_file import show_text_as_is

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "BODY",
    "CORE",
    "LABELS",
    "NORTH",
    "REACH",
    "SENSOR",
    "SOUTH",
    "VIEWS",
    "SectionPlane",
    "ball_facets",
    "choose_bar",
    "cut_part",
    "draw_geometry",
    "draw_section",
    "draw_space",
    "part_facets",
    "shade",
    "split_poles",
]


# --------------------------------------------------------------------------------------------------
# Where a vertical plane through the origin cuts a round part: exact outlines, from circles and straight lines.


_STEPS = 121  #: points of one curve
_PARALLEL = 1e-12  #: a plane whose axis' share is below this is parallel, or square, to the part's axis

#: a closed outline (n, 2), and where it has one a hole in it
Outline = tuple[Array, ...]


@dataclass(frozen=True)
class SectionPlane:
    """The plane that contains the z axis and the direction at `azimuth` [rad] from +x towards +y."""

    azimuth: float = 0.0

    @property
    def axes(self) -> Array:
        """(3, 3) rows: to the right in the section, upwards (+z), and towards the eye."""
        c, s = np.cos(self.azimuth), np.sin(self.azimuth)
        return np.array([[c, s, 0.0], [0.0, 0.0, 1.0], [s, -c, 0.0]])

    def project(self, points: Array) -> Array:
        """(n, 3) to the right, upwards and towards the eye [m], of `points` (n, 3) [m]."""
        projected: Array = np.atleast_2d(points) @ self.axes.T
        return projected


def cut_part(part: RoundPart, plane: SectionPlane) -> list[Outline]:
    """Outlines [m] of what `plane` cuts of `part`: none, one, or two where the hole divides it.

    Along e, the axis' direction in the plane, and f beside it, the plane's points are r = x e + y f + z n from the
    part's centre, with z the same for all. A point belongs to the part where its height along the axis is within half
    the length, and its distance from the axis between the radii: for each x two intervals of y, which meet where the
    hole is not cut.
    """
    x_axis, z_axis, eye = plane.axes
    k = part.axis / np.linalg.norm(part.axis)
    steep = float(k @ eye)
    inside = k - steep * eye
    flat = float(np.linalg.norm(inside))
    e = inside / flat if flat > _PARALLEL else x_axis
    f = np.cross(eye, e)
    z = -float(part.position @ eye)

    def limit(radius: float) -> tuple[float, float]:
        """x between which the distance from the axis can be below `radius`, within the part's length."""
        low, high = -np.inf, np.inf
        for slope, offset, most in ((flat, z * steep, part.length / 2), (steep, -z * flat, radius)):
            if abs(slope) > _PARALLEL:
                ends = sorted(((-most - offset) / slope, (most - offset) / slope))
                low, high = max(low, ends[0]), min(high, ends[1])
            elif abs(offset) >= most:
                return 0.0, 0.0
        return low, high

    def curve(radius: float) -> Array:
        """(n, 2) x and y ≥ 0 at that distance from the axis."""
        low, high = limit(radius)
        x = 0.5 * (low + high) - 0.5 * (high - low) * np.cos(np.linspace(0.0, np.pi, _STEPS))
        return np.stack([x, np.sqrt(np.maximum(radius**2 - (x * steep - z * flat) ** 2, 0.0))], axis=1)

    low, high = limit(part.outer_radius)
    if not low < high:
        return []
    outer, below = curve(part.outer_radius), np.array([1.0, -1.0])
    hole_low, hole_high = limit(part.inner_radius) if part.inner_radius > 0 else (0.0, 0.0)
    loops: list[Outline]
    if not hole_low < hole_high:
        loops = [(np.concatenate([outer, outer[::-1] * below]),)]
    else:
        inner = curve(part.inner_radius)
        at_low, at_high = np.isclose([hole_low, hole_high], [low, high], rtol=0, atol=1e-9 * part.outer_radius)
        if at_low and at_high:
            upper = np.concatenate([outer, inner[::-1]])
            loops = [(upper,), (upper * below,)]
        elif at_low or at_high:  # a notch at one end
            way = 1 if at_high else -1
            notch = np.concatenate([inner[::-way], inner[::way] * below])
            loops = [(np.concatenate([outer[::way], notch, outer[::-way] * below]),)]
        else:
            closed = [np.concatenate([one, one[::-1] * below]) for one in (outer, inner)]
            loops = [(closed[0], closed[1][::-1])]
    middle = part.position + z * eye
    to_plane = np.array([[e @ x_axis, e @ z_axis], [f @ x_axis, f @ z_axis]])
    origin = np.array([middle @ x_axis, middle @ z_axis])
    return [tuple(origin + loop @ to_plane for loop in outline) for outline in loops]


def split_poles(part: RoundPart) -> tuple[RoundPart, RoundPart]:
    """North and south half of a magnet."""
    sign = 1.0 if part.polarity > 0 else -1.0
    step = 0.25 * part.length * part.axis / np.linalg.norm(part.axis)
    north, south = (
        replace(part, position=part.position + side * step, length=part.length / 2) for side in (sign, -sign)
    )
    return north, south


# --------------------------------------------------------------------------------------------------
# Colours of a drawing, distinguished with any colour vision, and the scale bar.


#: Okabe and Ito's
NORTH, SOUTH, SENSOR, REACH = "#d55e00", "#0072b2", "#009e73", "#56b4e9"
CORE = "#9aa0a6"
BODY = {"coil": "#e0a040", "magnet": "#c0c6cc", "ring": "#c0c6cc"}
LABELS = {"coil": "coil (winding)", "magnet": "magnet", "ring": "magnet ring"}


def choose_bar(size: float) -> float:
    """Length of a scale bar [m], a round number, for a picture of a device of `size` [m].

    >>> choose_bar(0.07), choose_bar(0.14)
    (0.02, 0.05)
    """
    power = 10.0**-6
    best = power
    while power < 1e3:
        for step in (1.0, 2.0, 5.0):
            if step * power <= 0.4 * size:
                best = step * power
        power *= 10.0
    return round(best, 12)


# --------------------------------------------------------------------------------------------------
# The section: cut faces in millimetres, and outlines of the bodies in front of and behind the plane.


_IN_PLANE_M = 1.5e-3  #: a sensor or mark whose place is this near to the plane counts as in it [m]


def draw_section(axes: Any, geometry: Geometry, plane: SectionPlane) -> dict[str, Any]:
    """Draw `geometry` in `plane` into matplotlib's `axes`; return the entries of a legend."""
    entries: dict[str, Any] = {}
    if geometry.reach is not None:
        entries[f"workspace of the {geometry.reach.name}"] = _draw_reach(axes, geometry.reach)
    for ball in geometry.balls:
        solid = ball.role == "core"
        style = (
            {"facecolor": CORE, "edgecolor": "0.3"} if solid else {"fill": False, "edgecolor": "0.2", "linewidth": 1.5}
        )
        entries[ball.name] = _add_circle(axes, 1e3 * ball.radius, style)
        if ball.inner_radius:
            _draw_wall(axes, 1e3 * ball.inner_radius, 1e3 * ball.radius)
    for part in geometry.round_parts:
        _draw_part(axes, part, plane, entries)
    for rod in geometry.rods:
        ends = 1e3 * plane.project(np.stack([rod.start, rod.end]))
        across = np.ptp(ends[:, :2], axis=0).max() < 1.0  # seen along its axis
        style = {"marker": "o", "ms": 5, "ls": ""} if across else {"ls": "-.", "lw": 1}
        (entries[rod.name],) = axes.plot(ends[:, 0], ends[:, 1], color="0.2", label=rod.name, **style)
    for edge in geometry.edges:
        x, z = (1e3 * plane.project(edge.points))[:, :2].T
        (entries["edge of the workspace"],) = axes.plot(x, z, color=REACH, lw=1.5)
    for role, marker, colour in (("sensor", "s", SENSOR), ("mark", "o", "k")):
        _draw_spots(axes, geometry.select_spots(role), plane, (role, marker, colour), entries)
    _section_view_finish(axes, geometry, plane)
    return entries


def _draw_wall(axes: Any, inner: float, outer: float) -> None:
    """The wall of a dome as the plane cuts it [mm]: a ring, filled lightly."""
    from matplotlib.patches import Annulus

    axes.add_patch(
        Annulus((0.0, 0.0), outer, outer - inner, facecolor="0.85", edgecolor="0.2", linewidth=0.8, zorder=0)
    )


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
    inside = np.abs(places[:, 2]) <= _IN_PLANE_M
    for chosen, face, label in ((inside, colour, name), (~inside, "none", f"{name} off this plane")):
        if chosen.any():
            entries[label] = axes.plot(
                *(1e3 * places[chosen, :2]).T, marker, ms=4, mfc=face, mec=colour, mew=0.9, ls="", zorder=5
            )[0]


def _section_view_finish(axes: Any, geometry: Geometry, plane: SectionPlane) -> None:
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


# --------------------------------------------------------------------------------------------------
# Round parts and balls as flat facets with a shade, for a drawing in three dimensions.


_AROUND = 36  #: facets about an axis
_LIGHT = np.array([-0.45, -0.55, 0.70])  #: towards the lamp


def part_facets(part: RoundPart) -> Array:
    """(n, 4, 3) facets of `part` [m]: outer wall, inner wall where it is hollow, both ends."""
    turn = np.linspace(0.0, 2 * np.pi, _AROUND + 1)
    ring = np.stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)], axis=1)
    up = np.array([0.0, 0.0, part.length / 2])
    outer, inner = part.outer_radius * ring, part.inner_radius * ring

    def band(first: Array, second: Array) -> Array:
        return np.stack([first[:-1], first[1:], second[1:], second[:-1]], axis=1)

    walls = [band(outer - up, outer + up), band(outer + up, inner + up), band(inner - up, outer - up)]
    if part.inner_radius > 0:
        walls.append(band(inner + up, inner - up))
    frame = spherical_frames(part.axis[None])[0]
    facets: Array = np.concatenate(walls) @ frame.T + part.position
    return facets


def ball_facets(radius: float) -> Array:
    """(n, 4, 3) facets of a ball about the origin [m]."""
    polar, turn = np.linspace(0.0, np.pi, 19), np.linspace(0.0, 2 * np.pi, _AROUND + 1)
    grid = radius * np.stack(
        [
            np.sin(polar)[:, None] * np.cos(turn),
            np.sin(polar)[:, None] * np.sin(turn),
            np.repeat(np.cos(polar)[:, None], len(turn), axis=1),
        ],
        axis=2,
    )
    facets: Array = np.stack([grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]], axis=2).reshape(-1, 4, 3)
    return facets


def shade(facets: Array, colour: tuple[float, float, float], opacity: float = 1.0) -> Array:
    """(n, 4) colours [1] of `facets` (n, 4, 3) [m] of a body of that `colour`, 0 to 1; light from upper left."""
    normals = np.cross(facets[:, 2] - facets[:, 0], facets[:, 3] - facets[:, 1])
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    light = np.clip(normals / np.maximum(length, 1e-30) @ (_LIGHT / np.linalg.norm(_LIGHT)), 0.0, 1.0)
    lit: Array = np.empty((len(facets), 4))
    lit[:, :3] = np.clip(np.asarray(colour) * (0.55 + 0.55 * light[:, None]), 0.0, 1.0)
    lit[:, 3] = opacity
    return lit


# --------------------------------------------------------------------------------------------------
# The view in three dimensions, without perspective: one millimetre is as long everywhere.


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
    for edge in geometry.edges:
        axes.plot(*(1e3 * edge.points).T, color=REACH, lw=1.5)
    for role, marker, colour in (("sensor", "s", SENSOR), ("mark", "o", "k")):
        spots = geometry.select_spots(role)
        if spots:
            axes.plot(*(1e3 * np.stack([spot.position for spot in spots])).T, marker, ms=4, color=colour, ls="")
    _space_view_finish(
        axes, geometry, np.concatenate([surface.reshape(-1, 3) for surface in facets] or [np.zeros((1, 3))])
    )


def _draw_dome(axes: Any, radius: float) -> None:
    """Draw a hemisphere as a few circles, so that the parts below it stay visible."""
    turn, rise = np.linspace(0.0, 2 * np.pi, 73), np.linspace(0.0, np.pi, 37)
    style = {"color": "0.45", "lw": 0.6}
    for height in np.radians([0.0, 30.0, 60.0]):
        ring = radius * np.cos(height)
        axes.plot(ring * np.cos(turn), ring * np.sin(turn), radius * np.sin(height), **style)
    for azimuth in np.radians([0.0, 45.0, 90.0, 135.0]):
        flat = radius * np.cos(rise)
        axes.plot(flat * np.cos(azimuth), flat * np.sin(azimuth), radius * np.sin(rise), **style)


def _space_view_finish(axes: Any, geometry: Geometry, corners: Array) -> None:
    points = [corners, *(spot.position[None] for spot in geometry.spots)]
    points += [np.stack([rod.start, rod.end]) for rod in geometry.rods] + [edge.points for edge in geometry.edges]
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
    axes.set_title("Oblique view, parallel projection", loc="left", fontsize=11)


VIEWS = ("section", "3d", "both")


def draw_geometry(geometry: Geometry, title: str, view: str = "both", azimuth: float = 0.0) -> Figure:
    """The drawing of `geometry`; `azimuth` [°] turns the plane of the section about +z, from +x towards +y.

    Raises UnknownName for another view, InputError for an angle that is not finite.
    """
    from matplotlib.figure import Figure

    if view not in VIEWS:
        raise UnknownName("view of a drawing", view, VIEWS)
    if not math.isfinite(azimuth):
        raise InputError(f"the azimuth of the section must be a finite angle in degrees; got {azimuth!r}")
    wide = view == "both"
    figure = Figure(figsize=(13 if wide else 7.5, 8.0))
    notes = [line for note in geometry.notes
             for line in textwrap.wrap(note, 190 if wide else 105, subsequent_indent="   ")]  # fmt: skip
    base = 0.02 + 0.018 * len(notes)
    figure.text(0.02, 0.01, "\n".join(notes), fontsize=8, color="0.3", va="bottom")
    figure.suptitle(title, x=0.02, ha="left", fontweight="bold")
    places = figure.add_gridspec(1, 2 if wide else 1, left=0.07, right=0.97, top=0.9, bottom=base + 0.17, wspace=0.12)
    if view != "3d":
        plane = SectionPlane(math.radians(azimuth))
        entries = draw_section(figure.add_subplot(places[0]), geometry, plane)
        figure.legend(entries.values(), entries.keys(), loc="lower left", bbox_to_anchor=(0.02, base),
                      ncols=5 if wide else 3, fontsize=8, frameon=False)  # fmt: skip
    if view != "section":
        draw_space(figure.add_subplot(places[-1], projection="3d"), geometry)
    return show_text_as_is(figure)
