"""Commands `haptorb design sweep | optimise | report | show`."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from haptorb.cli.keys import FILES, FileKeys, KeySection
from haptorb.cli.run import AddressOption, HostOption
from haptorb.errors import InputError
from haptorb.terminal import (
    CommandLine,
    announce_wait,
    echo,
    make_console,
    make_progress,
    notify,
    print_facts,
    print_json,
    queue_output,
)

if TYPE_CHECKING:
    from haptorb_design.problem import Design, Evaluation
    from haptorb_design.store import ResultsWriter
    from haptorb_design.tally import Tally

__all__ = [
    "FileArgument",
    "IntoOption",
    "JsonOption",
    "LimitOption",
    "ProcessesOption",
    "SchedulerOption",
    "SeedOption",
    "end_run",
    "list_design_sections",
    "open_run",
    "optimise",
    "register",
    "report",
    "show",
    "store_run",
    "sweep",
]


# --------------------------------------------------------------------------------------------------
# Options shared by several commands, and the end of a run.


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
LimitOption = Annotated[
    float, typer.Option("--time-limit", help="Processor time of one design [s]: one that needs longer is rejected.")
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON.")]


@contextmanager
def open_run(
    into: str, design: Design, method: str, seed: int, settings: Mapping[str, Any], limit: float
) -> Iterator[ResultsWriter]:
    """Open the run in the results `into`; announces a long computation of the base device (`limit` [s] a quantity)."""
    from haptorb_design.store import open_results

    with ExitStack() as stack:
        with announce_wait("Reading the results and computing the base device"):
            writer = stack.enter_context(open_results(into, design, method, seed, settings=settings, limit=limit))
        yield writer


def store_run(writer: ResultsWriter, found: Iterable[Evaluation], design: Design, total: int, into: str) -> Tally:
    """Store a run of at most `total` candidates with a progress bar. ^C: report what is stored, exit code 130."""
    from haptorb_design.tally import store_candidates

    with _explain_interrupt(writer, total, into):
        return store_candidates(writer, found, design, total)


def end_run(tally: Tally, into: str, json: bool) -> None:
    """Print the result of a run; exit code 1 if no design is valid."""
    from haptorb.database_address import mask_password

    if json:
        best = {name: {"number": one.number, "values": dict(one.values), "objectives": dict(one.objectives)}
                for name, one in tally.best.items()}  # fmt: skip
        print_json({"results": mask_password(into), "designs": tally.count, "valid": tally.valid,
                    "refused": dict(tally.refused), "best": best})  # fmt: skip
    else:
        echo(f"{tally.sentence}; in {mask_password(into)}")
        print_facts(make_console(), tally.list_best())
    if tally.failures:
        notify(tally.failures)
    if not tally.valid:
        notify(tally.advice)
        raise typer.Exit(1)


@contextmanager
def _explain_interrupt(writer: ResultsWriter, total: int, into: str) -> Iterator[None]:
    from haptorb.database_address import mask_password

    try:
        yield
    except KeyboardInterrupt:
        stored = sum(number < total for number in writer.list_known())
        notify(f"interrupted: {stored} of {total} designs are in {mask_password(into)}; repeat the command to continue")
        raise


# --------------------------------------------------------------------------------------------------
# Optimisation.


_DEFAULT_GENERATIONS = 20  #: default


def optimise(
    file: FileArgument,
    into: IntoOption = "results.sqlite",
    generations: Annotated[
        int | None,
        typer.Option(help=f"Number of generations (default: {_DEFAULT_GENERATIONS}). A larger number continues a run."),
    ] = None,
    evaluations: Annotated[
        int | None, typer.Option(help="Number of designs, instead of generations. A larger number continues a run.")
    ] = None,
    population: Annotated[int, typer.Option(help="Number of designs in a generation.")] = 50,
    seed: SeedOption = 1,
    processes: ProcessesOption = None,
    scheduler: SchedulerOption = None,
    time_limit: LimitOption = 600.0,
    json: JsonOption = False,
) -> None:
    """Search for the best design (differential evolution) or the Pareto front of several objectives (NSGA-II).

    The same command continues a run.
    """
    from haptorb.cli.own_code import announce_code
    from haptorb_design.design_file import load_design
    from haptorb_design.search import Optimiser
    from haptorb_design.search import optimise as evaluate_generations
    from haptorb_design.workers import open_workers

    total = _count_designs(generations, evaluations, population)
    design = load_design(file, announce_code)
    optimiser = Optimiser(design, seed=seed, population=population)
    with (
        open_run(into, design, optimiser.method, seed, {"population": population}, time_limit) as writer,
        open_workers(design, processes, scheduler, time_limit) as workers,
    ):
        found = evaluate_generations(optimiser, workers.evaluate, writer.list_known(), total)
        tally = store_run(writer, found, design, total, into)
    end_run(tally, into, json)


def _count_designs(generations: int | None, evaluations: int | None, population: int) -> int:
    """Number of designs of a run."""
    if generations is not None and evaluations is not None:
        raise InputError("give either --generations or --evaluations")
    for name, value in (("generations", generations), ("evaluations", evaluations)):
        if value is not None and value < 1:
            raise InputError(f"--{name} must be 1 or more; got {value}")
    return evaluations or (generations or _DEFAULT_GENERATIONS) * population


# --------------------------------------------------------------------------------------------------
# Report, and device files of the best designs.


def report(
    results: Annotated[str, typer.Argument(help="Results: a file, or postgresql://host/name.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="HTML file to write.")] = Path("report.html"),
    count: Annotated[int, typer.Option("--best", help="Number of best designs, 1 to 20.")] = 5,
    json: JsonOption = False,
) -> None:
    """Write the results as one HTML page, and the best designs beside it as device files for `haptorb run`."""
    from haptorb_design.report import write_report

    with make_progress() as bar:
        task = bar.add_task("reading the results", total=None)

        def advance(text: str, done: int, total: int) -> None:
            bar.update(task, description=text, completed=done, total=total)

        page, *devices = write_report(results, output, advance, count=count)
    if json:
        print_json({"report": str(page), "devices": [str(one) for one in devices]})
        return
    echo(f"report: {page}")
    for one in devices:
        echo(f"device: {one}")
    if not devices:
        notify("There is no valid design; the report counts the rejected ones.")


# --------------------------------------------------------------------------------------------------
# Chooser in the browser.


def show(
    results: Annotated[str, typer.Argument(help="Results: a file, or postgresql://host/name.")],
    port: Annotated[int, typer.Option(help="Port of the page; 0 takes any free port.")] = 8764,
    host: HostOption = "127.0.0.1",
    address: AddressOption = "",
    console_port: Annotated[int, typer.Option(help="Port of the console in the page; 0 takes any free port.")] = 0,
    console_address: Annotated[str, typer.Option(help="With --address: address of that console.")] = "",
    browser: Annotated[bool, typer.Option("--open", help="Open the page in the browser.")] = False,
    duration: Annotated[float | None, typer.Option(help="Duration [s] (default: until Ctrl-C).")] = None,
) -> None:
    """Choose a design in the browser, see its device in three dimensions, and feel it, SIMULATED."""
    if duration is not None and not 0 < duration < float("inf"):
        raise InputError(f"--duration must be greater than 0 s; got {duration:g} s")
    from haptorb.runtime.linux import describe_timing
    from haptorb.web.server import PageAddress

    if timing := describe_timing():
        notify(timing)
    where = PageAddress(host, address)
    from haptorb_design.chooser import Chooser
    from haptorb_design.results_table import ResultsTable
    from haptorb_design.store import read_results

    with announce_wait("reading the results, and computing the base device"):
        table = ResultsTable.of(read_results(results))
    if not table.found:
        refusals = ", ".join(f"{one.by} rejects {one.count}" for one in table.refusals)
        raise InputError(f"{results} holds no valid design to show ({refusals or 'nothing was computed'})")
    if where.warning:
        notify(where.warning)
    with (
        queue_output(),
        Chooser(table, port, where=where, console_port=console_port, console_address=console_address) as chooser,
    ):
        notify(f"Open {chooser.url} in a browser. Ctrl-C ends.")
        number = chooser.serve(open_browser=browser, notify=notify, until=duration)
    if number:
        raise typer.Exit(128 + number)


# --------------------------------------------------------------------------------------------------
# Sweep: grid, Latin hypercube, or Sobol sequence.


def sweep(
    file: FileArgument,
    into: IntoOption = "results.sqlite",
    method: Annotated[str, typer.Option(help="Method: sobol, latin-hypercube or grid.")] = "sobol",
    count: Annotated[int, typer.Option(help="Number of designs; for a grid the maximum.")] = 1000,
    seed: SeedOption = 1,
    processes: ProcessesOption = None,
    scheduler: SchedulerOption = None,
    time_limit: LimitOption = 600.0,
    json: JsonOption = False,
) -> None:
    """Evaluate many designs over the ranges of a design file. After Ctrl-C the same command continues."""
    from haptorb.cli.own_code import announce_code
    from haptorb_design.design_file import load_design
    from haptorb_design.sampling import list_settings, sample
    from haptorb_design.sampling import sweep as evaluate_sample
    from haptorb_design.workers import open_workers

    design = load_design(file, announce_code)
    values = sample(design, method, count, seed)
    with (
        open_run(into, design, method, seed, list_settings(method, values), time_limit) as writer,
        open_workers(design, processes, scheduler, time_limit) as workers,
    ):
        found = evaluate_sample(values, workers.evaluate, writer.list_known())
        tally = store_run(writer, found, design, len(values), into)
    end_run(tally, into, json)


def list_design_sections() -> list[KeySection]:
    """The keys of a design file, and the quantities for its objectives and constraints."""
    from haptorb.devices.schema import KeyText, list_keys
    from haptorb_design.design_file import DeviceDesignFile
    from haptorb_design.objectives import quantity, quantity_names

    named = [
        replace(key, path=re.sub(r"^(parameters|objectives|constraints)\.", r"\1.NAME.", key.path))
        for key in list_keys(DeviceDesignFile)
    ]
    quantities = [
        KeyText(one.name, one.text, f"{one.sense}; {', '.join(one.kinds)}", one.unit or "1", "any", "")
        for one in map(quantity, quantity_names())
    ]
    return [KeySection("", tuple(named)), KeySection("Quantities of objectives and constraints", tuple(quantities))]


def register(app: typer.Typer) -> None:
    """Add the commands to `app`."""
    FILES["design"] = FileKeys("a search for devices: haptorb design sweep FILE", list_design_sections)
    design = CommandLine(help="Search for devices by a sweep or an optimiser; report and show the results.")
    for command in (sweep, optimise, report, show):
        design.command()(command)
    app.add_typer(design, name="design")
