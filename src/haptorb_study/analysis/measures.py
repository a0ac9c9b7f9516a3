"""Measures: one value per participant and condition, used by the analysis and the power estimate."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, final

import numpy as np

from haptorb.arrays import Array
from haptorb_study.analysis.answer_directions import answer_directions, find_unbounded
from haptorb_study.columns import Columns
from haptorb_study.procedures import Procedure
from haptorb_study.statistics.power_law import fit_power_law
from haptorb_study.statistics.psychometric_fit import psychometric_fit
from haptorb_study.statistics.psychometric_function import PsychometricCurve
from haptorb_study.statistics.sphere import error_vectors, local_axes
from haptorb_study.study_file import Study

__all__ = ["PersonMeasures", "PersonValues", "Thresholds", "fit_slope", "list_thresholds", "measure_upward"]


_MEASURE_COLUMNS = {"error": "distance_mm", "accuracy": "correct", "rating": "answer"}
Thresholds = Mapping[str, Mapping[str, float]]  #: condition → participant's code → threshold


@dataclass(frozen=True)
class PersonValues:
    """Values of a measure, of participants who have it in both conditions; `b` is zero without a second condition."""

    a: Array  #: (people,)
    b: Array  #: (people,)
    paired: bool = True  #: whether the spread of both over participants is meaningful

    @property
    def differences(self) -> Array:
        """(people,) a − b."""
        difference: Array = self.a - self.b
        return difference

    @property
    def spread(self) -> float | None:
        """Root mean variance of both conditions; None below two participants or without a second condition."""
        if len(self.a) < 2 or not self.paired:
            return None
        return float(np.sqrt((self.a.var(ddof=1) + self.b.var(ddof=1)) / 2))


@final
class PersonMeasures:
    """Measures of `people` by condition; each value is computed once.

    `main` are the columns without practice, `thresholds` those of an adaptive procedure.
    """

    def __init__(
        self, study: Study, main: Columns, people: Sequence[str], thresholds: Thresholds | None = None
    ) -> None:
        self._study, self._main, self._thresholds = study, main, thresholds
        self._rows = {code: np.flatnonzero(main["participant"] == code) for code in people}
        self._values: dict[tuple[str, str], list[float]] = {}

    def compare(self, measure: str, between: tuple[str, str] | None) -> PersonValues:
        """Values of `measure` in both conditions of `between`; None: over all conditions, against zero.

        Participants without a value in either are left out.
        """
        if measure == "choice" and between is not None:
            one = [_share_chosen(self._main, rows, *between) for rows in self._rows.values()]
        else:
            one = self._measure_all(measure, between[0] if between else "")
        paired = between is not None and measure != "choice"
        two = self._measure_all(measure, between[1]) if between and paired else [0.5 if between else 0.0] * len(one)
        values = np.array([one, two], dtype=float)
        values = values[:, np.isfinite(values).all(axis=0)]
        # The spread between participants is that of their personal scales.
        return PersonValues(values[0], values[1], paired and measure != "magnitude")

    def values_in(self, measure: str, condition: str) -> Array:
        """(people,) `measure` of the participants who have it in `condition`."""
        values = np.array(self._measure_all(measure, condition), dtype=float)
        known: Array = values[np.isfinite(values)]
        return known

    def _measure_all(self, measure: str, condition: str) -> list[float]:
        """Values of all participants; condition "": over all conditions."""
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
    """Condition → participant's code → threshold of adaptive `procedures` (by code); unfinished tracks have none."""
    found: dict[str, dict[str, float]] = {}
    for code, procedure in procedures.items():
        for part in getattr(procedure, "parts", ()):
            threshold = getattr(part, "threshold", None)
            if threshold is not None and part.prompt is None:
                found.setdefault(part.condition, {})[code] = float(threshold)
    return found


def measure_upward(study: Study, main: Columns, rows: Any) -> Array:
    """(rows,) errors towards the top [deg] of the trials `rows` (index) that can deviate both ways; else NaN.

    The top has no meridian. A numbered answer cannot lie beyond the outermost ring, where all errors would be upward:
    only set-points with others above and below count. A place reached always counts.
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
    """`measure` of one participant from the trials `rows` of `condition`; NaN without data."""
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
        measure_upward(study, main, rows)
        if measure == "upward-bias"
        else main[_MEASURE_COLUMNS[measure]][rows].astype(float)
    )
    values = values[np.isfinite(values)]
    return float(values.mean()) if len(values) else math.nan


def _fit_person(main: Columns, rows: Any, measure: str) -> float:
    """Point of subjective equality or 75 % JND of a participant with constant stimuli; NaN with one level only."""
    levels, which = np.unique(main["level"][rows], return_inverse=True)
    if len(levels) < 2:
        return math.nan
    stronger = main["answer"][rows] == main["interval"][rows]
    counts = np.bincount(which, minlength=len(levels))
    fit = _fit_counts(*(tuple(x.tolist()) for x in (levels, np.bincount(which, stronger, len(levels)), counts)))
    return fit.middle if measure == "midpoint" else 0.6745 * fit.spread


@lru_cache(4096)  # shared by several measures and pairs of conditions
def _fit_counts(levels: tuple[float, ...], yes: tuple[float, ...], of: tuple[float, ...]) -> PsychometricCurve:
    return psychometric_fit(levels, yes, of)


def _share_chosen(main: Columns, rows: Any, a: str, b: str) -> float:
    """Share of the choices between conditions `a` and `b` in which `a` was chosen."""
    one, other = main["condition"][rows], main["other"][rows]
    first, second = (one == a) & (other == b), (one == b) & (other == a)
    met = first | second
    if not met.any():
        return math.nan
    chosen = (main["answer"][rows] == main["interval"][rows]) == first
    return float(chosen[met].mean())
