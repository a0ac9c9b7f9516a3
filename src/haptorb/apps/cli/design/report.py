"""Write the report of a results file, and its best designs as device files."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from haptorb.apps.cli.design.options import JsonOption
from haptorb.apps.terminal import make_progress, print_json, say, tell

__all__ = ["report"]


def report(
    results: Annotated[str, typer.Argument(help="Results: a file, or postgresql://host/name.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="HTML file to write.")] = Path("report.html"),
    count: Annotated[int, typer.Option("--best", help="Number of best designs, 1 to 20.")] = 5,
    json: JsonOption = False,
) -> None:
    """Write the results as one HTML page, and the best designs beside it as device files for `haptorb run`."""
    from haptorb.apps.design.report import write_report

    with make_progress() as bar:
        task = bar.add_task("reading the results", total=None)

        def advance(text: str, done: int, total: int) -> None:
            bar.update(task, description=text, completed=done, total=total)

        page, *devices = write_report(results, output, advance, count=count)
    if json:
        print_json({"report": str(page), "devices": [str(one) for one in devices]})
        return
    tell(f"report: {page}")
    for one in devices:
        tell(f"device: {one}")
    if not devices:
        say("There is no valid design; the report counts the rejected ones.")
