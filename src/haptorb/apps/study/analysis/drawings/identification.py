"""Where people were right and where wrong answers went: confusion matrix, dome from above, error over θ.

In the form of Zárate 2020, Figs. 8 and 9. Of Fig. 8 the paper prints no numbers; those of Fig. 9 stand beside it.
"""

from __future__ import annotations

from math import radians

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.projections.polar import PolarAxes

from haptorb.apps.study.analysis.analysis import Analysis
from haptorb.apps.study.analysis.drawings.style import COLOURS, INK, MARKERS, SHADES, PaperSize, new_paper_figure
from haptorb.apps.study.model.set_points import PUBLISHED_ERRORS

__all__ = ["draw_identification", "draw_latitude_error", "is_published_layout"]


def is_published_layout(analysis: Analysis) -> bool:
    """Whether the study asked for the places of Zárate 2020 by number."""
    study = analysis.study
    return study.procedure == "identification" and study.set_points.layout == "published"


def draw_identification(analysis: Analysis, size: PaperSize) -> Figure:
    """Left the confusion matrix, right the set-points from above: the form of Fig. 8."""
    figure = new_paper_figure(analysis, size.double, 0.52 * size.double)
    grid = figure.add_gridspec(1, 2, width_ratios=(1.15, 1))
    _draw_matrix(figure.add_subplot(grid[0, 0]), analysis)
    polar = figure.add_subplot(grid[0, 1], projection="polar")
    assert isinstance(polar, PolarAxes)
    _draw_map(polar, analysis)
    return figure


def draw_latitude_error(analysis: Analysis, size: PaperSize) -> Figure:
    """Error over θ; for the published set-points beside the printed errors, in the same form: Fig. 9."""
    if not is_published_layout(analysis):
        figure = new_paper_figure(analysis, size.single, 0.8 * size.single)
        axes = figure.subplots()
        _draw_error(axes, _list_rings(analysis), 0)
        axes.set_ylim(0, None)
        return figure
    figure = new_paper_figure(analysis, size.double, 0.4 * size.double)
    left, right = figure.subplots(1, 2, sharex=True, sharey=True)
    _draw_error(left, [(theta, *errors) for theta, errors in PUBLISHED_ERRORS.items()], 1)
    _draw_error(right, _list_rings(analysis), 0)
    left.set_title("Zárate et al. 2020, as printed: 6 people, 300 answers", loc="left")
    right.set_title(f"this study: {analysis.trials} answers", loc="left")
    right.set_ylabel("")
    right.set_ylim(0, None)
    return figure


def _list_rings(analysis: Analysis) -> list[tuple[float, float, float]]:
    return [(ring.theta_deg, ring.mean, ring.sd) for ring in analysis.rings]


def _draw_error(axes: Axes, rows: list[tuple[float, float, float]], style: int) -> None:
    theta, mean, sd = zip(*rows, strict=True)
    colour = COLOURS[style]
    axes.errorbar(theta, mean, sd, fmt=MARKERS[style], color=colour, mfc="white" if style else colour, capsize=2.5,
                  elinewidth=0.8)  # fmt: skip
    axes.set(xlabel="θ of the set-point, from the top [deg]", ylabel="error, mean ± SD over trials [mm]")
    axes.set_xticks(sorted(set(theta)))
    axes.margins(x=0.15)


def _draw_matrix(axes: Axes, analysis: Analysis) -> None:
    c = analysis.confusion
    assert c is not None
    ticks = range(len(c.numbers))
    # Squares, not the pixels of imshow: vector throughout. Edges of the same colour close the seams that viewers show.
    shown = axes.pcolormesh(ticks, ticks, c.matrix, cmap=SHADES, vmin=0, vmax=1, edgecolors="face", linewidth=0.1)
    axes.set(xlim=(-0.5, len(ticks) - 0.5), ylim=(len(ticks) - 0.5, -0.5), aspect="equal")
    small = 4.0 if len(c.numbers) > 15 else 6.5
    axes.set_xticks(ticks, [str(n) for n in c.numbers], fontsize=small)
    axes.set_yticks(ticks, [str(n) for n in c.numbers], fontsize=small)
    axes.tick_params(length=0)
    axes.set(xlabel="answered set-point", ylabel="prompted set-point")
    axes.spines[:].set_visible(False)
    if len(c.numbers) <= 10:  # with few set-points there is room for the numbers themselves
        for i in ticks:
            for j in ticks:
                share = float(c.matrix[i, j])
                axes.text(j, i, f"{100 * share:.0f}", ha="center", va="center", fontsize=5.5,
                          color="white" if share < 0.5 else INK)  # fmt: skip
    bar = axes.figure.colorbar(shown, ax=axes, label="share of answers, mean over participants", shrink=0.85, pad=0.02)
    assert bar.solids is not None
    bar.solids.set(rasterized=False, edgecolor="face", linewidth=0.1)


def _draw_map(axes: PolarAxes, analysis: Analysis) -> None:
    c = analysis.confusion
    assert c is not None
    places = {n: (radians(p.phi_deg), p.theta_deg) for n in c.numbers for p in [analysis.study.point(n)]}
    shades = matplotlib.colormaps[SHADES]
    for arrow in analysis.arrows:
        axes.annotate("", places[arrow.to], places[arrow.of], zorder=2, arrowprops={
            "arrowstyle": "-|>,head_width=0.15,head_length=0.3", "color": COLOURS[1], "lw": 0.5 + arrow.share,
            "shrinkA": 6, "shrinkB": 6, "connectionstyle": "arc3,rad=0.12",
        })  # fmt: skip
    for n, number in enumerate(c.numbers):
        right = float(c.matrix[n, n])
        phi, theta = places[number]
        axes.scatter([phi], [theta], s=95, color=[shades(right)], edgecolors=INK, linewidths=0.5, zorder=3)
        axes.annotate(str(number), (phi, theta), ha="center", va="center", fontsize=5.5, zorder=4,
                      color="white" if right < 0.5 else INK)  # fmt: skip
    rings = sorted({p.theta_deg for p in analysis.study.points} - {0.0})
    axes.set_rgrids(rings, [f"{ring:g}°" for ring in rings], angle=22.5, fontsize=5.5, color="0.3")
    axes.set_rlim(0, max(rings, default=18.0) + 8)
    axes.set_xticks([])
    axes.spines["polar"].set_visible(False)
    axes.grid(linewidth=0.4, color="0.8")
    axes.set_xlabel("shade: share of correct answers; from above, +x to the right", fontsize=6)
