"""Show the designs of a results file in the browser, and run the device of one with the console."""

from __future__ import annotations

from typing import Annotated

import typer

from haptorb.apps.terminal import announce_wait, say
from haptorb.errors import InputError

__all__ = ["show"]


def show(
    results: Annotated[str, typer.Argument(help="Results: a file, or postgresql://host/name.")],
    port: Annotated[int, typer.Option(help="Port of the page; 0 takes any free port.")] = 8764,
    browser: Annotated[bool, typer.Option("--open", help="Open the page in the browser.")] = False,
    duration: Annotated[float | None, typer.Option(help="Duration [s] (default: until Ctrl-C).")] = None,
) -> None:
    """Choose a design in the browser, see its device in three dimensions, and feel it, SIMULATED."""
    if duration is not None and not 0 < duration < float("inf"):
        raise InputError(f"--duration must be greater than 0 s; got {duration:g} s")
    from haptorb.runtime.realtime.linux import require_linux

    require_linux("`haptorb design show`")
    from haptorb.apps.design.results_table import ResultsTable
    from haptorb.apps.design.show import Chooser
    from haptorb.design.store import read_results

    with announce_wait("reading the results, and computing the base device"):
        table = ResultsTable.of(read_results(results))
    if not table.found:
        refusals = ", ".join(f"{one.by} rejects {one.count}" for one in table.refusals)
        raise InputError(f"{results} holds no valid design to show ({refusals or 'nothing was computed'})")
    with Chooser(table, port) as chooser:
        say(f"Open {chooser.url} in a browser. Ctrl-C ends.")
        number = chooser.serve(open_browser=browser, say=say, until=duration)
    if number:
        raise typer.Exit(128 + number)
