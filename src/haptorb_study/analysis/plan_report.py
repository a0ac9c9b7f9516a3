"""Planned against actual analysis: participants, tests, smallest effects, and changes of the plan."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from haptorb_study.analysis.comparison import ConditionComparison
from haptorb_study.analysis_plan import CLAIMS, AnalysisPlan, PlannedTest
from haptorb_study.preregistration import Registration
from haptorb_study.statistics.significance import CORRECTIONS
from haptorb_study.study_file import Study

__all__ = ["PlanOutcome", "PlanReport", "SessionPlan", "find_plan", "report_plan"]


@dataclass(frozen=True)
class SessionPlan:
    """Analysis plan with which a session began."""

    started: str  #: UTC
    digest: str  #: of the plan in the study file at that time; empty: none
    finished: bool


@dataclass(frozen=True)
class PlanOutcome:
    """Result of a planned test."""

    test: PlannedTest
    found: ConditionComparison | None  #: None: fewer than two participants have a value
    significant: bool  #: corrected p below the plan's alpha

    @property
    def name(self) -> str:
        """Measure and conditions."""
        pair = self.test.between
        return f"{self.test.measure}: {f'{pair[0]} − {pair[1]}' if pair else CLAIMS.get(self.test.measure, '')}"

    @property
    def verdict(self) -> str:
        """Position of the 95 % interval relative to the smallest effect of interest."""
        least, found = self.test.smallest_effect, self.found
        if found is None or not math.isfinite(found.low + found.high):
            return "no data" if found is None else "no interval"
        if least is None:
            return "not stated"
        if -least < found.low and found.high < least:
            return "excluded"
        if found.low > least or found.high < -least:
            return "exceeded"
        return "in the interval"


@dataclass(frozen=True)
class PlanReport:
    """The plan that was in force before the first session, and its outcomes."""

    digest: str  #: empty: there was no plan
    since: str  #: start of the first session, which stored the plan (UTC)
    planned: int  #: planned participants; 0 without a plan
    finished: int  #: participants who finished
    alpha: float
    correction: str
    remarks: tuple[str, ...]  #: deviations from the plan and registration
    outcomes: tuple[PlanOutcome, ...]
    registered: str = ""  #: when the same plan was registered; empty: no registration, or of another plan

    @property
    def sentence(self) -> str:
        """Summary: which plan, stored when, and whether the planned number of participants was reached."""
        if not self.digest:
            return "no plan was stored before data existed: all tests are exploratory"
        reached = "reached" if self.finished >= self.planned else "NOT REACHED"
        tests = f"{len(self.outcomes)} planned test{'' if len(self.outcomes) == 1 else 's'}"
        return (
            f"plan {self.digest}, stored with the first session ({_minute(self.since)} UTC): {tests}, "
            f"α = {self.alpha:g}, {CORRECTIONS[self.correction]}; {self.finished} of {self.planned} planned "
            f"participants finished: {reached}{self.registered and f'; {self.registered}'}"
        )

    def numbers(self) -> dict[str, Any]:
        """As plain JSON types."""
        return {
            "digest": self.digest, "stored_at": self.since, "planned_participants": self.planned,
            "finished_participants": self.finished, "reached": self.finished >= self.planned,
            "alpha": self.alpha if self.digest else None,
            "correction": self.correction, "registered": self.registered or None, "remarks": list(self.remarks),
            "tests": [
                {
                    "measure": one.test.measure, "between": one.test.between and list(one.test.between),
                    "smallest_effect": one.test.smallest_effect, "significant": one.significant,
                    "verdict": one.verdict, "found": one.found and one.found.numbers(),
                }
                for one in self.outcomes
            ],
        }  # fmt: skip


def find_plan(study: Study, sessions: Sequence[SessionPlan]) -> AnalysisPlan | None:
    """The plan in force: that of `study` in the database, if the first of the `sessions` began with it."""
    if study.plan is None or not sessions:
        return study.plan
    return study.plan if min(sessions, key=lambda one: one.started).digest == study.plan.digest else None


def report_plan(
    study: Study,
    comparisons: Sequence[ConditionComparison],
    sessions: Sequence[SessionPlan],
    registration: Registration | None = None,
) -> PlanReport | None:
    """Report of the plan of `study` as stored in the database; None if there never was one.

    The plan with which the first session began is in force. Later and changed plans, and differences from the
    `registration`, are reported.
    """
    order = sorted(sessions, key=lambda one: one.started)
    first = order[0] if order else SessionPlan("", study.plan.digest if study.plan else "", False)
    held = study.plan.digest if study.plan is not None else ""
    others = [one for one in order if one.digest != first.digest]
    remarks = [] if registration is None else _compare_registration(study, first, registration)
    if held != first.digest:
        remarks.append(
            f"the plan in the database was CHANGED: it is now {held or 'missing'}; the first session began with "
            f"{first.digest or 'none'}"
        )
    if others:
        plans = ", ".join(dict.fromkeys(one.digest or "none" for one in others))
        count = f"{len(others)} session{'' if len(others) == 1 else 's'}"
        remarks.append(
            f"the plan was CHANGED after data existed: {count}, the first of them at "
            f"{_minute(others[0].started)} UTC, began with plan {plans}; this report uses that of the first session, "
            f"{first.digest or 'none'}"
        )
    plan = find_plan(study, sessions)
    if plan is None:
        return PlanReport("", first.started, 0, 0, math.nan, "", tuple(remarks), ()) if remarks else None
    outcomes = []
    for test in plan.tests:
        a, b = test.between or ("", "")
        found = next((x for x in comparisons if (x.what, x.a, x.b) == (test.measure, a, b) and x.planned), None)
        outcomes.append(PlanOutcome(test, found, found is not None and found.p_corrected < plan.alpha))
    finished = sum(one.finished for one in order)
    registered = ""
    if registration is not None and registration.plan == held:
        registered = f"registered {_minute(registration.written)} UTC"
    return PlanReport(
        held, first.started, plan.participants, finished, plan.alpha, plan.correction, tuple(remarks), tuple(outcomes),
        registered,
    )  # fmt: skip


def _compare_registration(study: Study, first: SessionPlan, registration: Registration) -> list[str]:
    """Mismatches between registration, study and first session."""
    remarks = []
    if registration.study != study.digest:
        remarks.append(
            f"the registration is of ANOTHER STUDY: {registration.name}, digest {registration.study}; this one has "
            f"{study.digest}"
        )
    elif registration.plan != first.digest:
        remarks.append(
            f"ANOTHER PLAN was registered: {registration.plan}; the first session began with {first.digest or 'none'}"
        )
    if first.started and registration.written > first.started:
        remarks.append(
            f"the registration is LATER than the data: written {_minute(registration.written)} UTC, first session "
            f"{_minute(first.started)} UTC"
        )
    return remarks


def _minute(time: str) -> str:
    """Date and time of day of a time stamp, to the minute."""
    return time[:16].replace("T", " ")
