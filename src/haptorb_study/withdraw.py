"""Withdrawal of a participant: removal of answers, replies and recordings wherever haptorb has recorded a copy.

This covers the database with its free pages, recordings beside it, exports (remade without the participant), and
databases that it was merged from or into, or copied to. A record of the withdrawn code and of the amount remains.
"""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from glob import escape
from pathlib import Path

from sqlalchemy import func, select, text
from sqlalchemy.engine import Engine
from sqlalchemy.exc import SQLAlchemyError

from haptorb.database_address import mask_password, path_of
from haptorb.errors import HaptorbError, RecordingError
from haptorb.sql import connect_file
from haptorb_study.columns import read_study
from haptorb_study.data_kind import check_kind
from haptorb_study.database import (
    database,
    events,
    identity_of,
    lock,
    lock_session,
    participants,
    replies,
    sessions,
    trials,
    withdrawn,
)
from haptorb_study.database_copies import Copy, list_copies
from haptorb_study.export import export_study
from haptorb_study.export_table import explain_foreign
from haptorb_study.json_values import utc_now
from haptorb_study.participant_codes import find_other_spelling
from haptorb_study.recordings import folder_of, locate_recording
from haptorb_study.study_file import Study

__all__ = ["Withdrawal", "withdraw"]


@dataclass(frozen=True)
class Withdrawal:
    """What was removed."""

    code: str
    study: str
    trials: int
    replies: int
    recordings: tuple[str, ...]  #: deleted files
    exports: tuple[str, ...]  #: remade exports
    databases: tuple[str, ...]  #: other databases that the participant was removed from
    left: tuple[str, ...]  #: copies that could not be reached, with the reason: to be removed by hand

    @property
    def sentence(self) -> str:
        """Summary, also stored in the database."""
        return (
            f"{self.trials} trials, {self.replies} replies and {len(self.recordings)} recordings removed; "
            f"{len(self.exports)} exports made again; removed from {len(self.databases)} other databases; "
            f"{len(self.left)} copies not reached"
        )


def withdraw(
    place: str | Path, code: str, name: str | None = None, *, exports_in: Sequence[str | Path] = ()
) -> Withdrawal:
    """Remove the participant `code` from the study `name` (default: the only one) in the database at `place`.

    exports_in   folders whose exports are made again, besides those in the folder of the database: the database names
                 its exports, and a stranger may have written it

    Raises RecordingError, with nothing removed, if there is no such participant, or the session is running.
    """
    return _withdraw(place, code, name, {identity_of(place)}, [Path(one).expanduser() for one in exports_in])


def _withdraw(
    place: str | Path, code: str, name: str | None, visited: set[str], exports_in: Sequence[Path]
) -> Withdrawal:
    engine = database(place, make=False)
    try:
        study = read_study(engine, name)
        session = _find_session(engine, study, code)
        drawn = _read_session(engine, session)
        claims = [] if session is None else [lock_session(engine, session)]
        try:
            files, shared, others = _list_recordings(engine, place, session)
            trial_count, reply_count = _remove_rows(engine, study, code, session)
        finally:
            for claim in claims:
                claim.release()
        left = [f"{path}: other participants' trials are in it" for path in shared]
        left += [f"{name}: not the name of a recording of haptorb beside the database" for name in others]
        gone = []
        for path in files:
            try:
                path.unlink()
                gone.append(str(path))
            except FileNotFoundError:
                left.append(f"{path}: it no longer exists; if it was moved, remove it")
            except OSError as cause:
                left.append(f"{path}: {cause.strerror}")
        _erase(engine)
        exports: list[str] = []
        databases: list[str] = []
        path_here = path_of(place)
        for copy in list_copies(engine):
            if copy.study not in ("", study.name):
                continue
            if copy.kind == "export":
                folders = None if path_here is None else [path_here.parent, *exports_in]
                _remake(engine, study, copy, folders, exports, left)
            elif identity_of(copy.place) not in visited:
                visited.add(identity_of(copy.place))
                there = str(copy.settings["codes"].get(code, "")) if "codes" in copy.settings else code
                if there and "://" in copy.place and path_here is not None:  # safety: no-strange-host
                    why = "haptorb connects to no server that a file names"
                    left.append(f"{mask_password(copy.place)}: {why}; withdraw {there} there")
                elif there:
                    _follow(copy, there, drawn, study, visited, exports_in, databases, left, gone)
        done = Withdrawal(
            code, study.name, trial_count, reply_count, tuple(gone), tuple(exports), tuple(databases), tuple(left)
        )  # fmt: skip
        with engine.begin() as connection:
            mine = (withdrawn.c.study == study.digest) & (withdrawn.c.code == code)
            connection.execute(withdrawn.update().where(mine).values(text=done.sentence))
        return done
    except SQLAlchemyError as cause:
        raise RecordingError(f"database {mask_password(place)}: {getattr(cause, 'orig', cause)}") from cause
    finally:
        engine.dispose()


