"""Answered trials as columns, one row per trial: the tidy table that everything else is made from."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import select
from sqlalchemy.engine import Engine

from haptorb.apps.study.database import participants, replies, sessions, studies, trials
from haptorb.apps.study.set_points import angle_between
from haptorb.apps.study.study_file import Study, study_of
from haptorb.errors import InputError, RecordingError

__all__ = ["COLUMNS", "Columns", "replied", "studied", "tidy"]

#: column → what it is; the data dictionary of every export
COLUMNS = {
    "participant": "pseudonymous code",
    "simulated": "true: a simulated participant, not a person",
    "session": "number of the session in the database",
    "trial": "number of the trial in its session, from 0",
    "phase": "practice (left out of every analysis) or main",
    "condition": "condition rendered",
    "other": "forced choice: the condition in the other interval",
    "set_point": "number of the set-point prompted; 0: none",
    "theta_deg": "angle of the set-point from the top [deg]",
    "phi_deg": "angle of the set-point about the vertical, from +x [deg]",
    "level": "value of the varied parameter in the comparison interval; 0: none varied",
    "interval": "interval (1 or 2) with the comparison, or with `condition`; 0: single interval",
    "answer": "number answered; empty: the position was the answer",
    "correct": "1 the answer is right, 0 it is not, empty where there is no right answer",
    "x_m": "tool's magnet when answered, stator frame [m]",
    "y_m": "tool's magnet when answered, stator frame [m]",
    "z_m": "tool's magnet when answered, stator frame [m]",
    "distance_mm": "from the tool's magnet to where it is in contact at the set-point [mm]",
    "angle_deg": "between the directions of the tool's magnet and of the set-point [deg]",
    "seconds": "from prompt to answer [s]",
    "safety": "reasons for which the device tripped during the trial, separated by |",
    "recording": "file with the tool's course",
    "answered": "time of the answer (UTC)",
}

Columns = dict[str, NDArray[Any]]


def studied(engine: Engine, name: str | None = None) -> Study:
    """The study in the database; if there are several, the one called `name`. InputError if that does not tell."""
    with engine.connect() as connection:
        rows = connection.execute(select(studies.c.name, studies.c.text)).all()
    fitting = [row for row in rows if name is None or row.name == name]
    known = ", ".join(sorted(row.name for row in rows)) or "none"
    if not fitting:
        raise InputError(
            f"no study '{name}' in this database (known: {known})" if name else "no study was run here yet"
        )
    if len(fitting) > 1:
        raise InputError(
            f"several studies here (known: {known}): name one; versions of one study go into databases apart"
        )
    return study_of(fitting[0].text, f"'{fitting[0].name}' in the database")


def tidy(engine: Engine, study: Study) -> Columns:
    """All answered trials of `study`, practice included, by participant and trial: column → array of one length."""
    query = (
        select(trials, participants.c.code, sessions.c.simulated)
        .join(sessions, trials.c.session == sessions.c.id)
        .join(participants, sessions.c.participant == participants.c.id)
        .where(participants.c.study == study.digest)
        .order_by(participants.c.ordinal, trials.c.number)
    )
    places = {point.number: point for point in study.points}
    contact = study.loaded_device().contact_distance
    rows = []
    with engine.connect() as connection:
        for row in connection.execute(query):
            prompt = json.loads(row.prompt)
            point = places.get(prompt["set_point"])
            position = None if row.x is None else np.array([row.x, row.y, row.z])
            distance = angle = float("nan")
            if point is not None and position is not None:
                way = np.array(point.direction)
                distance = float(np.linalg.norm(position - contact * way)) * 1e3
                angle = angle_between(position, way)
            rows.append(
                (
                    row.code, row.simulated, row.session, row.number, prompt["phase"], prompt["condition"],
                    prompt["other"], prompt["set_point"], point.theta_deg if point else np.nan,
                    point.phi_deg if point else np.nan, prompt["level"], prompt["interval"], row.answer,
                    _correct(study, prompt, row.answer),
                    *((np.nan,) * 3 if position is None else position.tolist()),
                    distance, angle, row.seconds, "|".join(_reasons(row.safety)), row.recording or "", row.answered,
                )
            )  # fmt: skip
    if not rows:
        raise RecordingError(f"study '{study.name}' has no answered trials yet")
    return {name: _column(values) for name, values in zip(COLUMNS, zip(*rows, strict=True), strict=True)}


def replied(engine: Engine, study: Study) -> dict[str, dict[str, str]]:
    """Participant's code → question's name → what was answered in words."""
    query = (
        select(participants.c.code, replies.c.question, replies.c.reply)
        .join(sessions, replies.c.session == sessions.c.id)
        .join(participants, sessions.c.participant == participants.c.id)
        .where(participants.c.study == study.digest)
        .order_by(participants.c.ordinal, replies.c.id)
    )
    found: dict[str, dict[str, str]] = {}
    with engine.connect() as connection:
        for code, question, reply in connection.execute(query):
            found.setdefault(code, {})[question] = reply
    return found


def _correct(study: Study, prompt: dict[str, Any], answer: int | None) -> float:
    if study.procedure == "identification":
        return float(answer == prompt["set_point"])
    if study.procedure in ("staircase", "bayesian"):
        return float(answer == prompt["interval"])
    return float("nan")  # of constant stimuli either answer may be right: the curve tells; the rest has no right answer


def _reasons(stored: str) -> Iterable[str]:
    return (str(one.get("code", one)) for one in json.loads(stored))


def _column(values: tuple[Any, ...]) -> NDArray[Any]:
    if any(value is None for value in values):
        return np.array([np.nan if value is None else value for value in values], dtype=float)
    return np.array(values)
