"""Figures of a study for publication, and their captions: all files or none."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import radians
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.projections.polar import PolarAxes
from matplotlib.ticker import LogLocator

from haptorb.errors import InputError, RecordingError
from haptorb.figure_file import show_text_as_is
from haptorb.files import read_text, replace_files
from haptorb.version import __version__
from haptorb_study.analysis.analysis import Analysis
from haptorb_study.analysis.paper_style import (
    COLOURS,
    DASHES,
    INK,
    MARKERS,
    SHADES,
    PaperSize,
    draw_open_interval,
    new_paper_figure,
    use_paper_style,
)
from haptorb_study.set_points import PUBLISHED_ERRORS

__all__ = [
    "KINDS",
    "draw_choices",
    "draw_curves",
    "draw_figures",
    "draw_identification",
    "draw_latitude_error",
    "draw_magnitudes",
    "draw_ratings",
    "draw_response_times",
    "draw_thresholds",
    "is_published_layout",
    "write_figures",
]


# --------------------------------------------------------------------------------------------------
# Figures by condition: psychometric curves, thresholds, ratings, choices, magnitudes, response times.


def draw_curves(analysis: Analysis, size: PaperSize) -> Figure:
    """Share of "comparison stronger" over the level: thin for participants, bold for the population."""
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
    """Each participant's threshold by condition with 95 % interval, joined by a line; the population mean with 95 %."""
    figure = new_paper_figure(analysis, size.single, 0.85 * size.single)
    axes = figure.subplots()
    names, bars = list(analysis.tracks), []
    codes = list(dict.fromkeys(code for one in analysis.tracks.values() for code in one.people))
    for number, code in enumerate(codes):
        aside = 0.12 + 0.2 * (number + 0.5) / len(codes)  # beside the population mean, so that none is covered
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
    """Mean rating by condition with 95 % interval over participants."""
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
    """Share of choices of the first of each pair, with 95 % interval."""
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
    """Geometric means of the estimates over the level, both logarithmic, with the power law."""
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
    """Geometric mean response time by condition with 95 % interval over participants."""
    figure = new_paper_figure(analysis, size.single, 0.7 * size.single)
    axes = figure.subplots()
    for n, one in enumerate(analysis.times):
        _draw_interval(axes, n, one.geometric_mean, *one.geometric_mean_95, n)
    _name_conditions(axes, [one.condition for one in analysis.times])
    axes.set_ylabel("response time [s]")
    axes.set_ylim(0, None)
    return figure


def _draw_interval(axes: Axes, x: float, value: float, low: float, high: float, style: int) -> None:
    """A point with its interval; no interval with one participant."""
    bars = [[max(0.0, value - low)], [max(0.0, high - value)]] if np.isfinite([low, high]).all() else None
    axes.errorbar([x], [value], bars, fmt=MARKERS[style % 7], color=COLOURS[style % 7], capsize=2.5, zorder=3)


def _write_plain_numbers(axes: Axes) -> None:
    """Format the ticks of a logarithmic axis as 0.05, not 5 × 10⁻²."""
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter("{x:g}")
    axes.yaxis.set_minor_locator(LogLocator(subs=(0.2, 0.3, 0.5, 0.7)))


def _name_conditions(axes: Axes, names: list[str]) -> None:
    axes.set_xticks(range(len(names)), names)
    axes.set_xlim(-0.6, len(names) - 0.4)


def _level_label(analysis: Analysis) -> str:
    levels, unit = analysis.study.levels, analysis.study.level_unit
    return "" if levels is None else f"{levels.parameter}{f' [{unit}]' if unit else ''}"


# --------------------------------------------------------------------------------------------------
# Identification: confusion matrix, confusions on the dome from above, error over θ.
#
# In the form of Zárate 2020, Figs. 8 and 9. The paper prints no numbers for Fig. 8; those of Fig. 9 are drawn beside.


def is_published_layout(analysis: Analysis) -> bool:
    """Whether the study identifies the set-points of Zárate 2020 by number."""
    study = analysis.study
    return study.procedure == "identification" and study.set_points.layout == "published"


def draw_identification(analysis: Analysis, size: PaperSize) -> Figure:
    """Confusion matrix (left) and set-points from above (right), in the form of Fig. 8."""
    figure = new_paper_figure(analysis, size.double, 0.52 * size.double)
    grid = figure.add_gridspec(1, 2, width_ratios=(1.15, 1))
    _draw_matrix(figure.add_subplot(grid[0, 0]), analysis)
    polar = figure.add_subplot(grid[0, 1], projection="polar")
    assert isinstance(polar, PolarAxes)
    _draw_map(polar, analysis)
    return figure


def draw_latitude_error(analysis: Analysis, size: PaperSize) -> Figure:
    """Error over θ; for the published set-points beside the printed errors, in the form of Fig. 9."""
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
    # Squares instead of imshow's pixels keep this vector graphics; same-coloured edges close the seams of viewers.
    shown = axes.pcolormesh(ticks, ticks, c.matrix, cmap=SHADES, vmin=0, vmax=1, edgecolors="face", linewidth=0.1)
    axes.set(xlim=(-0.5, len(ticks) - 0.5), ylim=(len(ticks) - 0.5, -0.5), aspect="equal")
    small = 4.0 if len(c.numbers) > 15 else 6.5
    axes.set_xticks(ticks, [str(n) for n in c.numbers], fontsize=small)
    axes.set_yticks(ticks, [str(n) for n in c.numbers], fontsize=small)
    axes.tick_params(length=0)
    axes.set(xlabel="answered set-point", ylabel="prompted set-point")
    axes.spines[:].set_visible(False)
    if len(c.numbers) <= 10:  # with few set-points the numbers fit into the cells
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


