"""The tables of a study database and the door to them: SQLite in a file, PostgreSQL by URL.

A database of an older schema is brought forward when it is opened, one of a newer schema is refused.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

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
)
from sqlalchemy.engine import Engine
from sqlalchemy.exc import SQLAlchemyError

from haptorb.apps.study.store.migrations import STEPS, migrate
from haptorb.apps.study.store.stored_rows import check_rows
from haptorb.errors import RecordingError
from haptorb.files.file_kind import FileKind
from haptorb.files.sql_engine import BUSY, lock_database, mask_password, path_of
from haptorb.files.table_set import TableSet, explain_error

__all__ = [
    "FAMILY",
    "SCHEMA",
    "contents",
    "copies",
    "database",
    "events",
    "lock",
    "participants",
    "replies",
    "sessions",
    "studies",
    "trials",
    "utc_now",
    "withdrawn",
]  # fmt: skip

SCHEMA = 1 + len(STEPS)  #: of this version; a database of a newer one is refused
FAMILY = 0x68617074  #: of PostgreSQL's advisory locks that are ours

_tables = MetaData()
versions = Table("haptorb_schema", _tables, Column("version", Integer, primary_key=True))
studies = Table(
    "studies", _tables,
    Column("digest", String(16), primary_key=True),
    Column("name", String(64), nullable=False),
    Column("text", Text, nullable=False),  # the study file, word for word
)  # fmt: skip
participants = Table(
    "participants", _tables,
    Column("id", Integer, primary_key=True),
    Column("study", ForeignKey("studies.digest"), nullable=False),
    Column("code", String(16), nullable=False),  # a pseudonym; who it is stands nowhere here
    Column("ordinal", Integer, nullable=False),  # decides order and seed
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
    Column("versions", Text, nullable=False),  # JSON: what ran it
)  # fmt: skip
trials = Table(
    "trials", _tables,
    Column("id", Integer, primary_key=True),
    Column("session", ForeignKey("sessions.id"), nullable=False),
    Column("number", Integer, nullable=False),  # from 0; with the session unique: nothing doubled
    Column("prompt", Text, nullable=False),  # JSON
    # Whole numbers but for magnitudes; `read_value` tells them. SQLite keeps any number in a column called INTEGER.
    Column("answer", Float().with_variant(Integer(), "sqlite")),
    Column("x", Float), Column("y", Float), Column("z", Float),  # tool's magnet at the answer [m]
    Column("seconds", Float, nullable=False),
    Column("safety", Text, nullable=False, default="[]"),  # JSON: trips of the device during this trial
    Column("recording", Text),  # file with the tool's course
    Column("answered", String(32), nullable=False),
    Column("driver", String(200)),  # of the device: "sim" is a simulated one; unknown before schema 3
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
    Column("id", Integer, primary_key=True),  # 1: there is one row, from the first session on
    Column("holds", String(16), nullable=False),  # real, pilot, simulated; mixed: from an older haptorb
)  # fmt: skip
withdrawn = Table(
    "withdrawn", _tables,
    Column("id", Integer, primary_key=True),
    Column("study", ForeignKey("studies.digest"), nullable=False),
    Column("code", String(16), nullable=False),  # may not return; nothing else of the person is left
    Column("ordinal", Integer, nullable=False),  # stays taken
    Column("at", String(32), nullable=False),
    Column("text", Text, nullable=False),  # how much was removed, and where
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
    """The database at `place`, with its tables; RecordingError if it cannot be reached, is newer, or is none of ours.

    With `make` false one that is not there is refused rather than made.
    """
    path = path_of(place)
    if not make and path is not None and not path.exists():
        raise RecordingError(f"database {place} does not exist: create it with `haptorb study run` or `simulate`")
    engine = _STUDY.open(place, make=make)
    try:
        with engine.connect() as connection:
            check_rows(connection, _tables.tables, f"database {mask_password(place)}")
    except (SQLAlchemyError, ValueError, TypeError, OverflowError) as cause:  # what a driver makes of a damaged value
        engine.dispose()
        what = explain_error(cause) if isinstance(cause, SQLAlchemyError) else str(cause)
        raise RecordingError(f"database {mask_password(place)} cannot be read: {what}") from cause
    except RecordingError:
        engine.dispose()
        raise
    return engine


def lock(connection: Connection) -> None:
    """No other study's program passes here until the transaction that has just begun on `connection` ends."""
    lock_database(connection, FAMILY)


@contextmanager
def try_begin(engine: Engine) -> Iterator[Connection]:
    """A transaction that fails after 50 ms where another program holds the database."""
    with engine.connect() as connection:
        sqlite = engine.dialect.name == "sqlite"
        connection.exec_driver_sql("PRAGMA busy_timeout = 50" if sqlite else "SET LOCAL lock_timeout = 50")
        try:
            yield connection
            connection.commit()
        finally:
            if sqlite:
                connection.rollback()
                connection.exec_driver_sql(f"PRAGMA busy_timeout = {BUSY}")


def utc_now() -> str:
    """The time of day in UTC, to the millisecond, as the database keeps it."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")
