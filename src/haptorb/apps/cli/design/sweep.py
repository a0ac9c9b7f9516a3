"""Try many designs: a grid, a Latin hypercube, or a Sobol sequence."""

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

__all__ = ["sweep"]


def sweep(
    file: FileArgument,
    into: IntoOption = "results.sqlite",
    method: Annotated[str, typer.Option(help="Method: sobol, latin-hypercube or grid.")] = "sobol",
    count: Annotated[int, typer.Option(help="Number of designs; for a grid the maximum.")] = 1000,
    seed: SeedOption = 1,
    processes: ProcessesOption = None,
    scheduler: SchedulerOption = None,
    json: JsonOption = False,
) -> None:
    """Evaluate many designs over the ranges of a design file. After Ctrl-C the same command continues."""
    from haptorb.apps.own_code import announce_code
    from haptorb.design.design_file import load_design
    from haptorb.design.sampling import list_settings, sample
    from haptorb.design.sampling import sweep as evaluate_sample
    from haptorb.design.workers.open_workers import open_workers

    design = load_design(file, announce_code)
    values = sample(design, method, count, seed)
    with (
        open_run(into, design, method, seed, list_settings(method, values)) as writer,
        open_workers(design, processes, scheduler) as workers,
    ):
        found = evaluate_sample(values, workers.evaluate, writer.list_known())
        tally = keep_run(writer, found, design, len(values), into)
    end_run(tally, into, json)
