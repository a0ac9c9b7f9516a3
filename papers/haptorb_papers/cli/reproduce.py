"""`haptorb reproduce`: every table, figure and number of both papers, as one page and as JSON."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from haptorb.errors import InputError
from haptorb.terminal import Column, TextTable, echo, make_console, make_progress, print_json, print_table

if TYPE_CHECKING:
    from haptorb_papers.reproduce import Reproduction, ReproductionResult

__all__ = ["register"]


def register(app: typer.Typer) -> None:
    """Add the command to `app`."""
    app.command()(reproduce)


def reproduce(
    paper: Annotated[str | None, typer.Argument(help="Paper: bai2012 or zarate2020 (default: both).")] = None,
    figure: Annotated[int | None, typer.Option(help="Only this figure.")] = None,
    table: Annotated[str | None, typer.Option(help="Only this table: 1, 2, 3 or A.1.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for page and JSON (default: current folder).")] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace existing files.")] = False,
    quick: Annotated[bool, typer.Option("--quick", help="Leave out the slow sections.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Also print the numbers as JSON.")] = False,
) -> None:
    """Recompute the numbers of both papers, classify each result, and write a page and JSON.

    Exit code 1 if a number differs and its row does not state why."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # training: small matrices, a second thread only waits in a loop
    from haptorb.files import replace_file
    from haptorb_papers.reproduce import report_page

    folder = out or Path()
    if not folder.is_dir():
        raise InputError(f"--out: the folder '{folder}' does not exist; create it, or choose another")
    chosen, name = _choose(paper, figure, table, quick)
    paths = [folder / f"{name}.html", folder / f"{name}.json"]
    there = [str(path) for path in paths if path.exists()]
    if there and not force:
        raise InputError(f"{there[0]} exists; use --force to replace it, or --out for another folder")
    made = _make(chosen)
    every = [item for one in made for item in one.items]
    from json import dumps

    numbers = dumps([item.numbers() for item in every], indent=2, ensure_ascii=False)
    for path, text in zip(paths, (report_page(made), numbers + "\n"), strict=True):
        with replace_file(path) as part:
            part.write_text(text, encoding="utf-8")
    if json:
        print_json([item.numbers() for item in every])
    else:
        _show(made, paths)
    if any(item.is_surprise for item in every):
        raise typer.Exit(1)


def _choose(
    paper: str | None, figure: int | None, table: str | None, quick: bool
) -> tuple[tuple[Reproduction, ...], str]:
    """Parts to be made, and the name of the files."""
    from haptorb_papers.reproduce import find_reproduction, reproductions

    chosen = reproductions(paper)
    if figure is not None or table is not None:
        if paper is None or (figure is not None and table is not None):
            raise InputError(
                "--figure and --table need one paper and exclude each other: haptorb reproduce bai2012 --figure 8"
            )
        one = find_reproduction(paper, f"figure {figure}" if figure is not None else f"table {table}")
        return (one,), f"{one.paper}-{one.name.replace(' ', '-')}"
    if quick:
        chosen = tuple(one for one in chosen if not one.slow)
    return chosen, f"reproduction-{paper}" if paper else "reproduction"


def _make(chosen: tuple[Reproduction, ...]) -> list[ReproductionResult]:
    from haptorb_papers.reproduce import ReproductionResult

    # The slow ones take about as long as thirty others each; so the bar moves evenly.
    weights = [30.0 if one.slow else 1.0 for one in chosen]
    made = []
    with make_progress() as bar:
        task = bar.add_task("", total=sum(weights))
        for n, one in enumerate(chosen):
            bar.update(task, description=f"{one.paper}, {one.name}", completed=sum(weights[:n]))

            def report(share: float, before: float = sum(weights[:n]), weight: float = weights[n]) -> None:
                bar.update(task, completed=before + weight * share)

            made.append(ReproductionResult(one, *one.make(report)))
    return made


def _show(made: list[ReproductionResult], paths: list[Path]) -> None:
    from haptorb_papers.reproduce import summary

    table = TextTable((Column("statement", kind="text"), Column("published"), Column("here"),
                       Column("unit", kind="short"), Column("verdict", kind="note")))  # fmt: skip
    for item in (item for one in made for item in one.items):
        numbers = ["" if value is None else f"{value:.5g}" for value in (item.published, item.computed)]
        if item.implied:  # no number in print
            numbers[0] = f"({numbers[0]})"
        table.add_row(f"{item.where}: {item.what}", *numbers, "" if item.unit == "1" else item.unit, item.label)
    print_table(make_console(), table)
    counts = summary(item for one in made for item in one.items)
    echo("\n" + ", ".join(f"{count} {verdict}" for verdict, count in counts.items()))
    for path in paths:
        echo(f"written: {path}")
