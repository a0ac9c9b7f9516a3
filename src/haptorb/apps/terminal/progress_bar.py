"""Bars and status lines on standard error; nothing is drawn where that is no terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from haptorb.apps.terminal.console import make_console

if TYPE_CHECKING:
    from rich.progress import Progress
    from rich.status import Status

__all__ = ["make_progress", "show_status"]


def make_progress(*, show: bool = True) -> Progress:
    """A bar with its task's description and the time that remains; it vanishes at the end."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = TextColumn("{task.description}", markup=False), BarColumn(), TimeRemainingColumn()
    console = make_console(error=True)  # rich ends a bar with an empty line where it has drawn none
    return Progress(*columns, console=console, transient=True, disable=not (show and console.is_interactive))


def show_status(text: str) -> Status:
    """A line that says what is running, until its block ends."""
    from rich.status import Status

    return Status(text, console=make_console(error=True), spinner="line")
