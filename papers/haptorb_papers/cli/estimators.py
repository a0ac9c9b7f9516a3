"""`haptorb estimators`: comparison of methods to estimate a spherical motor's orientation or torque from its field."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from haptorb.errors import InputError
from haptorb.figure_file import check_figure_file
from haptorb.terminal import make_console, make_progress, print_json

if TYPE_CHECKING:
    from haptorb.devices.motor import SphericalMotor

__all__ = ["register"]


def register(app: typer.Typer) -> None:
    """Add the command to `app`."""
    app.command()(estimators)


def estimators(
    device: Annotated[str, typer.Argument(help="Spherical motor: device name, or path of a device file.")] = "pmsm",
    orientations: Annotated[int, typer.Option(help="Number of test orientations over the workspace.")] = 500,
    networks: Annotated[
        Path | None, typer.Option(help="File of trained networks (default: those of the device).")
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of noise and orientations.")] = 0,
    plot: Annotated[
        Path | None, typer.Option(help="Plot Fig. 4 and other figures to this PNG, SVG or PDF file.")
    ] = None,
    sensors: Annotated[
        bool,
        typer.Option("--sensors", help="Show the effect of each error of the field sensors on orientation and torque."),
    ] = False,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Compare network, linear map and least squares under noise, offset, a dead sensor and changed magnets."""
    if not 10 <= orientations <= 100_000 or seed < 0:
        raise InputError(f"--orientations must be 10 to 100000 and --seed 0 or more; got {orientations} and {seed}")
    if plot is not None:
        check_figure_file(plot, "--plot")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # small matrices; a second thread would only wait in a loop
    from haptorb.cli.progress import build_tables
    from haptorb.devices.api import motor
    from haptorb.estimation.network import check_networks, read_networks
    from haptorb_papers.estimators import compare, plot_comparison, print_comparison

    known = motor(device, "`haptorb estimators`")
    build_tables(known)
    if sensors:
        if plot is not None or networks is not None:
            raise InputError("--sensors tests least squares only and has no plot; leave out --plot and --networks")
        _print_effects(known, max(10, orientations // 5), seed, json)
        return
    trained = check_networks(known) if networks is None else read_networks(networks)
    with make_progress() as bar:
        task = bar.add_task("comparing", total=1.0)
        result = compare(
            known, trained, orientations=orientations, seed=seed, report=lambda done: bar.update(task, completed=done)
        )
    if json:
        print_json(result.numbers())
    else:
        print_comparison(result, make_console())
    if plot is not None:
        plot_comparison(result, plot)


def _print_effects(known: SphericalMotor, orientations: int, seed: int, json: bool) -> None:
    from haptorb_papers.estimators import find_effects, print_effects

    with make_progress() as bar:
        task = bar.add_task("trying", total=1.0)
        found = find_effects(
            known, orientations=orientations, seed=seed, report=lambda done: bar.update(task, completed=done)
        )
    if json:
        print_json(found.numbers())
    else:
        print_effects(found, make_console())
