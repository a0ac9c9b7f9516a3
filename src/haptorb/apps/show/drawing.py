"""A device to scale: its section in a vertical plane, and a view in three dimensions, with a millimetre axis each."""

from __future__ import annotations

import math
import textwrap
from typing import TYPE_CHECKING

from haptorb.apps.show.section import SectionPlane
from haptorb.apps.show.section_view import draw_section
from haptorb.apps.show.space_view import draw_space
from haptorb.devices.device import Device
from haptorb.devices.geometry import Geometry
from haptorb.errors import InputError, UnknownName

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["VIEWS", "draw_device"]

VIEWS = ("section", "3d", "both")


def draw_device(device: Device, view: str = "both", azimuth: float = 0.0) -> Figure:
    """The drawing of `device`; `azimuth` [°] turns the plane of the section about +z, from +x towards +y.

    Raises UnknownName for another view, InputError for an angle that is none or a kind that has no geometry.
    """
    from matplotlib.figure import Figure

    if view not in VIEWS:
        raise UnknownName("view of a drawing", view, VIEWS)
    if not math.isfinite(azimuth):
        raise InputError(f"the azimuth of the section must be a finite angle in degrees; got {azimuth!r}")
    geometry: Geometry = device.kind.require_part("geometry", device.name, "`haptorb show`")(device)
    wide = view == "both"
    figure = Figure(figsize=(13 if wide else 7.5, 8.0))
    notes = [line for note in geometry.notes
             for line in textwrap.wrap(note, 190 if wide else 105, subsequent_indent="   ")]  # fmt: skip
    base = 0.02 + 0.018 * len(notes)
    figure.text(0.02, 0.01, "\n".join(notes), fontsize=8, color="0.3", va="bottom")
    figure.suptitle(device.title, x=0.02, ha="left", fontweight="bold")
    places = figure.add_gridspec(1, 2 if wide else 1, left=0.07, right=0.97, top=0.9, bottom=base + 0.17, wspace=0.12)
    if view != "3d":
        plane = SectionPlane(math.radians(azimuth))
        entries = draw_section(figure.add_subplot(places[0]), geometry, plane)
        figure.legend(entries.values(), entries.keys(), loc="lower left", bbox_to_anchor=(0.02, base),
                      ncols=5 if wide else 3, fontsize=8, frameon=False)  # fmt: skip
    if view != "section":
        draw_space(figure.add_subplot(places[-1], projection="3d"), geometry)
    return figure
