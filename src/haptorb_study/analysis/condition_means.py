"""Means of error and accuracy by condition: one value per participant, as the tests use them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from haptorb.terminal import Column, TextTable
from haptorb_study.analysis.measures import PersonMeasures
from haptorb_study.analysis.number_format import format_range, format_value
from haptorb_study.analysis_plan import CLAIMS, MEASURES, unit_of
from haptorb_study.columns import Columns
from haptorb_study.json_values import to_json
from haptorb_study.statistics.intervals import mean_interval, share_interval
from haptorb_study.study_file import Study

__all__ = ["ConditionMean", "average_conditions", "list_condition_means", "make_condition_table"]


_PROCEDURES_WITH_ERRORS = ("identification", "localisation")  #: other procedures have tables of their own


@dataclass(frozen=True)
class ConditionMean:
    """Mean of one measure in one condition; the limits are NaN with one participant."""

    measure: str
    unit: str
    condition: str
    people: int
    mean: float
    sd: float  #: between participants
    low: float  #: 95 % confidence limits of the mean over participants
    high: float


def average_conditions(study: Study, main: Columns, people: Sequence[str]) -> tuple[ConditionMean, ...]:
    """Mean of each measure in each condition, in the order of the study file; without values: left out."""
    if study.procedure not in _PROCEDURES_WITH_ERRORS:
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
    """As plain JSON types; NaN and infinity become None."""
    return [to_json(asdict(one)) for one in means]


def make_condition_table(means: tuple[ConditionMean, ...]) -> TextTable:
    """One row per measure and condition, for terminal and report; accuracy in per cent."""
    columns = (
        Column("measure", kind="key"), Column("condition", kind="key"), Column("participants"), Column("mean"),
        Column("95 % CI"), Column("SD between people"),
    )  # fmt: skip
    table = TextTable(columns, "Means by condition, over participants")
    for one in means:
        scale, form, unit = (100, ".1f", "%") if one.measure == "accuracy" else (1, ".2f", one.unit)
        table.add_row(
            f"{one.measure} [{unit}]", one.condition, str(one.people), format_value(one.mean, form, scale),
            format_range((one.low, one.high), form, scale), format_value(one.sd, form, scale),
        )  # fmt: skip
    return table
