"""The tables of one program in a database, made at its first opening; what is none of ours, or newer, is refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from time import sleep

from sqlalchemy import Connection, MetaData, Table, inspect, select
from sqlalchemy.engine import Engine
from sqlalchemy.exc import SQLAlchemyError

from haptorb.errors import RecordingError, quote
from haptorb.files.file_kind import FileKind
from haptorb.files.sql_engine import lock_database, make_engine, mask_password, path_of
from haptorb.files.text_file import open_regular

__all__ = ["TableSet", "explain_error"]

_TRIES, _PAUSE = 20, 0.02  #: for another program that makes the database [s]
_HEAD = 256 * 1024  #: bytes by which a file is recognised


def explain_error(cause: SQLAlchemyError) -> str:
    """The database's own words, one line."""
    return str(getattr(cause, "orig", None) or cause).splitlines()[0]


def _check_neighbours(path: Path) -> None:
    """RecordingError for files beside the database that SQLite would obey: they may have come with it.

    A write-ahead log that is a link has what it leads to overwritten. A rollback journal, which a database of ours
    never has, as it begins with a write-ahead log, names a file that is deleted.
    """
    for end in ("-wal", "-shm"):
        beside = path.with_name(path.name + end)
        if beside.is_symlink() or (beside.exists() and not beside.is_file()):  # safety: database-link
            raise RecordingError(f"{beside} is not a regular file, so {path} is not opened: remove it")
    journal = path.with_name(f"{path.name}-journal")
    for _ in range(_TRIES):
        if not (journal.is_symlink() or journal.exists()):  # safety: database-journal
            return
        sleep(_PAUSE)  # another program may be making the database
    raise RecordingError(
        f"{path} has a rollback journal beside it, {journal.name}, so another program was writing it: it is not opened"
    )


def _check_schema(connection: Connection, place: str | Path) -> None:
    """RecordingError for a database that computes: views, triggers, virtual tables and generated columns."""
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
    """Tables that belong together, and the version of their schema.

    content    what a database with these tables holds, such as "a study"
    kind       of the file, if it is one
    metadata   the tables
    versions   the table whose only row has the schema's version
    newest     version of this haptorb
    family     of PostgreSQL's advisory locks of this program
    migrate    (connection, version): bring tables of an older version forward; None where there are none
    """

    content: str
    kind: FileKind
    metadata: MetaData
    versions: Table
    newest: int
    family: int
    migrate: Callable[[Connection, int], object] | None = None

    def open(self, place: str | Path, *, make: bool) -> Engine:
        """The database at `place`, with these tables; RecordingError if it cannot be reached, is newer, or another.

        With `make` false one without tables is refused.
        """
        path = path_of(place)
        if path is not None:
            self._check_file(path)
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

    def _check_file(self, path: Path) -> None:
        """RecordingError for what is there and is no database of this kind: opening it to write could change it."""
        _check_neighbours(path)
        if not path.exists() and not path.is_symlink():
            return
        with open_regular(path, "database", RecordingError) as file:
            head = file.read(_HEAD)
        if not head:  # as made by `touch`, or by a program that was ended before its first table
            return
        if other := self.kind.explain_other(path, head):
            raise RecordingError(other)
        if not head.startswith(b"SQLite format 3\0"):
            raise RecordingError(f"{path} is not a database, so it does not hold {self.content}; choose another name")

    def _bring_forward(self, connection: Connection, place: str | Path) -> None:
        lock_database(connection, self.family)
        version = self._read_version(connection, place)  # another program may have been quicker
        if version is None:
            self.metadata.create_all(connection)
            connection.execute(self.versions.insert().values(version=self.newest))
        elif self.migrate is not None:
            self.migrate(connection, version)

    def _read_version(self, connection: Connection, place: str | Path) -> int | None:
        """Version of the tables, None where there are none; RecordingError if they are not these, or newer."""
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
