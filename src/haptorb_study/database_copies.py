"""Copies of a study database made by haptorb: exports, backups, sources and results of merges."""

from __future__ import annotations

import json
import sqlite3
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sqlalchemy import select
from sqlalchemy.engine import Engine
from sqlalchemy.exc import SQLAlchemyError

from haptorb.errors import InputError, RecordingError
from haptorb.files import replace_file
from haptorb.sql import connect_file
from haptorb_study.database import copies, database
from haptorb_study.json_values import utc_now

__all__ = ["Copy", "back_up", "list_copies", "record_copy"]


@dataclass(frozen=True)
class Copy:
    """One copy; `settings`: how an export was made, or the mapping of codes."""

    kind: str  #: export, backup, source (this database was merged from it) or merged (into it)
    place: str  #: absolute path, or URL
    study: str
    settings: dict[str, Any]


def record_copy(
    engine: Engine, kind: str, place: str | Path, study: str = "", settings: dict[str, Any] | None = None
) -> None:
    """Record a copy at `place`; a read-only database cannot record it."""
    key = {"kind": kind, "place": str(place) if "://" in str(place) else str(Path(place).absolute()), "study": study}
    row = {**key, "settings": json.dumps(settings or {}), "at": utc_now()}
    with suppress(SQLAlchemyError), engine.begin() as connection:
        connection.execute(copies.delete().where(*(copies.c[name] == value for name, value in key.items())))
        connection.execute(copies.insert().values(**row))


def back_up(place: str | Path, into: Path) -> Path:
    """Back up the database file at `place`, also while a session runs.

    Raises RecordingError, with nothing written, if `into` exists.
    """
    if "://" in str(place):
        raise InputError("a backup is of a database file; for a server, use pg_dump")
    into = into.expanduser().absolute()
    if into.exists():
        raise RecordingError(f"{into} exists; choose another name for the backup")
    engine = database(place, make=False)
    record_copy(engine, "backup", into)
    try:
        with (
            replace_file(into) as part,
            closing(connect_file(str(engine.url.database), read_only=True)) as raw,
            closing(sqlite3.connect(part)) as kept,
        ):
            raw.backup(kept)
    except (sqlite3.Error, OSError) as cause:
        raise RecordingError(f"{into}: the backup cannot be written ({cause})") from cause
    finally:
        engine.dispose()
    return into


def list_copies(engine: Engine) -> tuple[Copy, ...]:
    """All recorded copies, oldest first."""
    with engine.connect() as connection:
        rows = connection.execute(select(copies).order_by(copies.c.id)).all()
    return tuple(Copy(row.kind, row.place, row.study, json.loads(row.settings)) for row in rows)
