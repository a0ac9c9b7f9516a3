"""Before anybody takes part: check the study file, rehearse it, and find how many people it needs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from haptorb.apps.cli.study.forecast import keep_begun_study, print_forecast
from haptorb.apps.cli.study.options import DatabaseOption, FileArgument
from haptorb.apps.cli.study.order_table import print_order
from haptorb.apps.terminal import Column, TextTable, make_console, make_progress, print_json, print_table, say, tell

__all__ = ["check", "new", "power", "simulate"]


def new(
    name: Annotated[str, typer.Argument(help="Name of the study, or of its file, NAME.toml.")],
    like: Annotated[
        str, typer.Option(help="Template: zarate2020, identification, staircase, magnitude or comparison.")
    ] = "identification",
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
) -> None:
    """Write a commented study file as a template."""
    from haptorb.apps.study.templates.study_template import write_study

    path = write_study(name, like, overwrite=force)
    tell(f"{path}: like '{like}'. Edit it, then: haptorb study check {path}")


def check(
    file: FileArgument,
    people: Annotated[int, typer.Option(help="Number of participants whose order to show.")] = 6,
    register: Annotated[
        Path | None,
        typer.Option(
            metavar="NEW.toml", help="Write a registration before data exist: study and plan, with digests and time."
        ),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Check a study file: mistakes, order of the trials, duration, coil temperature, overlap of the maps, plan."""
    from haptorb.apps.study.model.order_summary import summarize_order
    from haptorb.apps.study.model.prompts import has_set_points
    from haptorb.apps.study.model.study_reader import read_study

    known = read_study(file)
    order = summarize_order(known, people)
    if register is not None:
        from haptorb.apps.study.store.registration import write_registration

        made = write_registration(known, register)
        say(f"registered: plan {made.plan} of study {made.study}, {made.written}, in {register}")
    if json:
        from haptorb.apps.study.simulated.forecast import find_unfelt, forecast, overlap

        result, reach, unfelt = forecast(known), overlap(known), find_unfelt(known)
        about = {"study": known.name, "procedure": known.procedure, "device": known.device}
        print_json({**about, "set_points": len(known.points), **result.numbers(), "overlap": reach and reach.numbers(),
                    "unfelt": [one.numbers() for one in unfelt], "order": order.numbers(),
                    "plan": known.plan and known.plan.numbers()})  # fmt: skip
        if not result.holds or unfelt:
            raise typer.Exit(1)
        return
    first = known.points[0]
    where = f"{len(known.points)} set-points" if has_set_points(known) else f"everything at θ = {first.theta_deg:g} deg"
    tell(f"{known.name}: {known.procedure} on '{known.device}', {where}")
    print_order(order)
    if known.plan is not None:
        tell(known.plan.sentence)
    if not print_forecast(known):
        raise typer.Exit(1)


def simulate(
    file: FileArgument,
    db: DatabaseOption = "simulated.db",
    participants: Annotated[int, typer.Option(help="Number of simulated participants.")] = 6,
    first: Annotated[int, typer.Option(help="Number in the first code, SIM01 and so on.")] = 1,
    seed: Annotated[int, typer.Option(help="Seed of the simulated participants.")] = 0,
) -> None:
    """Rehearse the study with SIMULATED participants. Their answers are not evidence about people."""
    from haptorb.apps.study.model.study_reader import read_study
    from haptorb.apps.study.simulated.rehearsal import rehearse
    from haptorb.apps.study.store.contents import check_contents
    from haptorb.apps.study.store.database import database

    known = read_study(file)  # before a database is made
    engine = database(db)
    check_contents(engine, "simulated")
    known = keep_begun_study(engine, known)
    with make_progress() as bar:
        task = bar.add_task("SIMULATED trials", total=None)
        answered = rehearse(
            engine, known, participants, seed=seed, first=first,
            progress=lambda done, total: bar.update(task, completed=done, total=total),
        )  # fmt: skip
    tell(f"{answered} SIMULATED trials in {db}; `haptorb study analyse {db}` shows them")


def power(
    file: FileArgument,
    between: Annotated[
        tuple[str, str] | None,
        typer.Option(help="The two conditions to compare (default: those of the plan, or the first two in the file)."),
    ] = None,
    measure: Annotated[
        str | None,
        typer.Option(
            help="Measure: error, accuracy, rating, threshold, midpoint, choice, magnitude, exponent, upward-bias or "
            "error-slope (default: by plan or procedure)."
        ),
    ] = None,
    pool: Annotated[int, typer.Option(help="Number of simulated participants to draw from.")] = 40,
    people: Annotated[
        list[int] | None,
        typer.Option(
            help="Number of participants to show; repeatable. The search also tries lower and higher numbers."
        ),
    ] = None,
    alpha: Annotated[
        float | None, typer.Option(help="Significance level (default: that of the plan for one test, or 0.05).")
    ] = None,
    test: Annotated[str | None, typer.Option(help="Test: t or sign-flip (default: that of the plan, or t).")] = None,
    wanted: Annotated[float, typer.Option("--power", help="Required probability of detecting the difference.")] = 0.8,
    seed: Annotated[int, typer.Option(help="Seed of the simulated participants.")] = 0,
    processes: Annotated[
        int | None, typer.Option(help="Number of processes (default: one per core). The result is the same.")
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Dask scheduler, such as tcp://host:8786: compute on its cluster."),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Estimate how many participants a study needs, with simulated participants."""
    from haptorb.apps.study.inference.significance import check_test
    from haptorb.apps.study.model.study_reader import read_study
    from haptorb.apps.study.simulated.power import power as estimate_power
    from haptorb.cluster.cores import count_cores

    known = read_study(file)
    with make_progress() as bar:
        task = bar.add_task("SIMULATED participants", total=None)
        found = estimate_power(
            known, between, measure, pool=pool, people=people, alpha=alpha, wanted=wanted, seed=seed,
            test=None if test is None else check_test(test),
            processes=count_cores() if processes is None else processes, scheduler=scheduler,
            progress=lambda done, total: bar.update(task, completed=done, total=total),
        )  # fmt: skip
    if json:
        print_json(found.numbers())
        return
    table = TextTable((Column("participants"), Column("power"), Column("95 %")))
    for n, share, low, high in zip(found.people, found.power, found.low, found.high, strict=True):
        table.add_row(str(n), f"{share:.2f}", f"{low:.2f} to {high:.2f}")
    print_table(make_console(), table)
    tell(found.sentence)
