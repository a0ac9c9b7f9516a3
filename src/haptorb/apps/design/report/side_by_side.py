"""A design's device and the base device in section, side by side and to one scale."""

from __future__ import annotations

from io import BytesIO
from typing import Any

from haptorb.apps.show.section import SectionPlane
from haptorb.apps.show.section_view import draw_section
from haptorb.apps.show.space_view import draw_space
from haptorb.devices.device import Device
from haptorb.devices.geometry import Geometry

__all__ = ["draw_beside"]

_WIDTH, _HEIGHT, _BELOW = 12.0, 10.6, 0.9  #: of the figure, and of its legend [inch]
_DOTS = 90  #: per inch


def draw_beside(device: Device, base: Device) -> bytes:
    """A PNG picture: sections above, views in three dimensions below, `device` at the left and `base` at the right.

    One millimetre is as long in both. InputError for a kind of device without geometry.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(_WIDTH, _HEIGHT))
    places = figure.add_gridspec(
        2, 2, left=0.06, right=0.98, top=0.95, bottom=_BELOW / _HEIGHT, wspace=0.14, hspace=0.16
    )
    sections: list[Any] = []
    spaces: list[Any] = []
    entries: dict[str, Any] = {}
    for column, (name, one) in enumerate((("this design", device), (f"base device: {base.name}", base))):
        geometry: Geometry = one.kind.require_part("geometry", one.name, "`haptorb design report`")(one)
        section = figure.add_subplot(places[0, column])
        entries |= draw_section(section, geometry, SectionPlane())
        section.set_title(f"Section, {name}", loc="left", fontsize=11)
        space = figure.add_subplot(places[1, column], projection="3d")
        draw_space(space, geometry)
        space.set_title(f"From the front, {name}", loc="left", fontsize=11)
        sections.append(section)
        spaces.append(space)
    _unite(sections, ("xlim", "ylim"))
    _unite(spaces, ("xlim", "ylim", "zlim"))
    for space in spaces:
        space.set_box_aspect([high - low for low, high in (space.get_xlim(), space.get_ylim(), space.get_zlim())])
    figure.legend(list(entries.values()), list(entries), loc="lower center", ncols=5, fontsize=8, frameon=False)
    file = BytesIO()
    figure.savefig(file, format="png", dpi=_DOTS)
    return file.getvalue()


def _unite(axes: list[Any], limits: tuple[str, ...]) -> None:
    """The same limits for all `axes`: those that hold everything."""
    for limit in limits:
        ends = [getattr(one, f"get_{limit}")() for one in axes]
        whole = min(low for low, _ in ends), max(high for _, high in ends)
        for one in axes:
            getattr(one, f"set_{limit}")(*whole)
