"""`haptorb study new | check | run | simulate | power | participants | analyse | figures | export | merge | withdraw |
backup`, joined.
"""

from __future__ import annotations

import signal
from collections.abc import Callable
from functools import partial
from pathlib import Path
from shlex import join
from typing import TYPE_CHECKING, Annotated

import typer

from haptorb.cli.keys import FILES, FileKeys, KeySection
from haptorb.cli.run import AddressOption, HostOption
from haptorb.errors import InputError, RecordingError
from haptorb.terminal import (
    Column,
    CommandLine,
    TextTable,
    echo,
    make_console,
    make_progress,
    notify,
    print_json,
    print_table,
    queue_output,
    show_status,
)

if TYPE_CHECKING:
    from sqlalchemy.engine import Engine

    from haptorb.runtime.servo import Servo
    from haptorb.web.server import PageAddress
    from haptorb_study.order import OrderSummary
    from haptorb_study.pages.session_manager import SessionManager
    from haptorb_study.study_file import Study

__all__ = [
    "DataOption",
    "DatabaseArgument",
    "DatabaseOption",
    "FileArgument",
    "NameOption",
    "analyse",
    "backup",
    "check",
    "export",
    "figures",
    "list_study_sections",
    "merge",
    "new",
    "participants",
    "power",
    "print_forecast",
    "print_order",
    "register",
    "run",
    "simulate",
    "use_begun_version",
    "withdraw",
]


# --------------------------------------------------------------------------------------------------
# Options shared by several commands.


FileArgument = Annotated[Path, typer.Argument(help="Study file (TOML).")]
DatabaseArgument = Annotated[str, typer.Argument(help="Database of the study: a file, or postgresql://host/name.")]
DatabaseOption = Annotated[
    str, typer.Option("--db", help="Database for the answers: a file, or postgresql://host/name.")
]
NameOption = Annotated[str | None, typer.Option("--study", help="Name of the study, if the database holds several.")]
DataOption = Annotated[
    str | None,
    typer.Option(
        "--data",
        help="Kind of data: real, pilot or simulated (default: real; if there are none, pilot, then simulated).",
    ),
]


# --------------------------------------------------------------------------------------------------
# Data: participants, analysis, figures, export.


