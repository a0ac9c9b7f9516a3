"""Thresholds of adaptive procedures, by condition: each participant's with an interval, and the group's."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any

import numpy as np

from haptorb.apps.asking.prompt import Answer
from haptorb.apps.study.analysis.curves import effect_numbers
from haptorb.apps.study.inference.hierarchical import NormalEffect, fit_normal_effect
from haptorb.apps.study.inference.intervals import mean_interval
from haptorb.apps.study.inference.person_fit import central_interval, find_median
from haptorb.apps.study.inference.psychometric import LevelCounts, count_by_level
from haptorb.apps.study.inference.psychometric_grid import PsychometricGrid
from haptorb.apps.study.model.bayesian import Bayesian
from haptorb.apps.study.model.staircase import Staircase
from haptorb.apps.study.model.study_file import Study
from haptorb.apps.study.model.study_parts import Levels
from haptorb.apps.study.store.columns import Columns
from haptorb.numerics.arrays import Array

__all__ = ["ConditionTracks", "TrackFit", "follow_tracks"]

_SPREADS = (1 / 6, 2.0)  #: of a staircase's function [octaves of the difference], those that QUEST+ considers
_STAIRCASE_SHARE = 0.5**0.5  #: of right answers where 1-up/2-down settles (Levitt 1971)


@dataclass(frozen=True)
class TrackFit:
    """One person's track in one condition; differences from the reference in the parameter's unit, NaN: unknown."""

    trials: int
    complete: bool
    threshold: float  #: the procedure's own: of a staircase its reversals', else the posterior's mean
    fitted: float  #: of the posterior after all trials: with QUEST+ the mean in the logarithm, else the median
    fitted_95: tuple[float, float]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class ConditionTracks:
    """Everybody's tracks in one condition."""

    people: dict[str, TrackFit]
    group: NormalEffect | None  #: of log2 of the threshold; None with one person

    def numbers(self) -> dict[str, Any]:
        """As plain JSON types."""
        found: dict[str, Any] = {"people": {code: _numbers(fit) for code, fit in self.people.items()}, "group": None}
        if (group := self.group) is not None:
            found["group"] = {
                "mean": 2**group.mean,
                "mean_95": [2**end for end in group.mean_95],
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
    for code, track, mass in zip(codes, tracks, posteriors, strict=True):
        mass = mass / mass.sum()
        low, high = central_interval(axis, mass)
        # A staircase's posterior has a long tail downwards, where the least differences were hardly met.
        fitted = 2 ** (float(mass @ axis) if procedure == "bayesian" else find_median(axis, mass))
        own = track.threshold if track.complete else math.nan
        notes = _note(track, mass, fitted, (least, most))
        people[code] = TrackFit(len(track.right), track.complete, own, fitted, (2**low, 2**high), notes)
    return ConditionTracks(people, _join_group(axis, likelihoods, people.values()) if len(tracks) > 1 else None)


def _join_group(axis: Array, likelihoods: Array, people: Collection[TrackFit]) -> NormalEffect:
    """Student's interval of the logarithms of the procedure's own thresholds; of an unfinished track, of the fitted.

    Adaptive tracks tell unequally much about their thresholds, and the more, the lower these happen to be: a mean that
    weighs by it is biased, and its interval held the truth in 89 % of 300 studies with six people.
    """
    own = [fit.threshold if math.isfinite(fit.threshold) else fit.fitted for fit in people]
    logs = np.log2(own)
    low, high = mean_interval(logs)
    differing = fit_normal_effect(axis, likelihoods)
    return NormalEffect(float(logs.mean()), (float(low), float(high)), differing.sd, differing.sd_95)


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


def _note(track: _Track, mass: Array, fitted: float, limits: tuple[float, float]) -> tuple[str, ...]:
    found = []
    if not track.complete:
        found.append(f"not finished: {len(track.right)} trials")
    elif not math.isfinite(track.threshold):
        found.append("too few reversals for a mean")
    if mass[:2].sum() > 0.025 or mass[-2:].sum() > 0.025 or not limits[0] <= fitted <= limits[1]:
        found.append("the threshold may lie outside the differences that were offered")
    return tuple(found)


def _numbers(fit: TrackFit) -> dict[str, Any]:
    own = fit.threshold if math.isfinite(fit.threshold) else None
    return {
        "trials": fit.trials, "complete": fit.complete, "threshold": own, "fitted": fit.fitted,
        "fitted_95": list(fit.fitted_95), "notes": list(fit.notes),
    }  # fmt: skip
