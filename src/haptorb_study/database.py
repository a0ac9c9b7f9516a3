"""Schema of a study database, its migrations, connection and locks: SQLite in a file, PostgreSQL by URL.

A database with an older schema is migrated when it is opened, one with a newer schema is refused.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sqlalchemy import (
    Boolean,
    Column,
    Connection,
    Float,
    ForeignKey,
    Integer,
    MetaData,
    String,
    Table,
    Text,
    UniqueConstraint,
    func,
    select,
    text,
)
from sqlalchemy.engine import Engine
from sqlalchemy.exc import SQLAlchemyError

from haptorb.database_address import mask_password, path_of
from haptorb.errors import RecordingError
from haptorb.file_kind import FileKind
from haptorb.sql import BUSY_TIMEOUT_MS, ProgramLock, TableSet, explain_error, lock_database
from haptorb_study.participant_codes import is_reserved
from haptorb_study.stored_rows import check_rows
from haptorb_study.study_file import Study

__all__ = [
    "FAMILY",
    "SCHEMA",
    "STEPS",
    "StoredParticipant",
    "check_database_file",
    "contents",
    "copies",
    "database",
    "events",
    "identity_of",
    "list_participants",
    "lock",
    "lock_session",
    "migrate",
    "participants",
    "replies",
    "session_lock_end",
    "sessions",
    "studies",
    "trials",
    "withdrawn",
]


# --------------------------------------------------------------------------------------------------
# Migrations from older schemas: forward only, one step per version, all in one transaction.
#
# A step uses plain SQL that SQLite and PostgreSQL share, never the table definitions below: those belong to the
# newest schema, and a step must keep its meaning when they change.


def _questions(connection: Connection) -> None:
    """1 → 2: answers to the questions of a study file."""
    number = "INTEGER NOT NULL PRIMARY KEY" if connection.dialect.name == "sqlite" else "SERIAL PRIMARY KEY"
    connection.execute(
        text(
            f"CREATE TABLE replies (id {number}, session INTEGER NOT NULL REFERENCES sessions (id), "
            "question VARCHAR(48) NOT NULL, reply TEXT NOT NULL, at VARCHAR(32) NOT NULL, UNIQUE (session, question))"
        )
    )


def _driver(connection: Connection) -> None:
    """2 → 3: driver of the device in a trial; unknown for older trials."""
    connection.execute(text("ALTER TABLE trials ADD COLUMN driver VARCHAR(200)"))


def _decimal_answers(connection: Connection) -> None:
    """3 → 4: decimal answers. A column of SQLite stores them without a change."""
    if connection.dialect.name != "sqlite":
        connection.execute(text("ALTER TABLE trials ALTER COLUMN answer TYPE DOUBLE PRECISION"))


def _contents(connection: Connection) -> None:
    """4 → 5: kind of data, withdrawn codes, and copies of the database.

    Mixed, unless the driver of every trial is known and of one kind.
    """
    number = "INTEGER NOT NULL PRIMARY KEY" if connection.dialect.name == "sqlite" else "SERIAL PRIMARY KEY"
    for table in (
        f"contents (id {number}, holds VARCHAR(16) NOT NULL)",
        f"withdrawn (id {number}, study VARCHAR(16) NOT NULL REFERENCES studies (digest), code VARCHAR(16) NOT NULL, "
        "ordinal INTEGER NOT NULL, at VARCHAR(32) NOT NULL, text TEXT NOT NULL, UNIQUE (study, code))",
        f"copies (id {number}, kind VARCHAR(16) NOT NULL, place TEXT NOT NULL, study VARCHAR(64) NOT NULL, "
        "settings TEXT NOT NULL, at VARCHAR(32) NOT NULL, UNIQUE (kind, place, study))",
    ):
        connection.execute(text(f"CREATE TABLE {table}"))
    people = list(connection.execute(text("SELECT simulated FROM sessions GROUP BY simulated")).scalars())
    drivers = connection.execute(
        text(
            "SELECT DISTINCT trials.driver FROM trials JOIN sessions ON trials.session = sessions.id "
            "WHERE NOT sessions.simulated"
        )
    )
    on_simulation = {None if driver is None else driver == "sim" for driver in drivers.scalars()}
    if not people:
        return
    if people == [True]:
        holds = "simulated"
    elif len(people) > 1 or len(on_simulation) != 1 or on_simulation == {None}:
        holds = "mixed"
    else:
        holds = "pilot" if on_simulation == {True} else "real"
    connection.execute(text("INSERT INTO contents (id, holds) VALUES (1, :holds)"), {"holds": holds})


#: version → migration from it to the next
STEPS: Mapping[int, Callable[[Connection], None]] = {1: _questions, 2: _driver, 3: _decimal_answers, 4: _contents}


def migrate(connection: Connection, version: int) -> int:
    """Migrate the tables from `version` to the newest, in the caller's transaction. Returns the newest version."""
    while version in STEPS:
        STEPS[version](connection)
        version += 1
        connection.execute(text("UPDATE haptorb_schema SET version = :version"), {"version": version})
    return version


