"""Tests between conditions, and of measures against zero, with effect sizes and correction for multiple tests."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from haptorb_study.analysis.measures import PersonMeasures, PersonValues, Thresholds
from haptorb_study.analysis_plan import CLAIMS, MEASURES, AnalysisPlan, unit_of
from haptorb_study.columns import Columns
from haptorb_study.json_values import to_json
from haptorb_study.statistics.effect_size import EffectSize, effect_size
from haptorb_study.statistics.intervals import mean_interval, share_interval, wilson
from haptorb_study.statistics.significance import PairTest, compute_p, correct_p
from haptorb_study.study_file import Study

__all__ = [
    "ConditionComparison",
    "RatingMean",
    "compare_conditions",
    "compare_values",
    "count_choices",
    "rate_condition",
]


_Question = tuple[str, tuple[str, str] | None]  # measure and pair of conditions; None: against zero


@dataclass(frozen=True)
class ConditionComparison:
    """Test over participants of the difference a − b of two conditions, or of a measure against zero (a, b empty)."""

    what: str
    unit: str  #: of the difference; empty: dimensionless
    a: str
    b: str
    difference: float  #: mean over participants
    low: float  #: 95 % confidence limits of the mean difference (Student)
    high: float
    people: int
    p: float  #: two-sided
    p_corrected: float = math.nan  #: corrected within the family of planned, or of exploratory tests
    planned: bool = False
    test: PairTest = "t"
    effect: EffectSize | None = None

    @property
    def name(self) -> str:
        """Label of the difference, or of the hypothesis about a single measure."""
        return f"{self.a} − {self.b}" if self.a else CLAIMS.get(self.what, self.what)

    def numbers(self) -> dict[str, Any]:
        """As plain JSON types; NaN and infinity become None."""
        found = {key: value for key, value in vars(self).items() if key != "effect"}
        if self.effect is not None:
            found |= asdict(self.effect)
        return {key: to_json(value) for key, value in found.items()}


@dataclass(frozen=True)
class RatingMean:
    """Mean rating of one condition."""

    mean: float
    sd: float
    ratings: int
    low: float  #: 95 % confidence limits of the mean over participants
    high: float


def rate_condition(main: Columns, name: str, index: np.ndarray[Any, Any], people: int) -> RatingMean:
    """Mean rating of condition `name`; `index` (trials,) is the participant of each trial, of `people` participants."""
    here = main["condition"] == name
    given = main["answer"][here].astype(float)
    with np.errstate(invalid="ignore", divide="ignore"):
        own = np.bincount(index[here], given, people) / np.bincount(index[here], minlength=people)
    low, high = mean_interval(own)
    if low == high:  # identical means of whole numbers do not measure the spread between participants
        low = high = np.array(np.nan)
    sd = float(given.std(ddof=1)) if len(given) > 1 else math.nan
    return RatingMean(float(given.mean()), sd, len(given), float(low), float(high))


def count_choices(main: Columns) -> dict[tuple[str, str], tuple[int, int, tuple[float, float]]]:
    """Pair of conditions → (times the first was chosen, number of choices, interval of its share over participants).

    With one participant it is Wilson's interval over the choices.
    """
    found = {}
    for a, b in dict.fromkeys(zip(main["condition"].tolist(), main["other"].tolist(), strict=True)):
        here = (main["condition"] == a) & (main["other"] == b)
        chosen = main["answer"][here] == main["interval"][here]
        _, person = np.unique(main["participant"][here], return_inverse=True)
        k, n, of = int(chosen.sum()), int(here.sum()), np.bincount(person)
        found[(a, b)] = (k, n, share_interval(np.bincount(person, chosen), of) if len(of) > 1 else wilson(k, n))
    return found


def compare_conditions(
    study: Study,
    main: Columns,
    people: Sequence[str] | np.ndarray[Any, Any],
    thresholds: Thresholds | None = None,
    plan: AnalysisPlan | None = None,
) -> tuple[ConditionComparison, ...]:
    """All tests of `study` for which at least two of `people` have a value in both conditions.

    First the tests of `plan`, the one in force, in its order and direction; then tests over all conditions; then pairs
    of conditions. p is corrected within each of the three, by the plan's correction, Holm's without a plan.
    `main` are the columns without practice.
    """
    names = [condition.name for condition in study.conditions]
    known = MEASURES.get(study.procedure, ())
    planned: list[_Question] = [(one.measure, one.between) for one in (plan.tests if plan else ())]
    claims: list[_Question] = [(measure, None) for measure in known if measure in CLAIMS]
    pairs: list[_Question] = [
        (measure, pair) for measure in known if measure not in CLAIMS for pair in combinations(names, 2)
    ]
    test, correction = (plan.test, plan.correction) if plan else ("t", "holm")
    measures = PersonMeasures(study, main, [str(code) for code in people], thresholds)
    found = []
    for family in (planned, claims, pairs):
        rows = []
        for measure, between in family:
            if family is not planned and plan and plan.find(measure, *(between or ("", ""))):
                continue
            values = measures.compare(measure, between)
            row = compare_values(measure, unit_of(measure, study.level_unit), between, values, test)
            if row is not None:
                rows.append(replace(row, planned=family is planned))
        corrected = correct_p([row.p for row in rows], correction)
        found += [replace(row, p_corrected=p) for row, p in zip(rows, corrected, strict=True)]
    return tuple(found)


def compare_values(
    measure: str, unit: str, between: tuple[str, str] | None, values: PersonValues, test: PairTest = "t"
) -> ConditionComparison | None:
    """The test of participants' `values`; None with fewer than two participants."""
    d = values.differences
    if len(d) < 2:
        return None
    a, b = between or ("", "")
    low, high = mean_interval(d)
    return ConditionComparison(
        measure, unit, a, b, float(d.mean()), float(low), float(high), len(d), float(compute_p(d, test)), test=test,
        effect=effect_size(d, values.spread),
    )  # fmt: skip
