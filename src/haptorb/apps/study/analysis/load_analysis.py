"""From a database to its analysis, in one call."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from sqlalchemy import select
from sqlalchemy.engine import Engine

from haptorb.apps.study.analysis.analysis import Analysis, analyse
from haptorb.apps.study.analysis.plan_report import SessionPlan
from haptorb.apps.study.model.study_file import Study
from haptorb.apps.study.store.columns import read_study, select_kind, tidy
from haptorb.apps.study.store.contents import Kind
from haptorb.apps.study.store.database import database, participants, sessions
from haptorb.apps.study.store.incidents import list_incidents
from haptorb.apps.study.store.registration import Registration

__all__ = ["analysis_of", "read_plans"]


def analysis_of(
    place: str | Path, name: str | None = None, progress: Callable[[int, int], None] | None = None, *,
    registration: Registration | None = None, data: Kind | None = None,
) -> Analysis:  # fmt: skip
    """The analysis of the study called `name` (the only one, if there is one) in the database at `place`.

    `progress` receives (people fitted, people in all), where something is fitted. The plan of the study is compared
    with the one of the `registration`. `data` says which kind is analysed, see `columns.select_kind`: real data,
    unless there are none, and never two kinds in one number.
    """
    engine = database(place, make=False)
    study = read_study(engine, name)
    plans = read_plans(engine, study)
    columns, left_out = select_kind(tidy(engine, study), data)
    found = analyse(study, columns, progress, plans=plans, registration=registration)
    incidents = list_incidents(engine, study, set(columns["participant"].tolist()))
    return replace(found, left_out=left_out, incidents=incidents)


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