SCHEMA = 1 + len(STEPS)  #: of this version; databases of newer ones are refused
FAMILY = 0x68617074  #: key of our PostgreSQL advisory locks

_tables = MetaData()
versions = Table("haptorb_schema", _tables, Column("version", Integer, primary_key=True))
studies = Table(
    "studies", _tables,
    Column("digest", String(16), primary_key=True),
    Column("name", String(64), nullable=False),
    Column("text", Text, nullable=False),  # the study file, verbatim
)  # fmt: skip
participants = Table(
    "participants", _tables,
    Column("id", Integer, primary_key=True),
    Column("study", ForeignKey("studies.digest"), nullable=False),
    Column("code", String(16), nullable=False),  # a pseudonym; the identity is not stored
    Column("ordinal", Integer, nullable=False),  # determines order and seed
    UniqueConstraint("study", "code"),
    UniqueConstraint("study", "ordinal"),
)  # fmt: skip
sessions = Table(
    "sessions", _tables,
    Column("id", Integer, primary_key=True),
    Column("participant", ForeignKey("participants.id"), nullable=False, unique=True),
    Column("plan", Text, nullable=False),  # JSON: seed, order, intervals; drawn once
    Column("simulated", Boolean, nullable=False),
    Column("started", String(32), nullable=False),
    Column("ended", String(32)),
    Column("aborted", Boolean, nullable=False, default=False),
    Column("versions", Text, nullable=False),  # JSON: versions of software and plan
)  # fmt: skip
trials = Table(
    "trials", _tables,
    Column("id", Integer, primary_key=True),
    Column("session", ForeignKey("sessions.id"), nullable=False),
    Column("number", Integer, nullable=False),  # from 0; unique with the session
    Column("prompt", Text, nullable=False),  # JSON
    # Whole numbers except for magnitudes; `read_value` converts. SQLite stores any number in an INTEGER column.
    Column("answer", Float().with_variant(Integer(), "sqlite")),
    Column("x", Float), Column("y", Float), Column("z", Float),  # tool's magnet at the answer [m]
    Column("seconds", Float, nullable=False),
    Column("safety", Text, nullable=False, default="[]"),  # JSON: trips of the device during this trial
    Column("recording", Text),  # file with the recorded trajectory
    Column("answered", String(32), nullable=False),
    Column("driver", String(200)),  # driver; "sim" is the simulated device; unknown before schema 3
    UniqueConstraint("session", "number"),
)  # fmt: skip
events = Table(
    "events", _tables,
    Column("id", Integer, primary_key=True),
    Column("session", ForeignKey("sessions.id"), nullable=False),
    Column("kind", String(16), nullable=False),  # begin, resume, pause, abort, repeat, leave, safety, merged ...
    Column("trial", Integer, nullable=False),
    Column("at", String(32), nullable=False),
    Column("text", Text, nullable=False, default=""),
)  # fmt: skip
replies = Table(
    "replies", _tables,
    Column("id", Integer, primary_key=True),
    Column("session", ForeignKey("sessions.id"), nullable=False),
    Column("question", String(48), nullable=False),
    Column("reply", Text, nullable=False),
    Column("at", String(32), nullable=False),
    UniqueConstraint("session", "question"),
)  # fmt: skip
contents = Table(
    "contents", _tables,
    Column("id", Integer, primary_key=True),  # 1: one row, from the first session on
    Column("holds", String(16), nullable=False),  # real, pilot, simulated; mixed: from an older haptorb
)  # fmt: skip
withdrawn = Table(
    "withdrawn", _tables,
    Column("id", Integer, primary_key=True),
    Column("study", ForeignKey("studies.digest"), nullable=False),
    Column("code", String(16), nullable=False),  # may not be reused; no other data of the participant remain
    Column("ordinal", Integer, nullable=False),  # remains taken
    Column("at", String(32), nullable=False),
    Column("text", Text, nullable=False),  # what was removed, and from where
    UniqueConstraint("study", "code"),
)  # fmt: skip
copies = Table(
    "copies", _tables,
    Column("id", Integer, primary_key=True),
    Column("kind", String(16), nullable=False),  # export, backup, source (of a merge), merged (into)
    Column("place", Text, nullable=False),  # absolute path, or URL
    Column("study", String(64), nullable=False),  # name; empty: all
    Column("settings", Text, nullable=False),  # JSON: how an export was made
    Column("at", String(32), nullable=False),
    UniqueConstraint("kind", "place", "study"),
)  # fmt: skip