KINDS = ("pdf", "svg", "png")
_Entry = tuple[str, Callable[[Analysis, PaperSize], Figure], str]


def draw_figures(analysis: Analysis, size: PaperSize | None = None) -> dict[str, tuple[Figure, str]]:
    """Name → figure and caption, for the results that this study has."""
    size = size or PaperSize()
    with use_paper_style():
        return {name: (draw(analysis, size), caption) for name, draw, caption in _list_figures(analysis)}


def write_figures(
    analysis: Analysis, folder: str | Path, kind: str = "pdf", *, size: PaperSize | None = None, overwrite: bool = False
) -> tuple[Path, ...]:
    """Write NAME.`kind` for every figure, and captions.md, into `folder`; all files or none. Returns their paths.

    Raises InputError for another kind and for a study without figures, RecordingError if a file exists and `overwrite`
    is not set, or cannot be written.
    """
    if kind not in KINDS:
        raise InputError(f"figures can be {', '.join(KINDS)}; got '{kind}'")
    folder = Path(folder)
    found = draw_figures(analysis, size)
    if not found:
        raise InputError(f"study '{analysis.study.name}' has no answers to plot")
    files = [folder / f"{name}.{kind}" for name in found]
    captions = folder / "captions.md"
    text_of_captions = _write_captions(analysis, found)
    for path in (*files, captions):
        if path.exists() and not overwrite and not (path == captions and _has_text(path, text_of_captions)):
            text = f"{path} exists; choose another folder, or replace it"
            raise RecordingError(f"{text} with overwrite=True", command=f"{text} with --force")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with replace_files([*files, captions]) as parts, use_paper_style():
            for part, (figure, _) in zip(parts, found.values(), strict=False):
                show_text_as_is(figure).savefig(part, format=kind, dpi=600, metadata=_describe_file(analysis, kind))
            parts[-1].write_text(text_of_captions, encoding="utf-8")
    except OSError as cause:
        raise RecordingError(f"{folder}: figures cannot be written ({cause.strerror or cause})") from cause
    return (*files, captions)


def _list_figures(analysis: Analysis) -> Iterator[_Entry]:
    people = "Points: means over participants; bars: 95 % over participants."
    if analysis.confusion is not None:
        form = " In the form of Zárate et al. 2020, Fig. 8." if is_published_layout(analysis) else ""
        yield (
            "identification", draw_identification,
            "Left: answered against prompted set-point, mean over participants. Right: set-points from above; shade: "
            f"share of correct answers; arrows: a third or more of the wrong answers went there.{form}",
        )  # fmt: skip
    if analysis.rings:
        beside = " Left: as printed in Zárate et al. 2020, Fig. 9." if is_published_layout(analysis) else ""
        yield (
            "error-over-theta", draw_latitude_error,
            "Distance of the answered from the true position over θ, mean ± standard deviation over trials." + beside,
        )  # fmt: skip
    if analysis.curves:
        yield (
            "psychometric-curves", draw_curves,
            "Points: share of trials in which the comparison was called stronger, over all participants. Thin: "
            "function of each participant; thick: median participant of the group; bar near 0.5: 95 % of its "
            "threshold, an arrow where an end does not exist; vertical line: reference.",
        )  # fmt: skip
    if analysis.tracks:
        yield (
            "thresholds", draw_thresholds,
            "Grey: fitted thresholds of each participant with 95 % (arrow: no end), joined. Large points: mean of "
            "the group in the logarithm, 95 %.",
        )  # fmt: skip
    if analysis.scores:
        yield "ratings", draw_ratings, f"Ratings by condition. {people}"
    if analysis.chosen:
        yield "choices", draw_choices, "Share of trials in which the first was chosen, 95 %; line: no preference."
    if analysis.magnitudes:
        yield (
            "magnitudes", draw_magnitudes,
            "Geometric means over participants of their estimates, each divided by the value of the participant's "
            "power law at the reference in the first condition; bars: Student's 95 % (logarithm); lines: mean law.",
        )  # fmt: skip
    if analysis.times:
        yield (
            "response-times",
            draw_response_times,
            f"Response times by condition, geometric means. {people}",
        )


def _has_text(path: Path, text: str) -> bool:
    """Whether the file has this text: the same figures in another format have the same captions."""
    try:
        return read_text(path, "captions", InputError) == text
    except InputError:
        return False


def _describe_file(analysis: Analysis, kind: str) -> dict[str, str | None]:
    """Metadata of the file, without a date, so that equal data give equal files."""
    title = f"{analysis.study.name}{' (SIMULATED)' if analysis.marked else ''}"
    made = f"haptorb {__version__}"
    if kind == "pdf":
        return {"Title": title, "Subject": analysis.origin, "Creator": made, "CreationDate": None}
    if kind == "svg":
        return {"Title": title, "Description": analysis.origin, "Creator": made, "Date": None}
    return {"Title": title, "Description": analysis.origin, "Software": made}


def _write_captions(analysis: Analysis, found: dict[str, tuple[Figure, str]]) -> str:
    head = f"# Figures of study {analysis.study.name}\n\n{analysis.origin}. {analysis.trials} trials.\n"
    return head + "".join(f"\n**{name}.** {caption}\n" for name, (_, caption) in found.items())
