"""The tables of one program in a database, made at its first opening; what is none of ours, or newer, is refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from sqlalchemy import Connection, MetaData, Table, inspect, select
from sqlalchemy.engine import Engine
from sqlalchemy.exc import SQLAlchemyError

from haptorb.errors import RecordingError
from haptorb.files.sql_engine import lock_database, make_engine, mask_password

__all__ = ["TableSet", "explain_error"]


def explain_error(cause: SQLAlchemyError) -> str:
    """The database's own words, one line."""
    return str(getattr(cause, "orig", None) or cause).splitlines()[0]


@dataclass(frozen=True)
class TableSet:
    """Tables that belong together, and the version of their schema.

    content    what a database with these tables holds, such as "a study"
    metadata   the tables
    versions   the table whose only row has the schema's version
    newest     version of this haptorb
    family     of PostgreSQL's advisory locks of this program
    migrate    (connection, version): bring tables of an older version forward; None where there are none
    """

    content: str
    metadata: MetaData
    versions: Table
    newest: int
    family: int
    migrate: Callable[[Connection, int], object] | None = None

    def open(self, place: str | Path, *, make: bool) -> Engine:
        """The database at `place`, with these tables; RecordingError if it cannot be reached, is newer, or another.

        With `make` false one without tables is refused.
        """
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
