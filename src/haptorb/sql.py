"""Databases for answers and results: SQLite in a file, PostgreSQL by URL.

SQLite uses a write-ahead log and `synchronous = FULL`: a committed transaction survives a power loss.
"""

from __future__ import annotations

import os
import sqlite3
import stat
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import sleep
from types import TracebackType
from typing import Any, Self, final

from sqlalchemy import Connection, MetaData, Table, create_engine, event, inspect, select, text
from sqlalchemy.engine import URL, Engine, ExceptionContext, make_url
from sqlalchemy.engine import Connection as engine_Connection
from sqlalchemy.exc import ArgumentError, SQLAlchemyError

from haptorb.database_address import mask_password, path_of
from haptorb.errors import RecordingError, quote
from haptorb.file_kind import FileKind
from haptorb.files import describe_size_limit, open_regular

__all__ = [
    "BUSY_TIMEOUT_MS",
    "ProgramLock",
    "TableSet",
    "connect_file",
    "explain_error",
    "lock_database",
    "lock_file_of",
    "make_engine",
]


BUSY_TIMEOUT_MS = 10_000  #: time for which a writer waits while another program holds the database [ms]
_MAX_VALUE_BYTES = 64 * 1024 * 1024  #: largest size of a value
_CONNECT_TIMEOUT_S = 5  #: connection timeout of a server


def make_engine(place: str | Path) -> Engine:
    """Create an engine for the database at `place` without connecting; RecordingError if `place` is not a database.

    Each connection to a file raises RecordingError for files beside it that SQLite would process.
    """
    path = path_of(place)
    try:
        # A file's name is no URL: what follows a "?" in it belongs to the name.
        url = make_url(str(place)) if path is None else URL.create("sqlite", database=str(path))
        if url.drivername == "postgresql":
            url = url.set(drivername="postgresql+psycopg")
        engine = create_engine(url, connect_args=_watched if url.get_backend_name() == "postgresql" else {})
    except ArgumentError as cause:
        raise RecordingError(
            f"'{mask_password(place)}' is not a database; give a file, or a URL like postgresql://host/name"
        ) from cause
    except ImportError as cause:
        raise RecordingError(
            f"database {mask_password(place)} needs a driver that is not installed ({cause.name or cause}): "
            "pip install 'haptorb[study]' brings PostgreSQL's"
        ) from cause
    if path is not None:
        event.listen(engine, "do_connect", lambda *_: _check_neighbours(path))
    if engine.dialect.name == "sqlite":
        event.listen(engine, "connect", _set_pragmas)
        event.listen(engine, "handle_error", partial(_explain_damage, place))
    return engine


def connect_file(path: str | Path, *, read_only: bool = False, timeout: float = 10.0) -> sqlite3.Connection:
    """Connect to the database file `path` without SQLAlchemy, for a copy of its pages or to compact it; no transaction
    is begun. Raises RecordingError for files beside it that SQLite would process."""
    _check_neighbours(Path(path))
    mode = "ro" if read_only else "rw"
    return sqlite3.connect(
        f"{Path(path).absolute().as_uri()}?mode={mode}", uri=True, timeout=timeout, isolation_level=None
    )


def lock_database(connection: Connection, family: int) -> None:
    """Lock the database for programs of `family` until the transaction that has just begun on `connection` ends."""
    if connection.dialect.name == "sqlite":
        connection.execute(text("BEGIN IMMEDIATE"))  # Python's sqlite3 would begin only at the first change of data
    else:
        connection.execute(text("SELECT pg_advisory_xact_lock(:family, 0)"), {"family": family})


#: a station that loses power must not hold its session for hours, nor must one that loses its server wait
_watched = {
    "connect_timeout": _CONNECT_TIMEOUT_S, "keepalives_idle": 10, "keepalives_interval": 5, "keepalives_count": 3,
    "tcp_user_timeout": 30_000,
}  # fmt: skip


