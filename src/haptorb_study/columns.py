"""Answered trials as a tidy table, one row per trial: input of analysis and export."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import func, select
from sqlalchemy.engine import Engine

from haptorb.errors import InputError, RecordingError
from haptorb_study.data_kind import KINDS, Kind
from haptorb_study.database import contents, events, participants, replies, sessions, studies, trials
from haptorb_study.prompts import read_value
from haptorb_study.set_points import angles_between
from haptorb_study.study_file import Study, list_older, study_of

__all__ = [
    "COLUMNS",
    "Columns",
    "find_begun_version",
    "place_answers",
    "read_replies",
    "read_study",
    "select_kind",
    "tidy",
]


#: column → description; the data dictionary of every export
COLUMNS = {
    "participant": "pseudonymous code",
    "simulated": "whether the participant is simulated, not a person",
    "simulated_device": "whether on the SIMULATED DEVICE: nobody felt a force; empty: unknown, from older haptorb",
    "pilot": "whether these are pilot data: on the SIMULATED DEVICE, or begun as a pilot",
    "session": "number of the session in the database",
    "trial": "number of the trial in its session, from 1, as on the pages",
    "phase": "practice (left out of every analysis) or main",
    "condition": "condition rendered",
    "other": "forced choice: the condition in the other interval",
    "set_point": "number of the set-point prompted; 0: none",
    "theta_deg": "angle of the set-point from the top [deg]",
    "phi_deg": "angle of the set-point about the vertical, from +x [deg]",
    "level": "value of the varied parameter in the comparison interval; 0: none varied",
    "interval": "interval (1 or 2) with the comparison, or with `condition`; 0: single interval",
    "answer": "number answered; empty: the position was the answer",
    "correct": "1: correct answer, 0: wrong answer, empty: there is no correct answer",
    "x_m": "position of the tool's magnet at the answer, stator frame [m]",
    "y_m": "position of the tool's magnet at the answer, stator frame [m]",
    "z_m": "position of the tool's magnet at the answer, stator frame [m]",
    "distance_mm": "error: straight distance of the answered place from the set-point prompted; identification: "
    "between the contact positions of both set-points; localisation: of the tool's magnet; else empty [mm]",
    "angle_deg": "error: angle between the directions of the answered place and of the set-point prompted [deg]",
    "pen_distance_mm": "distance of the tool's magnet at the answer from its contact position at the set-point [mm]",
    "pen_angle_deg": "angle between the directions of the tool's magnet at the answer and of the set-point [deg]",
    "seconds": "time from prompt to answer [s]",
    "safety": "reasons for which the device tripped during the trial, separated by |",
    "repeats": "number of restarts of the trial: the device was off, or the experimenter repeated it",
    "recording": "file with the recording",
    "answered": "time of the answer (UTC)",
    "study": "name of the study",
}

Columns = dict[str, NDArray[Any]]


def read_study(engine: Engine, name: str | None = None) -> Study:
    """The study in the database; `name` chooses one of several. InputError if the choice is ambiguous."""
    with engine.connect() as connection:
        rows = connection.execute(select(studies.c.name, studies.c.text)).all()
    fitting = [row for row in rows if name is None or row.name == name]
    known = ", ".join(sorted(row.name for row in rows)) or "none"
    if not fitting:
        raise InputError(
            f"no study '{name}' in this database (known: {known})" if name else "this database holds no study yet"
        )
    if len(fitting) > 1:
        raise InputError(
            f"several studies in this database (known: {known}): name one; versions of a study need separate databases"
        )
    file = engine.url.database if engine.dialect.name == "sqlite" else None
    devices = Path(file).absolute().parent if file else Path()
    return study_of(fitting[0].text, f"'{fitting[0].name}' in the database", stored=True, devices=devices)


def find_begun_version(engine: Engine, study: Study) -> Study:
    """`study`, or the version of it that the database holds from an older haptorb (order, layout)."""
    older = list_older(study)
    if not older:
        return study
    with engine.connect() as connection:
        known = set(connection.execute(select(studies.c.digest)).scalars())
    return next((one for one in (study, *older) if one.digest in known), study)


def tidy(engine: Engine, study: Study) -> Columns:
    """All answered trials of `study` with practice, by participant and trial: column → array of equal length."""
    query = (
        select(trials, participants.c.code, sessions.c.simulated)
        .join(sessions, trials.c.session == sessions.c.id)
        .join(participants, sessions.c.participant == participants.c.id)
        .where(participants.c.study == study.digest)
        .order_by(participants.c.ordinal, trials.c.number)
    )
    counted = (
        select(events.c.session, events.c.trial, func.count())
        .where(events.c.kind == "repeat")
        .group_by(events.c.session, events.c.trial)
    )
    with engine.connect() as connection:
        rows = connection.execute(query).all()
        holds = connection.execute(select(contents.c.holds)).scalar()
        repeats = {(session, trial): count for session, trial, count in connection.execute(counted)}
    if not rows:
        raise RecordingError(f"study '{study.name}' has no answered trials yet")
    asked: dict[str, dict[str, Any]] = {}  # prompts recur: parse each once
    prompts = [asked.get(row.prompt) or asked.setdefault(row.prompt, json.loads(row.prompt)) for row in rows]
    reasons: dict[str, str] = {}
    for row in rows:
        if row.safety not in reasons:
            reasons[row.safety] = "|".join(_reasons(row.safety))
    answers = _column(tuple(read_value(row.answer) for row in rows))
    position = np.array([(row.x, row.y, row.z) for row in rows], dtype=float)  # None becomes NaN
    places = {p.number: p for p in study.points}
    number = np.array([prompt["set_point"] for prompt in prompts])
    there = [places.get(n) for n in number.tolist()]
    theta, phi = (
        np.array([np.nan if p is None else getattr(p, f"{name}_deg") for p in there]) for name in ("theta", "phi")
    )
    ways = np.array([(np.nan,) * 3 if p is None else p.direction for p in there])
    contact = study.load_device().contact_distance * ways
    answered = place_answers(study, answers, position)
    return {
        "participant": np.array([row.code for row in rows]),
        "simulated": np.array([row.simulated for row in rows]),
        "simulated_device": np.array(
            [None if row.driver is None else row.driver == "sim" for row in rows], dtype=object
        ),
        "pilot": np.array([not row.simulated and (holds == "pilot" or row.driver == "sim") for row in rows]),
        "session": np.array([row.session for row in rows]),
        "trial": np.array([row.number + 1 for row in rows]),
        **{name: np.array([prompt[name] for prompt in prompts]) for name in ("phase", "condition", "other")},
        "set_point": number,
        "theta_deg": theta,
        "phi_deg": phi,
        "level": np.array([prompt["level"] for prompt in prompts], dtype=float),
        "interval": np.array([prompt["interval"] for prompt in prompts]),
        "answer": answers,
        "correct": _correct(study, number, np.array([prompt["interval"] for prompt in prompts]), answers),
        "x_m": position[:, 0],
        "y_m": position[:, 1],
        "z_m": position[:, 2],
        "distance_mm": 1e3 * np.linalg.norm(answered - contact, axis=1),
        "angle_deg": angles_between(answered, ways),
        "pen_distance_mm": 1e3 * np.linalg.norm(position - contact, axis=1),
        "pen_angle_deg": angles_between(position, ways),
        "seconds": np.array([row.seconds for row in rows]),
        "safety": np.array([reasons[row.safety] for row in rows]),
        "repeats": np.array([repeats.get((row.session, row.number), 0) for row in rows]),
        "recording": np.array([row.recording or "" for row in rows]),
        "answered": np.array([row.answered for row in rows]),
        "study": np.array([study.name for _ in rows]),
    }


def select_kind(columns: Columns, kind: Kind | None = None) -> tuple[Columns, str]:
    """Trials of one `kind` of data only, and a description of what is left out; RecordingError if there are none.

    kind   None: real; without real trials pilot, without these simulated
    """
    simulated, pilot = columns["simulated"].astype(bool), columns["pilot"].astype(bool)
    of: dict[Kind, NDArray[Any]] = {"real": ~simulated & ~pilot, "pilot": pilot & ~simulated, "simulated": simulated}
    wanted = next(one for one in KINDS if of[one].any()) if kind is None else kind
    if not of[wanted].any():
        raise RecordingError(f"this database holds no {wanted} trials")
    left = [
        f"{count} {one} trials ({len(set(columns['participant'][of[one]].tolist()))} participants; --data {one})"
        for one in KINDS
        if one != wanted and (count := int(of[one].sum()))
    ]
    return {name: values[of[wanted]] for name, values in columns.items()}, ", ".join(left)


def read_replies(engine: Engine, study: Study) -> dict[str, dict[str, str]]:
    """Participant's code → question's name → the answer as text."""
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


def _correct(study: Study, number: NDArray[Any], interval: NDArray[Any], answers: NDArray[Any]) -> NDArray[Any]:
    right = {"identification": number, "staircase": interval, "bayesian": interval}.get(study.procedure)
    if right is None:
        # With constant stimuli either answer may be correct; of the others only some procedures have a correct answer.
        return np.full(len(answers), np.nan)
    found: NDArray[Any] = np.equal(answers, right).astype(float)
    return found


def place_answers(study: Study, answers: NDArray[Any], position: NDArray[Any]) -> NDArray[Any]:
    """(trials, 3) answered positions [m], whose distance from the prompted set-point is the error.

    In an identification the contact position at the set-point named, in a localisation the position of the tool; NaN
    where the answer is not a place.
    """
    if study.procedure == "localisation":
        return position
    known = {p.number: p.direction for p in study.points} if study.procedure == "identification" else {}
    ways = [known.get(int(n), (np.nan,) * 3) if np.isfinite(n) else (np.nan,) * 3 for n in answers.astype(float)]
    found: NDArray[Any] = study.load_device().contact_distance * np.array(ways, dtype=float).reshape(-1, 3)
    return found


def _reasons(stored: str) -> Iterable[str]:
    return (str(one.get("code", one)) for one in json.loads(stored))


def _column(values: tuple[Any, ...]) -> NDArray[Any]:
    if any(value is None for value in values):
        return np.array([np.nan if value is None else value for value in values], dtype=float)
    return np.array(values)
