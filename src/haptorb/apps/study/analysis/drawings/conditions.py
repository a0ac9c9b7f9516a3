"""What conditions show: psychometric curves, thresholds, ratings, choices, magnitudes, response times."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from haptorb.apps.study.analysis.analysis import Analysis
from haptorb.apps.study.analysis.drawings.style import (
    COLOURS,
    DASHES,
    MARKERS,
    PaperSize,
    draw_open_interval,
    new_paper_figure,
)

__all__ = ["draw_choices", "draw_curves", "draw_magnitudes", "draw_ratings", "draw_response_times", "draw_thresholds"]


def draw_curves(analysis: Analysis, size: PaperSize) -> Figure:
    """How often the comparison was called the stronger, over its level: thin people, bold the group."""
    figure = new_paper_figure(analysis, size.single, 0.85 * size.single)
    axes = figure.subplots()
    for n, (name, one) in enumerate(analysis.curves.items()):
        x, yes, of = one.answered.pooled
        colour, dashes = COLOURS[n % 7], DASHES[n % 7]
        fine = np.linspace(x.min(), x.max(), 200)
        axes.plot(x, yes / of, MARKERS[n % 7], color=colour, label=name, zorder=3)
        for fit in one.people.values():
            axes.plot(fine, fit.curve(fine), color=colour, ls=dashes, lw=0.4, alpha=0.5)
        if (curve := one.group_curve) is not None:
            axes.plot(fine, curve(fine), color=colour, ls=dashes, lw=1.6)
    for n, one in enumerate(analysis.curves.values()):
        if one.group is not None:
            draw_open_interval(axes, one.group.threshold.mean_95, 0.5 + 0.02 * n, COLOURS[n % 7], width=0.8)
    if analysis.study.levels is not None:
        axes.axvline(analysis.study.levels.reference, color="0.5", lw=0.6)
    axes.set(xlabel=_level_label(analysis), ylabel="share called stronger than the reference", ylim=(-0.02, 1.02))
    axes.legend(loc="upper left")
    return figure


def draw_thresholds(analysis: Analysis, size: PaperSize) -> Figure:
    """Everybody's fitted threshold by condition with its 95 %, lines joining one person's; the group's mean, 95 %."""
    figure = new_paper_figure(analysis, size.single, 0.85 * size.single)
    axes = figure.subplots()
    names, bars = list(analysis.tracks), []
    codes = list(dict.fromkeys(code for one in analysis.tracks.values() for code in one.people))
    for number, code in enumerate(codes):
        aside = 0.12 + 0.2 * (number + 0.5) / len(codes)  # beside the group's, so that nothing hides
        mine = [(n + aside, fit) for n, name in enumerate(names) if (fit := analysis.tracks[name].people.get(code))]
        closed = [(at, fit.fitted) for at, fit in mine if fit.closed]
        axes.plot([at for at, _ in closed], [value for _, value in closed], "-", color="0.75", marker=".", lw=0.5, ms=3)
        for at, fit in mine:
            bars.append((at, fit.fitted_95, "0.75", 0.5))
    for n, name in enumerate(names):
        if (group := analysis.tracks[name].group) is not None:
            if np.isfinite(group.mean_95).all():
                axes.plot([n], [2**group.mean], MARKERS[n % 7], color=COLOURS[n % 7], zorder=3)
            bars.append((n, (2 ** group.mean_95[0], 2 ** group.mean_95[1]), COLOURS[n % 7], 1.0))
    axes.set_yscale("log")
    ends = [end for _, limits, _, _ in bars for end in limits if 0 < end < np.inf]
    if ends:
        axes.set_ylim(min(ends) / 1.3, max(ends) * 1.3)
    for at, limits, colour, width in bars:
        draw_open_interval(axes, limits, at, colour, upright=True, width=width)
    _write_plain_numbers(axes)
    _name_conditions(axes, names)
    axes.set_ylabel(f"threshold: difference of {_level_label(analysis)}")
    return figure


def draw_ratings(analysis: Analysis, size: PaperSize) -> Figure:
    """Mean rating by condition with its 95 % over people."""
    figure = new_paper_figure(analysis, size.single, 0.8 * size.single)
    axes = figure.subplots()
    for n, one in enumerate(analysis.scores.values()):
        _draw_interval(axes, n, one.mean, one.low, one.high, n)
    scale = analysis.study.rating
    axes.set_ylim(scale.low - 0.2, scale.high + 0.2)
    _name_conditions(axes, list(analysis.scores))
    axes.set_ylabel(f"rating, {scale.low} to {scale.high}, mean and 95 %")
    return figure


