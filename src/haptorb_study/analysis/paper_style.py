"""Style of figures for publication: widths in millimetres, colours for any colour vision, never colour alone.

The colours are those of Okabe and Ito 2008, and for shades matplotlib's cividis (Nuñez et al. 2018), whose lightness
grows evenly, so that it survives a photocopy. Conditions differ in marker and line style besides.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from haptorb.errors import InputError
from haptorb_study.analysis.analysis import Analysis

__all__ = [
    "COLOURS",
    "DASHES",
    "INK",
    "MARKERS",
    "MM",
    "SHADES",
    "PaperSize",
    "draw_open_interval",
    "new_paper_figure",
    "use_paper_style",
]


MM = 1 / 25.4  #: inches
INK = "#000000"
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")  #: Okabe–Ito
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
DASHES = ("-", "--", ":", "-.", (0, (5, 1, 1, 1, 1, 1)), (0, (1, 3)), (0, (7, 3)))
SHADES = "cividis"
_STYLE: Mapping[str, Any] = {
    "font.family": "DejaVu Sans", "font.size": 7.0, "axes.labelsize": 7.0, "axes.titlesize": 7.0,
    "xtick.labelsize": 6.5, "ytick.labelsize": 6.5, "legend.fontsize": 6.5, "figure.titlesize": 7.5,
    "axes.linewidth": 0.6, "lines.linewidth": 1.0, "lines.markersize": 4.0, "xtick.major.width": 0.6,
    "ytick.major.width": 0.6, "xtick.major.size": 2.5, "ytick.major.size": 2.5, "axes.spines.top": False,
    "axes.spines.right": False, "legend.frameon": False, "axes.unicode_minus": True,
    # TrueType outlines are embedded in PDF (many publishers reject type 3); in SVG, text becomes outlines.
    "pdf.fonttype": 42, "ps.fonttype": 42, "svg.fonttype": "path", "svg.hashsalt": "haptorb", "savefig.bbox": None,
}  # fmt: skip


@dataclass(frozen=True)
class PaperSize:
    """Column widths of a journal [mm]."""

    single: float = 85.0
    double: float = 174.0

    def __post_init__(self) -> None:
        if not 50 <= self.single <= self.double <= 400:
            raise InputError(
                f"widths of figures must be 50 to 400 mm, single first; got {self.single:g} and {self.double:g}"
            )


def use_paper_style() -> AbstractContextManager[None]:
    """Matplotlib settings for drawing and writing."""
    settings: Any = dict(_STYLE)
    return matplotlib.rc_context(settings)


def new_paper_figure(analysis: Analysis, width: float, height: float) -> Figure:
    """New empty figure; the participants are named below it, SIMULATED is printed above it where that applies."""
    figure = Figure(figsize=(width * MM, height * MM), layout="constrained")
    if analysis.marked:
        figure.suptitle("SIMULATED", x=0.99, ha="right", fontweight="bold", color=COLOURS[1])
    figure.supxlabel(_wrap(analysis.origin, width), x=0.01, ha="left", fontsize=5.5, color="0.25")
    return figure


def draw_open_interval(
    axes: Axes, limits: tuple[float, float], at: float, colour: str, *, upright: bool = False, width: float = 1.2
) -> None:
    """Draw the interval `limits` at position `at`; an open limit is an arrow to the edge of `axes`. NaN: nothing.

    Limits beyond the axes become arrows too. Call it last: the axes keep the range that they have.
    """
    low, high = limits
    if math.isnan(low) or math.isnan(high):
        return
    edges = sorted(axes.get_ylim() if upright else axes.get_xlim())
    (axes.set_ylim if upright else axes.set_xlim)(*edges)  # open limits do not widen the axes
    inner = [min(max(end, edges[0]), edges[1]) for end in (low, high)]
    for end, inside, other in ((low, *inner), (high, *reversed(inner))):
        if end == inside:
            continue
        here, there = ((at, inside), (at, other)) if upright else ((inside, at), (other, at))
        arrow = {"arrowstyle": "-|>", "color": colour, "lw": width, "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", here, there, arrowprops=arrow, zorder=4)
    axes.plot(*(([at, at], inner) if upright else (inner, [at, at])), color=colour, lw=width, zorder=4)
    closed = [inside for end, inside in zip((low, high), inner, strict=True) if end == inside]
    axes.plot(*(([at] * len(closed), closed) if upright else (closed, [at] * len(closed))),
              ls="", marker="_" if upright else "|", color=colour, ms=5, zorder=4)  # fmt: skip


def _wrap(text: str, width: float) -> str:
    """Wrap `text` to `width` [mm] at 5.5 points, 1.15 mm per character."""
    from textwrap import fill

    return fill(text, max(20, int(width / 1.15)))
