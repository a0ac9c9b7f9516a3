"""Analysis of a study: all tables, fits and tests of its procedure, from the stored answers."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from sqlalchemy import select
from sqlalchemy.engine import Engine

from haptorb.errors import InputError
from haptorb.notebook import NotebookReport
from haptorb_study.analysis.answer_directions import SPHERICAL
from haptorb_study.analysis.comparison import (
    compare_conditions,
    count_choices,
    rate_condition,
)
from haptorb_study.analysis.condition_means import average_conditions
from haptorb_study.analysis.confusion import count_answers, find_arrows
from haptorb_study.analysis.curves import fit_curves
from haptorb_study.analysis.error_by_latitude import measure_rings
from haptorb_study.analysis.localisation import localise
from haptorb_study.analysis.magnitude import estimate_magnitudes
from haptorb_study.analysis.plan_report import SessionPlan, find_plan, report_plan
from haptorb_study.analysis.response_times import find_response_times
from haptorb_study.analysis.results import StudyResults
from haptorb_study.analysis.tables import print_summary
from haptorb_study.analysis.tracks import fit_tracks
from haptorb_study.columns import Columns, read_study, select_kind, tidy
from haptorb_study.data_kind import Kind
from haptorb_study.database import database, participants, sessions
from haptorb_study.incidents import list_incidents
from haptorb_study.preregistration import Registration
from haptorb_study.study_file import Study

__all__ = ["Analysis", "analyse", "analysis_of", "read_plans"]


_RECORDING_COLUMNS = ("participant", "trial", "safety", "recording")


@dataclass(frozen=True)
class Analysis(StudyResults, NotebookReport):
    """All results of a study; those that do not apply to its procedure are empty.

    `analysis_of` makes one. In a notebook it shows the summary that `haptorb study analyse` prints.

    Parameters
    ----------
    study : Study
        The study.
    participants : int
        Number of participants.
    trials : int
        Number of answered trials, without practice.
    practice : int
        Number of practice trials.
    simulated : int
        Number of simulated participants.
    trips : int
        Number of trials in which the device tripped.
    repeated : int
        Number of trials that were restarted before they were answered.
    on_simulated_device : int
        Number of trials of real participants on a simulated device, without a rendered force.
    on_unknown_device : int
        Number of trials of real participants stored by an older version without the device.
    confusion : Confusion, optional
        Answers by set-point.
    arrows : tuple of Arrow
        Most frequent wrong answers.
    means : tuple of ConditionMean
        Error and accuracy by condition.
    rings : tuple of LatitudeError
        Error by latitude.
    curves : dict
        Condition → psychometric functions.
    tracks : dict
        Condition → tracks of an adaptive procedure.
    thresholds : dict
        Condition → participant → threshold.
    scores : dict
        Condition → mean rating.
    chosen : dict
        Pair of conditions → times chosen, number of choices, and 95 % interval of the share.
    comparisons : tuple of ConditionComparison
        Conditions compared.
    localisation : Localisation, optional
        Errors on the sphere and information transferred.
    plan : PlanReport, optional
        Result of the planned tests.
    magnitudes : tuple of MagnitudeScale
        Estimated magnitudes by condition.
    times : tuple of ResponseTime
        Response times by condition [s].
    notes : tuple of str
        What the data do not determine.
    left_out : str
        Data of another kind (real, pilot, simulated) in the same database.
    incidents : tuple of Incident
        Stops, repeats, safety events, and ends before the last trial.
    recorded : tuple
        Participant, trial, safety, and part of a recording, of each recorded trial.
    """

    def show(self, console: Console) -> None:
        """Print all tables and notes on `console`."""
        print_summary(self, console)


def analyse(
    study: Study, columns: Columns, progress: Callable[[int, int], None] | None = None, *,
    plans: Sequence[SessionPlan] = (), registration: Registration | None = None,
) -> Analysis:  # fmt: skip
    """Analyse the tidy `columns` of `study`; `progress` receives (participants fitted, participants in all).

    `plans` are those with which the sessions began, `registration` is the plan that was registered.
    """
    practice = columns["phase"] == "practice"
    main = {name: values[~practice] for name, values in columns.items()}
    if not len(main["trial"]):
        raise InputError(f"study '{study.name}' has only practice trials so far: there is nothing to analyse")
    people, index = np.unique(main["participant"], return_inverse=True)
    simulated = {code for code, flag in zip(main["participant"], main["simulated"], strict=True) if flag}
    parts: dict[str, Any] = {}
    if study.procedure == "identification":
        parts["confusion"] = confusion = count_answers(study, main, index, len(people))
        parts["arrows"] = find_arrows(confusion)
    parts["means"] = average_conditions(study, main, people.tolist())
    if study.procedure in SPHERICAL and np.isfinite(main["distance_mm"]).any():
        parts["rings"] = measure_rings(main, index, len(people))
    if main.keys() >= set(_RECORDING_COLUMNS):  # external answers have no recordings
        parts["recorded"] = tuple(
            (str(code), int(trial), str(safety), str(part))
            for code, trial, safety, part in zip(*(main[n] for n in _RECORDING_COLUMNS), strict=True) if part
        )  # fmt: skip
    notes = _list_empty_conditions(study, main)
    if study.procedure == "constant":
        parts["curves"], more = fit_curves(main, progress)
        notes += more
    if study.procedure in ("staircase", "bayesian"):
        parts["tracks"] = tracks = fit_tracks(study, main, progress)
        parts["thresholds"] = {
            name: {code: fit.threshold for code, fit in one.people.items() if fit.complete}
            for name, one in tracks.items()
        }
    if study.procedure == "rating":
        parts["scores"] = {
            str(n): rate_condition(main, str(n), index, len(people)) for n in dict.fromkeys(main["condition"].tolist())
        }
    if study.procedure == "forced-choice":
        parts["chosen"] = count_choices(main)
    if study.procedure in SPHERICAL:
        parts["localisation"] = localise(study, main, people.tolist())
    parts["comparisons"] = compare_conditions(study, main, people, parts.get("thresholds"), find_plan(study, plans))
    parts["plan"] = report_plan(study, parts["comparisons"], plans, registration)
    device = main["simulated_device"][~main["simulated"].astype(bool)].tolist()
    return Analysis(
        study, len(people), len(main["trial"]), int(practice.sum()), len(simulated),
        int(np.count_nonzero(main["safety"] != "")), int(np.count_nonzero(main["repeats"])), device.count(True),
        device.count(None), magnitudes=estimate_magnitudes(study, main), times=find_response_times(study, main),
        notes=tuple(notes), **parts,
    )  # fmt: skip


def _list_empty_conditions(study: Study, main: Columns) -> list[str]:
    """Notes on conditions without answers; a forced choice compares every condition with the others, so it has none."""
    if study.procedure == "forced-choice":
        return []
    met = set(main["condition"].tolist())
    return [f"condition '{one.name}': no answers yet" for one in study.conditions if one.name not in met]


def analysis_of(
    place: str | Path, name: str | None = None, progress: Callable[[int, int], None] | None = None, *,
    registration: Registration | None = None, data: Kind | None = None,
) -> Analysis:  # fmt: skip
    """Analyse a study from its database.

    Parameters
    ----------
    place : str or Path
        SQLite file, or address of a PostgreSQL database.
    name : str, optional
        Name of the study; None: the only one in the database.
    progress : callable, optional
        Receives (participants fitted, participants in all) while psychometric functions are fitted.
    registration : Registration, optional
        Registered plan, with which the study's own plan is compared.
    data : str, optional
        Kind of data: "real", "pilot" or "simulated"; None: real data, unless there are none. Kinds are never
        mixed in a result.

    Returns
    -------
    Analysis
        Tables, fits and tests of the study.

    Raises
    ------
    RecordingError
        If the database does not exist, or cannot be read.
    InputError
        If it has no study of this name.
    """
    engine = database(place, make=False)
    study = read_study(engine, name)
    plans = read_plans(engine, study)
    columns, left_out = select_kind(tidy(engine, study), data)
    found = analyse(study, columns, progress, plans=plans, registration=registration)
    incidents = list_incidents(engine, study, set(columns["participant"].tolist()))
    return replace(found, left_out=left_out, incidents=incidents)


def read_plans(engine: Engine, study: Study) -> tuple[SessionPlan, ...]:
    """Analysis plans with which the sessions of `study` began."""
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
