"""`haptorb study check | run | simulate | power | analyse | export`: perceptual studies on the dome."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from shlex import join
from typing import TYPE_CHECKING, Annotated, Any

import typer

from haptorb.apps.terminal import Column, TextTable, make_console, make_progress, print_json, print_table, say, tell
from haptorb.apps.terminal.help_text import CommandLine
from haptorb.errors import InputError

if TYPE_CHECKING:
    from sqlalchemy.engine import Engine

    from haptorb.apps.study.model.study_file import Study
    from haptorb.apps.study.pages.session_manager import SessionManager
    from haptorb.runtime.servo.servo import Servo

__all__ = ["register"]

study = CommandLine(help="Perceptual studies: check, rehearse, run, analyse and export.")

FileArgument = Annotated[Path, typer.Argument(help="Study file (TOML).")]
DatabaseArgument = Annotated[str, typer.Argument(help="Database of the study: a file, or postgresql://host/name.")]
DatabaseOption = Annotated[
    str, typer.Option("--db", help="Database for the answers: a file, or postgresql://host/name.")
]
NameOption = Annotated[str | None, typer.Option("--study", help="Name of the study, if the database holds several.")]


def register(app: typer.Typer) -> None:
    """Add the commands to `app`."""
    app.add_typer(study, name="study")


@study.command()
def check(file: FileArgument, json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False) -> None:
    """Check a study file: mistakes, duration, coil temperature, overlap of the maps."""
    from haptorb.apps.study.model.study_file import read_study

    known = read_study(file)
    if json:
        from haptorb.apps.study.simulated.forecast import forecast, overlap

        result, reach = forecast(known), overlap(known)
        about = {"study": known.name, "procedure": known.procedure, "device": known.device}
        print_json({**about, "set_points": len(known.points), **result.numbers(), "overlap": reach and reach.numbers()})
        if not result.holds:
            raise typer.Exit(1)
        return
    tell(f"{known.name}: {known.procedure} on '{known.device}', {len(known.points)} set-points")
    if not _print_forecast(known):
        raise typer.Exit(1)


@study.command()
def run(
    file: FileArgument,
    participant: Annotated[
        str | None, typer.Option("--participant", "-p", help="Pseudonymous code, such as P01; optional in the browser.")
    ] = None,
    db: DatabaseOption = "study.db",
    driver: Annotated[str, typer.Option(help="Driver: sim, serial:PORT or i2c:BUS.")] = "sim",
    tracker: Annotated[
        str, typer.Option(help="Source of the tool pose; pointer: the page, or the arrow keys.")
    ] = "pointer",
    frame: Annotated[
        Path | None, typer.Option(help="Frame file, from `haptorb frame`, for a tracker with its own frame.")
    ] = None,
    record: Annotated[bool, typer.Option(help="Record the session beside the database.")] = True,
    terminal: Annotated[bool, typer.Option("--terminal", help="Run in the terminal instead of the browser.")] = False,
    lsl: Annotated[
        str | None, typer.Option(help="Send LSL streams for other equipment, visible on this: computer or network.")
    ] = None,
    port: Annotated[int, typer.Option(help="Port of the pages; 0 takes any free port.")] = 8766,
) -> None:
    """Run sessions with a page for the participant and one for the experimenter. Resumes interrupted sessions."""
    from haptorb.apps.study.model.study_file import read_study
    from haptorb.apps.study.session.stored_session import check_code
    from haptorb.apps.study.store.database import database
    from haptorb.runtime.realtime.linux import require_linux

    require_linux("`haptorb study run`")
    known = read_study(file)
    if participant is not None:
        check_code(participant)
    elif terminal:
        raise InputError("--terminal needs --participant CODE, such as P01")
    if terminal and (known.mask is not None or lsl is not None):
        raise InputError("masking noise and LSL streams need the browser: leave out --terminal")
    _print_forecast(known)
    from haptorb.runtime.servo.servo import Servo

    def start(recording: Path | None) -> Servo:
        servo = Servo(
            known.device, "nothing", driver=driver, tracker=tracker, frame=frame, record=recording or False,
            model=known.model or None,
        )  # fmt: skip
        if known.own_world is not None:
            servo.add_world(known.own_world)
        return servo

    start(None)  # not opened: a driver, tracker, frame or stream that is none is refused before a database is made
    streams = None
    if lsl is not None:
        from haptorb.apps.study.session.streams import open_streams

        streams = open_streams(lsl)
    engine = database(db)  # before the device: without a place for answers nothing is started
    if terminal:
        options = {"--driver": (driver, "sim"), "--tracker": (tracker, "pointer"), "--frame": (frame, None)}
        more = [word for name, (value, usual) in options.items() if value != usual for word in (name, str(value))]
        again = join(["haptorb", "study", "run", str(file), "--terminal", "-p", str(participant), "--db", db, *more])
        _run_in_terminal(known, engine, str(participant), start, db, again, record)
    else:
        from haptorb.apps.study.pages.session_manager import SessionManager

        def find_path(session: int) -> Path | None:
            return _free_recording_path(db, session) if record else None

        _run_in_browser(SessionManager(engine, known, start, find_path, streams), known, participant, db, driver, port)


def _run_in_terminal(
    known: Study, engine: Engine, participant: str, start: Callable[[Path | None], Servo], db: str, again: str,
    record: bool,
) -> None:  # fmt: skip
    from haptorb.apps.study.session.stored_session import StoredSession

    with StoredSession(engine, known, participant, simulated=False) as sitting:
        if sitting.resumed:
            say(f"resuming session {sitting.id} of {participant} at trial {sitting.number + 1}")
        if sitting.over:
            raise InputError(f"participant '{participant}' has already answered all trials")
        from haptorb.apps.study.session.terminal import run_session

        how = run_session(sitting, start, _free_recording_path(db, sitting.id) if record else None)
    words = {"done": "done: thank you", "aborted": "aborted: the answers are stored"}
    say(words.get(how, f"session ended: `{again}` resumes at trial {sitting.number + 1}"))


def _run_in_browser(
    sessions: SessionManager, known: Study, participant: str | None, db: str, driver: str, port: int
) -> None:
    from haptorb.apps.study.pages.server import StudyServer
    from haptorb.apps.study.simulated.forecast import forecast
    from haptorb.apps.study.store.database import mask_password

    more = {"database": mask_password(db), "foretold": forecast(known).sentence, "code": participant or ""}
    with StudyServer(sessions, port, simulated=driver == "sim", more=more) as host:
        nature = "SIMULATED DEVICE" if driver == "sim" else f"driver {driver}"
        say(f"participant:  {host.participant}\nexperimenter: {host.experimenter}\n{nature}. Ctrl-C ends.")
        if participant is not None:
            sessions.ask({"do": "begin", "code": participant}, say)
        number = host.serve()
    if number:
        say("ended: the same command resumes an interrupted session")


@study.command()
def simulate(
    file: FileArgument,
    db: DatabaseOption = "simulated.db",
    participants: Annotated[int, typer.Option(help="Number of simulated participants.")] = 6,
    first: Annotated[int, typer.Option(help="Number in the first code, SIM01 and so on.")] = 1,
    seed: Annotated[int, typer.Option(help="Seed of the simulated participants.")] = 0,
) -> None:
    """Rehearse the study with SIMULATED participants. Their answers are no evidence about people."""
    from haptorb.apps.study.model.study_file import read_study
    from haptorb.apps.study.simulated.rehearsal import rehearse
    from haptorb.apps.study.store.database import database

    known = read_study(file)
    with make_progress() as bar:
        task = bar.add_task("SIMULATED trials", total=None)
        answered = rehearse(
            database(db), known, participants, seed=seed, first=first,
            progress=lambda done, total: bar.update(task, completed=done, total=total),
        )  # fmt: skip
    tell(f"{answered} SIMULATED trials in {db}; `haptorb study analyse {db}` shows them")


@study.command()
def power(
    file: FileArgument,
    between: Annotated[
        tuple[str, str] | None, typer.Option(help="The two conditions to compare (default: the first two in the file).")
    ] = None,
    measure: Annotated[
        str | None, typer.Option(help="Measure: error, accuracy, rating, threshold or choice (default: by procedure).")
    ] = None,
    pool: Annotated[int, typer.Option(help="Number of simulated participants to draw from.")] = 40,
    people: Annotated[list[int] | None, typer.Option(help="Number of participants to evaluate; repeatable.")] = None,
    alpha: Annotated[float, typer.Option(help="Significance level of the test.")] = 0.05,
    wanted: Annotated[float, typer.Option("--power", help="Required probability of detecting the difference.")] = 0.8,
    seed: Annotated[int, typer.Option(help="Seed of the simulated participants.")] = 0,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Estimate how many participants a study needs. Predicted with simulated participants."""
    from haptorb.apps.study.model.study_file import read_study
    from haptorb.apps.study.simulated.power import PEOPLE
    from haptorb.apps.study.simulated.power import power as foretold

    known = read_study(file)
    with make_progress() as bar:
        task = bar.add_task("SIMULATED participants", total=None)
        found = foretold(
            known, between, measure, pool=pool, people=people or PEOPLE, alpha=alpha, wanted=wanted, seed=seed,
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


@study.command()
def analyse(
    db: DatabaseArgument,
    name: NameOption = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder for report and figures (default: STUDY-report).")
    ] = None,
    figures: Annotated[str, typer.Option(help="Format of the figures: svg or png.")] = "svg",
    json: Annotated[bool, typer.Option("--json", help="Only print the numbers as JSON.")] = False,
) -> None:
    """Analyse the answers: confusion, accuracy, error over θ, psychometric curves; write an HTML report."""
    from haptorb.apps.study.analysis.load_analysis import analysis_of

    if figures not in ("svg", "png"):
        raise InputError(f"--figures must be svg or png; got '{figures}'")
    done = analysis_of(db, name)
    if json:
        print_json(done.numbers())
        return
    from haptorb.apps.study.analysis.report import write_report
    from haptorb.apps.study.analysis.summary import print_summary

    print_summary(done, make_console())
    path = write_report(done, out or Path(f"{done.study.name}-report"), kind=figures)
    tell(f"report: {path}")


