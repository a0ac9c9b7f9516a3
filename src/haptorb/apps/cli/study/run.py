"""Run sessions: with two pages in the browser, or at the terminal."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from shlex import join
from typing import TYPE_CHECKING, Annotated

import typer

from haptorb.apps.cli.study.forecast import keep_begun_study, print_forecast
from haptorb.apps.cli.study.options import DatabaseOption, FileArgument
from haptorb.apps.terminal import say
from haptorb.errors import InputError

if TYPE_CHECKING:
    from sqlalchemy.engine import Engine

    from haptorb.apps.study.model.study_file import Study
    from haptorb.apps.study.pages.session_manager import SessionManager
    from haptorb.runtime.servo.servo import Servo

__all__ = ["run"]


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
) -> None:
    """Run sessions with a page for the participant and one for the experimenter. Resumes interrupted sessions."""
    from haptorb.apps.study.model.codes import check_code
    from haptorb.apps.study.model.study_reader import read_study
    from haptorb.apps.study.store.contents import check_contents
    from haptorb.apps.study.store.database import database
    from haptorb.apps.study.store.recordings import find_recording_path, name_parts
    from haptorb.runtime.realtime.linux import require_linux

    require_linux("`haptorb study run`")
    known = read_study(file)
    if participant is not None:
        participant = check_code(participant)
    elif terminal:
        raise InputError("--terminal needs --participant CODE, such as P01")
    if terminal and (known.mask is not None or lsl is not None):
        raise InputError("masking noise and LSL streams need the browser: leave out --terminal")
    print_forecast(known)
    from haptorb.runtime.servo.servo import Servo

    def start(recording: Path | None) -> Servo:
        servo = Servo(
            known.device, "nothing", driver=driver, tracker=tracker, frame=frame, record=recording or False,
            model=known.model or None, render=known.render or None,
            about={"study": known.name, "digest": known.digest, **({} if recording is None else name_parts(recording))},
        )  # fmt: skip
        if known.own_world is not None:
            servo.add_world(known.own_world)
        return servo

    pilot = pilot or driver == "sim"  # nobody feels a force of a simulated device
    start(None)  # not opened: a driver, tracker, frame or stream that is none is refused before a database is made
    streams = None
    if lsl is not None:
        from haptorb.apps.study.session.streams import open_streams

        streams = open_streams(lsl)
    engine = database(db)  # before the device: without a place for answers nothing is started
    check_contents(engine, "pilot" if pilot else "real")
    known = keep_begun_study(engine, known)
    if terminal:
        options = {"--driver": (driver, "sim"), "--tracker": (tracker, "pointer"), "--frame": (frame, None)}
        more = [word for name, (value, usual) in options.items() if value != usual for word in (name, str(value))]
        more += ["--pilot"] if pilot and driver != "sim" else []
        again = join(["haptorb", "study", "run", str(file), "--terminal", "-p", str(participant), "--db", db, *more])
        _run_in_terminal(known, engine, str(participant), start, db, again, record, pilot)
    else:
        from haptorb.apps.study.pages.session_manager import SessionManager
        from haptorb.apps.study.session.stored_session import StoredSession

        def find_path(session: StoredSession) -> Path | None:
            return find_recording_path(db, session) if record else None

        begin = partial(StoredSession, pilot=pilot)
        manager = SessionManager(engine, known, start, find_path, streams, begin)
        _run_in_browser(manager, known, participant, db, driver, port, pilot)


def _run_in_terminal(
    known: Study, engine: Engine, participant: str, start: Callable[[Path | None], Servo], db: str, again: str,
    record: bool, pilot: bool,
) -> None:  # fmt: skip
    from haptorb.apps.study.session.stored_session import StoredSession
    from haptorb.apps.study.store.recordings import find_recording_path

    with StoredSession(engine, known, participant, pilot=pilot) as session:
        if session.resumed:
            say(f"resuming session {session.id} of {participant} at trial {session.number + 1}")
        if session.over:
            raise InputError(f"participant '{participant}' has already answered all trials")
        from haptorb.apps.study.session.terminal import run_session

        how = run_session(session, start, find_recording_path(db, session) if record else None)
    words = {"done": "done: thank you", "aborted": "aborted: the answers are stored"}
    say(words.get(how, f"session ended: `{again}` resumes at trial {session.number + 1}"))


def _run_in_browser(
    sessions: SessionManager, known: Study, participant: str | None, db: str, driver: str, port: int, pilot: bool
) -> None:
    from haptorb.apps.study.pages.server import StudyServer
    from haptorb.apps.study.simulated.forecast import forecast
    from haptorb.files.sql_engine import mask_password

    more = {
        "database": mask_password(db),
        "pilot": pilot,
        "forecast": forecast(known).sentence,
        "code": participant or "",
    }
    with StudyServer(sessions, port, simulated=driver == "sim", more=more) as host:
        nature = ("PILOT, " if pilot else "") + ("SIMULATED DEVICE" if driver == "sim" else f"driver {driver}")
        say(f"participant:  {host.participant}\nexperimenter: {host.experimenter}\n{nature}. Ctrl-C ends.")
        if participant is not None:
            sessions.ask({"do": "begin", "code": participant}, say)
        number = host.serve()
    if number:
        say("ended: the same command continues an interrupted session")
