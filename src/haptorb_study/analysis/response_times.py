"""Response times by condition or pair, with equal weight per participant; time-outs are counted.

Response times are skewed, so each participant is represented by the median and the geometric mean.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from haptorb.arrays import Array
from haptorb.terminal import Column, TextTable
from haptorb_study.analysis.number_format import format_range, format_value
from haptorb_study.columns import Columns
from haptorb_study.json_values import json_number
from haptorb_study.statistics.intervals import mean_interval
from haptorb_study.study_file import Study

__all__ = ["ResponseTime", "find_response_times", "list_response_times", "make_response_table"]


@dataclass(frozen=True)
class ResponseTime:
    """Response time of one condition or pair; 95 % intervals over participants, NaN for one participant."""

    condition: str
    trials: int
    people: int
    median: float  #: [s] mean over participants of their medians
    median_95: tuple[float, float]  #: Student
    geometric_mean: float  #: [s] over participants, of their geometric means
    geometric_mean_95: tuple[float, float]  #: Student, of the logarithms
    time_outs: int | None  #: answers after the time limit; None: no time limit


def find_response_times(study: Study, main: Columns) -> tuple[ResponseTime, ...]:
    """Response times by condition or pair, practice left out, in the order of the study file.

    By pair where a trial compares two conditions.
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
        # A time of zero (clock resolution) has no logarithm.
        logs = np.array([np.log(one[one > 0]).mean() if (one > 0).any() else math.nan for one in own])
        known = np.isfinite(logs)
        found.append(
            ResponseTime(
                name,
                len(seconds),
                len(own),
                float(medians.mean()),
                _interval(medians),
                float(np.exp(logs[known].mean())) if known.any() else math.nan,
                _interval(logs, exponential=True),
                None if limit is None else int(np.count_nonzero(seconds > limit)),
            )
        )
    return tuple(found)


def _group(study: Study, main: Columns) -> Iterator[tuple[str, Any]]:
    """(name, mask of trials (n,)) of each condition or pair."""
    names = [condition.name for condition in study.conditions]
    if study.procedure != "forced-choice":
        yield from ((name, main["condition"] == name) for name in names)
        return
    for first, second in combinations(names, 2):
        one_way = (main["condition"] == first) & (main["other"] == second)
        yield f"{first}, {second}", one_way | ((main["condition"] == second) & (main["other"] == first))


def list_response_times(times: tuple[ResponseTime, ...]) -> list[dict[str, Any]]:
    """As plain JSON types with units in the keys; NaN becomes None."""
    return [
        {
            "condition": one.condition, "trials": one.trials, "people": one.people, "median_s": json_number(one.median),
            "median_95_s": list(map(json_number, one.median_95)), "geometric_mean_s": json_number(one.geometric_mean),
            "geometric_mean_95_s": list(map(json_number, one.geometric_mean_95)), "time_outs": one.time_outs,
        }
        for one in times
    ]  # fmt: skip


def make_response_table(times: tuple[ResponseTime, ...]) -> TextTable:
    """One row per condition or pair, for terminal and report."""
    columns = (
        Column("condition", kind="key"), Column("trials"), Column("median", "s"), Column("95 % CI", "s"),
        Column("geometric mean", "s"), Column("95 % CI", "s"), Column("time-outs"),
    )  # fmt: skip
    return TextTable(columns, "Response times, over participants", list(_rows(times)))


def _rows(times: tuple[ResponseTime, ...]) -> Iterator[tuple[str, ...]]:
    for one in times:
        yield (
            one.condition, str(one.trials), format_value(one.median, ".2f"), format_range(one.median_95, ".2f"),
            format_value(one.geometric_mean, ".2f"), format_range(one.geometric_mean_95, ".2f"),
            "–" if one.time_outs is None else str(one.time_outs),
        )  # fmt: skip


def _interval(values: Array, *, exponential: bool = False) -> tuple[float, float]:
    low, high = (float(end) for end in mean_interval(values))
    return (math.exp(low), math.exp(high)) if exponential and math.isfinite(low) else (low, high)
