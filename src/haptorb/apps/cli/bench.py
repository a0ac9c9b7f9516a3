"""`haptorb bench magnetics`: this library against its peers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from haptorb.errors import InputError, UnknownName

__all__ = ["register"]


def register(app: typer.Typer) -> None:
    """Add the commands to `app`."""
    app.command()(bench)


def bench(
    subject: Annotated[str, typer.Argument(help="What to compare: magnetics.")] = "magnetics",
    device: Annotated[str, typer.Option(help="The spherical motor that is computed.")] = "pmsm",
    budget: Annotated[float, typer.Option(help="Seconds spent on each row.")] = 0.5,
    plot: Annotated[Path | None, typer.Option(help="Draw time against error into this PNG or SVG file.")] = None,
    json: Annotated[bool, typer.Option("--json", help="As JSON.")] = False,
) -> None:
    """This library against its peers: same run, same geometry, error against one reference beside each time."""
    from rich.console import Console

    if subject != "magnetics":
        raise UnknownName("benchmark", subject, ["magnetics"])
    if not 0 < budget <= 60:
        raise InputError(f"--budget must be between 0 and 60 seconds; got {budget:g}")
    if plot is not None and (plot.suffix not in (".png", ".svg") or not plot.parent.is_dir()):
        raise InputError(f"--plot must name a .png or .svg file in a folder that exists; got '{plot}'")
    from haptorb.apps.bench import magnetics

    with Console(stderr=True).status("compiling") as status:
        contest = magnetics(device, budget, lambda text: status.update(text))
    if json:
        from json import dumps

        print(dumps(contest.numbers(), indent=2, ensure_ascii=False))
    else:
        contest.show(Console())
    if plot is not None:
        contest.plot(plot)