def _set_pragmas(connection: Any, record: Any) -> None:
    """Configure durable writes, and distrust the schema: functions in a foreign database must not run."""
    connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _MAX_VALUE_BYTES)
    cursor = connection.cursor()
    for pragma in (
        "trusted_schema = OFF",
        "cell_size_check = ON",
        "journal_mode = WAL",
        "synchronous = FULL",
        "foreign_keys = ON",
        f"busy_timeout = {BUSY_TIMEOUT_MS}",
    ):
        try:
            cursor.execute(f"PRAGMA {pragma}")
        except (UnicodeDecodeError, MemoryError) as cause:  # the name of a table in SQLite's own message
            raise sqlite3.DatabaseError("malformed database schema") from cause
    cursor.close()


def _explain_damage(place: str | Path, context: ExceptionContext) -> None:
    """Raise RecordingError for SQLite's errors on a damaged file, and Python's on a text in it."""
    cause = context.original_exception
    if type(cause) is sqlite3.DatabaseError or isinstance(cause, UnicodeDecodeError | MemoryError):
        raise RecordingError(
            f"database {mask_password(place)} is damaged: {cause or 'malformed'}; use a backup, or what SQLite's own "
            "program saves of it (sqlite3 FILE .recover)"
        ) from cause


# --------------------------------------------------------------------------------------------------
# Tables of one program in a database, created at its first opening; foreign or newer databases are refused.


_TABLE_SET_TRIES, _PAUSE = 20, 0.02  #: tries, and pause between them, while another program creates the database [s]
_HEAD_BYTES = 256 * 1024  #: bytes read to recognise a file's kind


def explain_error(cause: SQLAlchemyError) -> str:
    """Return the database's own message in one line, with this shell's file size limit where that may be the cause."""
    words = str(getattr(cause, "orig", None) or cause).splitlines()[0]
    if (limit := describe_size_limit()) and ("I/O error" in words or "is full" in words):
        words += f"; {limit}"
    return words


def _check_neighbours(path: Path) -> None:
    """Raise RecordingError for files beside the database that SQLite would process: they may have come with it.

    If the write-ahead log is a link, its target would be overwritten. A rollback journal names a file that is deleted;
    databases of this package never have one, as they use a write-ahead log from the start.
    """
    for place in dict.fromkeys((path, Path(os.path.realpath(path)))):  # SQLite looks beside what a link leads to
        for end in ("-wal", "-shm"):
            beside = place.with_name(place.name + end)
            if beside.is_symlink() or (beside.exists() and not beside.is_file()):  # safety: database-link
                raise RecordingError(f"{beside} is not a regular file, so {path} is not opened: remove it")
        journal = place.with_name(f"{place.name}-journal")
        for _ in range(_TABLE_SET_TRIES):
            if not (journal.is_symlink() or journal.exists()):  # safety: database-journal
                break
            sleep(_PAUSE)  # another program may be creating the database
        else:
            raise RecordingError(
                f"{path} has a rollback journal beside it, {journal.name}, so another program was writing it: it is "
                "not opened"
            )


def _check_schema(connection: Connection, place: str | Path) -> None:
    """Raise RecordingError for a schema that computes: views, triggers, virtual tables and generated columns."""
    for kind, name, made in connection.exec_driver_sql("SELECT type, name, sql FROM sqlite_master").all():
        words = str(made or "").upper().split()
        generated: list[str] = []
        if kind == "table":
            columns = connection.exec_driver_sql("SELECT name, hidden FROM pragma_table_xinfo(?)", (name,)).all()
            generated = [column for column, hidden in columns if hidden]
        if kind in ("view", "trigger") or words[1:2] == ["VIRTUAL"] or generated:  # safety: database-schema
            what = kind if kind in ("view", "trigger") else "computed table"
            raise RecordingError(
                f"database {mask_password(place)} has a {what}, {quote(name)}, which haptorb does not make: it is not "
                "opened"
            )


