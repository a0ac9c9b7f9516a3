"""What the trials say: who was right where, where wrong answers went, how far off, and the curves and thresholds.

Practice is left out. Averages over participants weigh every person alike; intervals are 95 %, over the people drawn.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache
from itertools import combinations
from pathlib import Path
from typing import Any, ClassVar, final

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import select
from sqlalchemy.engine import Engine

from haptorb.arrays import Array
from haptorb.errors import InputError
from haptorb.notebook import NotebookReport
from haptorb.terminal import Column, TextTable
from haptorb_study.columns import Columns, read_study, select_kind, tidy
from haptorb_study.copies import Kind
from haptorb_study.database import database, participants, sessions
from haptorb_study.incidents import Incident, list_incidents
from haptorb_study.procedures import Answer, Bayesian, Procedure, Staircase
from haptorb_study.psychometric import (
    REVERSED,
    LevelCounts,
    NormalEffect,
    PersonFit,
    Population,
    PsychometricCurve,
    PsychometricGrid,
    SlopeLikelihood,
    central_interval,
    count_by_level,
    find_median,
    fit_group,
    fit_normal_effect,
    fit_person,
    psychometric_fit,
)
from haptorb_study.registration import Registration
from haptorb_study.statistics import (
    DirectionSpread,
    EffectSize,
    Information,
    PairTest,
    PowerLaw,
    binomial_tail,
    correct_p,
    decide_p,
    effect_size,
    error_vectors,
    find_away_axes,
    fit_power_law,
    local_axes,
    mean_interval,
    share_interval,
    summarize_directions,
    transfer_information,
    wilson,
)
from haptorb_study.study_file import CLAIMS, MEASURES, AnalysisPlan, Levels, PlannedTest, Study, directions, unit_of

__all__ = [
    "ERROR_MEANING",
    "JND",
    "SPHERICAL",
    "Analysis",
    "Arrow",
    "ConditionComparison",
    "ConditionCurves",
    "ConditionMean",
    "ConditionTracks",
    "Confusion",
    "ErrorAxis",
    "LatitudeError",
    "Localisation",
    "MagnitudeScale",
    "PersonMean",
    "PersonMeasures",
    "PersonValues",
    "PlaceError",
    "PlanOutcome",
    "PlanReport",
    "RatingMean",
    "ResponseTime",
    "SessionPlan",
    "TrackFit",
    "analyse",
    "analysis_of",
    "answer_directions",
    "answer_numbers",
    "average_conditions",
    "compare_conditions",
    "count_answers",
    "count_choices",
    "decide",
    "describe_accuracy",
    "effect_numbers",
    "estimate_magnitudes",
    "find_arrows",
    "find_plan",
    "find_response_times",
    "find_unbounded",
    "fit_curves",
    "fit_slope",
    "follow_tracks",
    "format_p",
    "format_percent",
    "format_range",
    "format_value",
    "index_set_points",
    "list_condition_means",
    "list_magnitudes",
    "list_response_times",
    "list_thresholds",
    "list_wrong_answers",
    "localise",
    "make_condition_table",
    "make_magnitude_tables",
    "make_response_table",
    "measure_rings",
    "measure_tool_rings",
    "measure_upward",
    "name_error",
    "rate_condition",
    "read_plans",
    "report_plan",
]


# --------------------------------------------------------------------------------------------------
# Numbers and intervals of an analysis as people read them; what is not a number is a dash, never "nan".


def format_value(value: float, form: str, scale: float = 1.0) -> str:
    """`scale` times `value`, or a dash.

    >>> format_value(0.25, ".1f", 100), format_value(float("nan"), ".1f")
    ('25.0', '–')
    """
    return f"{scale * value:{form}}" if math.isfinite(value) else "–"


def format_range(limits: tuple[float, float], form: str, scale: float = 1.0) -> str:
    """Both ends; the one that exists, of an interval with an open end; a dash where none is known.

    >>> format_range((0.25, 0.5), ".1f", 100), format_range((float("nan"), float("nan")), ".1f")
    ('25.0 to 50.0', '–')
    >>> format_range((0.25, math.inf), ".2f"), format_range((-math.inf, 0.5), ".2f")
    ('≥ 0.25', '≤ 0.50')
    >>> format_range((-math.inf, math.inf), ".2f")
    'no limit'
    """
    low, high = limits
    if math.isnan(low) or math.isnan(high):
        return "–"
    if math.isinf(low) or math.isinf(high):
        one = f"≤ {scale * high:{form}}" if math.isfinite(high) else f"≥ {scale * low:{form}}"
        return one if math.isfinite(low) or math.isfinite(high) else "no limit"
    return f"{scale * low:{form}} to {scale * high:{form}}"


def format_p(p: float) -> str:
    """ "p = ..." or, where a computer's numbers end, "p < ...".

    >>> format_p(0.0123), format_p(0.0)
    ('p = 0.012', 'p < 1e-300')
    """
    return "p < 1e-300" if p < 1e-300 else f"p = {p:.2g}"


def format_percent(share: float) -> str:
    """As a percentage with its sign.

    >>> format_percent(0.125), format_percent(float("nan"))
    ('12.5 %', '–')
    """
    return "–" if not math.isfinite(share) else f"{100 * share:.1f} %"


# --------------------------------------------------------------------------------------------------
# Identification: who was right where, and where wrong answers went.


WANDERED = 1 / 3  #: an arrow is drawn where this share of the wrong answers, or more, went to one set-point


@dataclass(frozen=True)
class Confusion:
    """Answers (columns) to prompts (rows), averaged over participants; all arrays by set-point in the study's order."""

    numbers: tuple[int, ...]
    counts: Array  #: (n, n) answers, pooled
    matrix: Array  #: (n, n) share of answers, averaged over participants
    right_95: Array  #: (n, 2) of the share of right answers to each set-point, over people; NaN with one person
    accuracy: float  #: averaged over participants
    accuracy_95: tuple[float, float]  #: over people; NaN with one person
    single_95: tuple[float, float]  #: with one person alone: Wilson's, of this person's trials; else NaN
    chance: float
    p_chance: float  #: of so many right answers by guessing


@dataclass(frozen=True)
class Arrow:
    """A third or more of the wrong answers to `of` went to `to`."""

    of: int
    to: int
    wrong: int  #: wrong answers to `of`
    share: float