def participants(
    db: DatabaseArgument,
    name: NameOption = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """List the codes in use, the states of their sessions, and a free code."""
    from haptorb_study.columns import read_study
    from haptorb_study.data_kind import describe_kind, read_contents
    from haptorb_study.database import database, list_participants
    from haptorb_study.participant_codes import next_code

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
    echo(f"next free code: {free}")
    echo(f"{db} holds {describe_kind(holds)}")


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
    from haptorb_study.analysis.analysis import analysis_of
    from haptorb_study.data_kind import check_kind

    if figures not in ("svg", "png"):
        raise InputError(f"--figures must be svg or png; got '{figures}'")
    kind = None if data is None else check_kind(data)
    registered = None
    if registration is not None:
        from haptorb_study.preregistration import read_registration

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
    from haptorb_study.analysis.report import write_report
    from haptorb_study.analysis.tables import print_summary

    print_summary(done, make_console())
    pages = list[str]()
    with show_status("drawing the figures"):
        folder = out or _own_folder(f"{done.study.name}-report")
        path = write_report(done, folder, kind=figures, serve=pages.append if serve else None)
    echo(f"report: {path}")
    if serve:
        _serve_report(pages[0], [_find_beside(db, part) for *_, part in done.recorded], port)


def _own_folder(name: str) -> Path:
    """Default folder of a command's output. A link of that name came with the database: it may lead anywhere."""
    if Path(name).is_symlink():  # safety: output-not-linked
        raise RecordingError(f"{name}: is a link; name the folder to write to with --out")
    return Path(name)


def _find_beside(db: str, part: str) -> str:
    """The part of a recording that a database names, looked up beside the database only."""
    path, mark, span = part.partition("#t=")
    folder = Path.cwd() if "://" in db else Path(db).absolute().parent
    return f"{folder / Path(path).name}{mark}{span}"  # safety: recording-beside


def _serve_report(html: str, parts: list[str], port: int) -> None:
    from haptorb_study.pages.report_server import ReportServer

    server = ReportServer(html, parts, port)
    number = server.serve(
        lambda: notify(f"Open {server.url} in a browser: the report, with its recordings. Ctrl-C ends.")
    )
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
    from haptorb_study.analysis.analysis import analysis_of
    from haptorb_study.analysis.paper_figures import KINDS, write_figures
    from haptorb_study.analysis.paper_style import PaperSize
    from haptorb_study.data_kind import check_kind

    if kind not in KINDS:
        raise InputError(f"--format must be {', '.join(KINDS)}; got '{kind}'")
    size = PaperSize(single, double)
    done = analysis_of(db, name, data=None if data is None else check_kind(data))
    files = write_figures(done, out or _own_folder(f"{done.study.name}-figures"), kind, size=size, overwrite=force)
    echo(f"{done.origin}\n" + "\n".join(map(str, files)))


def export(
    db: DatabaseArgument,
    path: Annotated[Path, typer.Argument(help="Output: NAME.csv, NAME.parquet, or a folder for BIDS.")],
    name: NameOption = None,
    data: DataOption = None,
    force: Annotated[bool, typer.Option("--force", help="Replace an earlier export of this study.")] = False,
) -> None:
    """Export all trials, one row each: CSV, Parquet, or a BIDS folder, with a data dictionary."""
    from haptorb_study.data_kind import check_kind
    from haptorb_study.database import database
    from haptorb_study.database_copies import record_copy
    from haptorb_study.export import check_output, export_study

    check_output(path)
    engine = database(db, make=False)
    done = export_study(engine, path, name, None if data is None else check_kind(data), overwrite=force)
    record_copy(engine, "export", path, done.study, {"data": data})
    practice = f", {done.practice} of them practice" if done.practice else ""
    echo(f"{done.trials} trials{practice}: {', '.join(map(str, done.files))}")
    if done.left_out:
        notify(f"left out, of another kind: {done.left_out}")
    if done.on_simulated_device:
        notify("SIMULATED DEVICE: trials in which nobody felt a force are marked in the column simulated_device")


# --------------------------------------------------------------------------------------------------
# Forecast of a session, printed before it begins; settings with which a stored study continues.


def print_forecast(known: Study) -> bool:
    """Print the forecast of a session; return whether it stays cool enough and every trial can be felt."""
    from haptorb_study.simulated.forecast import find_unfelt, forecast, overlap

    found = forecast(known)
    notify(("" if found.holds else "warning: ") + found.sentence)
    reach = overlap(known)
    if reach is not None:
        notify("note: " + reach.sentence)
    unfelt = find_unfelt(known)
    for one in unfelt:
        notify("warning: " + one.sentence)
    return found.holds and not unfelt


def use_begun_version(engine: Engine, known: Study) -> Study:
    """`known`, or the version of it that the database holds, with its order and layout; prints which."""
    from haptorb_study.columns import find_begun_version

    study = find_begun_version(engine, known)
    if known.order_version and not study.order_version:
        notify("this study was begun with an older haptorb and keeps the order of that version")
    if known.model_version and not study.model_version:
        notify("this study was begun with an older haptorb, which modelled coils as points, and keeps that model")
    if study.published_layout != known.published_layout:
        notify("this study was begun with 1 + 8 + 8 + 8 set-points and keeps them (erratum E17, withdrawn)")
    return study


# --------------------------------------------------------------------------------------------------
# Order of the trials per participant, printed before the first session.


def print_order(summary: OrderSummary) -> None:
    """Print the order of the first participants and its balance."""
    for sentence in summary.sentences:
        echo(sentence)
    if len(summary.units) < 2 and not summary.asks:
        return
    title = f"Order of the {summary.asks}" if len(summary.units) < 2 else "Order, trial by trial"
    if len(summary.units) > 1 and not summary.mixed:
        title = "Order of the blocks" + (f", and of the {summary.asks} in each" if summary.asks else "")
    table = TextTable((Column("participant"), Column("order", kind="text")), title)
    for person in range(len(summary.plans)):
        table.add_row(str(person + 1), summary.row(person))
    print_table(make_console(), table)


# --------------------------------------------------------------------------------------------------
# Planning: check the study file, rehearse, estimate the number of participants.


def new(
    name: Annotated[str, typer.Argument(help="Name of the study, or of its file, NAME.toml.")],
    like: Annotated[
        str, typer.Option(help="Template: zarate2020, identification, staircase, magnitude or comparison.")
    ] = "identification",
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
) -> None:
    """Write a commented study file as a template."""
    from haptorb_study.template import write_study

    path = write_study(name, like, overwrite=force)
    echo(f"{path}: written from the template '{like}'. Edit it, then: haptorb study check {path}")


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
    from haptorb_study.order import summarize_order
    from haptorb_study.study_file import read_study
    from haptorb_study.trial_lists import has_set_points

    known = read_study(file)
    order = summarize_order(known, people)
    if register is not None:
        from haptorb_study.preregistration import write_registration

        made = write_registration(known, register)
        notify(f"registered: plan {made.plan} of study {made.study}, {made.written}, in {register}")
    if json:
        from haptorb_study.simulated.forecast import find_unfelt, forecast, overlap

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
    echo(f"{known.name}: {known.procedure} on '{known.device}', {where}")
    print_order(order)
    if known.plan is not None:
        echo(known.plan.sentence)
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
    from haptorb_study.data_kind import check_contents
    from haptorb_study.database import database
    from haptorb_study.simulated.rehearsal import rehearse
    from haptorb_study.study_file import read_study

    known = read_study(file)  # before a database is created
    engine = database(db)
    check_contents(engine, "simulated")
    known = use_begun_version(engine, known)
    with make_progress() as bar:
        task = bar.add_task("SIMULATED trials", total=None)
        answered = rehearse(
            engine, known, participants, seed=seed, first=first,
            progress=lambda done, total: bar.update(task, completed=done, total=total),
        )  # fmt: skip
    echo(f"{answered} SIMULATED trials in {db}; `haptorb study analyse {db}` shows them")


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
    from haptorb.child_process import count_cores
    from haptorb_study.simulated.power import power as estimate_power
    from haptorb_study.statistics.significance import check_test
    from haptorb_study.study_file import read_study

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
    table = TextTable((Column("participants"), Column("power"), Column("95 % CI")))
    for n, share, low, high in zip(found.people, found.power, found.low, found.high, strict=True):
        table.add_row(str(n), f"{share:.2f}", f"{low:.2f} to {high:.2f}")
    print_table(make_console(), table)
    echo(found.sentence)


# --------------------------------------------------------------------------------------------------
# Sessions: with two pages in the browser, or at the terminal.


def run(
    file: FileArgument,
    participant: Annotated[
        str | None, typer.Option("--participant", "-p", help="Pseudonymous code, such as P01; optional in the browser.")
    ] = None,
    db: DatabaseOption = "study.db",
    driver: Annotated[str, typer.Option(help="Driver: sim, serial:PORT or i2c:BUS.")] = "sim",
    tracker: Annotated[
        str,
        typer.Option(
            help="Source of the tool pose, as for `haptorb run`; pointer: page, or arrow keys with --terminal."
        ),
    ] = "pointer",
    frame: Annotated[
        Path | None, typer.Option(help="Frame file, from `haptorb frame`, for a tracker with its own frame.")
    ] = None,
    pilot: Annotated[
        bool, typer.Option("--pilot", help="A pilot: kept apart from real data, as is every run with --driver sim.")
    ] = False,
    record: Annotated[bool, typer.Option(help="Record the session beside the database.")] = True,
    terminal: Annotated[bool, typer.Option("--terminal", help="Run in the terminal instead of the browser.")] = False,
    lsl: Annotated[
        str | None, typer.Option(help="Send LSL streams to other equipment on: computer (this one) or network.")
    ] = None,
    port: Annotated[int, typer.Option(help="Port of the pages; 0 takes any free port.")] = 8766,
    host: HostOption = "127.0.0.1",
    address: AddressOption = "",
) -> None:
    """Run sessions with a page for the participant and one for the experimenter. Resumes interrupted sessions."""
    from haptorb.runtime.linux import describe_timing, is_windows
    from haptorb.web.server import PageAddress
    from haptorb_study.data_kind import check_contents
    from haptorb_study.database import database
    from haptorb_study.participant_codes import check_code
    from haptorb_study.recordings import find_recording_path, name_parts
    from haptorb_study.study_file import read_study

    where = PageAddress(host, address)
    known = read_study(file)
    if participant is not None:
        participant = check_code(participant)
    elif terminal:
        raise InputError("--terminal needs --participant CODE, such as P01")
    if terminal and is_windows():
        raise InputError(
            "--terminal reads single keys, which a console of Windows does not send: leave it out, for pages"
        )
    if terminal and (known.mask is not None or lsl is not None):
        raise InputError("masking noise and LSL streams need the browser: leave out --terminal")
    print_forecast(known)
    from haptorb.runtime.config import RunConfig
    from haptorb.runtime.servo import Servo

    def start(recording: Path | None) -> Servo:
        config = RunConfig.of(
            known.device, "nothing", driver=driver, tracker=tracker, frame=frame,
            model=known.model_on(known.load_device()), render=known.render or None,
        )  # fmt: skip
        about = {"study": known.name, "digest": known.digest, **({} if recording is None else name_parts(recording))}
        servo = Servo(config, record=recording or False, about=about)
        if known.own_world is not None:
            servo.add_world(known.own_world)
        return servo

    pilot = pilot or driver == "sim"  # the simulated device renders no force to a participant
    start(None)  # not opened: wrong drivers, trackers, frames and streams are refused before a database is created
    if timing := describe_timing():
        notify(timing)
    streams = None
    if lsl is not None:
        from haptorb_study.lsl_streams import open_streams

        streams = open_streams(lsl)
    engine = database(db)  # before the device: without storage nothing is started
    check_contents(engine, "pilot" if pilot else "real")
    known = use_begun_version(engine, known)
    if terminal:
        options = {"--driver": (driver, "sim"), "--tracker": (tracker, "pointer"), "--frame": (frame, None)}
        more = [word for name, (value, usual) in options.items() if value != usual for word in (name, str(value))]
        more += ["--pilot"] if pilot and driver != "sim" else []
        again = join(["haptorb", "study", "run", str(file), "--terminal", "-p", str(participant), "--db", db, *more])
        _run_in_terminal(known, engine, str(participant), start, db, again, record, pilot)
    else:
        from haptorb_study.pages.session_manager import SessionManager
        from haptorb_study.stored_session import StoredSession

        def find_path(session: StoredSession) -> Path | None:
            return find_recording_path(db, session) if record else None

        begin = partial(StoredSession, pilot=pilot)
        manager = SessionManager(engine, known, start, find_path, streams, begin)
        _run_in_browser(manager, known, participant, db, driver, port, pilot, where)


def _run_in_terminal(
    known: Study, engine: Engine, participant: str, start: Callable[[Path | None], Servo], db: str, again: str,
    record: bool, pilot: bool,
) -> None:  # fmt: skip
    from haptorb_study.recordings import find_recording_path
    from haptorb_study.stored_session import StoredSession

    with StoredSession(engine, known, participant, pilot=pilot) as session:
        if session.resumed:
            notify(f"resuming session {session.id} of {participant} at trial {session.number + 1}")
        if session.over:
            raise InputError(f"participant '{participant}' has already answered all trials")
        from haptorb_study.terminal_session import run_session

        how = run_session(session, start, find_recording_path(db, session) if record else None)
    words = {"done": "done: thank you", "aborted": "aborted: the answers are stored"}
    notify(words.get(how, f"session ended: `{again}` resumes at trial {session.number + 1}"))


def _run_in_browser(
    sessions: SessionManager, known: Study, participant: str | None, db: str, driver: str, port: int, pilot: bool,
    where: PageAddress,
) -> None:  # fmt: skip
    from haptorb.database_address import mask_password
    from haptorb_study.pages.study_server import StudyServer
    from haptorb_study.simulated.forecast import forecast

    more = {
        "database": mask_password(db),
        "pilot": pilot,
        "forecast": forecast(known).sentence,
        "code": participant or "",
    }
    if where.warning:
        notify(where.warning)
    with queue_output(), StudyServer(sessions, port, simulated=driver == "sim", more=more, where=where) as host:
        nature = ("PILOT, " if pilot else "") + ("SIMULATED DEVICE" if driver == "sim" else f"driver {driver}")
        notify(f"participant:  {host.participant}\nexperimenter: {host.experimenter}\n{nature}. Ctrl-C ends.")
        if participant is not None:
            sessions.enqueue({"do": "begin", "code": participant}, notify)
        number = host.serve()
    if number:
        notify("ended: the same command continues an interrupted session")


# --------------------------------------------------------------------------------------------------
# Withdrawal, merging of databases, and backups.


def merge(
    databases: Annotated[list[str], typer.Argument(help="Databases to merge, two or more, of one study.")],
    into: Annotated[Path, typer.Option("--into", help="New database; it must not exist.")],
    rename: Annotated[
        list[str] | None,
        typer.Option(
            metavar="N:OLD=NEW",
            help="Rename a code of database N (1, 2, ...): 2:P01=Q01; or all of its codes: 2:*=B-*; repeatable.",
        ),
    ] = None,
    name: NameOption = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Merge databases of one study from several laboratories; the sources stay as they are."""
    from haptorb_study.merge import merge_databases, read_renaming

    renamings = [read_renaming(one) for one in rename or []]
    with make_progress() as bar:
        task = bar.add_task("merging participants", total=None)
        done = merge_databases(
            databases, into, study=name, renamings=renamings,
            progress=lambda ready, total: bar.update(task, completed=ready, total=total),
        )  # fmt: skip
    for note in done.notes:
        notify(f"note: {note}")
    for missing in done.missing:
        notify(f"warning: {missing} does not exist: its trials keep this name")
    if json:
        print_json({**vars(done), "missing": list(done.missing), "notes": list(done.notes)})
        return
    people = ", ".join(f"{count} participants of {place}" for place, count in done.people.items())
    echo(f"{done.place}: {people}; {done.trials} trials, {done.recordings} recordings")


def withdraw(
    db: DatabaseArgument,
    code: Annotated[str, typer.Argument(help="Code of the person, exactly as in the database.")],
    name: NameOption = None,
    yes: Annotated[bool, typer.Option("--yes", help="Remove without asking.")] = False,
    exports_in: Annotated[
        list[Path] | None,
        typer.Option("--exports-in", help="Folder whose exports are made again too; may be repeated."),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Remove a person who withdraws: answers, words, recordings; from exports, merged databases and backups too."""
    from haptorb_study.database import database
    from haptorb_study.withdraw import withdraw as remove

    database(db, make=False).dispose()  # a missing database needs no confirmation
    if not yes and not typer.confirm(f"Remove all data of {code} for good?", err=True):
        notify("nothing was removed")
        raise typer.Exit(1)
    with show_status(f"removing {code}"):
        done = remove(db, code, name, exports_in=exports_in or ())
    if json:
        print_json({key: list(value) if isinstance(value, tuple) else value for key, value in vars(done).items()})
    else:
        echo(f"{done.code} withdrew from study '{done.study}': {done.sentence}")
    for left in done.left:
        notify(f"warning: not removed: {left}")


def backup(
    db: DatabaseArgument,
    into: Annotated[Path, typer.Argument(help="New file.")],
) -> None:
    """Copy a database file in its present state, also while a session runs; `withdraw` includes the copy."""
    from haptorb_study.database_copies import back_up

    echo(f"backup: {back_up(db, into)}")


def list_study_sections() -> list[KeySection]:
    """The keys of a study file."""
    from haptorb.devices.schema import list_keys
    from haptorb_study.study_file import Study

    return [KeySection("", tuple(list_keys(Study)))]


def register(app: typer.Typer) -> None:
    """Add the commands to `app`."""
    FILES["study"] = FileKeys("a study: haptorb study run FILE", list_study_sections)
    study = CommandLine(help="Perceptual studies: write, check, rehearse, run, analyse, plot and export.")
    for command in (new, check, run, simulate, power, participants, analyse, figures, export, merge, withdraw, backup):
        study.command()(command)
    app.add_typer(study, name="study")