_STUDY = TableSet("a study", FileKind.STUDY_DATABASE, _tables, versions, SCHEMA, FAMILY, migrate)


def database(place: str | Path, *, make: bool = True) -> Engine:
    """Open the database at `place`; RecordingError if it cannot be reached, is newer, or is not a study database.

    With `make` false a missing database is refused instead of created.
    """
    path = path_of(place)
    if not make and path is not None and not path.exists():
        raise RecordingError(
            f"database {place} does not exist: check its name; `haptorb study run` and `simulate` create one"
        )
    engine = _STUDY.open(place, make=make)
    try:
        with engine.connect() as connection:
            check_rows(connection, _tables.tables, f"database {mask_password(place)}")
    except (SQLAlchemyError, ValueError, TypeError, OverflowError) as cause:  # raised by drivers for damaged values
        engine.dispose()
        what = explain_error(cause) if isinstance(cause, SQLAlchemyError) else str(cause)
        raise RecordingError(f"database {mask_password(place)} cannot be read: {what}") from cause
    except RecordingError:
        engine.dispose()
        raise
    return engine


def identity_of(place: str | Path) -> str:
    """The same text for every spelling of the address `place`: a file's path without links, or the URL as it is."""
    return str(place) if "://" in str(place) else str(Path(place).expanduser().resolve())


def check_database_file(path: Path) -> None:
    """Raise RecordingError if the file `path` is of another kind, or files lie beside it that SQLite would process.

    SQLite does not open it.
    """
    _STUDY.check_file(path)


def lock(connection: Connection) -> None:
    """Lock the database for this transaction against other study programs."""
    lock_database(connection, FAMILY)


@contextmanager
def try_begin(engine: Engine) -> Iterator[Connection]:
    """A transaction that fails after 50 ms if another program holds the database."""
    with engine.connect() as connection:
        sqlite = engine.dialect.name == "sqlite"
        connection.exec_driver_sql("PRAGMA busy_timeout = 50" if sqlite else "SET LOCAL lock_timeout = 50")
        try:
            yield connection
            connection.commit()
        finally:
            if sqlite:
                connection.rollback()
                connection.exec_driver_sql(f"PRAGMA busy_timeout = {BUSY_TIMEOUT_MS}")


# --------------------------------------------------------------------------------------------------
# Session lock: one experimenter per session.


def session_lock_end(session: int) -> str:
    """End of the name of the session's lock file."""
    return f".session-{session}.lock"


def lock_session(engine: Engine, session: int) -> ProgramLock:
    """Lock of the session, held until released; RecordingError if another program holds it."""
    conflict = RecordingError(
        f"session {session} is being run by another experimenter (or another window): end that one first"
    )
    return ProgramLock(engine, FAMILY, session, session_lock_end(session), conflict)


# --------------------------------------------------------------------------------------------------
# Participants of a study: codes and states of their sessions.


@dataclass(frozen=True)
class StoredParticipant:
    """A code in use."""

    code: str
    simulated: bool
    state: str  #: finished, aborted, open (can be continued) or withdrawn (data removed)
    answered: int  #: trials, with practice
    started: str  #: UTC; of a withdrawn code, when it was withdrawn

    def numbers(self) -> dict[str, Any]:
        """As plain JSON types."""
        return {
            "code": self.code, "simulated": self.simulated, "state": self.state, "answered_trials": self.answered,
            "started": self.started,
        }  # fmt: skip


def list_participants(engine: Engine, study: Study) -> tuple[StoredParticipant, ...]:
    """Withdrawn codes of `study`, then its participants in the order in which they began."""
    answered = select(func.count()).where(trials.c.session == sessions.c.id).scalar_subquery()
    query = (
        select(participants.c.code, sessions.c.simulated, sessions.c.ended, sessions.c.aborted, sessions.c.started,
               answered.label("answered"))
        .join(sessions, sessions.c.participant == participants.c.id)
        .where(participants.c.study == study.digest)
        .order_by(participants.c.ordinal)
    )  # fmt: skip
    with engine.connect() as connection:
        rows = connection.execute(query).all()
        gone = connection.execute(
            select(withdrawn).where(withdrawn.c.study == study.digest).order_by(withdrawn.c.id)
        ).all()
    left = tuple(StoredParticipant(row.code, is_reserved(row.code), "withdrawn", 0, row.at) for row in gone)
    return left + tuple(
        StoredParticipant(
            row.code, bool(row.simulated),
            "aborted" if row.aborted else "open" if row.ended is None else "finished", int(row.answered), row.started,
        )
        for row in rows
    )  # fmt: skip
