"""`haptorb reproduce`: tables and figures of both papers again, number by number."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from haptorb.errors import InputError

if TYPE_CHECKING:
    from haptorb.apps.reproduce import Item, Reproduction

__all__ = ["register"]


def register(app: typer.Typer) -> None:
    """Add the command to `app`."""
    app.command()(reproduce)


def reproduce(
    paper: Annotated[str | None, typer.Argument(help="bai2012 or zarate2020; both if not given.")] = None,
    figure: Annotated[int | None, typer.Option(help="Only this figure.")] = None,
    table: Annotated[int | None, typer.Option(help="Only this table.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for the figures; the present one if not given.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace figures that are there.")] = False,
    json: Annotated[bool, typer.Option("--json", help="The numbers as JSON.")] = False,
) -> None:
    """Compute what the papers print, say whether it agrees, and draw the figures. Exit code 1 where it differs."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # training: small matrices, a second thread only waits in a loop
    from haptorb.apps.reproduce import reproduced, reproductions

    folder = out or Path()
    if not folder.is_dir():
        raise InputError(f"--out: the folder '{folder}' does not exist")
    chosen = reproductions(paper)
    if figure is not None or table is not None:
        if paper is None or (figure is not None and table is not None):
            raise InputError("--figure or --table is one of a paper: haptorb reproduce bai2012 --figure 8")
        chosen = (reproduced(paper, f"figure {figure}" if figure is not None else f"table {table}"),)
    paths = {one: folder / f"{one.paper}-{one.name.replace(' ', '-')}.png" for one in chosen}
    there = [str(path) for path in paths.values() if path.exists()]
    if there and not force:
        raise InputError(f"{there[0]} exists; use --force to replace it, or --out for another folder")
    every: list[Item] = []
    for one, path in paths.items():
        items, draw = _made(one)
        every += items
        draw(path)
    _shown(every, list(paths.values()), json)
    if any(item.verdict == "differs" for item in every):
        raise typer.Exit(1)


def _made(one: Reproduction) -> tuple[tuple[Item, ...], Any]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn(f"{one.paper}, {one.name}"), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(one.name, total=1.0)
        return one.made(lambda share: bar.update(task, completed=share))


def _shown(items: list[Item], paths: list[Path], json: bool) -> None:
    if json:
        from json import dumps

        print(dumps([item.numbers() for item in items], indent=2, ensure_ascii=False))
        return
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None)
    for column in ("", "published", "here", "", "verdict"):
        table.add_column(column)
    for item in items:
        published = "" if item.published is None else f"{item.published:.5g}"
        table.add_row(f"{item.where}: {item.what}", published, f"{item.computed:.5g}", item.unit, item.verdict)
    console = Console()
    console.print(table)
    for path in paths:
        console.print(f"drawn: {path}", highlight=False)
