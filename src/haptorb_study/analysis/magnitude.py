"""Magnitude estimation: geometric means over participants, and the exponent of Stevens' power law.

Personal scales are arbitrary, so each participant's estimates are divided by the value of their own power law at the
reference in the first condition: the reference is 1 there, and other conditions are relative to it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from haptorb.arrays import Array
from haptorb.terminal import Column, TextTable
from haptorb_study.analysis.number_format import format_range, format_value
from haptorb_study.columns import Columns
from haptorb_study.json_values import json_number
from haptorb_study.statistics.intervals import mean_interval
from haptorb_study.statistics.power_law import PowerLaw, fit_power_law
from haptorb_study.study_file import Study

__all__ = ["MagnitudeScale", "estimate_magnitudes", "list_magnitudes", "make_magnitude_tables"]


@dataclass(frozen=True)
class MagnitudeScale:
    """Estimated magnitudes of one condition; 95 % intervals over participants (Student), NaN for one participant."""

    condition: str
    people: int
    levels: Array  #: (n,)
    means: Array  #: (n,) geometric means over participants; 1 at the reference in the first condition
    low: Array  #: (n,)
    high: Array  #: (n,)
    exponent: float  #: mean over participants
    exponent_95: tuple[float, float]
    exponents: dict[str, float]  #: by participant's code
    at_reference: float  #: geometric mean over participants of the power law at the reference; 1 in the first condition
    at_reference_95: tuple[float, float]  #: NaN in the first condition


def estimate_magnitudes(study: Study, main: Columns) -> tuple[MagnitudeScale, ...]:
    """Estimated magnitudes by condition, in the order of the study file, of participants with two levels or more.

    A participant with too few levels in the first condition has an exponent, but no scale, and is left out of the
    means.
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
    """Participant's code → power law, for participants who answered at two levels or more."""
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
        condition, len(laws), levels, np.exp(_mean_over_people(own)), np.exp(low), np.exp(high), float(each.mean()),
        _to_floats(*mean_interval(each)), exponents, float(np.exp(_mean_over_people(factors))),
        _to_floats(*np.exp(mean_interval(factors))) if np.nan_to_num(factors).any() else (math.nan, math.nan),
    )  # fmt: skip


def _mean_over_people(values: Array) -> Array:
    """(n,) mean over participants without NaN; NaN where all are NaN."""
    known = np.isfinite(values)
    with np.errstate(invalid="ignore"):
        found: Array = np.where(known, values, 0.0).sum(axis=0) / known.sum(axis=0)
    return found


def _to_floats(low: Any, high: Any) -> tuple[float, float]:
    return float(low), float(high)


def list_magnitudes(scales: tuple[MagnitudeScale, ...]) -> list[dict[str, Any]]:
    """As plain JSON types; NaN and infinity become None."""
    return [
        {
            "condition": one.condition, "people": one.people, "levels": one.levels.tolist(),
            "geometric_mean": list(map(json_number, one.means)),
            "interval_95": [[json_number(a), json_number(b)] for a, b in zip(one.low, one.high, strict=True)],
            "exponent": one.exponent, "exponent_95": list(map(json_number, one.exponent_95)),
            "exponent_by_participant": one.exponents,
            "at_reference": json_number(one.at_reference),
            "at_reference_95": list(map(json_number, one.at_reference_95)),
        }
        for one in scales
    ]  # fmt: skip


def make_magnitude_tables(scales: tuple[MagnitudeScale, ...], unit: str) -> tuple[TextTable, ...]:
    """Tables of means by level and of exponents, for terminal and report; none without data. `unit` of the levels."""
    if not scales:
        return ()
    columns = (Column("condition", kind="key"), Column("level", unit), Column("geometric mean"), Column("95 % CI"))
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
    heads = (Column("condition", kind="key"), Column("participants"), Column("exponent"), Column("95 % CI"),
             Column("at the reference"), Column("95 % CI"))  # fmt: skip
    where = f" in '{scales[0].condition}'" if several else ""
    return (
        TextTable(columns, f"Estimated magnitude (reference{where} = 1)", rows),
        TextTable(heads, "Power law", laws),
    )
