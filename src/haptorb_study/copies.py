"""Copies of a study database made by haptorb (exports, backups, merges), and the kind of data it holds."""

from __future__ import annotations

import json
import os
import sqlite3
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from sqlalchemy import Connection, select
from sqlalchemy.engine import Engine
from sqlalchemy.exc import SQLAlchemyError

from haptorb.errors import InputError, RecordingError
from haptorb_study.database import contents, copies, database, utc_now

__all__ = [
    "KINDS",
    "MIXED",
    "Copy",
    "Kind",
    "back_up",
    "check_contents",
    "check_kind",
    "claim_contents",
    "describe_kind",
    "list_copies",
    "read_contents",
    "record_copy",
]


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
    part = into.with_name(f".{into.name}.part")
    try:
        with (
            closing(sqlite3.connect(str(engine.url.database), timeout=10.0)) as raw,
            closing(sqlite3.connect(part)) as kept,
        ):
            raw.backup(kept)
        os.replace(part, into)
    except (sqlite3.Error, OSError) as cause:
        part.unlink(missing_ok=True)
        raise RecordingError(f"{into}: the backup cannot be written ({cause})") from cause
    finally:
        engine.dispose()
    return into


def list_copies(engine: Engine) -> tuple[Copy, ...]:
    """All recorded copies, oldest first."""
    with engine.connect() as connection:
        rows = connection.execute(select(copies).order_by(copies.c.id)).all()
    return tuple(Copy(row.kind, row.place, row.study, json.loads(row.settings)) for row in rows)


# --------------------------------------------------------------------------------------------------
# Kind of data in a database: real, pilot or simulated; one kind, from its first session on.


Kind = Literal["real", "pilot", "simulated"]
KINDS: tuple[Kind, ...] = ("real", "pilot", "simulated")
MIXED = "mixed"  #: from an older haptorb, which did not separate the kinds
_WORDS = {
    "real": "real data",
    "pilot": "pilot data (begun with --pilot, or on the SIMULATED DEVICE)",
    "simulated": "SIMULATED participants",
    MIXED: "data of an older haptorb, which did not separate real, pilot and simulated ones",
}
_WAYS = {
    "real": "give the real sessions a database of their own: --db NAME.db",
    "pilot": "give the pilot a database of its own: --db NAME-pilot.db",
    "simulated": "give the simulated participants a database of their own: --db NAME-simulated.db",
}


def describe_kind(kind: str) -> str:
    """Description of the data in a database of `kind`."""
    return _WORDS.get(kind, "no session yet")


def check_kind(kind: str) -> Kind:
    """Validate `kind`; InputError if it is unknown."""
    for known in KINDS:
        if kind == known:
            return known
    raise InputError(f"kind of data must be {', '.join(KINDS)}; got '{kind}'")


def read_contents(engine: Engine) -> str:
    """Kind of data in the database: one of KINDS or MIXED; empty before its first session."""
    with engine.connect() as connection:
        return _read(connection)


def _read(connection: Connection) -> str:
    return str(connection.execute(select(contents.c.holds)).scalar() or "")


def check_contents(engine: Engine, kind: Kind) -> None:
    """Raise RecordingError, with the remedy, if sessions of `kind` do not belong into this database."""
    with engine.connect() as connection:
        _check(_read(connection), kind)


def claim_contents(connection: Connection, kind: Kind) -> None:
    """Set the kind of data of this database to `kind`, in the transaction; RecordingError if it holds another."""
    held = _read(connection)
    _check(held, kind)
    if not held:
        connection.execute(contents.insert().values(id=1, holds=kind))


def _check(held: str, kind: Kind) -> None:
    # Sessions of real people may continue in a mixed database: its trials are separated by their driver.
    allowed = held in ("", kind) or (held == MIXED and kind != "simulated")
    more = ", or run with --pilot to add to the pilot" if (held, kind) == ("pilot", "real") else ""
    if not allowed:  # safety: study-one-kind
        raise RecordingError(
            f"this database holds {describe_kind(held)}, and this would add {_WORDS[kind]}: nothing was stored. "
            f"{_WAYS[kind][0].upper()}{_WAYS[kind][1:]}{more}"
        )
