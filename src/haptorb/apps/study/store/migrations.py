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


def _contents(connection: Connection) -> None:
    """4 → 5: what the database holds, who withdrew, and which copies of it there are.

    Where it is not known of every trial whether its device was simulated, people may continue with either: mixed.
    """
    number = "INTEGER NOT NULL PRIMARY KEY" if connection.dialect.name == "sqlite" else "SERIAL PRIMARY KEY"
    for table in (
        f"contents (id {number}, holds VARCHAR(16) NOT NULL)",
        f"withdrawn (id {number}, study VARCHAR(16) NOT NULL REFERENCES studies (digest), code VARCHAR(16) NOT NULL, "
        "ordinal INTEGER NOT NULL, at VARCHAR(32) NOT NULL, text TEXT NOT NULL, UNIQUE (study, code))",
        f"copies (id {number}, kind VARCHAR(16) NOT NULL, place TEXT NOT NULL, study VARCHAR(64) NOT NULL, "
        "settings TEXT NOT NULL, at VARCHAR(32) NOT NULL, UNIQUE (kind, place, study))",
    ):
        connection.execute(text(f"CREATE TABLE {table}"))
    people = list(connection.execute(text("SELECT simulated FROM sessions GROUP BY simulated")).scalars())
    drivers = connection.execute(
        text(
            "SELECT DISTINCT trials.driver FROM trials JOIN sessions ON trials.session = sessions.id "
            "WHERE NOT sessions.simulated"
        )
    )
    on_simulation = {None if driver is None else driver == "sim" for driver in drivers.scalars()}
    if not people:
        return
    if people == [True]:
        holds = "simulated"
    elif len(people) > 1 or len(on_simulation) != 1 or on_simulation == {None}:
        holds = "mixed"
    else:
        holds = "pilot" if on_simulation == {True} else "real"
    connection.execute(text("INSERT INTO contents (id, holds) VALUES (1, :holds)"), {"holds": holds})


#: version → the step that leads from it to the next
STEPS: Mapping[int, Callable[[Connection], None]] = {1: _questions, 2: _driver, 3: _decimal_answers, 4: _contents}


def migrate(connection: Connection, version: int) -> int:
    """Take the tables from `version` on to the newest; the transaction is the caller's. Returns the newest."""
    while version in STEPS:
        STEPS[version](connection)
        version += 1
        connection.execute(text("UPDATE haptorb_schema SET version = :version"), {"version": version})
    return version