@study.command()
def export(
    db: DatabaseArgument,
    path: Annotated[Path, typer.Argument(help="Output: NAME.csv, NAME.parquet, or a folder for BIDS.")],
    name: NameOption = None,
    force: Annotated[bool, typer.Option("--force", help="Replace existing files.")] = False,
) -> None:
    """Export all trials, one row each: CSV, Parquet, or a BIDS folder, with a data dictionary."""
    from haptorb.apps.study.store import export as out
    from haptorb.apps.study.store.columns import read_replies, read_study, tidy
    from haptorb.apps.study.store.database import database

    engine = database(db, make=False)
    known = read_study(engine, name)
    columns, replies = tidy(engine, known), read_replies(engine, known)
    write: dict[str, Any] = {".csv": out.write_csv, ".parquet": out.write_parquet}
    if path.suffix in write:
        write[path.suffix](columns, path, overwrite=force)
        if replies:
            words = out.write_replies(known, replies, path.with_name(f"{path.stem}-questions.csv"), overwrite=force)
            tell(f"answers to questions: {words}")
    elif path.suffix:
        raise InputError(f"the output must be NAME.csv, NAME.parquet or a folder; got '{path}'")
    else:
        out.write_bids(known, columns, path, overwrite=force, replies=replies)
    tell(f"{len(columns['trial'])} trials: {path}")


def _print_forecast(known: Study) -> bool:
    """Say what a session will be like; whether the thermal budget holds."""
    from haptorb.apps.study.simulated.forecast import forecast, overlap

    result = forecast(known)
    say(("" if result.holds else "warning: ") + result.sentence)
    reach = overlap(known)
    if reach is not None:
        say("note: " + reach.sentence)
    return result.holds


def _free_recording_path(db: str, session: int) -> Path:
    """A name for this stretch of the session's recording that is not taken."""
    from haptorb.apps.study.store.database import url_of

    url = url_of(db)
    folder = Path(url.removeprefix("sqlite:///")).parent if url.startswith("sqlite:///") else Path()
    number = 1 + len(list(folder.glob(f"session-{session}-*.mcap")))
    return folder / f"session-{session}-{number}.mcap"
