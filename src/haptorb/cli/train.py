"""`haptorb train`: trains networks that map the field at a motor's sensors to its torque per ampere."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from haptorb.terminal import make_console, make_progress, print_json

__all__ = ["register"]


def register(app: typer.Typer) -> None:
    """Add the command to `app`."""
    app.command()(train)


def train(
    device: Annotated[str, typer.Argument(help="Spherical motor: device name, or path of a device file.")] = "pmsm",
    nodes: Annotated[int, typer.Option(help="Nodes of the hidden layer.")] = 10,
    starts: Annotated[int, typer.Option(help="Number of random starts; training continues with the best.")] = 16,
    iterations: Annotated[int, typer.Option(help="Largest number of Levenberg–Marquardt steps.")] = 120,
    seed: Annotated[int, typer.Option(help="Seed of the random starts.")] = 0,
    out: Annotated[Path | None, typer.Option(help="Store the networks in this file instead of the cache.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Let --out replace an existing file.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Train the networks of a motor's `network` estimator on its computed field and torque, and print their errors."""
    # Matrices this small gain nothing from a second thread, which busy-waits on a loaded machine; the library reads the
    # variable when it is loaded, which is below.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from haptorb.cli.progress import build_tables
    from haptorb.cli.training import train_networks
    from haptorb.devices.api import motor

    build_tables(motor(device, "`haptorb train`"))
    with make_progress() as bar:
        task = bar.add_task("training", total=1.0)
        result = train_networks(
            device,
            nodes=nodes,
            starts=starts,
            iterations=iterations,
            seed=seed,
            path=out,
            overwrite=out is None or force,
            report=lambda done: bar.update(task, completed=done),
        )
    if json:
        print_json(result.numbers())
    else:
        result.show(make_console())
