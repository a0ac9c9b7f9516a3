"""Search for the best designs: an optimiser that learns from what it has tried."""

from __future__ import annotations

from typing import Annotated

import typer

from haptorb.apps.cli.design.options import (
    FileArgument,
    IntoOption,
    JsonOption,
    ProcessesOption,
    SchedulerOption,
    SeedOption,
    end_run,
    keep_run,
    open_run,
)
from haptorb.errors import InputError

__all__ = ["optimise"]

_GENERATIONS = 20  #: unless something else is asked for


def optimise(
    file: FileArgument,
    into: IntoOption = "results.sqlite",
    generations: Annotated[
        int | None,
        typer.Option(help=f"Number of generations (default: {_GENERATIONS}). A larger number continues a run."),
    ] = None,
    evaluations: Annotated[
        int | None, typer.Option(help="Number of designs, instead of generations. A larger number continues a run.")
    ] = None,
    population: Annotated[int, typer.Option(help="Number of designs in a generation.")] = 50,
    seed: SeedOption = 1,
    processes: ProcessesOption = None,
    scheduler: SchedulerOption = None,
    json: JsonOption = False,
) -> None:
    """Search for the best design (differential evolution) or the Pareto front of several objectives (NSGA-II).

    The same command continues a run.
    """
    from haptorb.apps.own_code import announce_code
    from haptorb.design.design_file import load_design
    from haptorb.design.search.optimise import optimise as evaluate_generations
    from haptorb.design.search.optimiser import Optimiser
    from haptorb.design.workers.open_workers import open_workers

    total = _count_designs(generations, evaluations, population)
    design = load_design(file, announce_code)
    optimiser = Optimiser(design, seed=seed, population=population)
    with (
        open_run(into, design, optimiser.method, seed, {"population": population}) as writer,
        open_workers(design, processes, scheduler) as workers,
    ):
        found = evaluate_generations(optimiser, workers.evaluate, writer.list_known(), total)
        tally = keep_run(writer, found, design, total, into)
    end_run(tally, into, json)


def _count_designs(generations: int | None, evaluations: int | None, population: int) -> int:
    """How many designs a run has."""
    if generations is not None and evaluations is not None:
        raise InputError("give either --generations or --evaluations")
    for name, value in (("generations", generations), ("evaluations", evaluations)):
        if value is not None and value < 1:
            raise InputError(f"--{name} must be 1 or more; got {value}")
    return evaluations or (generations or _GENERATIONS) * population
