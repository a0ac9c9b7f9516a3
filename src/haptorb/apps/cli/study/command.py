"""`haptorb study new | check | run | simulate | power | participants | analyse | figures | export | merge | withdraw |
backup`, joined."""

from __future__ import annotations

import typer

from haptorb.apps.cli.study.data import analyse, export, figures, participants
from haptorb.apps.cli.study.people import backup, merge, withdraw
from haptorb.apps.cli.study.planning import check, new, power, simulate
from haptorb.apps.cli.study.run import run
from haptorb.apps.terminal.help_text import CommandLine

__all__ = ["register"]


def register(app: typer.Typer) -> None:
    """Add the commands to `app`."""
    study = CommandLine(help="Perceptual studies: write, check, rehearse, run, analyse, plot and export.")
    for command in (new, check, run, simulate, power, participants, analyse, figures, export, merge, withdraw, backup):
        study.command()(command)
    app.add_typer(study, name="study")
