"""`haptorb fit-multipole`: a distributed multipole model for a motor's magnet or coil."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from haptorb.errors import InputError
from haptorb.figure_file import check_figure_file
from haptorb.terminal import make_console, make_progress, print_json

__all__ = ["register"]


def register(app: typer.Typer) -> None:
    """Add the command to `app`."""
    app.command("fit-multipole")(fit_multipole)


def fit_multipole(
    device: Annotated[str, typer.Argument(help="Spherical motor: device name, or path of a device file.")] = "pmsm",
    part: Annotated[str, typer.Option(help="Part to fit: magnet or coil.")] = "magnet",
    dipoles: Annotated[int | None, typer.Option(help="Largest number of pole pairs (default: as in the file).")] = None,
    plot: Annotated[
        Path | None, typer.Option(help="Plot exact, fitted and stored field to this PNG, SVG or PDF file.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Fit a multipole model, loops of dipoles, to a magnet or coil, and print its error near its counterparts."""
    if dipoles is not None and not 1 <= dipoles <= 2000:
        raise InputError(f"--dipoles must be between 1 and 2000; got {dipoles}")
    if plot is not None:
        check_figure_file(plot, "--plot")
    from haptorb.cli.multipole_comparison import compare
    from haptorb.devices.api import motor

    known = motor(device, "`haptorb fit-multipole`")
    with make_progress() as bar:
        task = bar.add_task("fitting", total=None)
        made = compare(known, part, dipoles, lambda done, total: bar.update(task, completed=done, total=total))
    if json:
        print_json(made.numbers())
    else:
        made.show(make_console())
    if plot is not None:
        made.plot(plot)
