"""Output of a comparison of guidance: tables on a terminal, and a figure."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rich.console import Console

from haptorb.figure_file import write_figure
from haptorb.terminal import Column, TextTable, print_table, print_text
from haptorb_papers.guidance.comparison import WAYS, GuidanceComparison

__all__ = ["plot_guidance", "print_guidance"]

#: colours that people who confuse red and green can tell apart
_COLOURS = {"none": "#8a8a8a", "valley": "#0072b2", "spring": "#e69f00", "plan": "#d55e00"}


def print_guidance(found: GuidanceComparison, console: Console) -> None:
    """Print the tables."""
    table = TextTable(
        (
            Column("path", kind="key"), Column("grip", kind="key"), Column("guidance", kind="key"),
            Column("error", "mm"), Column("worst", "mm"), Column("force", "N"), Column("heat", "W"),
        ),
        f"Guidance of simulated hands on '{found.device}', {found.seconds:g} s each",
    )  # fmt: skip
    last = ("", "")
    for row in found.rows:
        first = (row.path, row.grip) != last
        if first and last[0]:
            table.end_section()
        table.add_row(
            row.path if first else "", row.grip if first else "", row.way + (" (tripped)" if row.tripped else ""),
            f"{1e3 * row.error:.3f}", f"{1e3 * row.largest:.2f}", f"{row.force:.3f}", f"{row.heat:.1f}",
        )  # fmt: skip
        last = (row.path, row.grip)
    print_table(console, table)
    grips = tuple(dict.fromkeys(row.grip for row in found.rows))
    ways = tuple(way for way in WAYS if any(key[1] == way for key in found.drift))
    rest = TextTable(
        (Column("grip", kind="key"), *(Column(way, "mm") for way in ways), Column("error", "1"), Column("force", "%")),
        "Motion of a resting hand in 5 s; error of the plan relative to the valley, and difference of their forces",
    )
    for grip in grips:
        rest.add_row(
            grip,
            *(f"{1e3 * found.drift[grip, way]:.2f}" for way in ways),
            f"{found.find_ratio(grip):.2f}",
            f"{100 * found.find_inequality(grip):.1f}",
        )
    print_text(console, "")
    print_table(console, rest)
    print_text(
        console,
        "\nError: mean deviation across the path. Force: mean commanded force. The stiffness of the valley (world "
        "guidance) is chosen for the same mean force as the plan (world path_guidance). If a valley of that force "
        "oscillates, it is the valley with the smallest error, and the plan has a wider tolerance, so that it uses no "
        "more force than that valley. The plan assumes 70 % of the hand's mass and damping. Spring: to a point that "
        "moves along the path at constant speed.",
    )


def plot_guidance(found: GuidanceComparison, path: Path) -> None:
    """Draw the figure into `path`: error and force of every way, and its course on the first path."""
    from matplotlib.figure import Figure

    grips = tuple(dict.fromkeys(row.grip for row in found.rows))
    paths = tuple(dict.fromkeys(row.path for row in found.rows))
    figure = Figure(figsize=(4.2 * len(grips) + 1.0, 9.0), layout="constrained")
    places = figure.subplots(3, len(grips), squeeze=False, sharey="row")
    for column, grip in enumerate(grips):
        above, middle, below = places[:, column]
        for number, way in enumerate(WAYS):
            at = np.arange(len(paths)) + 0.2 * (number - 1.5)
            rows = [found.find_row(name, grip, way) for name in paths]
            above.bar(at, [1e3 * row.error for row in rows], 0.19, color=_COLOURS[way], label=way)
            middle.bar(at, [row.force for row in rows], 0.19, color=_COLOURS[way])
            course = found.courses[grip, way]
            below.plot(1.0 + 0.01 * np.arange(len(course)), 1e3 * course, color=_COLOURS[way], lw=1.2)
        for place, title in ((above, "mean deviation [mm]"), (middle, "mean force [N]")):
            place.set_xticks(range(len(paths)), paths)
            place.set_title(f"{grip} grip: {title}", loc="left", fontsize=9)
        above.set_yscale("log")
        below.set_title(f"{grip} grip: deviation on '{paths[0]}' [mm]", loc="left", fontsize=9)
        below.set_xlabel("t [s]")
        if column == 0:
            above.legend(frameon=False, fontsize=8)
        for place in (above, middle, below):
            place.spines[["top", "right"]].set_visible(False)
    figure.suptitle(f"Four kinds of guidance along a path, simulated hands on '{found.device}'", fontsize=11)
    write_figure(figure, path, "--plot")
