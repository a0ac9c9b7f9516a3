"""Localisation errors on the sphere: constant and variable error, trend over θ, spread, information transferred."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from haptorb.arrays import Array
from haptorb_study.analysis.answer_directions import answer_directions, answer_numbers, index_set_points
from haptorb_study.analysis.measures import PersonMeasures, measure_upward
from haptorb_study.columns import Columns
from haptorb_study.json_values import to_json
from haptorb_study.statistics.information import Information, transfer_information
from haptorb_study.statistics.intervals import mean_interval
from haptorb_study.statistics.significance import compute_p
from haptorb_study.statistics.sphere import (
    DirectionSpread,
    error_vectors,
    find_away_axes,
    local_axes,
    summarize_directions,
)
from haptorb_study.study_file import Study

__all__ = ["ErrorAxis", "Localisation", "PersonMean", "PlaceError", "localise"]


_MIN_ERROR_DEG = 1e-9  #: smaller errors are rounding of the directions, which no test may find significant [deg]


@dataclass(frozen=True)
class PersonMean:
    """Mean of one value per participant, with Student's confidence interval."""

    mean: float
    low: float  #: 95 % confidence limits of the mean
    high: float
    people: int
    p: float  #: two-sided, of a zero mean; NaN with fewer than two participants


@dataclass(frozen=True)
class ErrorAxis:
    """Errors along one local axis [deg]."""

    axis: str  #: towards the top, azimuthal (growing φ), or away from the hand
    trials: int
    constant: PersonMean  #: [deg]
    variable: float  #: [deg] SD about each participant's mean at each set-point; NaN without repetitions


@dataclass(frozen=True)
class PlaceError:
    """Mean error and spread of the answers to one set-point, over all participants."""

    set_point: int
    theta_deg: float
    phi_deg: float
    up: float  #: mean error towards the top [deg]; NaN at the top
    around: float  #: mean azimuthal error, along growing φ [deg]; NaN at the top
    spread: DirectionSpread


@dataclass(frozen=True)
class Localisation:
    """Localisation errors of a study."""

    answers: str  #: kind of answer: set-point named, or place reached
    axes: tuple[ErrorAxis, ...]
    slope: PersonMean | None  #: of the distance error over θ [mm/deg]
    intercept: float  #: of the regression line at θ = 0 [mm]; NaN without a slope
    places: tuple[PlaceError, ...]
    information: dict[str, Information]  #: by condition

    def numbers(self) -> dict[str, Any]:
        """As plain JSON types; NaN and infinity become None."""
        found: dict[str, Any] = to_json(
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
    """Localisation errors of `people` in `main`, columns without practice; None where no answer has a direction."""
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
            rise, turn = (_finite_mean(np.sum(errors[here] * axis[here], axis=-1)) for axis in (up, around))
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
    """Mean of one value per participant (at least one)."""
    low, high = mean_interval(values)
    p = float(compute_p(values)) if len(values) > 1 else math.nan
    return PersonMean(float(np.mean(values)), float(low), float(high), len(values), p)


def _axis(name: str, set_points: Any, values: Array, index: Any, people: int) -> ErrorAxis:
    met = np.isfinite(values)
    values, index = np.where(np.abs(values) < _MIN_ERROR_DEG, 0.0, values)[met], index[met]
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
    """Information transferred by condition; a place reached counts as the nearest set-point."""
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


def _finite_mean(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else math.nan