def _find_session(engine: Engine, study: Study, code: str) -> int | None:
    """Number of the session of `code`; None: withdrawn before, and its exports are made again."""
    with engine.connect() as connection:
        rows = connection.execute(
            select(participants.c.code, sessions.c.id)
            .outerjoin(sessions, sessions.c.participant == participants.c.id)
            .where(participants.c.study == study.digest)
        ).all()
        before = connection.execute(
            select(withdrawn.c.code).where(withdrawn.c.study == study.digest, withdrawn.c.code == code)
        ).scalar()
    known = {str(row.code): row.id for row in rows}
    if code in known:
        return int(known[code])
    if before is not None:
        return None
    other = find_other_spelling(code, known)
    hint = f"; is '{other}' meant? Enter the code exactly" if other else ""
    raise RecordingError(
        f"study '{study.name}' has no participant '{code}' in this database: nothing was removed{hint}"
    )


def _read_session(engine: Engine, session: int | None) -> tuple[str, str] | None:
    """Start and plan of a session: they identify a person in copies, whatever the code is there."""
    with engine.connect() as connection:
        row = connection.execute(select(sessions.c.started, sessions.c.plan).where(sessions.c.id == session)).first()
    return None if row is None else (row.started, row.plan)


def _list_recordings(
    engine: Engine, place: str | Path, session: int | None
) -> tuple[list[Path], list[Path], list[str]]:
    """Files with trials of `session` only; files shared with other sessions, and names that haptorb does not give:
    these are not removed."""
    with engine.connect() as connection:
        rows = connection.execute(
            select(trials.c.session, trials.c.recording).where(trials.c.recording.is_not(None))
        ).all()
    folder = folder_of(place)
    of: dict[Path, set[int]] = {}
    others: dict[str, None] = {}
    for row in rows:
        if (found := locate_recording(folder, row.recording)) is not None:
            of.setdefault(found, set()).add(row.session)
        elif row.session == session:
            others[row.recording.partition("#t=")[0]] = None
    mine = {path: people for path, people in of.items() if session in people}
    # A part interrupted before its first answer is named after its session only.
    with engine.connect() as connection:
        names = [str(name) for name in connection.execute(text("SELECT DISTINCT name FROM studies")).scalars()]
    for name in names if session is not None else ():
        if Path(name).name != name:
            continue  # of a stranger
        for path in folder.glob(f"{escape(name)}-session-{session}-trial-*.mcap"):  # safety: withdrawn-names
            mine.setdefault(path, {session or 0})
    for path in folder.glob(f"session-{session}-*.mcap") if session is not None else ():  # of an older haptorb
        mine.setdefault(path, {session or 0})
    alone, shared = ([path for path, people in mine.items() if (len(people) > 1) is many] for many in (False, True))
    return alone, shared, list(others)


def _remove_rows(engine: Engine, study: Study, code: str, session: int | None) -> tuple[int, int]:
    """Delete the rows in one transaction with the record of the withdrawal; numbers of trials and replies deleted."""
    if session is None:
        return 0, 0
    with engine.begin() as connection:
        lock(connection)
        trial_count, reply_count = (
            int(connection.execute(select(func.count()).select_from(t).where(t.c.session == session)).scalar_one())
            for t in (trials, replies)
        )
        person = connection.execute(
            select(participants.c.id, participants.c.ordinal).where(
                participants.c.study == study.digest, participants.c.code == code
            )
        ).one()
        for table in (trials, events, replies):
            connection.execute(table.delete().where(table.c.session == session))
        connection.execute(sessions.delete().where(sessions.c.id == session))
        connection.execute(participants.delete().where(participants.c.id == person.id))
        row = {"study": study.digest, "code": code, "ordinal": person.ordinal, "at": utc_now()}
        connection.execute(
            withdrawn.insert().values(**row, text=f"{trial_count} trials and {reply_count} replies removed")
        )
    return trial_count, reply_count


