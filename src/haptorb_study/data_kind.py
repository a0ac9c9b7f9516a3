"""Kind of data in a database: real, pilot or simulated; one kind, from its first session on."""

from __future__ import annotations

from typing import Literal

from sqlalchemy import Connection, select
from sqlalchemy.engine import Engine

from haptorb.errors import InputError, RecordingError
from haptorb_study.database import contents

__all__ = ["KINDS", "MIXED", "Kind", "check_contents", "check_kind", "claim_contents", "describe_kind", "read_contents"]


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
