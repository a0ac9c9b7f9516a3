"""One condition, and two against each other: ratings, choices, and what every participant did in both."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from haptorb.apps.study.inference.intervals import bootstrap, mean_interval, wilson
from haptorb.apps.study.inference.significance import sign_flip
from haptorb.apps.study.model.study_file import Study
from haptorb.apps.study.store.columns import Columns

__all__ = ["ConditionComparison", "RatingMean", "compare_conditions", "count_choices", "rate_condition"]


@dataclass(frozen=True)
class ConditionComparison:
    """Two conditions, participants as pairs: sign-flip test of the mean difference a − b."""

    what: str
    unit: str  #: of the difference; empty for plain numbers
    a: str
    b: str
    difference: float
    low: float  #: 95 % of the mean difference, over people
    high: float
    people: int
    p: float


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
    sd = float(given.std(ddof=1)) if len(given) > 1 else math.nan
    return RatingMean(float(given.mean()), sd, len(given), float(low), float(high))


def count_choices(main: Columns) -> dict[tuple[str, str], tuple[int, int, tuple[float, float]]]:
    """Pair of conditions → how often the first was chosen, of how many, and Wilson's interval."""
    found = {}
    for a, b in dict.fromkeys(zip(main["condition"].tolist(), main["other"].tolist(), strict=True)):
        here = (main["condition"] == a) & (main["other"] == b)
        k, n = int((main["answer"][here] == main["interval"][here]).sum()), int(here.sum())
        found[(a, b)] = (k, n, wilson(k, n))
    return found


def compare_conditions(study: Study, main: Columns, people: np.ndarray[Any, Any]) -> tuple[ConditionComparison, ...]:
    """Pairs of conditions by accuracy, error and rating, where both were met by at least two participants."""
    measures = {
        "identification": [("accuracy", "", "correct"), ("error", "mm", "distance_mm")],
        "localisation": [("error", "mm", "distance_mm")],
        "rating": [("rating", "", "answer")],
    }.get(study.procedure, [])
    found = []
    for what, unit, column in measures:
        values = main[column].astype(float)
        for a, b in combinations([condition.name for condition in study.conditions], 2):
            pairs = []
            for code in people:
                mine = (main["participant"] == code) & np.isfinite(values)
                one, two = (values[mine & (main["condition"] == name)] for name in (a, b))
                if len(one) and len(two):
                    pairs.append(float(one.mean() - two.mean()))
            if len(pairs) > 1:
                low, high = (float(end) for end in bootstrap(pairs))
                mean, p = float(np.mean(pairs)), sign_flip(pairs)
                found.append(ConditionComparison(what, unit, a, b, mean, low, high, len(pairs), p))
    return tuple(found)
