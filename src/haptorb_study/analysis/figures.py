"""Figures of the report: confusion matrix, confusions on the dome, error over θ, psychometric curves."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.projections.polar import PolarAxes

from haptorb_study.analysis.analysis import Analysis
from haptorb_study.analysis.error_by_latitude import name_error
from haptorb_study.analysis.number_format import format_range
from haptorb_study.analysis.paper_style import draw_open_interval
from haptorb_study.set_points import PUBLISHED_ERRORS

__all__ = ["draw_answers", "draw_confusion", "draw_curves", "draw_error", "figures"]

_INK, _BLUE, _RED = "#22303c", "#1769aa", "#c0392b"
_SHADE = LinearSegmentedColormap.from_list("shade", ["#ffffff", "#9cc3e0", _BLUE, "#0b2d4a"])


def figures(analysis: Analysis) -> dict[str, Figure]:
    """Name → figure, for the results that this study has."""
    found = {}
    if analysis.confusion is not None:
        found["confusion"] = _confusion(analysis)
        found["answers"] = _answers(analysis)
    if analysis.rings:
        found["error"] = _error(analysis)
    if analysis.curves:
        found["curves"] = _curves(analysis)
    return found


def _new_figure(analysis: Analysis, title: str, size: tuple[float, float]) -> Figure:
    figure = Figure(figsize=size, layout="constrained")
    figure.suptitle(title, x=0.01, ha="left", fontweight="bold", color=_INK)
    figure.supxlabel(analysis.origin, x=0.01, ha="left", fontsize=8, color=_RED if analysis.marked else _INK)
    return figure


def _confusion(analysis: Analysis) -> Figure:
    figure = _new_figure(analysis, "Answered against prompted set-point, averaged over participants", (7.2, 6.6))
    draw_confusion(figure.subplots(), analysis)
    return figure


def draw_confusion(axes: Axes, analysis: Analysis) -> None:
    """Draw the confusion matrix of an identification into `axes`, with a colour bar."""
    c = analysis.confusion
    assert c is not None
    shown = axes.imshow(c.matrix, cmap=_SHADE, vmin=0, vmax=1)
    ticks = range(len(c.numbers))
    axes.set_xticks(ticks, [str(n) for n in c.numbers], fontsize=7)
    axes.set_yticks(ticks, [str(n) for n in c.numbers], fontsize=7)
    axes.set(xlabel="answered", ylabel="prompted")
    theta = [analysis.study.point(n).theta_deg for n in c.numbers]
    for n in ticks[1:]:
        if theta[n] != theta[n - 1]:  # boundary between two rings
            axes.axhline(n - 0.5, color="0.6", lw=0.6)
            axes.axvline(n - 0.5, color="0.6", lw=0.6)
    axes.figure.colorbar(shown, ax=axes, label="share of answers", shrink=0.8)


def _answers(analysis: Analysis) -> Figure:
    figure = _new_figure(analysis, "Correct answers; arrows: a third or more of the wrong answers", (6.8, 6.6))
    axes = figure.subplots(subplot_kw={"projection": "polar"})
    assert isinstance(axes, PolarAxes)
    draw_answers(axes, analysis)
    return figure


def draw_answers(axes: PolarAxes, analysis: Analysis) -> None:
    """Draw the set-points of an identification: share of correct answers, and arrows for frequent confusions."""
    c = analysis.confusion
    assert c is not None
    places = {
        n: (p.phi_deg * 3.141592653589793 / 180, p.theta_deg) for n in c.numbers for p in [analysis.study.point(n)]
    }
    for arrow in analysis.arrows:
        axes.annotate(
            "", places[arrow.to], places[arrow.of],
            arrowprops={
                "arrowstyle": "-|>", "color": _RED, "lw": 0.8 + 1.6 * arrow.share, "shrinkA": 11, "shrinkB": 11,
                "alpha": 0.85, "connectionstyle": "arc3,rad=0.12",
            },
        )  # fmt: skip
    for n, number in enumerate(c.numbers):
        right = float(c.matrix[n, n])
        phi, theta = places[number]
        axes.scatter([phi], [theta], s=330, color=[_SHADE(right)], edgecolors=_INK, linewidths=0.8, zorder=3)
        axes.annotate(
            str(number), (phi, theta), ha="center", va="center", fontsize=8, zorder=4,
            color="white" if right > 0.45 else _INK,
        )  # fmt: skip
    rings = sorted({p.theta_deg for p in analysis.study.points} - {0.0})
    axes.set_rgrids(rings, [f"{ring:g}°" for ring in rings], angle=22.5, fontsize=7, color="0.4")
    axes.set_rlim(0, max(rings, default=18.0) + 9)
    axes.set_xticks([])
    axes.grid(alpha=0.4)
    axes.set_title("shade: share of correct answers; seen from above, +x to the right", fontsize=8, color="0.35")


def _error(analysis: Analysis) -> Figure:
    figure = _new_figure(analysis, "Distance between answered and true position", (6.4, 4.4))
    draw_error(figure.subplots(), analysis)
    return figure


def draw_error(axes: Axes, analysis: Analysis) -> None:
    """Draw the error over θ; for the published set-points beside the published error."""
    theta = [ring.theta_deg for ring in analysis.rings]
    axes.errorbar(
        theta, [ring.mean for ring in analysis.rings], [ring.sd for ring in analysis.rings], fmt="o", color=_BLUE,
        capsize=4, label="mean ± standard deviation over trials",
    )  # fmt: skip
    published = analysis.study.set_points.layout is not None and analysis.study.procedure == "identification"
    if published:
        axes.errorbar(
            [t + 1.4 for t in PUBLISHED_ERRORS], [m for m, _ in PUBLISHED_ERRORS.values()],
            [s for _, s in PUBLISHED_ERRORS.values()], fmt="s", color="0.55", capsize=3, mfc="white",
            label="Zárate 2020, 6 people (shifted by 1.4°)",
        )  # fmt: skip
    axes.set(
        xlabel="θ of the set-point, from the top [deg]",
        ylabel=f"error [mm]: {name_error(analysis.study.procedure)}",
        ylim=(0, None),
    )
    axes.set_xticks(theta)
    axes.grid(alpha=0.3)
    axes.legend(frameon=False, loc="upper left")


def _curves(analysis: Analysis) -> Figure:
    figure = _new_figure(analysis, "Share of answers that the comparison was stronger", (6.4, 4.4))
    draw_curves(figure.subplots(), analysis)
    return figure


def draw_curves(axes: Axes, analysis: Analysis) -> None:
    """Draw psychometric curves: thin for participants, bold for the population; points are pooled shares."""
    levels = analysis.study.levels
    for n, (name, one) in enumerate(analysis.curves.items()):
        colour = f"C{n}"
        x, yes, of = one.answered.pooled
        axes.scatter(x, yes / of, s=8 + 60 * of / of.max(), color=colour, edgecolors="white", linewidths=0.6, zorder=3)
        fine = np.linspace(x.min(), x.max(), 200)
        for fit in one.people.values():
            axes.plot(fine, fit.curve(fine), color=colour, alpha=0.3, lw=0.8)
        label = f"{name}: {len(one.people)} participant{'' if len(one.people) == 1 else 's'}"
        curve = one.group_curve
        if one.group is not None:
            value = "" if curve is None else f" {curve.middle:.3g},"
            label = f"{label}; group's threshold{value} 95 %: {format_range(one.group.threshold.mean_95, '.3g')}"
        if curve is not None:
            axes.plot(fine, curve(fine), color=colour, lw=2.8, label=label)
        else:
            axes.plot([], [], color=colour, lw=0.8, label=label)
    for n, one in enumerate(analysis.curves.values()):
        if one.group is not None:
            draw_open_interval(axes, one.group.threshold.mean_95, 0.5 + 0.02 * n, f"C{n}")
    if levels is not None:
        axes.axvline(levels.reference, color="0.5", ls=":", lw=1)
        axes.set_xlabel(f"{levels.parameter} of the comparison (dotted: reference)")
    axes.set(ylabel="share", ylim=(-0.02, 1.02))
    axes.grid(alpha=0.3)
    axes.legend(frameon=False, fontsize=8)