def _erase(engine: Engine) -> None:
    """Erase deleted data from the file: free pages are overwritten, the log is truncated."""
    if engine.dialect.name != "sqlite":
        with engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
            for table in (trials, events, replies, sessions, participants):
                connection.exec_driver_sql(f"VACUUM FULL {table.name}")
        return
    engine.dispose()
    try:
        with closing(connect_file(str(engine.url.database))) as raw:
            raw.execute("PRAGMA secure_delete = ON")
            raw.execute("VACUUM")
            busy = bool(raw.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()[0])
    except sqlite3.OperationalError:
        busy = True
    if busy:
        raise RecordingError(
            f"{engine.url.database} is in use by another program, so deleted data remain in its file: end that "
            "program, then withdraw again"
        )


def _remake(
    engine: Engine, study: Study, copy: Copy, folders: Sequence[Path] | None, exports: list[str], left: list[str]
) -> None:
    """Remake an export without the participant; nothing to do if it no longer exists.

    The database says where it is: only a complete export of this version of the study is replaced, and only in one of
    the `folders` (None: anywhere, for a server is trusted).
    """
    path = Path(copy.place)
    inside = folders is None or any(_is_inside(path, folder) for folder in folders)
    if not inside:  # safety: withdrawn-export-inside
        left.append(
            f"{path}: an export outside the database's folder is not touched; if it is yours, withdraw again with "
            f"--exports-in {path.parent}, or remove it"
        )
        return
    if not path.exists():
        left.append(f"{path}: this export no longer exists; if it was moved or sent on, remove it there")
        return
    if path.suffix and (why := explain_foreign(study, path)):
        left.append(
            f"{path}: {why}, so it is not touched; if it is your export, perhaps by an older haptorb, export again "
            "with --force, or remove it"
        )
        return
    kind = copy.settings.get("data")
    try:
        export_study(engine, path, study.name, None if kind is None else check_kind(kind), overwrite=True)
        exports.append(str(path))
    except HaptorbError as cause:
        left.append(f"{path}: {cause}")


def _is_inside(path: Path, folder: Path) -> bool:
    """Whether `path` is in `folder` or below, links resolved."""
    real = os.path.realpath(path)
    return Path(real).is_relative_to(os.path.realpath(folder)) and not path.is_symlink()


def _follow(
    copy: Copy, code: str, drawn: tuple[str, str] | None, study: Study, visited: set[str], exports_in: Sequence[Path],
    databases: list[str], left: list[str], gone: list[str],
) -> None:  # fmt: skip
    """Remove the participant from another database, where the code is `code`, if it is the same person there: the
    session has the start and the plan `drawn`. A stranger who wrote this database chose both place and code."""
    if "://" not in copy.place and not Path(copy.place).is_file():
        left.append(f"{copy.place}: this database no longer exists; if it was moved, withdraw {code} there")
        return
    try:
        engine = database(copy.place, make=False)
        try:
            query = select(participants.c.code).where(participants.c.study == study.digest)
            with engine.connect() as connection:
                known = set(connection.execute(query).scalars())
            if code not in known:
                return
            session = _find_session(engine, study, code)
            if drawn is None or _read_session(engine, session) != drawn:  # safety: same-person
                why = "was withdrawn here before" if drawn is None else "has another session there"
                left.append(
                    f"{mask_password(copy.place)}: {code} {why}; if it is the same person, withdraw {code} there"
                )
                return
            if copy.kind == "backup":  # its exports and recordings are those of the original
                _remove_rows(engine, study, code, session)
                _erase(engine)
                databases.append(copy.place)
                return
        finally:
            engine.dispose()
        done = _withdraw(copy.place, code, study.name, visited, exports_in)
        databases += [copy.place, *done.databases]
        left += done.left
        gone += done.recordings
    except (HaptorbError, SQLAlchemyError) as cause:
        left.append(f"{copy.place}: {cause}")
