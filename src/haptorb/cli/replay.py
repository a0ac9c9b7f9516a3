"""`haptorb replay`: run a recording again, bit for bit, or with another world, estimator, model or rate."""

from __future__ import annotations

import os
import time
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from haptorb.errors import InputError
from haptorb.terminal import make_console, make_progress, print_facts, print_json, print_table

if TYPE_CHECKING:
    from haptorb.arrays import Array
    from haptorb.devices.base import Device
    from haptorb.recording.recording import Recording
    from haptorb.replay.replay import Replay
    from haptorb.worlds.base import World

__all__ = ["register"]


def register(app: typer.Typer) -> None:
    """Add the command to `app`."""
    app.command()(replay)


def replay(
    file: Annotated[Path, typer.Argument(help="Recording of a run, a study or a trip (MCAP).")],
    out: Annotated[Path | None, typer.Option(help="Write the result to this recording (MCAP).")] = None,
    compare: Annotated[Path | None, typer.Option(help="Plot both runs to this PNG, SVG or PDF file.")] = None,
    world: Annotated[
        str | None,
        typer.Option(help="World to render instead: a name, FILE.py:NAME, or recorded (the recorded wrench)."),
    ] = None,
    settings: Annotated[
        list[str] | None, typer.Option("--set", help="With --world: parameter, NAME=VALUE, as for `haptorb run`.")
    ] = None,
    estimator: Annotated[
        str | None,
        typer.Option(
            help="Estimator to use instead of the recorded one: tracker, hall, least-squares, network, linear (the "
            "last three of a motor)."
        ),
    ] = None,
    model: Annotated[str | None, typer.Option(help="Controller model to use instead of the recorded one.")] = None,
    rate: Annotated[float | None, typer.Option(help="Loop rate [Hz] to use instead of the recorded one.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Let --out and --compare replace existing files.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Run a recording again and compare every number of every tick. Can replace world, estimator, model or rate."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as in the loop: the order of summation affects rounding
    from haptorb.cli.recording import check_rows, list_missing, report_end
    from haptorb.figure_file import check_figure_file
    from haptorb.recording.recording import Recording
    from haptorb.replay.replay import Replay, check_replay_file

    if settings and world in (None, "recorded"):
        raise InputError("--set needs --world: it changes the parameters of that world")
    recording = Recording(file)
    check_rows(recording, show=not json)
    report_end(recording)
    if out is not None:
        check_replay_file(out, overwrite=force)
    if compare is not None:
        check_figure_file(compare, "--compare")
        if compare.exists() and not force:
            raise InputError(f"--compare: {compare} exists; choose another name, or replace it with --force")
    chosen = None
    if world not in (None, "recorded"):
        from haptorb.replay.recorded_run import RecordedRun

        chosen = _choose_world(str(world), settings or [], RecordedRun(recording).device)
    as_recorded = world == "recorded"
    start = time.perf_counter()
    if all(choice is None for choice in (out, compare, chosen, estimator, model, rate)):
        run = _verify(recording, as_recorded, show=not json)
    else:
        run = Replay(recording, world=chosen, estimator=estimator, model=model, rate=rate, recorded_world=as_recorded)
        _run(run, out, compare, file.name, show=not json)
    took = time.perf_counter() - start
    seconds = run.seconds
    from haptorb.cli.replay_report import difference_table, list_numbers, list_replay_facts

    if json:
        print_json({**list_numbers(run, seconds, took), **list_missing(recording)})
    else:
        console = make_console()
        facts = [("recording", str(file)), *list_replay_facts(run)]
        facts += [("written", str(path)) for path in (out, compare) if path is not None]
        print_facts(console, [*facts, ("took", f"{took:.3g} s for {seconds:.4g} s")])
        if run.comparison.bounds:
            print_table(console, difference_table(run))
    if not (run.comparison.identical or run.replaced or run.approximate):
        raise typer.Exit(1)


def _choose_world(name: str, settings: list[str], device: Device) -> World:
    from haptorb.cli.world_option import choose_world_option
    from haptorb.worlds.user_world import WorldFile

    found = choose_world_option(name, settings, device)
    return found.load() if isinstance(found, WorldFile) else found


def _verify(recording: Recording, recorded_world: bool, *, show: bool) -> Replay:
    """Replay on all processors, for the verdict alone."""
    from haptorb.replay.parallel import replay_in_parts

    with make_progress(show=show) as bar:
        task = bar.add_task("replaying", total=len(recording))
        return replay_in_parts(
            recording, lambda ticks: bar.update(task, completed=ticks), recorded_world=recorded_world
        )


def _run(run: Replay, out: Path | None, compare: Path | None, name: str, *, show: bool) -> None:
    """Replay, and write the requested output files."""
    from haptorb.cli.replay_report import SHOWN, Curves, draw_comparison
    from haptorb.figure_file import write_figure

    curves = Curves(run.layout)
    with make_progress(show=show) as bar, run.write_to(out) if out else nullcontext() as written:
        task = bar.add_task("replaying", total=len(run))

        def store(rows: Array) -> None:
            if written is not None:
                written.append(rows)
            if compare is not None:
                curves.add(rows)

        run.run(lambda ticks: bar.update(task, completed=ticks), store)
    if compare is not None:
        figure = draw_comparison(run.read_recorded(SHOWN), curves.fields(), run.recorded.device.coils.names, name)
        write_figure(figure, compare, "--compare")