@dataclass(frozen=True)
class TableSet:
    """Tables of one program, and the version of their schema.

    content    description of a database with these tables, such as "a study"
    kind       kind of the file, if it is one
    metadata   the tables
    versions   the table whose only row has the schema's version
    newest     version of this haptorb
    family     number of this program's advisory locks in PostgreSQL
    migrate    (connection, version): migrate tables of an older version; None if there are none
    """

    content: str
    kind: FileKind
    metadata: MetaData
    versions: Table
    newest: int
    family: int
    migrate: Callable[[Connection, int], object] | None = None

    def open(self, place: str | Path, *, make: bool) -> Engine:
        """Open the database at `place`, with these tables; RecordingError if it cannot be reached, is newer or foreign.

        If `make` is false, a database without tables is refused.
        """
        path = path_of(place)
        if path is not None:
            self.check_file(path)
        engine = make_engine(place)
        try:
            with engine.connect() as connection:
                version = self._read_version(connection, place)
            if version is None and not make:
                raise RecordingError(f"database {mask_password(place)} does not hold {self.content}")
            if version is None or version < self.newest:
                with engine.begin() as connection:
                    self._bring_forward(connection, place)
        except SQLAlchemyError as cause:
            engine.dispose()
            raise RecordingError(
                f"database {mask_password(place)} cannot be opened, and nothing was started: {explain_error(cause)}"
            ) from cause
        except RecordingError:
            engine.dispose()
            raise
        return engine

    def check_file(self, path: Path) -> None:
        """Raise RecordingError for an existing file of another kind: opening it for writing could change it. Raise it,
        too, for files beside it that SQLite would process."""
        if not path.name:
            raise RecordingError(f"'{path}' is a folder: give the file of a database")
        _check_neighbours(path)
        if not path.exists() and not path.is_symlink():
            return
        with open_regular(path, "database", RecordingError) as file:
            head = file.read(_HEAD_BYTES)
        if not head:  # as created by `touch`, or by a program that ended before its first table
            return
        if other := self.kind.explain_other(path, head):
            raise RecordingError(other)
        if not head.startswith(b"SQLite format 3\0"):
            raise RecordingError(f"{path} is not a database, so it does not hold {self.content}; choose another name")

    def _bring_forward(self, connection: Connection, place: str | Path) -> None:
        lock_database(connection, self.family)
        version = self._read_version(connection, place)  # another program may have migrated it meanwhile
        if version is None:
            self.metadata.create_all(connection)
            connection.execute(self.versions.insert().values(version=self.newest))
        elif self.migrate is not None:
            self.migrate(connection, version)

    def _read_version(self, connection: Connection, place: str | Path) -> int | None:
        """Return the version of the tables, None if there are none; RecordingError if they are foreign or newer."""
        names = set(inspect(connection).get_table_names())
        if not names:
            return None
        if connection.dialect.name == "sqlite":
            _check_schema(connection, place)
        if self.versions.name not in names:
            raise RecordingError(
                f"database {mask_password(place)} holds other tables, not {self.content}; choose another"
            )
        version = int(connection.execute(select(self.versions.c.version)).scalar_one())
        if version > self.newest:
            raise RecordingError(
                f"database {mask_password(place)} has schema {version}; this haptorb knows up to {self.newest}: "
                "update haptorb"
            )
        return version


# --------------------------------------------------------------------------------------------------
# Mutual exclusion of programs: a lock that the operating system, or PostgreSQL, releases when its holder ends.


_PROGRAM_LOCK_TRIES = 20  #: attempts to lock a file that others may remove meanwhile


