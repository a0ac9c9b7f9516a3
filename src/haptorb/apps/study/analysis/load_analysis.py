"""From a database to its analysis, in one call."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from sqlalchemy import select
from sqlalchemy.engine import Engine

from haptorb.apps.asking.procedure import Procedure
from haptorb.apps.asking.prompt import Answer
from haptorb.apps.study.analysis.analysis import Analysis, analyse
from haptorb.apps.study.analysis.over_people.plan_report import SessionPlan
from haptorb.apps.study.model.order import procedure_of
from haptorb.apps.study.model.study_file import Study
from haptorb.apps.study.plan.registration import Registration
from haptorb.apps.study.store.columns import Columns, read_study, tidy
from haptorb.apps.study.store.database import database, participants, sessions

__all__ = ["analysis_of", "read_plans"]


def analysis_of(place: str | Path, name: str | None = None, registration: Registration | None = None) -> Analysis:
    """The analysis of the study called `name` (the only one, if there is one) in the database at `place`.

    Its plan is compared with the one of the `registration`.
    """
    engine = database(place, make=False)
    study = read_study(engine, name)
    columns = tidy(engine, study)
    adaptive = study.procedure in ("staircase", "bayesian")
    procedures = _procedures(engine, study, columns) if adaptive else None
    return analyse(study, columns, procedures, read_plans(engine, study), registration)


def read_plans(engine: Engine, study: Study) -> tuple[SessionPlan, ...]:
    """With which plan each session of `study` began."""
    query = (
        select(sessions.c.started, sessions.c.ended, sessions.c.aborted, sessions.c.versions)
        .join(participants, sessions.c.participant == participants.c.id)
        .where(participants.c.study == study.digest)
    )
    with engine.connect() as connection:
        rows = connection.execute(query).all()
    return tuple(
        SessionPlan(
            row.started, str(json.loads(row.versions).get("plan", "")), row.ended is not None and not row.aborted
        )
        for row in rows
    )


def _procedures(engine: Engine, study: Study, columns: Columns) -> dict[str, Procedure]:
    """By participant, the procedure after all answers: the threshold is its own, not computed a second way."""
    query = (
        select(participants.c.code, sessions.c.plan)
        .join(sessions, sessions.c.participant == participants.c.id)
        .where(participants.c.study == study.digest)
    )
    found: dict[str, Procedure] = {}
    with engine.connect() as connection:
        rows = connection.execute(query).all()
    for code, stored in rows:
        procedure: Procedure = procedure_of(study, json.loads(stored))
        for value in columns["answer"][columns["participant"] == code]:
            procedure = procedure.record_answer(Answer(None if np.isnan(value) else int(value)))
        found[code] = procedure
    return found
