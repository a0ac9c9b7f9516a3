"""The tables of a study database and the door to them: SQLite in a file, PostgreSQL by URL.

SQLite runs with a write-ahead log and `synchronous = FULL`: a committed transaction is on the disk, power loss or not.
A database of an older schema is brought forward when it is opened, one of a newer schema is refused.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
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
    create_engine,
    event,
    inspect,
    select,
    text,
)
from sqlalchemy.engine import Engine, make_url
from sqlalchemy.exc import ArgumentError, SQLAlchemyError

from haptorb.apps.study.store.migrations import STEPS, migrate
from haptorb.errors import RecordingError

__all__ = [
    "FAMILY",
    "SCHEMA",
    "database",
    "events",
    "lock",
    "mask_password",
    "participants",
    "replies",
    "sessions",
    "studies",
    "trials",
    "url_of",
]  # fmt: skip

SCHEMA = 1 + len(STEPS)  #: of this version; a database of a newer one is refused
FAMILY = 0x68617074  #: of PostgreSQL's advisory locks that are ours
_BUSY = 10_000  #: milliseconds for which an answer waits while another program holds the database
_PATIENCE = 5  #: seconds until a server that does not answer counts as unreachable

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
    Column("answer", Integer),
    Column("x", Float), Column("y", Float), Column("z", Float),  # tool's magnet at the answer [m]
    Column("seconds", Float, nullable=False),
    Column("safety", Text, nullable=False, default="[]"),  # JSON: trips of the device during this trial
    Column("recording", Text),  # file with the tool's course
    Column("answered", String(32), nullable=False),
    UniqueConstraint("session", "number"),
)  # fmt: skip
events = Table(
    "events", _tables,
    Column("id", Integer, primary_key=True),
    Column("session", ForeignKey("sessions.id"), nullable=False),
    Column("kind", String(16), nullable=False),  # begin, resume, pause, abort, repeat, end
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


def url_of(place: str | Path) -> str:
    """`place` as a URL: a path means SQLite.

    >>> url_of("study.db")
    'sqlite:///study.db'
    """
    text = str(place)
    return text if "://" in text else f"sqlite:///{text}"


def database(place: str | Path, *, make: bool = True) -> Engine:
    """The database at `place`, with its tables; RecordingError if it cannot be reached, is newer, or is none of ours.

    With `make` false one that is not there is refused rather than made.
    """
    try:
        url = make_url(url_of(place))
        if url.get_backend_name() == "sqlite" and url.database and not make and not Path(url.database).is_file():
            raise RecordingError(f"database {place} does not exist: create it with `haptorb study run` or `simulate`")
        if url.drivername == "postgresql":
            url = url.set(drivername="postgresql+psycopg")
        engine = create_engine(url, connect_args=_watched if url.get_backend_name() == "postgresql" else {})
    except ArgumentError as cause:
        raise RecordingError(
            f"'{place}' is not a database; give a file, or a URL like postgresql://host/name"
        ) from cause
    except ImportError as cause:
        raise RecordingError(
            f"database {place} needs a driver that is not installed ({cause.name or cause}): "
            "pip install 'haptorb[study]' brings PostgreSQL's"
        ) from cause
    if engine.dialect.name == "sqlite":
        event.listen(engine, "connect", _set_pragmas)
    try:
        with engine.connect() as connection:
            version = _version(connection, place)
        if version is None and not make:
            raise RecordingError(f"database {place} holds no study")
        if version is None or version < SCHEMA:
            with engine.begin() as connection:
                lock(connection)
                version = _version(connection, place)  # another station may have been quicker
                if version is None:
                    _tables.create_all(connection)
                    connection.execute(versions.insert().values(version=SCHEMA))
                else:
                    migrate(connection, version)
    except SQLAlchemyError as cause:
        engine.dispose()
        text = str(getattr(cause, "orig", None) or cause).splitlines()[0]
        raise RecordingError(
            f"database {mask_password(place)} cannot be opened, and nothing was started: {text}"
        ) from cause
    except RecordingError:
        engine.dispose()
        raise
    return engine


def lock(connection: Connection) -> None:
    """Nobody else gets past here until the transaction that has just begun on `connection` ends."""
    if connection.dialect.name == "sqlite":
        connection.execute(text("BEGIN IMMEDIATE"))  # Python's sqlite3 would begin only at the first change of data
    else:
        connection.execute(text("SELECT pg_advisory_xact_lock(:family, 0)"), {"family": FAMILY})


def _version(connection: Connection, place: str | Path) -> int | None:
    """Schema of the tables, None where there are none; RecordingError if they are not ours, or newer."""
    known = set(inspect(connection).get_table_names())
    if not known:
        return None
    if versions.name not in known:
        raise RecordingError(
            f"database {mask_password(place)} holds other tables than those of a study; choose another"
        )
    version = int(connection.execute(select(versions.c.version)).scalar_one())
    if version > SCHEMA:
        raise RecordingError(
            f"database {mask_password(place)} has schema {version}; this haptorb knows up to {SCHEMA}: update haptorb"
        )
    return version


#: a station that loses its power must not hold its session, nor one that loses its server wait, for hours
_watched = {
    "connect_timeout": _PATIENCE, "keepalives_idle": 10, "keepalives_interval": 5, "keepalives_count": 3,
    "tcp_user_timeout": 30_000,
}  # fmt: skip


@contextmanager
def try_begin(engine: Engine) -> Iterator[Connection]:
    """A transaction that gives up after 50 ms where another program holds the database."""
    with engine.connect() as connection:
        sqlite = engine.dialect.name == "sqlite"
        connection.exec_driver_sql("PRAGMA busy_timeout = 50" if sqlite else "SET LOCAL lock_timeout = 50")
        try:
            yield connection
            connection.commit()
        finally:
            if sqlite:
                connection.rollback()
                connection.exec_driver_sql(f"PRAGMA busy_timeout = {_BUSY}")


def mask_password(place: str | Path) -> str:
    """`place` without the password that a URL may hold."""
    return make_url(url_of(place)).render_as_string() if "://" in str(place) else str(place)


def _set_pragmas(connection: Any, record: Any) -> None:
    cursor = connection.cursor()
    for pragma in ("journal_mode = WAL", "synchronous = FULL", "foreign_keys = ON", f"busy_timeout = {_BUSY}"):
        cursor.execute(f"PRAGMA {pragma}")
    cursor.close()
