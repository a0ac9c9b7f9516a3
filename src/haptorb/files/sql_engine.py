"""Databases that programs write answers and results to: SQLite in a file, PostgreSQL by URL.

SQLite runs with a write-ahead log and `synchronous = FULL`: a committed transaction is on the disk, power loss or not.
"""

from __future__ import annotations

import sqlite3
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, create_engine, event, text
from sqlalchemy.engine import Engine, make_url
from sqlalchemy.exc import ArgumentError

from haptorb.errors import RecordingError

__all__ = ["BUSY", "lock_database", "make_engine", "mask_password", "path_of", "url_of"]

BUSY = 10_000  #: milliseconds for which a writer waits while another program holds the database
_LONGEST = 64 * 1024 * 1024  #: bytes of a value
_PATIENCE = 5  #: seconds until a server that does not answer counts as unreachable


def url_of(place: str | Path) -> str:
    """`place` as a URL: a path means SQLite.

    >>> url_of("study.db")
    'sqlite:///study.db'
    """
    text = str(place)
    return text if "://" in text else f"sqlite:///{text}"


def path_of(place: str | Path) -> Path | None:
    """The file of a SQLite database, None for a server's."""
    url = url_of(place)
    return Path(url.removeprefix("sqlite:///")) if url.startswith("sqlite:///") else None


def make_engine(place: str | Path) -> Engine:
    """An engine for the database at `place`, which nothing was asked yet; RecordingError if `place` names none."""
    try:
        url = make_url(url_of(place))
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
    return engine


def lock_database(connection: Connection, family: int) -> None:
    """No other program of `family` passes here until the transaction that has just begun on `connection` ends."""
    if connection.dialect.name == "sqlite":
        connection.execute(text("BEGIN IMMEDIATE"))  # Python's sqlite3 would begin only at the first change of data
    else:
        connection.execute(text("SELECT pg_advisory_xact_lock(:family, 0)"), {"family": family})


def mask_password(place: str | Path) -> str:
    """`place` without the password that a URL may hold."""
    return make_url(url_of(place)).render_as_string() if "://" in str(place) else str(place)


#: a station that loses its power must not hold its session, nor one that loses its server wait, for hours
_watched = {
    "connect_timeout": _PATIENCE, "keepalives_idle": 10, "keepalives_interval": 5, "keepalives_count": 3,
    "tcp_user_timeout": 30_000,
}  # fmt: skip


def _set_pragmas(connection: Any, record: Any) -> None:
    """Durable, and careful: what a database from somebody else computes by its own schema is nothing of ours."""
    connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _LONGEST)
    cursor = connection.cursor()
    for pragma in (
        "trusted_schema = OFF",
        "cell_size_check = ON",
        "journal_mode = WAL",
        "synchronous = FULL",
        "foreign_keys = ON",
        f"busy_timeout = {BUSY}",
    ):
        cursor.execute(f"PRAGMA {pragma}")
    cursor.close()
