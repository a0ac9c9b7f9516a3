"""Magnitude estimation: geometric means over people of the numbers they gave, and the exponent of the power law.

Everybody has a scale of their own, which says nothing: each person's estimates are divided by what their own power law
ψ = k φⁿ (least squares in the logarithms, Stevens 1957) gives at the reference, so that the reference is 1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from haptorb.apps.study.analysis.wording import format_range, format_value
from haptorb.apps.study.inference.intervals import mean_interval
from haptorb.apps.study.model.study_file import Study
from haptorb.apps.study.store.columns import Columns
from haptorb.apps.terminal import Column, TextTable
from haptorb.numerics.arrays import Array

__all__ = ["MagnitudeScale", "estimate_magnitudes", "list_magnitudes", "make_magnitude_tables"]


@dataclass(frozen=True)
class MagnitudeScale:
    """Of one condition; intervals are Student's 95 % over people, NaN for a single one."""

    condition: str
    people: int
    levels: Array  #: (n,)
    means: Array  #: (n,) geometric means over people, the reference being 1
    low: Array  #: (n,)
    high: Array  #: (n,)
    exponent: float  #: mean over people of each one's n
    exponent_95: tuple[float, float]
    exponents: dict[str, float]  #: by participant


def estimate_magnitudes(study: Study, main: Columns) -> tuple[MagnitudeScale, ...]:
    """By condition in the order of the study file; people who met fewer than two levels of it are left out."""
    if study.procedure != "magnitude" or study.levels is None:
        return ()
    reference = math.log(study.levels.reference)
    found = []
    for condition in study.conditions:
        here = main["condition"] == condition.name
        levels = np.unique(main["level"][here])
        own, exponents = [], {}
        for code in dict.fromkeys(main["participant"][here].tolist()):
            mine = here & (main["participant"] == code)
            x, y = np.log(main["level"][mine]), np.log(main["answer"][mine].astype(float))
            if len(np.unique(x)) < 2:
                continue
            exponent, constant = np.polyfit(x - reference, y, 1)
            exponents[code] = float(exponent)
            means = [y[main["level"][mine] == level] for level in levels]
            own.append([one.mean() - constant if len(one) else math.nan for one in means])
        if not own:
            continue
        logs, each = np.array(own), np.array(list(exponents.values()))
        low, high = mean_interval(logs)
        ends = tuple(float(end) for end in mean_interval(each))
        found.append(
            MagnitudeScale(
                condition.name, len(own), levels, np.exp(np.nanmean(logs, axis=0)), np.exp(low), np.exp(high),
                float(each.mean()), (ends[0], ends[1]), exponents,
            )
        )  # fmt: skip
    return tuple(found)


def list_magnitudes(scales: tuple[MagnitudeScale, ...]) -> list[dict[str, Any]]:
    """As plain JSON types; what is not a number is None."""
    return [
        {
            "condition": one.condition, "people": one.people, "levels": one.levels.tolist(),
            "geometric_mean": one.means.tolist(),
            "interval_95": [[_number(a), _number(b)] for a, b in zip(one.low, one.high, strict=True)],
            "exponent": one.exponent, "exponent_95": list(map(_number, one.exponent_95)),
            "exponent_by_participant": one.exponents,
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
    laws: list[tuple[str, ...]] = [
        (one.condition, str(one.people), format_value(one.exponent, ".3f"), format_range(one.exponent_95, ".3f"))
        for one in scales
    ]
    heads = (Column("condition", kind="key"), Column("participants"), Column("exponent"), Column("95 %"))
    return (
        TextTable(columns, "Estimated magnitude (reference = 1)", rows),
        TextTable(heads, "Power law", laws),
    )


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
