"""What a database holds: real data, pilot data or simulated participants; one kind, from its first session on."""

from __future__ import annotations

from typing import Literal

from sqlalchemy import Connection, select
from sqlalchemy.engine import Engine

from haptorb.apps.study.store.database import contents
from haptorb.errors import InputError, RecordingError

__all__ = ["KINDS", "MIXED", "Kind", "check_contents", "check_kind", "claim_contents", "describe_kind", "read_contents"]

Kind = Literal["real", "pilot", "simulated"]
KINDS: tuple[Kind, ...] = ("real", "pilot", "simulated")
MIXED = "mixed"  #: from an older haptorb, which did not separate them
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
    """What a database of `kind` holds, in words."""
    return _WORDS.get(kind, "no session yet")


def check_kind(kind: str) -> Kind:
    """`kind` itself; InputError if there is none of this name."""
    for known in KINDS:
        if kind == known:
            return known
    raise InputError(f"kind of data must be {', '.join(KINDS)}; got '{kind}'")


def read_contents(engine: Engine) -> str:
    """What the database holds: one of KINDS or MIXED; empty before its first session."""
    with engine.connect() as connection:
        return _read(connection)


def _read(connection: Connection) -> str:
    return str(connection.execute(select(contents.c.holds)).scalar() or "")


def check_contents(engine: Engine, kind: Kind) -> None:
    """RecordingError, with what to do, if sessions of `kind` do not belong into this database."""
    with engine.connect() as connection:
        _check(_read(connection), kind)


def claim_contents(connection: Connection, kind: Kind) -> None:
    """In the transaction of `connection`: this database holds sessions of `kind`; RecordingError if it holds others."""
    held = _read(connection)
    _check(held, kind)
    if not held:
        connection.execute(contents.insert().values(id=1, holds=kind))


def _check(held: str, kind: Kind) -> None:
    # People may continue in a mixed one: what they answer is told apart by its device, trial by trial.
    allowed = held in ("", kind) or (held == MIXED and kind != "simulated")
    more = ", or run with --pilot to add to the pilot" if (held, kind) == ("pilot", "real") else ""
    if not allowed:  # safety: study-one-kind
        raise RecordingError(
            f"this database holds {describe_kind(held)}, and this would add {_WORDS[kind]}: nothing was stored. "
            f"{_WAYS[kind][0].upper()}{_WAYS[kind][1:]}{more}"
        )
