"""`haptorb design sweep | optimise | report | show`, joined."""

from __future__ import annotations

import typer

from haptorb.apps.cli.design.optimise import optimise
from haptorb.apps.cli.design.report import report
from haptorb.apps.cli.design.show import show
from haptorb.apps.cli.design.sweep import sweep
from haptorb.apps.terminal.help_text import CommandLine

__all__ = ["register"]


def register(app: typer.Typer) -> None:
    """Add the commands to `app`."""
    design = CommandLine(help="Search for devices by a sweep or an optimiser; report and show the results.")
    for command in (sweep, optimise, report, show):
        design.command()(command)
    app.add_typer(design, name="design")
