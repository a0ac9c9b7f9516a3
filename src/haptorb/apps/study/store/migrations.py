"""From the schema of an older haptorb to this one: forward only, one step per version, all in one transaction.

A step says what it did in plain SQL that SQLite and PostgreSQL both know. It never uses the tables as they are now:
those belong to the newest schema, and a step must still mean the same when that has moved on.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from sqlalchemy import Connection, text

__all__ = ["STEPS", "migrate"]


def _questions(connection: Connection) -> None:
    """1 → 2: answers to the questions of a study file."""
    number = "INTEGER NOT NULL PRIMARY KEY" if connection.dialect.name == "sqlite" else "SERIAL PRIMARY KEY"
    connection.execute(
        text(
            f"CREATE TABLE replies (id {number}, session INTEGER NOT NULL REFERENCES sessions (id), "
            "question VARCHAR(48) NOT NULL, reply TEXT NOT NULL, at VARCHAR(32) NOT NULL, UNIQUE (session, question))"
        )
    )


def _driver(connection: Connection) -> None:
    """2 → 3: how the device was driven in a trial; unknown for older trials."""
    connection.execute(text("ALTER TABLE trials ADD COLUMN driver VARCHAR(200)"))


def _decimal_answers(connection: Connection) -> None:
    """3 → 4: answers that are no whole numbers. A column of SQLite takes them as it is."""
    if connection.dialect.name != "sqlite":
        connection.execute(text("ALTER TABLE trials ALTER COLUMN answer TYPE DOUBLE PRECISION"))


#: version → the step that leads from it to the next
STEPS: Mapping[int, Callable[[Connection], None]] = {1: _questions, 2: _driver, 3: _decimal_answers}


def migrate(connection: Connection, version: int) -> int:
    """Take the tables from `version` on to the newest; the transaction is the caller's. Returns the newest."""
    while version in STEPS:
        STEPS[version](connection)
        version += 1
        connection.execute(text("UPDATE haptorb_schema SET version = :version"), {"version": version})
    return version
