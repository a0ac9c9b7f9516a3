"""Incidents of sessions: stops, repeated trials, safety events, early ends; with time, trial and reason."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import asdict, dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import select
from sqlalchemy.engine import Engine

from haptorb_study.database import events, participants, sessions
from haptorb_study.study_file import Study

__all__ = ["COLUMNS", "KINDS", "Incident", "count_incidents", "list_incidents", "name_kind"]

#: kind of event in the database → name of the incident; other events are the normal course of a session
KINDS = {
    "pause": "stop", "resume": "resume", "repeat": "repeat", "safety": "safety", "leave": "leave", "abort": "abort",
    "declined": "no consent", "failed": "failure",
}  # fmt: skip
#: column → description, of the table of incidents
COLUMNS = {
    "participant": "pseudonymous code",
    "session": "number of the session in the database",
    "trial": "number of the trial in its session, from 1: during it, or before it began",
    "event": "what happened",
    "onset": "time since the session began [s]",
    "time": "time of day (UTC)",
    "reason": "who or what caused it; empty: not known",
}


@dataclass(frozen=True)
class Incident:
    """An incident; fields as in COLUMNS."""

    participant: str
    session: int
    trial: int
    event: str
    onset: float
    time: str
    reason: str

    def row(self) -> dict[str, Any]:
        """Column → value."""
        return asdict(self)


def name_kind(kind: str) -> str | None:
    """Name of the incident for an event of `kind`; None if it is not an incident."""
    return KINDS.get(kind)


def list_incidents(engine: Engine, study: Study, people: Collection[str] | None = None) -> tuple[Incident, ...]:
    """Incidents of all participants of `study`, or of `people`, by participant and time."""
    query = (
        select(participants.c.code, sessions.c.id, sessions.c.started, events.c.trial, events.c.kind, events.c.at,
               events.c.text)
        .join(sessions, events.c.session == sessions.c.id)
        .join(participants, sessions.c.participant == participants.c.id)
        .where(participants.c.study == study.digest, events.c.kind.in_(KINDS))
        .order_by(participants.c.ordinal, events.c.at, events.c.id)
    )  # fmt: skip
    with engine.connect() as connection:
        rows = connection.execute(query).all()
    return tuple(
        Incident(row.code, row.id, row.trial + 1, KINDS[row.kind], _since(row.started, row.at), row.at, row.text)
        for row in rows
        if people is None or row.code in people
    )


def count_incidents(incidents: Iterable[Incident]) -> dict[str, int]:
    """Count incidents by name, zeros included."""
    found = dict.fromkeys(KINDS.values(), 0)
    for one in incidents:
        found[one.event] += 1
    return found


def _since(started: str, at: str) -> float:
    try:
        return round((datetime.fromisoformat(at) - datetime.fromisoformat(started)).total_seconds(), 3)
    except (ValueError, TypeError):
        return float("nan")
