"""What several commands of a design take, and how a run ends."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from haptorb.apps.terminal import announce_wait, make_console, print_facts, print_json, say, tell

if TYPE_CHECKING:
    from haptorb.apps.design.tally import Tally
    from haptorb.design.design import Design
    from haptorb.design.evaluation import Evaluation
    from haptorb.design.store import ResultsWriter

__all__ = [
    "FileArgument",
    "IntoOption",
    "JsonOption",
    "ProcessesOption",
    "SchedulerOption",
    "SeedOption",
    "end_run",
    "keep_run",
    "open_run",
]

FileArgument = Annotated[Path, typer.Argument(help="Design file (TOML).")]
IntoOption = Annotated[
    str,
    typer.Option(
        "--into", metavar="RESULTS", help="Results: a file, or postgresql://host/name. The same command continues them."
    ),
]
SeedOption = Annotated[int, typer.Option(help="Seed of the designs: the same seed gives the same designs.")]
ProcessesOption = Annotated[
    int | None, typer.Option(help="Number of processes (default: one per core). The result is the same.")
]
SchedulerOption = Annotated[
    str | None,
    typer.Option(metavar="ADDRESS", help="Dask scheduler, such as tcp://host:8786: compute on its cluster."),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON.")]


@contextmanager
def open_run(into: str, design: Design, method: str, seed: int, settings: Mapping[str, Any]) -> Iterator[ResultsWriter]:
    """The run in the results `into`; says so where the base device's own numbers take long."""
    from haptorb.design.store import open_results

    with ExitStack() as stack:
        with announce_wait("Reading the results and computing the base device"):
            writer = stack.enter_context(open_results(into, design, method, seed, settings=settings))
        yield writer


def keep_run(writer: ResultsWriter, found: Iterable[Evaluation], design: Design, total: int, into: str) -> Tally:
    """Store a run of at most `total` candidates with a bar. After ^C: what is stored, and exit code 130."""
    from haptorb.apps.design.keep import keep_candidates

    with _explain_interrupt(writer, total, into):
        return keep_candidates(writer, found, design, total)


def end_run(tally: Tally, into: str, json: bool) -> None:
    """Print the result of a run; exit code 1 if no design is valid."""
    from haptorb.files.sql_engine import mask_password

    if json:
        best = {name: {"number": one.number, "values": dict(one.values), "objectives": dict(one.objectives)}
                for name, one in tally.best.items()}  # fmt: skip
        print_json({"results": mask_password(into), "designs": tally.count, "valid": tally.valid,
                    "refused": dict(tally.refused), "best": best})  # fmt: skip
    else:
        tell(f"{tally.sentence}; in {mask_password(into)}")
        print_facts(make_console(), tally.list_best())
    if not tally.valid:
        say(tally.advice)
        raise typer.Exit(1)


@contextmanager
def _explain_interrupt(writer: ResultsWriter, total: int, into: str) -> Iterator[None]:
    from haptorb.files.sql_engine import mask_password

    try:
        yield
    except KeyboardInterrupt:
        stored = sum(number < total for number in writer.list_known())
        say(f"interrupted: {stored} of {total} designs are in {mask_password(into)}; repeat the command to continue")
        raise