@final
class ProgramLock:
    """Lock held in a `with` block, or until `release`; raises `conflict` if another program holds it.

    family, number  advisory lock in a PostgreSQL database
    end             suffix of the lock file beside a SQLite file

    A killed process loses it at once, so that its work can be resumed without waiting. The file is removed on release;
    one left by a killed process is removed by the next holder.
    """

    def __init__(self, engine: Engine, family: int, number: int, end: str, conflict: RecordingError) -> None:
        self._file: sqlite3.Connection | None = None
        self._path = Path()
        self._connection: engine_Connection | None = None
        if engine.dialect.name == "sqlite":
            self._path = lock_file_of(str(engine.url.database), end)
            self._file = _lock_file(self._path, conflict)
        else:
            self._connection = engine.connect()
            lock = text("SELECT pg_try_advisory_lock(:family, :number)")
            held = self._connection.execute(lock, {"family": family, "number": number}).scalar_one()
            self._connection.commit()
            if not held:
                self._connection.close()
                raise conflict

    def release(self) -> None:
        """Release the lock; may be called twice."""
        if self._file is not None:
            with suppress(
                OSError
            ):  # while it is locked: who opened it meanwhile sees that it is another file's name now
                self._path.unlink()
            self._file.close()
            self._file = None
        if self._connection is not None:
            self._connection.invalidate()  # the lock belongs to the connection, which a pool would keep open
            self._connection.close()
            self._connection = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.release()


def lock_file_of(database: str | Path, end: str) -> Path:
    """Lock file of a SQLite file: beside the file itself, where a link to it leads, so that all names have one lock."""
    return Path(f"{os.path.realpath(database)}{end}")


def _lock_file(path: Path, conflict: RecordingError) -> sqlite3.Connection:
    """Lock the empty file `path` until it is closed. Raises `conflict`, or RecordingError if it cannot be created.

    SQLite implements file locks for each operating system. A lock file may have come with the database of a stranger:
    SQLite opens only an empty one, with nothing beside it, so it finds no database to repair and no log to obey.
    """
    tries = 0
    while True:
        tries += 1
        file = None
        _clear_lock_file(path)  # safety: database-lock
        try:
            with suppress(FileExistsError):  # no other access: closing the file would release its locks
                os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o600))
            before = _identify(path)
            file = sqlite3.connect(path, timeout=0.0, isolation_level=None, check_same_thread=False)
            file.execute("PRAGMA journal_mode = MEMORY")  # no journal that a killed program would leave
            file.execute("BEGIN EXCLUSIVE")
            if before is not None and before == _identify(path):
                return file
            file.close()  # its last holder removed it meanwhile: the locked file has no name
        except (OSError, sqlite3.Error) as cause:
            if file is not None:
                file.close()
            if isinstance(cause, sqlite3.Error) and cause.sqlite_errorcode == sqlite3.SQLITE_BUSY:
                raise conflict from cause
            if isinstance(cause, sqlite3.Error) and tries < _PROGRAM_LOCK_TRIES:
                continue  # its last holder removed it while SQLite opened it
            raise RecordingError(f"{path} cannot be locked: {cause}") from cause


def _clear_lock_file(path: Path) -> None:
    """Raise RecordingError if the lock file `path` is no empty file; remove the files beside it, which hold nothing:
    a killed program of an older haptorb left a journal, and a stranger's may name other files."""
    with suppress(FileNotFoundError):
        found = path.lstat()
        if not stat.S_ISREG(found.st_mode) or found.st_size:
            raise RecordingError(f"{path} is not an empty regular file, so nothing can be locked by it: remove it")
    for end in ("-journal", "-wal", "-shm"):
        beside = path.with_name(path.name + end)
        try:
            beside.unlink(missing_ok=True)  # the name: what a link leads to stays
        except OSError as cause:
            raise RecordingError(
                f"{beside} cannot be removed ({cause.strerror}), so nothing can be locked by {path.name}: remove it"
            ) from cause


def _identify(path: Path) -> tuple[int, int, int] | None:
    """Return the identity of the file that has this name now; None if there is none."""
    try:
        status = path.stat()
    except FileNotFoundError:
        return None
    return status.st_dev, status.st_ino, status.st_ctime_ns