def draw_choices(analysis: Analysis, size: PaperSize) -> Figure:
    """How often the first of each pair was chosen, with its 95 %."""
    figure = new_paper_figure(analysis, size.single, min(130, 24 + 9 * len(analysis.chosen)))
    axes = figure.subplots()
    for n, (_, (chosen, of, (low, high))) in enumerate(analysis.chosen.items()):
        axes.errorbar([chosen / of], [n], xerr=[[max(0.0, chosen / of - low)], [max(0.0, high - chosen / of)]],
                      fmt=MARKERS[0], color=COLOURS[0], capsize=2.5)  # fmt: skip
    axes.axvline(0.5, color="0.5", lw=0.6)
    axes.set_yticks(range(len(analysis.chosen)), [f"{a} over {b}" for a, b in analysis.chosen])
    axes.set(xlim=(-0.03, 1.03), xlabel="share of choices, 95 %", ylim=(len(analysis.chosen) - 0.5, -0.5))
    return figure


def draw_magnitudes(analysis: Analysis, size: PaperSize) -> Figure:
    """Geometric means of estimates over the level, both logarithmic, with the power law."""
    figure = new_paper_figure(analysis, size.single, 0.85 * size.single)
    axes = figure.subplots()
    levels = analysis.study.levels
    assert levels is not None
    for n, one in enumerate(analysis.magnitudes):
        below, above = one.means - one.low, one.high - one.means
        bars = np.nan_to_num(np.array([below, above]))
        axes.errorbar(one.levels, one.means, bars, fmt=MARKERS[n % 7], color=COLOURS[n % 7], capsize=2.5,
                      label=f"{one.condition}: exponent {one.exponent:.2f}")  # fmt: skip
        law = one.at_reference * (one.levels / levels.reference) ** one.exponent
        axes.plot(one.levels, law, color=COLOURS[n % 7], ls=DASHES[n % 7])
    axes.set(xscale="log", yscale="log", xlabel=_level_label(analysis), ylabel="estimated magnitude (reference = 1)")
    ticks = sorted({level for one in analysis.magnitudes for level in one.levels.tolist()})
    axes.set_xticks(ticks, [f"{level:g}" for level in ticks])
    axes.set_xticks([], minor=True)
    _write_plain_numbers(axes)
    axes.legend(loc="upper left")
    return figure


def draw_response_times(analysis: Analysis, size: PaperSize) -> Figure:
    """Geometric mean of the response times by condition with its 95 % over people."""
    figure = new_paper_figure(analysis, size.single, 0.7 * size.single)
    axes = figure.subplots()
    for n, one in enumerate(analysis.times):
        _draw_interval(axes, n, one.geometric_mean, *one.geometric_mean_95, n)
    _name_conditions(axes, [one.condition for one in analysis.times])
    axes.set_ylabel("response time [s]")
    axes.set_ylim(0, None)
    return figure


def _draw_interval(axes: Axes, x: float, value: float, low: float, high: float, style: int) -> None:
    """A point with its interval; with a single person there is none."""
    bars = [[max(0.0, value - low)], [max(0.0, high - value)]] if np.isfinite([low, high]).all() else None
    axes.errorbar([x], [value], bars, fmt=MARKERS[style % 7], color=COLOURS[style % 7], capsize=2.5, zorder=3)


def _write_plain_numbers(axes: Axes) -> None:
    """0.05 in place of 5 × 10⁻² on a logarithmic axis."""
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter("{x:g}")
    axes.yaxis.set_minor_locator(LogLocator(subs=(0.2, 0.3, 0.5, 0.7)))


def _name_conditions(axes: Axes, names: list[str]) -> None:
    axes.set_xticks(range(len(names)), names)
    axes.set_xlim(-0.6, len(names) - 0.4)


def _level_label(analysis: Analysis) -> str:
    levels, unit = analysis.study.levels, analysis.study.level_unit
    return "" if levels is None else f"{levels.parameter}{f' [{unit}]' if unit else ''}"
