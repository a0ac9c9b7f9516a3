"""Thresholds of adaptive procedures by condition: each participant's with an interval, and the population's."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any

import numpy as np

from haptorb.arrays import Array
from haptorb_study.analysis.curves import effect_numbers
from haptorb_study.bayesian import Bayesian
from haptorb_study.columns import Columns
from haptorb_study.prompts import Answer
from haptorb_study.staircase import Staircase
from haptorb_study.statistics.intervals import mean_interval
from haptorb_study.statistics.population import NormalEffect, fit_normal_effect
from haptorb_study.statistics.psychometric_fit import central_interval, find_median
from haptorb_study.statistics.psychometric_function import LevelCounts, PsychometricGrid, count_by_level
from haptorb_study.study_file import Study
from haptorb_study.study_tables import Levels

__all__ = ["ConditionTracks", "TrackFit", "fit_tracks"]


_SPREAD_RANGE_OCTAVES = (1 / 6, 2.0)  #: range of a staircase's spread [octaves of the difference], as in QUEST+
_LIKELIHOOD_RATIO_95 = math.exp(-1.9207)  #: likelihood ratio at the 95 % limits: χ²₁ quantile
_CONVERGED_SHARE = 0.5**0.5  #: share of correct answers to which 1-up/2-down converges (Levitt 1971)


@dataclass(frozen=True)
class TrackFit:
    """One participant's track in one condition; differences from the reference in the parameter's unit, or NaN."""

    trials: int
    complete: bool
    threshold: float  #: the procedure's own: mean of a staircase's reversals, or mean of the posterior
    fitted: float  #: from the posterior after all trials: QUEST+ mean of the logarithm, staircase median
    fitted_95: tuple[float, float]  #: 0 and ∞ are open limits
    notes: tuple[str, ...] = ()

    @property
    def closed(self) -> bool:
        """Whether its interval has both limits."""
        return self.fitted_95[0] > 0 and math.isfinite(self.fitted_95[1])


@dataclass(frozen=True)
class ConditionTracks:
    """All participants' tracks in one condition."""

    people: dict[str, TrackFit]
    group: NormalEffect | None  #: of log2 of the threshold; None with one participant

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


def fit_tracks(
    study: Study, main: Columns, progress: Callable[[int, int], None] | None = None
) -> dict[str, ConditionTracks]:
    """Tracks by condition, from trials without practice. `progress` receives (tracks done, tracks in all)."""
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
    """Trials of one participant in one condition."""

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
            # The asked differences are known; choosing them again would take a hundred times as long.
            empty = Bayesian(levels.reference, least, most, intervals, name)
            asked = np.abs(np.log(self.differences[:, None] / empty.differences)).argmin(axis=1)
            answers = tuple(zip(asked.tolist(), self.right.tolist(), strict=True))
            bayesian = Bayesian(levels.reference, least, most, intervals, name, answers=answers)
            self.complete, self.threshold = enough, float(bayesian.threshold)
            self.posterior = bayesian.posterior.sum(axis=1)


def _join_tracks(procedure: str, levels: Levels, codes: list[str], tracks: list[_Track]) -> ConditionTracks:
    """Posterior of all participants' thresholds on one axis, and the population."""
    least, most = float(levels.least or 0), float(levels.most or 0)
    if procedure == "bayesian":
        axis = np.linspace(math.log2(least), math.log2(most), len(tracks[0].posterior))
        # The prior is flat over thresholds, so this posterior is the likelihood.
        likelihoods = posteriors = np.array([track.posterior for track in tracks])
    else:
        axis, likelihoods, posteriors = _fit_staircases(least, most, tracks)
    people = {}
    for code, track, mass, likelihood in zip(codes, tracks, posteriors, likelihoods, strict=True):
        mass = mass / mass.sum()
        low, high = _open_ends(central_interval(axis, mass), axis, likelihood)
        # A staircase's posterior has a long tail at the least differences, where there are few trials.
        fitted = 2 ** (float(mass @ axis) if procedure == "bayesian" else find_median(axis, mass))
        own = track.threshold if track.complete else math.nan
        notes = _list_notes(track, (low, high))
        people[code] = TrackFit(
            len(track.right), track.complete, own, fitted, (float(np.exp2(low)), float(np.exp2(high))), notes
        )
    return ConditionTracks(people, _join_group(axis, likelihoods, people.values()) if len(tracks) > 1 else None)


def _join_group(axis: Array, likelihoods: Array, people: Collection[TrackFit]) -> NormalEffect:
    """Student's interval of the log thresholds of the procedures; of unfinished tracks, of the fitted thresholds.

    It is open on a side on which that of any participant is.

    The information of adaptive tracks on their thresholds differs, and grows as these happen to be low: a mean weighted
    by it is biased, and its interval covered the true value in 89 % of 300 studies with six participants.
    """
    own = [fit.threshold if math.isfinite(fit.threshold) else fit.fitted for fit in people]
    logs = np.log2(own)
    mean_low, mean_high = mean_interval(logs)
    ends = np.array([fit.fitted_95 for fit in people])
    low, high = (
        (-math.inf if (ends[:, 0] == 0).any() else float(mean_low)),
        (math.inf if np.isinf(ends[:, 1]).any() else float(mean_high)),
    )
    if math.isinf(low) or math.isinf(high):  # the spread between participants depends on undetermined thresholds
        return NormalEffect(float(logs.mean()), (low, high), math.nan, (math.nan, math.nan))
    differing = fit_normal_effect(axis, likelihoods)
    return NormalEffect(float(logs.mean()), (low, high), differing.sd, differing.sd_95)


def _fit_staircases(least: float, most: float, tracks: list[_Track]) -> tuple[Array, Array, Array]:
    """Candidate thresholds [octaves], likelihood and posterior of each participant at 70.7 % correct."""
    person = np.repeat(np.arange(len(tracks)), [len(track.right) for track in tracks])
    # Differences reached by multiplication and by division may differ in the last digit.
    at = np.round(np.log2(np.concatenate([track.differences for track in tracks])), 9)
    right = np.concatenate([track.right for track in tracks])
    if len(np.unique(at)) < 2:  # a second level without data leaves the likelihood unchanged
        count = np.bincount(person, minlength=len(tracks))[:, None] * [1.0, 0.0]
        yes = np.bincount(person, right, len(tracks))[:, None] * [1.0, 0.0]
        answered = LevelCounts(at[0] + np.array([0.0, 1.0]), yes, count)
    else:
        answered = count_by_level(at, right, person, len(tracks))
    limits = math.log2(least) - 1, math.log2(most) + 1
    grid = PsychometricGrid.enclose(answered, 0.5, _CONVERGED_SHARE, limits, _SPREAD_RANGE_OCTAVES)
    _, spreads, lapses = grid.priors
    likelihoods = (grid.likelihoods @ lapses) @ spreads
    return grid.thresholds, likelihoods, grid.posterior.sum(axis=(2, 3))


def _open_ends(limits: tuple[float, float], axis: Array, likelihood: Array) -> tuple[float, float]:
    """`limits`, ±∞ where the `likelihood` (n,) at `axis` (n,) stays above the cut-off at the end of the axis.

    Thresholds beyond the axis then explain the answers as well as its last point, so its end must not be a limit.
    """
    enough = float(likelihood.max()) * _LIKELIHOOD_RATIO_95
    return (
        -math.inf if float(likelihood[0]) >= enough else limits[0],
        math.inf if float(likelihood[-1]) >= enough else limits[1],
    )


def _list_notes(track: _Track, limits: tuple[float, float]) -> tuple[str, ...]:
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