def count_answers(study: Study, main: Columns, index: np.ndarray[Any, Any], people: int) -> Confusion:
    """Who answered what; `index` (trials,) of each trial's participant, of so many `people`."""
    numbers = tuple(point.number for point in study.points)
    place = {number: n for n, number in enumerate(numbers)}
    asked = np.array([place[int(n)] for n in main["set_point"]])
    answered = np.array([place[int(n)] for n in main["answer"]])
    each = np.zeros((people, len(numbers), len(numbers)))
    np.add.at(each, (index, asked, answered), 1.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        shares = each / each.sum(axis=2, keepdims=True)
    finite = np.isfinite(shares)
    matrix = np.where(finite, shares, 0).sum(axis=0) / np.maximum(finite.sum(axis=0), 1)
    matrix[~finite.any(axis=0)] = np.nan
    right = asked == answered
    shown, named = each.sum(axis=2), np.einsum("pii->pi", each)
    limits = np.array([share_interval(named[:, n], shown[:, n]) for n in range(len(numbers))])
    total, good = np.bincount(index, minlength=people), np.bincount(index, right, people)
    k, n = int(right.sum()), len(right)
    chance = 1 / len(numbers)
    single = wilson(k, n) if people == 1 else (math.nan, math.nan)
    return Confusion(
        numbers, each.sum(axis=0), matrix, limits, float((good / total).mean()), share_interval(good, total), single,
        chance, binomial_tail(k, n, chance),
    )  # fmt: skip


def find_arrows(confusion: Confusion) -> tuple[Arrow, ...]:
    """Where a third or more of the wrong answers to a set-point went."""
    wrong = confusion.counts - np.diag(np.diag(confusion.counts))
    found = []
    for i, row in enumerate(wrong):
        total = row.sum()
        for j in np.flatnonzero(row):
            if row[j] / total >= WANDERED - 1e-12:
                of, to = confusion.numbers[i], confusion.numbers[int(j)]
                found.append(Arrow(of, to, int(total), float(row[j] / total)))
    return tuple(found)


def list_wrong_answers(arrows: Sequence[Arrow], number: int) -> str:
    """Set-points that a third or more of the wrong answers to set-point `number` went to, and how many did."""
    return ", ".join(f"{one.to} ({round(one.share * one.wrong)} of {one.wrong})" for one in arrows if one.of == number)


def describe_accuracy(confusion: Confusion) -> str:
    """Which interval the share of right answers has, and the interval, for people."""
    over_people = format_range(confusion.accuracy_95, ".1f", 100)
    if over_people != "–":
        return f"95 % over participants {over_people} %"
    single = format_range(confusion.single_95, ".1f", 100)
    return f"one participant: Wilson over this participant's trials {single} %; no interval over people"


# --------------------------------------------------------------------------------------------------
# Where people were asked to go, and where their answers lie, as directions from the centre of the dome.


SPHERICAL = ("identification", "localisation")  #: procedures whose answers are places on the dome


def answer_directions(study: Study, main: Columns, rows: Any) -> tuple[Array, Array]:
    """(asked, answered): (rows, 3) unit vectors of the trials `rows` (index); NaN where an answer has no direction.

    Of an identification the answer is the set-point that was named, of a localisation the place that was reached.
    """
    ways = directions(study.points)
    asked = ways[index_set_points(study, main["set_point"][rows])]
    if study.procedure == "identification":
        return asked, ways[index_set_points(study, main["answer"][rows])]
    place = np.stack([main[f"{axis}_m"][rows] for axis in "xyz"], axis=-1).astype(float)
    with np.errstate(invalid="ignore", divide="ignore"):
        return asked, place / np.linalg.norm(place, axis=-1, keepdims=True)


def answer_numbers(study: Study, main: Columns) -> NDArray[Any]:
    """(trials,) number of the set-point that was named, or of the one nearest to the place that was reached."""
    if study.procedure == "identification":
        return main["answer"]
    ways = directions(study.points)
    place = np.stack([main[f"{axis}_m"] for axis in "xyz"], axis=-1).astype(float)
    numbers = np.array([point.number for point in study.points])
    found: NDArray[Any] = numbers[np.argmax(np.nan_to_num(place) @ ways.T, axis=-1)]
    return found


def find_unbounded(study: Study, main: Columns, rows: Any) -> NDArray[np.bool_]:
    """(rows,) whether an answer could lie above and below what was asked: not at the top, where no meridian is.

    The numbers of an identification end with its outermost ring: below it nothing can be answered.
    """
    theta = main["theta_deg"][rows]
    known: NDArray[np.bool_] = (theta > 1e-9) & (theta < 180 - 1e-9)
    if study.procedure == "identification":
        known &= theta < max(point.theta_deg for point in study.points) - 1e-9
    return known


def index_set_points(study: Study, numbers: NDArray[Any]) -> NDArray[np.intp]:
    """(n,) places of set-points with these `numbers` among those of the study."""
    known = np.array([point.number for point in study.points])
    order = np.argsort(known)
    found: NDArray[np.intp] = order[np.searchsorted(known[order], numbers.astype(int))]
    return found


# --------------------------------------------------------------------------------------------------
# One number per person: what conditions are compared by, in the analysis and in the power of a study alike.


_COLUMN = {"error": "distance_mm", "accuracy": "correct", "rating": "answer"}
Thresholds = Mapping[str, Mapping[str, float]]  #: condition → participant's code → threshold


@dataclass(frozen=True)
class PersonValues:
    """A measure of people who have it in both conditions; `b` is zero where there is no second condition."""

    a: Array  #: (people,)
    b: Array  #: (people,)
    paired: bool = True  #: whether both are measurements whose spread over people means something

    @property
    def differences(self) -> Array:
        """(people,) a − b."""
        difference: Array = self.a - self.b
        return difference

    @property
    def spread(self) -> float | None:
        """Root mean variance of both conditions; None with fewer than two people or without a second condition."""
        if len(self.a) < 2 or not self.paired:
            return None
        return float(np.sqrt((self.a.var(ddof=1) + self.b.var(ddof=1)) / 2))


@final
class PersonMeasures:
    """What each of `people` has, by measure and condition; every number is computed once, however often it is compared.

    `main` are the columns without practice, `thresholds` those of an adaptive procedure.
    """

    def __init__(
        self, study: Study, main: Columns, people: Sequence[str], thresholds: Thresholds | None = None
    ) -> None:
        self._study, self._main, self._thresholds = study, main, thresholds
        self._rows = {code: np.flatnonzero(main["participant"] == code) for code in people}
        self._values: dict[tuple[str, str], list[float]] = {}

    def compare(self, measure: str, between: tuple[str, str] | None) -> PersonValues:
        """`measure` in both conditions of `between`; None: over all conditions, against zero.

        People without a value in either are left out: a condition without data gives no people.
        """
        if measure == "choice" and between is not None:
            one = [_share_chosen(self._main, rows, *between) for rows in self._rows.values()]
        else:
            one = self._measure_all(measure, between[0] if between else "")
        paired = between is not None and measure != "choice"
        two = self._measure_all(measure, between[1]) if between and paired else [0.5 if between else 0.0] * len(one)
        values = np.array([one, two], dtype=float)
        values = values[:, np.isfinite(values).all(axis=0)]
        # How much people's magnitudes differ is how much their scales do.
        return PersonValues(values[0], values[1], paired and measure != "magnitude")

    def values_in(self, measure: str, condition: str) -> Array:
        """(people,) `measure` of those who have it in `condition`."""
        values = np.array(self._measure_all(measure, condition), dtype=float)
        known: Array = values[np.isfinite(values)]
        return known

    def _measure_all(self, measure: str, condition: str) -> list[float]:
        """Of everybody; "": over all conditions."""
        known = (measure, condition)
        if known not in self._values:
            names = self._main["condition"]
            self._values[known] = [
                _measure(
                    self._study, self._main, rows[names[rows] == condition] if condition else rows, code, measure,
                    condition, self._thresholds,
                )
                for code, rows in self._rows.items()
            ]  # fmt: skip
        return self._values[known]


def list_thresholds(procedures: Mapping[str, Procedure]) -> dict[str, dict[str, float]]:
    """Condition → participant's code → threshold, of adaptive `procedures` by code; an unfinished track has none."""
    found: dict[str, dict[str, float]] = {}
    for code, procedure in procedures.items():
        for part in getattr(procedure, "parts", ()):
            threshold = getattr(part, "threshold", None)
            if threshold is not None and part.prompt is None:
                found.setdefault(part.condition, {})[code] = float(threshold)
    return found


def measure_upward(study: Study, main: Columns, rows: Any) -> Array:
    """(rows,) errors towards the top [deg] of the trials `rows` (index) where they may point both ways; else NaN.

    The top has no meridian. A numbered answer cannot go beyond the outermost ring, so there all errors would be upward:
    only set-points with others above and below count. A place that was reached counts wherever it is asked.
    """
    asked, answered = answer_directions(study, main, rows)
    up, _ = local_axes(asked)
    along: Array = np.where(
        find_unbounded(study, main, rows), np.sum(error_vectors(asked, answered) * up, axis=-1), np.nan
    )
    return along


def fit_slope(theta: Array, error: Array) -> float:
    """Least-squares slope of `error` over `theta`, both (n,); NaN with fewer than two different θ."""
    known = np.isfinite(theta) & np.isfinite(error)
    x, y = theta[known], error[known]
    if len(x) < 2 or np.ptp(x) == 0.0:
        return math.nan
    x = x - x.mean()
    return float(x @ y / (x @ x))


def _measure(
    study: Study, main: Columns, rows: Any, code: str, measure: str, condition: str, thresholds: Thresholds | None
) -> float:
    """Of one person, whose trials in the condition are `rows`; NaN where they tell nothing."""
    if thresholds is not None and measure == "threshold":
        return float(thresholds.get(condition, {}).get(code, math.nan))
    if not len(rows):
        return math.nan
    if measure in ("threshold", "midpoint"):
        return _fit_person(main, rows, measure)
    if measure in ("magnitude", "exponent") and study.levels is not None:
        law = fit_power_law(main["level"][rows], main["answer"][rows].astype(float), study.levels.reference)
        return law.exponent if measure == "exponent" else law.log_at_reference / math.log(10)
    if measure == "error-slope":
        return fit_slope(main["theta_deg"][rows], main["distance_mm"][rows].astype(float))
    values = (
        measure_upward(study, main, rows) if measure == "upward-bias" else main[_COLUMN[measure]][rows].astype(float)
    )
    values = values[np.isfinite(values)]
    return float(values.mean()) if len(values) else math.nan


def _fit_person(main: Columns, rows: Any, measure: str) -> float:
    """Of constant stimuli: midpoint, or difference noticed in 75 % of the pairs; NaN where one level is known."""
    levels, which = np.unique(main["level"][rows], return_inverse=True)
    if len(levels) < 2:
        return math.nan
    stronger = main["answer"][rows] == main["interval"][rows]
    counts = np.bincount(which, minlength=len(levels))
    fit = _fit_counts(*(tuple(x.tolist()) for x in (levels, np.bincount(which, stronger, len(levels)), counts)))
    return fit.middle if measure == "midpoint" else 0.6745 * fit.spread


@lru_cache(4096)  # several measures and pairs of conditions ask for the same fits
def _fit_counts(levels: tuple[float, ...], yes: tuple[float, ...], of: tuple[float, ...]) -> PsychometricCurve:
    return psychometric_fit(levels, yes, of)


def _share_chosen(main: Columns, rows: Any, a: str, b: str) -> float:
    """Share of the choices between `a` and `b` in which `a` was chosen."""
    one, other = main["condition"][rows], main["other"][rows]
    first, second = (one == a) & (other == b), (one == b) & (other == a)
    met = first | second
    if not met.any():
        return math.nan
    chosen = (main["answer"][rows] == main["interval"][rows]) == first
    return float(chosen[met].mean())


# --------------------------------------------------------------------------------------------------
# Conditions against each other, and measures against zero: tests over people, with effect size and correction.


_Question = tuple[str, tuple[str, str] | None]  # measure and conditions; None: against zero


@dataclass(frozen=True)
class ConditionComparison:
    """A test over people, one value each: two conditions, a − b, or a measure against zero, where both are empty."""

    what: str
    unit: str  #: of the difference; empty for plain numbers
    a: str
    b: str
    difference: float  #: mean over people
    low: float  #: 95 % of the mean difference, Student's over people
    high: float
    people: int
    p: float  #: two-sided
    p_corrected: float = math.nan  #: for the planned tests together, or for all others together
    planned: bool = False
    test: PairTest = "t"
    effect: EffectSize | None = None

    @property
    def name(self) -> str:
        """Of the difference, or of the claim."""
        return f"{self.a} − {self.b}" if self.a else CLAIMS.get(self.what, self.what)

    def numbers(self) -> dict[str, Any]:
        """As plain JSON types; what is not a number is None."""
        found = {key: value for key, value in vars(self).items() if key != "effect"}
        if self.effect is not None:
            found |= asdict(self.effect)
        return {key: _conditions_make_plain(value) for key, value in found.items()}


@dataclass(frozen=True)
class RatingMean:
    """Ratings of one condition."""

    mean: float
    sd: float
    ratings: int
    low: float  #: 95 % of the mean, over people
    high: float


def rate_condition(main: Columns, name: str, index: np.ndarray[Any, Any], people: int) -> RatingMean:
    """The ratings of condition `name`; `index` of the participant of each trial, of so many `people`."""
    here = main["condition"] == name
    given = main["answer"][here].astype(float)
    with np.errstate(invalid="ignore", divide="ignore"):
        own = np.bincount(index[here], given, people) / np.bincount(index[here], minlength=people)
    low, high = mean_interval(own)
    if low == high:  # whole numbers that agree say nothing about how much people differ
        low = high = np.array(np.nan)
    sd = float(given.std(ddof=1)) if len(given) > 1 else math.nan
    return RatingMean(float(given.mean()), sd, len(given), float(low), float(high))


def count_choices(main: Columns) -> dict[tuple[str, str], tuple[int, int, tuple[float, float]]]:
    """Pair of conditions → how often the first was chosen, of how many, and the interval of its share over people.

    With one person it is Wilson's interval, of this person's choices.
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
    """All tests that `study` can give, where at least two of `people` have a value in both conditions.

    First those of `plan`, the one in force, in its order and direction; then what is claimed of all conditions; then
    pairs of conditions. p is corrected within each of the three, by the plan's correction, Holm's without a plan.
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
            row = decide(measure, unit_of(measure, study.level_unit), between, values, test)
            if row is not None:
                rows.append(replace(row, planned=family is planned))
        corrected = correct_p([row.p for row in rows], correction)
        found += [replace(row, p_corrected=p) for row, p in zip(rows, corrected, strict=True)]
    return tuple(found)


def decide(
    measure: str, unit: str, between: tuple[str, str] | None, values: PersonValues, test: PairTest = "t"
) -> ConditionComparison | None:
    """The test of people's `values`; None with fewer than two people."""
    d = values.differences
    if len(d) < 2:
        return None
    a, b = between or ("", "")
    low, high = mean_interval(d)
    return ConditionComparison(
        measure, unit, a, b, float(d.mean()), float(low), float(high), len(d), float(decide_p(d, test)), test=test,
        effect=effect_size(d, values.spread),
    )  # fmt: skip


def _conditions_make_plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_conditions_make_plain(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


# --------------------------------------------------------------------------------------------------
# Psychometric curves of constant stimuli, by condition: one for each person, and one for the group behind them.


JND = 0.6745  #: spreads from the middle to where the comparison is called the stronger in 75 % of the trials

_SAME = 8  #: trials from which on one and the same key is no chance


@dataclass(frozen=True)
class ConditionCurves:
    """How often the comparison was called the stronger, over its level."""

    answered: LevelCounts
    people: dict[str, PersonFit]  #: by participant's code
    group: Population | None  #: None where fewer than two people have a function that does not fall with the level

    @property
    def group_curve(self) -> PsychometricCurve | None:
        """The function of the person in the middle of the group; None where the answers do not determine one."""
        if self.group is None or not all(map(math.isfinite, (*self.group.threshold.mean_95, self.group_spread))):
            return None
        return PsychometricCurve(self.group.threshold.mean, self.group_spread, self.group.lapse, self.group.lapse)

    @property
    def group_spread(self) -> float:
        """exp of the mean log spread; NaN where its interval has no upper end."""
        effect = self.group and self.group.log_spread
        return math.exp(effect.mean) if effect and math.isfinite(effect.mean_95[1]) else math.nan

    @property
    def group_jnd_95(self) -> tuple[float, float]:
        """From 50 to 75 %; an end is ±∞ where it does not exist, NaN without an interval."""
        assert self.group is not None
        low, high = self.group.log_spread.mean_95
        return (JND * math.exp(low) if low > -math.inf else -math.inf), JND * math.exp(high)

    @property
    def group_notes(self) -> list[str]:
        """What the answers of all people together cannot tell, and who is left out of the group."""
        reversed_ = [code for code, fit in self.people.items() if REVERSED in fit.notes]
        found = []
        if reversed_ and len(self.people) > 1:
            found.append(f"group: without {', '.join(reversed_)}, whose answers fall with the level")
        if (group := self.group) is None:
            return found
        low, high = group.log_spread.mean_95
        if math.isnan(low):
            found.append("group: on average the answers fall with the level: the keys were probably reversed")
        elif math.isinf(high):
            found.append("group: the answers hardly depend on the level: the JND has only a lower limit")
        elif math.isinf(low):
            found.append("group: the answers change from one level to the next: the JND has only an upper limit")
        least, most = group.threshold.mean_95
        if math.isinf(least) and math.isinf(most):
            found.append("group: the answers set no limit to the threshold")
        elif math.isinf(least) or math.isinf(most):
            found.append(f"group: the threshold has only {'an upper' if math.isinf(least) else 'a lower'} limit")
        if group.by_slope:
            found.append(
                "group: the answers of at least one person hardly depend on the level, so that the group is the mean "
                f"slope and intercept, with lapses of {100 * group.lapse:g} %; differences between people are not "
                "estimated"
            )
        return found

    @property
    def misfits(self) -> int:
        """Number of people whom the function fits worse than 95 % of simulated repetitions."""
        return sum(fit.p_fit < 0.05 for fit in self.people.values())

    def numbers(self) -> dict[str, Any]:
        """As plain JSON types."""
        x, yes, of = self.answered.pooled
        found: dict[str, Any] = {
            "levels": x.tolist(), "yes": yes.tolist(), "of": of.tolist(), "group": None,
            "people": {code: fit.numbers() for code, fit in self.people.items()}, "group_notes": self.group_notes,
        }  # fmt: skip
        if (group := self.group) is not None:
            spread = group.log_spread
            low, high = self.group_jnd_95
            found["group"] = {
                "people": group.people, "middle": effect_numbers(group.threshold), "log_spread": effect_numbers(spread),
                "spread": _to_json(self.group_spread),
                "spread_95": [_to_json(low / JND), _to_json(high / JND)],
                "jnd_75_percent": _to_json(JND * self.group_spread),
                "jnd_75_percent_95": [_to_json(low), _to_json(high)], "lapse": group.lapse,
                "by_slope": group.by_slope,
            }  # fmt: skip
        return found


def effect_numbers(effect: NormalEffect) -> dict[str, Any]:
    """A mean and a standard deviation over people as plain JSON types; an end that does not exist is None."""
    closed = all(map(math.isfinite, effect.mean_95))
    return {
        "mean": _to_json(effect.mean if closed else math.nan), "mean_95": [_to_json(end) for end in effect.mean_95],
        "between_people_sd": _to_json(effect.sd), "between_people_sd_95": [_to_json(end) for end in effect.sd_95],
    }  # fmt: skip


def _to_json(value: float) -> float | None:
    return value if math.isfinite(value) else None


def fit_curves(
    main: Columns, progress: Callable[[int, int], None] | None = None
) -> tuple[dict[str, ConditionCurves], list[str]]:
    """By condition; and in words what could not be fitted. `progress` receives (people fitted, people in all)."""
    names = [str(name) for name in dict.fromkeys(main["condition"].tolist())]
    codes = {name: np.unique(main["participant"][main["condition"] == name]).tolist() for name in names}
    total, done = sum(map(len, codes.values())), 0
    found: dict[str, ConditionCurves] = {}
    notes = []
    for name in names:
        here = main["condition"] == name
        people, person = np.unique(main["participant"][here], return_inverse=True)
        levels = main["level"][here]
        if len(np.unique(levels)) < 2:
            notes.append(f"condition '{name}': answers at one level only ({levels[0]:g}), which determine no function")
            done += len(people)
            continue
        stronger = main["answer"][here] == main["interval"][here]
        answered = count_by_level(levels, stronger, person, len(people))
        likelihood = SlopeLikelihood(answered)
        fits = {}
        for n, code in enumerate(people.tolist()):
            fit = fit_person(likelihood, n)
            given = np.unique(main["answer"][here][person == n])
            if len(given) == 1 and fit.trials >= _SAME:
                fit = replace(fit, notes=(f"every one of {fit.trials} answers is {given[0]:g}", *fit.notes))
            fits[str(code)] = fit
            done += 1
            if progress is not None:
                progress(done, total)
        found[name] = ConditionCurves(answered, fits, fit_group(likelihood))
    return found, notes


# --------------------------------------------------------------------------------------------------
# Thresholds of adaptive procedures, by condition: each participant's with an interval, and the group's.


_SPREADS = (1 / 6, 2.0)  #: of a staircase's function [octaves of the difference], those that QUEST+ considers
_FALL = math.exp(-1.9207)  #: of the greatest likelihood: half of the 95 % quantile of χ² lower in its logarithm
_STAIRCASE_SHARE = 0.5**0.5  #: of right answers where 1-up/2-down settles (Levitt 1971)


@dataclass(frozen=True)
class TrackFit:
    """One person's track in one condition; differences from the reference in the parameter's unit, NaN: unknown."""

    trials: int
    complete: bool
    threshold: float  #: the procedure's own: of a staircase its reversals', else the posterior's mean
    fitted: float  #: of the posterior after all trials: with QUEST+ the mean in the logarithm, else the median
    fitted_95: tuple[float, float]  #: 0 and ∞ are open ends
    notes: tuple[str, ...] = ()

    @property
    def closed(self) -> bool:
        """Whether its interval has both ends."""
        return self.fitted_95[0] > 0 and math.isfinite(self.fitted_95[1])


@dataclass(frozen=True)
class ConditionTracks:
    """Everybody's tracks in one condition."""

    people: dict[str, TrackFit]
    group: NormalEffect | None  #: of log2 of the threshold; None with one person

    def numbers(self) -> dict[str, Any]:
        """As plain JSON types."""
        found: dict[str, Any] = {
            "people": {code: _thresholds_numbers(fit) for code, fit in self.people.items()},
            "group": None,
        }
        if (group := self.group) is not None:
            closed = all(map(math.isfinite, group.mean_95))
            found["group"] = {
                "mean": 2**group.mean if closed else None,
                "mean_95": [2**end if math.isfinite(end) else None for end in group.mean_95],
                "log2": effect_numbers(group),
            }
        return found


def follow_tracks(
    study: Study, main: Columns, progress: Callable[[int, int], None] | None = None
) -> dict[str, ConditionTracks]:
    """By condition, from the trials without practice. `progress` receives (tracks done, tracks in all)."""
    levels = study.levels
    assert levels is not None
    names = [str(name) for name in dict.fromkeys(main["condition"].tolist())]
    codes = {name: np.unique(main["participant"][main["condition"] == name]) for name in names}
    total, done, found = sum(map(len, codes.values())), 0, {}
    for name in names:
        here = main["condition"] == name
        tracks = []
        for code in codes[name]:
            rows = np.flatnonzero(here & (main["participant"] == code))
            tracks.append(_Track(levels, study.procedure, name, main, rows))
            done += 1
            if progress is not None:
                progress(done, total)
        found[name] = _join_tracks(study.procedure, levels, [str(code) for code in codes[name]], tracks)
    return found


class _Track:
    """What one person did in one condition."""

    def __init__(self, levels: Levels, procedure: str, name: str, main: Columns, rows: Any) -> None:
        least, most = float(levels.least or 0), float(levels.most or 0)
        self.differences = np.maximum(main["level"][rows] - levels.reference, least / 2)
        self.right = main["answer"][rows] == main["interval"][rows]
        intervals = tuple(main["interval"][rows].tolist())
        enough = len(rows) >= levels.trials
        if procedure == "staircase":
            start = float(levels.start or most)
            track = Staircase(levels.reference, start, least, most, levels.step, levels.reversals, intervals, name)
            for answer in main["answer"][rows].tolist():
                track = track.advance(Answer(int(answer)))
            self.complete = enough or len(track.turned) >= levels.reversals
            self.threshold = float(track.threshold)
            self.posterior = np.array([])
        else:
            # What was asked is known: choosing it again takes a hundred times as long as the rest.
            empty = Bayesian(levels.reference, least, most, intervals, name)
            asked = np.abs(np.log(self.differences[:, None] / empty.differences)).argmin(axis=1)
            answers = tuple(zip(asked.tolist(), self.right.tolist(), strict=True))
            bayesian = Bayesian(levels.reference, least, most, intervals, name, answers=answers)
            self.complete, self.threshold = enough, float(bayesian.threshold)
            self.posterior = bayesian.posterior.sum(axis=1)


def _join_tracks(procedure: str, levels: Levels, codes: list[str], tracks: list[_Track]) -> ConditionTracks:
    """Posterior of everybody's threshold on one axis, and the group."""
    least, most = float(levels.least or 0), float(levels.most or 0)
    if procedure == "bayesian":
        axis = np.linspace(math.log2(least), math.log2(most), len(tracks[0].posterior))
        # Thresholds are equally probable before any answer, so this posterior is the likelihood.
        likelihoods = posteriors = np.array([track.posterior for track in tracks])
    else:
        axis, likelihoods, posteriors = _fit_staircases(least, most, tracks)
    people = {}
    for code, track, mass, likelihood in zip(codes, tracks, posteriors, likelihoods, strict=True):
        mass = mass / mass.sum()
        low, high = _open_ends(central_interval(axis, mass), axis, likelihood)
        # A staircase's posterior has a long tail downwards, where the least differences were hardly met.
        fitted = 2 ** (float(mass @ axis) if procedure == "bayesian" else find_median(axis, mass))
        own = track.threshold if track.complete else math.nan
        notes = _note(track, (low, high))
        people[code] = TrackFit(
            len(track.right), track.complete, own, fitted, (float(np.exp2(low)), float(np.exp2(high))), notes
        )
    return ConditionTracks(people, _join_group(axis, likelihoods, people.values()) if len(tracks) > 1 else None)


def _join_group(axis: Array, likelihoods: Array, people: Collection[TrackFit]) -> NormalEffect:
    """Student's interval of the logarithms of the procedure's own thresholds; of an unfinished track, of the fitted.

    It has no end on a side on which somebody's has none.

    Adaptive tracks tell unequally much about their thresholds, and the more, the lower these happen to be: a mean that
    weighs by it is biased, and its interval held the truth in 89 % of 300 studies with six people.
    """
    own = [fit.threshold if math.isfinite(fit.threshold) else fit.fitted for fit in people]
    logs = np.log2(own)
    mean_low, mean_high = mean_interval(logs)
    ends = np.array([fit.fitted_95 for fit in people])
    low, high = (
        (-math.inf if (ends[:, 0] == 0).any() else float(mean_low)),
        (math.inf if np.isinf(ends[:, 1]).any() else float(mean_high)),
    )
    if math.isinf(low) or math.isinf(high):  # how much people differ depends on thresholds that nobody knows
        return NormalEffect(float(logs.mean()), (low, high), math.nan, (math.nan, math.nan))
    differing = fit_normal_effect(axis, likelihoods)
    return NormalEffect(float(logs.mean()), (low, high), differing.sd, differing.sd_95)


def _fit_staircases(least: float, most: float, tracks: list[_Track]) -> tuple[Array, Array, Array]:
    """Thresholds considered [octaves], likelihood and posterior of each person, where 70.7 % are right."""
    person = np.repeat(np.arange(len(tracks)), [len(track.right) for track in tracks])
    # A difference that came up by multiplication and one by division may differ in the last digit.
    at = np.round(np.log2(np.concatenate([track.differences for track in tracks])), 9)
    right = np.concatenate([track.right for track in tracks])
    if len(np.unique(at)) < 2:  # a second level, without data, leaves the likelihood as it is
        count = np.bincount(person, minlength=len(tracks))[:, None] * [1.0, 0.0]
        yes = np.bincount(person, right, len(tracks))[:, None] * [1.0, 0.0]
        answered = LevelCounts(at[0] + np.array([0.0, 1.0]), yes, count)
    else:
        answered = count_by_level(at, right, person, len(tracks))
    limits = math.log2(least) - 1, math.log2(most) + 1
    grid = PsychometricGrid.enclose(answered, 0.5, _STAIRCASE_SHARE, limits, _SPREADS)
    _, spreads, lapses = grid.priors
    likelihoods = (grid.likelihoods @ lapses) @ spreads
    return grid.thresholds, likelihoods, grid.posterior.sum(axis=(2, 3))


def _open_ends(limits: tuple[float, float], axis: Array, likelihood: Array) -> tuple[float, float]:
    """`limits` without an end towards which the `likelihood` (n,) at `axis` (n,) does not fall enough: there it is ±∞.

    Thresholds beyond the axis explain the answers as well as its last point, so that where it ends decides nothing.
    """
    enough = float(likelihood.max()) * _FALL
    return (
        -math.inf if float(likelihood[0]) >= enough else limits[0],
        math.inf if float(likelihood[-1]) >= enough else limits[1],
    )


def _note(track: _Track, limits: tuple[float, float]) -> tuple[str, ...]:
    found = []
    if not track.complete:
        found.append(f"not finished: {len(track.right)} trials")
    elif not math.isfinite(track.threshold):
        found.append("too few reversals for a mean")
    low, high = limits
    if math.isinf(low) and math.isinf(high):
        found.append("the answers hardly depend on the difference: they set no limit to the threshold")
    elif math.isinf(high):
        found.append("nearly as many wrong answers at the greatest difference: the threshold has only a lower limit")
    elif math.isinf(low):
        found.append("hardly a wrong answer at the least difference: the threshold has only an upper limit")
    return tuple(found)


def _thresholds_numbers(fit: TrackFit) -> dict[str, Any]:
    own = fit.threshold if math.isfinite(fit.threshold) else None
    return {
        "trials": fit.trials, "complete": fit.complete, "threshold": own,
        "fitted": fit.fitted if fit.closed else None,
        "fitted_95": [fit.fitted_95[0] or None, fit.fitted_95[1] if math.isfinite(fit.fitted_95[1]) else None],
        "notes": list(fit.notes),
    }  # fmt: skip


# --------------------------------------------------------------------------------------------------
# How far off the answers were, ring by ring of θ.


#: procedure → what its error is, said below its tables
ERROR_MEANING = {
    "identification": "Error: straight distance between the contact positions of the set-point named and the set-point "
    "shown; 0 for every right answer, wherever the tool was.",
    "localisation": "Error: straight distance of the tool's magnet at the answer from its contact position at the "
    "set-point.",
}


def name_error(procedure: str) -> str:
    """What the distance in a table is, in a title's length."""
    return {
        "identification": "from the set-point shown to the one named", "localisation": "from the set-point to the tool",
    }.get(procedure, "")  # fmt: skip


@dataclass(frozen=True)
class LatitudeError:
    """Error of the set-points at one θ."""

    theta_deg: float
    trials: int
    mean: float  #: [mm] of the people's means
    sd: float  #: [mm] over trials
    low: float  #: [mm] of the mean, over people
    high: float  #: [mm]


def measure_rings(main: Columns, index: np.ndarray[Any, Any], people: int) -> tuple[LatitudeError, ...]:
    """Error by θ; `index` (trials,) of each trial's participant, of so many `people`."""
    found = []
    for theta in np.unique(main["theta_deg"][np.isfinite(main["theta_deg"])]):
        here = (main["theta_deg"] == theta) & np.isfinite(main["distance_mm"])
        if not here.any():
            continue
        error = main["distance_mm"][here]
        counts = np.bincount(index[here], minlength=people)
        with np.errstate(invalid="ignore", divide="ignore"):
            own = np.bincount(index[here], error, people) / counts
        low, high = mean_interval(own)
        sd = float(error.std(ddof=1)) if len(error) > 1 else math.nan
        found.append(
            LatitudeError(float(theta), len(error), float(own[counts > 0].mean()), sd, float(low), float(high))
        )
    return tuple(found)


def measure_tool_rings(columns: Columns) -> tuple[LatitudeError, ...]:
    """Distance of the tool at the answer from the set-point shown, by θ, whatever place was named: the error that
    Zárate 2020 prints in Fig. 9."""
    here = columns["phase"] == "main"
    main = {name: values[here] for name, values in columns.items()}
    people, index = np.unique(main["participant"], return_inverse=True)
    return measure_rings({**main, "distance_mm": main["pen_distance_mm"]}, index, len(people))


# --------------------------------------------------------------------------------------------------
# Error and accuracy in each condition: what the tests over people compare, one value per person.


_PROCEDURES = ("identification", "localisation")  #: the others have tables of their own


@dataclass(frozen=True)
class ConditionMean:
    """Of one measure in one condition; NaN where one person gives no interval."""

    measure: str
    unit: str
    condition: str
    people: int
    mean: float
    sd: float  #: between people
    low: float  #: 95 % of the mean over people
    high: float


def average_conditions(study: Study, main: Columns, people: Sequence[str]) -> tuple[ConditionMean, ...]:
    """By measure and condition, in the order of the study file; none where nobody has a value."""
    if study.procedure not in _PROCEDURES:
        return ()
    measures = PersonMeasures(study, main, [str(code) for code in people])
    found = []
    for measure in MEASURES[study.procedure]:
        if measure in CLAIMS:
            continue
        for condition in study.conditions:
            values = measures.values_in(measure, condition.name)
            if not len(values):
                continue
            if measure == "accuracy":
                here = main["condition"] == condition.name
                _, person = np.unique(main["participant"][here], return_inverse=True)
                right, of = np.bincount(person, main["correct"][here].astype(float)), np.bincount(person)
                low, high = share_interval(right, of)
            else:
                low, high = (float(end) for end in mean_interval(values))
            sd = float(values.std(ddof=1)) if len(values) > 1 else math.nan
            unit = unit_of(measure, study.level_unit)
            found.append(ConditionMean(measure, unit, condition.name, len(values), float(values.mean()), sd, low, high))
    return tuple(found)


def list_condition_means(means: tuple[ConditionMean, ...]) -> list[dict[str, Any]]:
    """As plain JSON types; what is not a number is None."""
    return [
        {key: None if isinstance(value, float) and not math.isfinite(value) else value for key, value in found.items()}
        for found in map(asdict, means)
    ]


def make_condition_table(means: tuple[ConditionMean, ...]) -> TextTable:
    """One row per measure and condition, for terminal and report; accuracy in per cent."""
    columns = (
        Column("measure", kind="key"), Column("condition", kind="key"), Column("participants"), Column("mean"),
        Column("95 %"), Column("SD between people"),
    )  # fmt: skip
    table = TextTable(columns, "Means by condition, over participants")
    for one in means:
        scale, form, unit = (100, ".1f", "%") if one.measure == "accuracy" else (1, ".2f", one.unit)
        table.add_row(
            f"{one.measure} [{unit}]", one.condition, str(one.people), format_value(one.mean, form, scale),
            format_range((one.low, one.high), form, scale), format_value(one.sd, form, scale),
        )  # fmt: skip
    return table


# --------------------------------------------------------------------------------------------------
# Magnitude estimation: geometric means over people of the numbers they gave, and the exponent of the power law.
#
# Everybody has a scale of their own, which says nothing: each person's estimates are divided by what their own power
# law gives at the reference in the first condition. So the reference is 1 there, and other conditions are compared with
# it.


@dataclass(frozen=True)
class MagnitudeScale:
    """Of one condition; intervals are Student's 95 % over people, NaN for a single one."""

    condition: str
    people: int
    levels: Array  #: (n,)
    means: Array  #: (n,) geometric means over people, the reference in the first condition being 1
    low: Array  #: (n,)
    high: Array  #: (n,)
    exponent: float  #: mean over people of each one's n
    exponent_95: tuple[float, float]
    exponents: dict[str, float]  #: by participant
    at_reference: float  #: geometric mean over people of the law at the reference; 1 in the first condition
    at_reference_95: tuple[float, float]  #: NaN in the first condition


def estimate_magnitudes(study: Study, main: Columns) -> tuple[MagnitudeScale, ...]:
    """By condition in the order of the study file; people who met fewer than two levels of it are left out.

    Whoever met too little of the first condition has an exponent, but no scale, and is left out of the means.
    """
    if study.procedure != "magnitude" or study.levels is None:
        return ()
    laws = {condition.name: _fit_people(main, condition.name, study.levels.reference) for condition in study.conditions}
    laws = {name: own for name, own in laws.items() if own}
    if not laws:
        return ()
    scales = {code: law.log_at_reference for code, law in next(iter(laws.values())).items()}
    return tuple(_average(main, name, own, scales) for name, own in laws.items())


def _fit_people(main: Columns, condition: str, reference: float) -> dict[str, PowerLaw]:
    """Participant's code → law, of those who met two levels."""
    here = main["condition"] == condition
    found = {}
    for code in dict.fromkeys(main["participant"][here].tolist()):
        mine = here & (main["participant"] == code)
        law = fit_power_law(main["level"][mine], main["answer"][mine].astype(float), reference)
        if math.isfinite(law.exponent):
            found[code] = law
    return found


def _average(main: Columns, condition: str, laws: dict[str, PowerLaw], scales: dict[str, float]) -> MagnitudeScale:
    here = main["condition"] == condition
    levels = np.unique(main["level"][here])
    own = np.full((len(laws), len(levels)), np.nan)
    for row, code in enumerate(laws):
        mine = here & (main["participant"] == code)
        logs, at = np.log(main["answer"][mine].astype(float)), np.searchsorted(levels, main["level"][mine])
        count = np.bincount(at, minlength=len(levels))
        met = count > 0
        own[row, met] = np.bincount(at, logs, len(levels))[met] / count[met] - scales.get(code, math.nan)
    exponents = {code: law.exponent for code, law in laws.items()}
    each = np.array(list(exponents.values()))
    factors = np.array([law.log_at_reference - scales.get(code, math.nan) for code, law in laws.items()])
    low, high = mean_interval(own)
    return MagnitudeScale(
        condition, len(laws), levels, np.exp(_magnitude_mean(own)), np.exp(low), np.exp(high), float(each.mean()),
        _magnitude_ends(*mean_interval(each)), exponents, float(np.exp(_magnitude_mean(factors))),
        _magnitude_ends(*np.exp(mean_interval(factors))) if np.nan_to_num(factors).any() else (math.nan, math.nan),
    )  # fmt: skip


def _magnitude_mean(values: Array) -> Array:
    """Over people, NaN left out; NaN where nobody is left."""
    known = np.isfinite(values)
    with np.errstate(invalid="ignore"):
        found: Array = np.where(known, values, 0.0).sum(axis=0) / known.sum(axis=0)
    return found


def _magnitude_ends(low: Any, high: Any) -> tuple[float, float]:
    return float(low), float(high)


def list_magnitudes(scales: tuple[MagnitudeScale, ...]) -> list[dict[str, Any]]:
    """As plain JSON types; what is not a number is None."""
    return [
        {
            "condition": one.condition, "people": one.people, "levels": one.levels.tolist(),
            "geometric_mean": list(map(_number, one.means)),
            "interval_95": [[_number(a), _number(b)] for a, b in zip(one.low, one.high, strict=True)],
            "exponent": one.exponent, "exponent_95": list(map(_number, one.exponent_95)),
            "exponent_by_participant": one.exponents,
            "at_reference": _number(one.at_reference), "at_reference_95": list(map(_number, one.at_reference_95)),
        }
        for one in scales
    ]  # fmt: skip


def make_magnitude_tables(scales: tuple[MagnitudeScale, ...], unit: str) -> tuple[TextTable, ...]:
    """Means by level, and exponents, for terminal and report; none without a scale. `unit` of the levels."""
    if not scales:
        return ()
    columns = (Column("condition", kind="key"), Column("level", unit), Column("geometric mean"), Column("95 %"))
    rows: list[tuple[str, ...]] = [
        (one.condition, f"{level:g}", format_value(mean, ".3g"), format_range((low, high), ".3g"))
        for one in scales
        for level, mean, low, high in zip(one.levels, one.means, one.low, one.high, strict=True)
    ]
    several = len(scales) > 1
    laws: list[tuple[str, ...]] = [
        (
            one.condition, str(one.people), format_value(one.exponent, ".3f"), format_range(one.exponent_95, ".3f"),
            format_value(one.at_reference, ".3g") if several else "",
            format_range(one.at_reference_95, ".3g") if several else "",
        )
        for one in scales
    ]  # fmt: skip
    heads = (Column("condition", kind="key"), Column("participants"), Column("exponent"), Column("95 %"),
             Column("at the reference"), Column("95 %"))  # fmt: skip
    where = f" in '{scales[0].condition}'" if several else ""
    return (
        TextTable(columns, f"Estimated magnitude (reference{where} = 1)", rows),
        TextTable(heads, "Power law", laws),
    )


# --------------------------------------------------------------------------------------------------
# How long people took to answer: by condition or pair, every person counting alike; time-outs counted.
#
# Response times are skewed, so that each person's median and geometric mean stand for their trials.


@dataclass(frozen=True)
class ResponseTime:
    """Of one condition, or of a pair that was compared; intervals are 95 % over people, NaN for a single one."""

    condition: str
    trials: int
    people: int
    median: float  #: [s] mean over people of each one's median
    median_95: tuple[float, float]  #: Student's
    geometric_mean: float  #: [s] over people, of each one's geometric mean
    geometric_mean_95: tuple[float, float]  #: Student's, of the logarithms
    time_outs: int | None  #: answers after the time limit; None: the study has none


def find_response_times(study: Study, main: Columns) -> tuple[ResponseTime, ...]:
    """Response times of the trials that count, in the order of the study file; none without a trial.

    By condition; where two are compared in a trial, by pair.
    """
    found = []
    limit = study.trials.time_limit
    for name, trials in _group(study, main):
        here = trials & np.isfinite(main["seconds"])
        seconds = main["seconds"][here]
        if not len(seconds):
            continue
        people = main["participant"][here]
        own = [seconds[people == code] for code in np.unique(people)]
        medians = np.array([np.median(one) for one in own])
        # A time of zero, from a clock of low resolution, has no logarithm.
        logs = np.array([np.log(one[one > 0]).mean() if (one > 0).any() else math.nan for one in own])
        known = np.isfinite(logs)
        found.append(
            ResponseTime(
                name,
                len(seconds),
                len(own),
                float(medians.mean()),
                _response_times_ends(medians),
                float(np.exp(logs[known].mean())) if known.any() else math.nan,
                _response_times_ends(logs, exponential=True),
                None if limit is None else int(np.count_nonzero(seconds > limit)),
            )
        )
    return tuple(found)


def _group(study: Study, main: Columns) -> Iterator[tuple[str, Any]]:
    """(name, which trials (n,)) of each condition or pair."""
    names = [condition.name for condition in study.conditions]
    if study.procedure != "forced-choice":
        yield from ((name, main["condition"] == name) for name in names)
        return
    for first, second in combinations(names, 2):
        one_way = (main["condition"] == first) & (main["other"] == second)
        yield f"{first}, {second}", one_way | ((main["condition"] == second) & (main["other"] == first))


def list_response_times(times: tuple[ResponseTime, ...]) -> list[dict[str, Any]]:
    """As plain JSON types, with units in the keys; what is not a number is None."""
    return [
        {
            "condition": one.condition, "trials": one.trials, "people": one.people, "median_s": _number(one.median),
            "median_95_s": list(map(_number, one.median_95)), "geometric_mean_s": _number(one.geometric_mean),
            "geometric_mean_95_s": list(map(_number, one.geometric_mean_95)), "time_outs": one.time_outs,
        }
        for one in times
    ]  # fmt: skip


def make_response_table(times: tuple[ResponseTime, ...]) -> TextTable:
    """One row per condition or pair, for terminal and report."""
    columns = (
        Column("condition", kind="key"), Column("trials"), Column("median", "s"), Column("95 %", "s"),
        Column("geometric mean", "s"), Column("95 %", "s"), Column("time-outs"),
    )  # fmt: skip
    return TextTable(columns, "Response times, over participants", list(_rows(times)))


def _rows(times: tuple[ResponseTime, ...]) -> Iterator[tuple[str, ...]]:
    for one in times:
        yield (
            one.condition, str(one.trials), format_value(one.median, ".2f"), format_range(one.median_95, ".2f"),
            format_value(one.geometric_mean, ".2f"), format_range(one.geometric_mean_95, ".2f"),
            "–" if one.time_outs is None else str(one.time_outs),
        )  # fmt: skip


def _response_times_ends(values: Array, *, exponential: bool = False) -> tuple[float, float]:
    low, high = (float(end) for end in mean_interval(values))
    return (math.exp(low), math.exp(high)) if exponential and math.isfinite(low) else (low, high)


# --------------------------------------------------------------------------------------------------
# Answers on the sphere: constant and variable error as vectors, error over θ as a trend, spread, information.


_ROUNDING = 1e-9  #: below it an error is that of computing directions, which no test may find significant [deg]


@dataclass(frozen=True)
class PersonMean:
    """A number per person, averaged: Student's over people."""

    mean: float
    low: float  #: 95 % of the mean
    high: float
    people: int
    p: float  #: two-sided, of the mean being zero; NaN with fewer than two people


@dataclass(frozen=True)
class ErrorAxis:
    """Errors along one local axis [deg]."""

    axis: str  #: towards the top, around the vertical (growing φ), or away from the hand
    trials: int
    constant: PersonMean  #: [deg]
    variable: float  #: [deg] standard deviation about each person's mean at each set-point; NaN without repetitions


@dataclass(frozen=True)
class PlaceError:
    """Answers to one set-point, all people together."""

    set_point: int
    theta_deg: float
    phi_deg: float
    up: float  #: mean error towards the top [deg]; NaN at the top
    around: float  #: mean error about the vertical, along growing φ [deg]; NaN at the top
    spread: DirectionSpread


@dataclass(frozen=True)
class Localisation:
    """Where answers lie about what was asked."""

    answers: str  #: what an answer is: the set-point that was named, or the place that was reached
    axes: tuple[ErrorAxis, ...]
    slope: PersonMean | None  #: of the distance over θ [mm/deg]
    intercept: float  #: of the mean line at θ = 0 [mm]; NaN without a slope
    places: tuple[PlaceError, ...]
    information: dict[str, Information]  #: by condition

    def numbers(self) -> dict[str, Any]:
        """As plain JSON types; what is not a number is None."""
        found: dict[str, Any] = _localisation_make_plain(
            {
                "answers": self.answers,
                "error_deg": [asdict(axis) for axis in self.axes],
                "slope_mm_per_deg": self.slope and {**asdict(self.slope), "intercept_mm": self.intercept},
                "set_points": [asdict(place) for place in self.places],
                "information": {name: asdict(one) for name, one in self.information.items()},
            }
        )
        return found


def localise(study: Study, main: Columns, people: Sequence[str]) -> Localisation | None:
    """The answers of `people` in the columns `main`, without practice; None where no answer has a direction."""
    asked, answered = answer_directions(study, main, slice(None))
    known = np.isfinite(answered).all(axis=-1)
    if not known.any():
        return None
    index = np.searchsorted(np.array(sorted(people)), main["participant"])
    errors = error_vectors(asked, answered)
    _, around = local_axes(asked)
    along = {"up": measure_upward(study, main, slice(None)), "around": np.sum(errors * around, axis=-1)}
    if study.hand_deg is not None:
        along["away from the hand"] = np.sum(errors * find_away_axes(asked, study.hand_deg), axis=-1)
    axes = tuple(_axis(name, main["set_point"], values, index, len(people)) for name, values in along.items())
    slopes = PersonMeasures(study, main, people).compare("error-slope", None).differences
    line = math.nan
    if len(slopes):
        distance, theta = main["distance_mm"].astype(float), main["theta_deg"]
        met = np.isfinite(distance)
        line = float(distance[met].mean() - slopes.mean() * theta[met].mean())
    up, _ = local_axes(asked)
    places = []
    for point in study.points:
        here = (main["set_point"] == point.number) & known
        if here.any():
            rise, turn = (_localisation_mean(np.sum(errors[here] * axis[here], axis=-1)) for axis in (up, around))
            places.append(
                PlaceError(
                    point.number, point.theta_deg, point.phi_deg, rise, turn, summarize_directions(answered[here])
                )
            )
    return Localisation(
        "set-points named" if study.procedure == "identification" else "places reached", axes,
        average_people(slopes) if len(slopes) else None, line, tuple(places),
        _inform(study, main, known, index, len(people)),
    )  # fmt: skip


def average_people(values: Array) -> PersonMean:
    """Mean of one value per person, at least one."""
    low, high = mean_interval(values)
    p = float(decide_p(values)) if len(values) > 1 else math.nan
    return PersonMean(float(np.mean(values)), float(low), float(high), len(values), p)


def _axis(name: str, set_points: Any, values: Array, index: Any, people: int) -> ErrorAxis:
    met = np.isfinite(values)
    values, index = np.where(np.abs(values) < _ROUNDING, 0.0, values)[met], index[met]
    counts = np.bincount(index, minlength=people)
    own = (np.bincount(index, values, people) / np.maximum(counts, 1))[counts > 0]
    _, place = np.unique(np.stack([index, set_points[met].astype(int)]), axis=1, return_inverse=True)
    place = place.ravel()
    size = np.bincount(place)
    rest = values - (np.bincount(place, values) / np.maximum(size, 1))[place] if len(values) else values
    free = len(values) - len(size)
    variable = math.sqrt(float(rest @ rest) / free) if free > 0 else math.nan
    constant = average_people(own) if len(own) else PersonMean(math.nan, math.nan, math.nan, 0, math.nan)
    return ErrorAxis(name, len(values), constant, variable)


def _inform(study: Study, main: Columns, known: Any, index: Any, people: int) -> dict[str, Information]:
    """By condition, what the answers tell of the set-points; places that were reached count as the nearest of them."""
    size = len(study.points)
    asked = index_set_points(study, main["set_point"])
    given = index_set_points(study, answer_numbers(study, main))
    found = {}
    for name in dict.fromkeys(main["condition"].tolist()):
        here = known & (main["condition"] == name)
        counts = np.zeros((people, size, size))
        np.add.at(counts, (index[here], asked[here], given[here]), 1.0)
        if here.any():
            found[str(name)] = transfer_information(counts[counts.sum(axis=(1, 2)) > 0])
    return found


def _localisation_mean(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else math.nan


def _localisation_make_plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _localisation_make_plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_localisation_make_plain(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


# --------------------------------------------------------------------------------------------------
# What was planned against what was found: people, tests, smallest effects, and whether the plan stayed as it was.


@dataclass(frozen=True)
class SessionPlan:
    """With which plan a session began."""

    started: str  #: UTC
    digest: str  #: of the plan in the study file then; empty: it had none
    finished: bool


@dataclass(frozen=True)
class PlanOutcome:
    """A planned test, and what came of it."""

    test: PlannedTest
    found: ConditionComparison | None  #: None: fewer than two people have a value
    significant: bool  #: corrected p below the plan's level

    @property
    def name(self) -> str:
        """Measure and conditions."""
        pair = self.test.between
        return f"{self.test.measure}: {f'{pair[0]} − {pair[1]}' if pair else CLAIMS.get(self.test.measure, '')}"

    @property
    def verdict(self) -> str:
        """About the smallest effect of interest, by the 95 % interval."""
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
    """The plan that was in force before data existed, if there was one."""

    digest: str  #: empty: there was none
    since: str  #: start of the first session, with which it was stored (UTC)
    planned: int  #: people; 0 without a plan
    finished: int  #: people
    alpha: float
    correction: str
    remarks: tuple[str, ...]  #: what else a reader must know
    outcomes: tuple[PlanOutcome, ...]
    registered: str = ""  #: when the same plan was registered; empty: no registration was given, or another plan

    @property
    def sentence(self) -> str:
        """For people: which plan, since when, and whether enough people took part."""
        if not self.digest:
            return "no plan was stored before data existed: all tests are exploratory"
        reached = "reached" if self.finished >= self.planned else "NOT REACHED"
        tests = f"{len(self.outcomes)} planned test{'' if len(self.outcomes) == 1 else 's'}"
        return (
            f"plan {self.digest}, stored with the first session ({_minute(self.since)} UTC): {tests}, "
            f"α = {self.alpha:g}, correction {self.correction}; {self.finished} of {self.planned} planned participants "
            f"finished: {reached}{self.registered and f'; {self.registered}'}"
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
    """The plan in force: that of `study`, as the database holds it, if the first of the `sessions` began with it."""
    if study.plan is None or not sessions:
        return study.plan
    return study.plan if min(sessions, key=lambda one: one.started).digest == study.plan.digest else None


def report_plan(
    study: Study,
    comparisons: Sequence[ConditionComparison],
    sessions: Sequence[SessionPlan],
    registration: Registration | None = None,
) -> PlanReport | None:
    """The report of the plan of `study`, as the database holds it; None where there never was one.

    `registration` is what was filed. In force is the plan with which the first session began. A plan that came later,
    or was altered, is remarked upon.
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
    """What does not fit together."""
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
    """Day and time of day of a time stamp."""
    return time[:16].replace("T", " ")


_RECORDED = ("participant", "trial", "safety", "recording")


@dataclass(frozen=True)
class Analysis(NotebookReport):
    """Everything that is reported of a study; parts that its procedure does not have are empty.

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
        Number of trials of people on a simulated device, without a rendered force.
    on_unknown_device : int
        Number of trials of people stored by an older version, which did not note the device.
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
        What the data cannot tell.
    left_out : str
        Data of another kind (real, pilot, simulated) in the same database.
    incidents : tuple of Incident
        Stops, repeats, safety events, and ends before the last trial.
    recorded : tuple
        Participant, trial, safety, and part of a recording, of each recorded trial.
    """

    study: Study
    participants: int
    trials: int
    practice: int
    simulated: int
    trips: int
    repeated: int = 0
    on_simulated_device: int = 0
    on_unknown_device: int = 0
    confusion: Confusion | None = None
    arrows: tuple[Arrow, ...] = ()
    means: tuple[ConditionMean, ...] = ()
    rings: tuple[LatitudeError, ...] = ()
    curves: dict[str, ConditionCurves] = field(default_factory=dict)
    tracks: dict[str, ConditionTracks] = field(default_factory=dict)
    thresholds: dict[str, dict[str, float]] = field(default_factory=dict)
    scores: dict[str, RatingMean] = field(default_factory=dict)
    chosen: dict[tuple[str, str], tuple[int, int, tuple[float, float]]] = field(default_factory=dict)
    comparisons: tuple[ConditionComparison, ...] = ()
    localisation: Localisation | None = None
    plan: PlanReport | None = None
    magnitudes: tuple[MagnitudeScale, ...] = ()
    times: tuple[ResponseTime, ...] = ()
    notes: tuple[str, ...] = ()
    left_out: str = ""
    incidents: tuple[Incident, ...] = ()
    recorded: tuple[tuple[str, int, str, str], ...] = ()

    printer: ClassVar[str] = "haptorb_study.tables:print_summary"

    def _summarize(self) -> str:
        return f"<Analysis of study {self.study.name!r}: {self.trials} trials; {self.origin}>"

    @property
    def origin(self) -> str:
        """Who answered, and on what, in words that go onto every page and figure."""
        people = f"{self.participants} participant{'' if self.participants == 1 else 's'}"
        if self.simulated == self.participants:
            return f"SIMULATED: {people.replace(' ', ' simulated ')}, calibrated to Zárate 2020; no person took part"
        text = people
        if self.simulated:
            text = f"PARTLY SIMULATED: {self.simulated} of {people} are simulated"
        if self.on_simulated_device:
            whole = not self.simulated and self.on_simulated_device == self.trials
            share = "" if whole else f" in {self.on_simulated_device} of {self.trials} trials"
            text = f"SIMULATED DEVICE{share}: nobody felt a force; {text}"
        if self.on_unknown_device:
            text = f"{text}; whether the device was simulated is not stored for {self.on_unknown_device} trials"
        return text

    @property
    def marked(self) -> bool:
        """Whether some of it is simulated, participants or device."""
        return self.simulated > 0 or self.on_simulated_device > 0

    def numbers(self) -> dict[str, Any]:
        """As plain JSON types; what is not a number is None."""
        found: dict[str, Any] = {
            "study": self.study.name, "procedure": self.study.procedure, "origin": self.origin,
            "participants": self.participants, "simulated": self.simulated, "trials": self.trials,
            "practice_trials": self.practice, "trials_with_trips": self.trips, "repeated_trials": self.repeated,
            "trials_on_simulated_device": self.on_simulated_device, "trials_on_unknown_device": self.on_unknown_device,
        }  # fmt: skip
        if (c := self.confusion) is not None:
            found["accuracy"] = {
                "mean": c.accuracy, "interval_95": [_number(x) for x in c.accuracy_95],
                "single_participant_95": [_number(x) for x in c.single_95],
                "chance": c.chance, "p_by_chance": c.p_chance,
                "by_set_point": {str(n): _number(c.matrix[i, i]) for i, n in enumerate(c.numbers)},
                "by_set_point_95": {
                    str(n): [_number(x) for x in c.right_95[i]] for i, n in enumerate(c.numbers)
                },
            }  # fmt: skip
            found["confusion"] = [[_number(x) for x in row] for row in c.matrix.tolist()]
            found["arrows"] = [vars(arrow) for arrow in self.arrows]
        if self.means:
            found["condition_means"] = list_condition_means(self.means)
        if self.rings:
            found["error_mm"] = [_analysis_numbers(ring) for ring in self.rings]
        if self.curves:
            found["curves"] = {name: one.numbers() for name, one in self.curves.items()}
        if self.curves or self.tracks or self.magnitudes:
            levels = self.study.levels
            found["level"] = {"parameter": levels and levels.parameter, "unit": self.study.level_unit or "1"}
        if self.tracks:
            found["thresholds"] = {name: one.numbers() for name, one in self.tracks.items()}
        if self.scores:
            found["ratings"] = {name: _analysis_numbers(one) for name, one in self.scores.items()}
        if self.chosen:
            found["choices"] = [
                {"a": a, "b": b, "a_chosen": k, "of": n, "interval_95": list(w)}
                for (a, b), (k, n, w) in self.chosen.items()
            ]
        if self.magnitudes:
            found["magnitudes"] = list_magnitudes(self.magnitudes)
        if self.times:
            found["response_times"] = list_response_times(self.times)
        if self.comparisons:
            found["comparisons"] = [one.numbers() for one in self.comparisons]
        if self.localisation is not None:
            found["localisation"] = self.localisation.numbers()
        if self.plan is not None:
            found["plan"] = self.plan.numbers()
        found["left_out"] = self.left_out
        found["incidents"] = [one.row() for one in self.incidents]
        if self.notes:
            found["notes"] = list(self.notes)
        return found


def analyse(
    study: Study, columns: Columns, progress: Callable[[int, int], None] | None = None, *,
    plans: Sequence[SessionPlan] = (), registration: Registration | None = None,
) -> Analysis:  # fmt: skip
    """The analysis of `study` from its tidy `columns`; `progress` receives (people fitted, people in all).

    `plans` tell with which plan of the analysis each session began, `registration` with which one was filed.
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
    if main.keys() >= set(_RECORDED):  # answers from elsewhere have no recordings
        parts["recorded"] = tuple(
            (str(code), int(trial), str(safety), str(part))
            for code, trial, safety, part in zip(*(main[n] for n in _RECORDED), strict=True) if part
        )  # fmt: skip
    notes = _list_empty(study, main)
    if study.procedure == "constant":
        parts["curves"], more = fit_curves(main, progress)
        notes += more
    if study.procedure in ("staircase", "bayesian"):
        parts["tracks"] = tracks = follow_tracks(study, main, progress)
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


def _list_empty(study: Study, main: Columns) -> list[str]:
    """Conditions without an answer; in a forced choice each is compared with the others, and pairs tell."""
    if study.procedure == "forced-choice":
        return []
    met = set(main["condition"].tolist())
    return [f"condition '{one.name}': no answers yet" for one in study.conditions if one.name not in met]


def _analysis_numbers(row: Any) -> dict[str, Any]:
    """The fields of `row`; what is not a number is None."""
    return {key: _number(value) if isinstance(value, float) else value for key, value in vars(row).items()}


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


# --------------------------------------------------------------------------------------------------
# From a database to its analysis, in one call.


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
        Receives (people fitted, people in all) while psychometric functions are fitted.
    registration : Registration, optional
        Registered plan, with which the study's own plan is compared.
    data : str, optional
        Kind of data: "real", "pilot" or "simulated"; None: real data, unless there are none. Two kinds never contribute
        to one number.

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
