"""Psychometric functions of constant stimuli by condition: each participant's and the population's."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from haptorb_study.columns import Columns
from haptorb_study.json_values import json_number
from haptorb_study.statistics.population import NormalEffect, Population, fit_group
from haptorb_study.statistics.psychometric_fit import REVERSED, PersonFit, fit_person
from haptorb_study.statistics.psychometric_function import LevelCounts, PsychometricCurve, count_by_level
from haptorb_study.statistics.psychometric_likelihood import SlopeLikelihood

__all__ = ["JND", "ConditionCurves", "effect_numbers", "fit_curves"]


JND = 0.6745  #: spreads from the point of subjective equality to 75 % "comparison stronger"

_MIN_IDENTICAL_ANSWERS = 8  #: trials from which identical answers are reported


@dataclass(frozen=True)
class ConditionCurves:
    """Share of "comparison stronger" over the level, in one condition."""

    answered: LevelCounts
    people: dict[str, PersonFit]  #: by participant's code
    group: Population | None  #: None: fewer than two participants have a function that does not fall with the level

    @property
    def group_curve(self) -> PsychometricCurve | None:
        """Psychometric function at the population means; None where the answers do not determine it."""
        if self.group is None or not all(map(math.isfinite, (*self.group.threshold.mean_95, self.group_spread))):
            return None
        return PsychometricCurve(self.group.threshold.mean, self.group_spread, self.group.lapse, self.group.lapse)

    @property
    def group_spread(self) -> float:
        """exp of the mean log spread; NaN where its interval has no upper limit."""
        effect = self.group and self.group.log_spread
        return math.exp(effect.mean) if effect and math.isfinite(effect.mean_95[1]) else math.nan

    @property
    def group_jnd_95(self) -> tuple[float, float]:
        """Confidence limits of the population's JND (50 to 75 %); ±∞: open, NaN: no interval."""
        assert self.group is not None
        low, high = self.group.log_spread.mean_95
        return (JND * math.exp(low) if low > -math.inf else -math.inf), JND * math.exp(high)

    @property
    def group_notes(self) -> list[str]:
        """What the answers do not determine for the population, and which participants are excluded."""
        reversed_ = [code for code, fit in self.people.items() if REVERSED in fit.notes]
        found = []
        if reversed_ and len(self.people) > 1:
            found.append(f"group: excludes {', '.join(reversed_)}, whose answers fall with the level")
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
                "group: the answers of at least one participant hardly depend on the level, so that the group is the "
                f"mean slope and intercept, with lapses of {100 * group.lapse:g} %; differences between participants "
                "are not estimated"
            )
        return found

    @property
    def misfits(self) -> int:
        """Number of participants whose goodness of fit is below the 5th percentile of simulated repetitions."""
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
                "spread": json_number(self.group_spread),
                "spread_95": [json_number(low / JND), json_number(high / JND)],
                "jnd_75_percent": json_number(JND * self.group_spread),
                "jnd_75_percent_95": [json_number(low), json_number(high)], "lapse": group.lapse,
                "by_slope": group.by_slope,
            }  # fmt: skip
        return found


def effect_numbers(effect: NormalEffect) -> dict[str, Any]:
    """Population mean and standard deviation as plain JSON types; an open limit is None."""
    closed = all(map(math.isfinite, effect.mean_95))
    return {
        "mean": json_number(effect.mean if closed else math.nan),
        "mean_95": [json_number(end) for end in effect.mean_95],
        "between_people_sd": json_number(effect.sd), "between_people_sd_95": [json_number(end) for end in effect.sd_95],
    }  # fmt: skip


def fit_curves(
    main: Columns, progress: Callable[[int, int], None] | None = None
) -> tuple[dict[str, ConditionCurves], list[str]]:
    """Curves by condition, and notes on conditions that cannot be fitted; `progress`: (participants fitted, in all)."""
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
            if len(given) == 1 and fit.trials >= _MIN_IDENTICAL_ANSWERS:
                fit = replace(fit, notes=(f"every one of {fit.trials} answers is {given[0]:g}", *fit.notes))
            fits[str(code)] = fit
            done += 1
            if progress is not None:
                progress(done, total)
        found[name] = ConditionCurves(answered, fits, fit_group(likelihood))
    return found, notes
