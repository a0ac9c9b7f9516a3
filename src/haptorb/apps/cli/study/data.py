"""What has been answered: who took part, what it says, and the data themselves."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Annotated

import typer

from haptorb.apps.cli.study.options import DatabaseArgument, DataOption, NameOption
from haptorb.apps.terminal import (
    Column,
    TextTable,
    make_console,
    make_progress,
    print_json,
    print_table,
    say,
    show_status,
    tell,
)
from haptorb.errors import InputError

__all__ = ["analyse", "export", "figures", "participants"]


def participants(
    db: DatabaseArgument,
    name: NameOption = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """List the codes in use, the states of their sessions, and a free code."""
    from haptorb.apps.study.model.codes import next_code
    from haptorb.apps.study.store.columns import read_study
    from haptorb.apps.study.store.contents import describe_kind, read_contents
    from haptorb.apps.study.store.database import database
    from haptorb.apps.study.store.people import list_participants

    engine = database(db, make=False)
    known, holds = read_study(engine, name), read_contents(engine)
    people = list_participants(engine, known)
    free = next_code(one.code for one in people)
    if json:
        print_json(
            {
                "study": known.name,
                "holds": holds,
                "participants": [one.numbers() for one in people],
                "next_free_code": free,
            }
        )
        return
    table = TextTable((Column("code", kind="key"), Column("session", kind="text"), Column("answered trials"),
                       Column("begun (UTC)", kind="text")))  # fmt: skip
    for one in people:
        state = f"{one.state}, its code continues it" if one.state == "open" else one.state
        state = f"SIMULATED, {state}" if one.simulated else state
        table.add_row(one.code, state, str(one.answered), one.started[:16].replace("T", " "))
    print_table(make_console(), table)
    tell(f"next free code: {free}")
    tell(f"{db} holds {describe_kind(holds)}")


def analyse(
    db: DatabaseArgument,
    name: NameOption = None,
    data: DataOption = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder for report and figures (default: STUDY-report).")
    ] = None,
    registration: Annotated[
        Path | None, typer.Option(help="Registration from `haptorb study check --register`, to compare the plan with.")
    ] = None,
    figures: Annotated[str, typer.Option(help="Format of the figures: svg or png.")] = "svg",
    serve: Annotated[
        bool, typer.Option("--serve", help="Serve the report, with a link that plays each recorded trial.")
    ] = False,
    port: Annotated[int, typer.Option(help="With --serve: port; 0 takes any free port.")] = 8768,
    json: Annotated[bool, typer.Option("--json", help="Only print the numbers as JSON.")] = False,
) -> None:
    """Analyse the answers: confusion, accuracy, error over θ, psychometric curves; write an HTML report."""
    from haptorb.apps.study.analysis.load_analysis import analysis_of
    from haptorb.apps.study.store.contents import check_kind

    if figures not in ("svg", "png"):
        raise InputError(f"--figures must be svg or png; got '{figures}'")
    kind = None if data is None else check_kind(data)
    registered = None
    if registration is not None:
        from haptorb.apps.study.store.registration import read_registration

        registered = read_registration(registration)
    with make_progress() as bar:
        task = bar.add_task("reading the answers", total=None)
        done = analysis_of(
            db, name,
            lambda fitted, people: bar.update(task, description="fitting people", completed=fitted, total=people),
            registration=registered, data=kind,
        )  # fmt: skip
    if json:
        print_json(done.numbers())
        return
    from haptorb.apps.study.analysis.report import write_report
    from haptorb.apps.study.analysis.summary import print_summary

    print_summary(done, make_console())
    pages = list[str]()
    with show_status("drawing the figures"):
        folder = out or Path(f"{done.study.name}-report")
        path = write_report(done, folder, kind=figures, serve=pages.append if serve else None)
    tell(f"report: {path}")
    if serve:
        _serve_report(pages[0], [_find_beside(db, part) for *_, part in done.recorded], port)


def _find_beside(db: str, part: str) -> str:
    """The part of a recording that a database names, beside the database: what lies elsewhere is not for it to name."""
    path, mark, span = part.partition("#t=")
    folder = Path() if "://" in db else Path(db).parent
    return f"{folder / Path(path).name}{mark}{span}"  # safety: recording-beside


def _serve_report(html: str, parts: list[str], port: int) -> None:
    from haptorb.apps.study.pages.report_server import ReportServer

    server = ReportServer(html, parts, port)
    number = server.serve(lambda: say(f"Open {server.url} in a browser: the report, with its recordings. Ctrl-C ends."))
    if number is not None and number != signal.SIGINT:
        raise typer.Exit(128 + number)


def figures(
    db: DatabaseArgument,
    name: NameOption = None,
    data: DataOption = None,
    out: Annotated[Path | None, typer.Option("--out", help="Folder to write (default: STUDY-figures).")] = None,
    kind: Annotated[str, typer.Option("--format", help="Format: pdf, svg or png (600 dpi).")] = "pdf",
    single: Annotated[float, typer.Option(help="Width of a figure in one column [mm].")] = 85.0,
    double: Annotated[float, typer.Option(help="Width of a figure over both columns [mm].")] = 174.0,
    force: Annotated[bool, typer.Option("--force", help="Replace existing files.")] = False,
) -> None:
    """Draw all figures for a paper: vector graphics, colour-blind safe, fonts embedded, with captions."""
    from haptorb.apps.study.analysis.drawings.figure_set import KINDS, write_figures
    from haptorb.apps.study.analysis.drawings.style import PaperSize
    from haptorb.apps.study.analysis.load_analysis import analysis_of
    from haptorb.apps.study.store.contents import check_kind

    if kind not in KINDS:
        raise InputError(f"--format must be {', '.join(KINDS)}; got '{kind}'")
    size = PaperSize(single, double)
    done = analysis_of(db, name, data=None if data is None else check_kind(data))
    files = write_figures(done, out or Path(f"{done.study.name}-figures"), kind, size=size, overwrite=force)
    tell(f"{done.origin}\n" + "\n".join(map(str, files)))


def export(
    db: DatabaseArgument,
    path: Annotated[Path, typer.Argument(help="Output: NAME.csv, NAME.parquet, or a folder for BIDS.")],
    name: NameOption = None,
    data: DataOption = None,
    force: Annotated[bool, typer.Option("--force", help="Replace an earlier export of this study.")] = False,
) -> None:
    """Export all trials, one row each: CSV, Parquet, or a BIDS folder, with a data dictionary."""
    from haptorb.apps.study.store.contents import check_kind
    from haptorb.apps.study.store.copies import note_copy
    from haptorb.apps.study.store.database import database
    from haptorb.apps.study.store.study_export import check_output, export_study

    check_output(path)
    engine = database(db, make=False)
    done = export_study(engine, path, name, None if data is None else check_kind(data), overwrite=force)
    note_copy(engine, "export", path, done.study, {"data": data})
    practice = f", {done.practice} of them practice" if done.practice else ""
    tell(f"{done.trials} trials{practice}: {', '.join(map(str, done.files))}")
    if done.left_out:
        say(f"left out, of another kind: {done.left_out}")
    if done.on_simulated_device:
        say("SIMULATED DEVICE: trials in which nobody felt a force are marked in the column simulated_device")
