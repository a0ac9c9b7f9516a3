"""Who has taken part in a study: codes, and what has become of their sessions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from sqlalchemy import func, select
from sqlalchemy.engine import Engine

from haptorb.apps.study.model.codes import is_reserved
from haptorb.apps.study.model.study_file import Study
from haptorb.apps.study.store.database import participants, sessions, trials, withdrawn

__all__ = ["StoredParticipant", "list_participants"]


@dataclass(frozen=True)
class StoredParticipant:
    """One code that is taken."""

    code: str
    simulated: bool
    state: str  #: finished, aborted, open (its code continues it) or withdrawn (its data are removed)
    answered: int  #: trials, practice included
    started: str  #: UTC; of one who withdrew, when

    def numbers(self) -> dict[str, Any]:
        """As plain JSON types."""
        return {
            "code": self.code, "simulated": self.simulated, "state": self.state, "answered_trials": self.answered,
            "started": self.started,
        }  # fmt: skip


def list_participants(engine: Engine, study: Study) -> tuple[StoredParticipant, ...]:
    """Those who withdrew from `study`, then everybody who began it, in the order in which they did."""
    answered = select(func.count()).where(trials.c.session == sessions.c.id).scalar_subquery()
    query = (
        select(participants.c.code, sessions.c.simulated, sessions.c.ended, sessions.c.aborted, sessions.c.started,
               answered.label("answered"))
        .join(sessions, sessions.c.participant == participants.c.id)
        .where(participants.c.study == study.digest)
        .order_by(participants.c.ordinal)
    )  # fmt: skip
    with engine.connect() as connection:
        rows = connection.execute(query).all()
        gone = connection.execute(
            select(withdrawn).where(withdrawn.c.study == study.digest).order_by(withdrawn.c.id)
        ).all()
    left = tuple(StoredParticipant(row.code, is_reserved(row.code), "withdrawn", 0, row.at) for row in gone)
    return left + tuple(
        StoredParticipant(
            row.code, bool(row.simulated),
            "aborted" if row.aborted else "open" if row.ended is None else "finished", int(row.answered), row.started,
        )
        for row in rows
    )  # fmt: skip
