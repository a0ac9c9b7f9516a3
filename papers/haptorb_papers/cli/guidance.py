"""`haptorb guidance`: comparison of guidance along a path, with simulated hands."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from haptorb.errors import InputError, UnknownName
from haptorb.figure_file import check_figure_file
from haptorb.terminal import make_console, make_progress, print_json

__all__ = ["register"]


def register(app: typer.Typer) -> None:
    """Add the command to `app`."""
    app.command()(guidance)


def guidance(
    device: Annotated[str, typer.Argument(help="Spherical electromagnet: device name or file.")] = "omni",
    path: Annotated[
        list[str] | None,
        typer.Option("--path", help="Path: line, circle, square or spiral; repeatable (default: all)."),
    ] = None,
    grip: Annotated[
        list[str] | None,
        typer.Option("--grip", help="Grip of the hand: loose, light or firm; repeatable (default: all)."),
    ] = None,
    duration: Annotated[
        float, typer.Option("--duration", "--seconds", help="Duration of each trial [s], 2 to 120.")
    ] = 8.0,
    hall: Annotated[
        bool, typer.Option("--hall", help="Locate the tool by calibrated field sensors instead of a tracker at 240 Hz.")
    ] = False,
    seed: Annotated[int, typer.Option(help="Seed of persons and noise.")] = 0,
    plot: Annotated[Path | None, typer.Option(help="Plot the comparison to this PNG, SVG or PDF file.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Compare planned guidance with a valley, a moving spring and no guidance: error, force, heat, drag at rest."""
    if not 2.0 <= duration <= 120.0:
        raise InputError(f"--duration must be 2 to 120 s; got {duration:g} s")
    if seed < 0:
        raise InputError(f"--seed must be 0 or more; got {seed}")
    if plot is not None:
        check_figure_file(plot, "--plot")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from haptorb.analysis.stability import GRIPS
    from haptorb.devices.api import electromagnet
    from haptorb.devices.loader import load
    from haptorb.worlds.path import SHAPES
    from haptorb_papers.guidance import compare_guidance, plot_guidance, print_guidance

    for names, known, what in ((path, SHAPES, "path"), (grip, tuple(GRIPS), "grip")):
        for name in names or ():
            if name not in known:
                raise UnknownName(what, name, known)
    found = electromagnet(load(device), "`haptorb guidance`")
    with make_progress() as bar:
        task = bar.add_task("guiding", total=1.0)
        result = compare_guidance(
            found,
            paths=tuple(dict.fromkeys(path or SHAPES)),
            grips=tuple(dict.fromkeys(grip or GRIPS)),
            seconds=duration,
            seed=seed,
            sensing="hall" if hall else "tracker",
            report=lambda share: bar.update(task, completed=share),
        )
    if json:
        print_json(result.numbers())
    else:
        print_guidance(result, make_console())
    if plot is not None:
        plot_guidance(result, plot)
