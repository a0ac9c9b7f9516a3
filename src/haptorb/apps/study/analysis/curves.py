"""Psychometric curves of constant stimuli, by condition: one for each person, and one for the group behind them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from haptorb.apps.study.inference.hierarchical import NormalEffect, Population, fit_population
from haptorb.apps.study.inference.person_fit import ONE_LEVEL, TOO_FEW, UPPER_LIMIT, PersonFit, fit_person
from haptorb.apps.study.inference.psychometric import LevelCounts, PsychometricCurve, count_by_level
from haptorb.apps.study.inference.psychometric_grid import PsychometricGrid
from haptorb.apps.study.store.columns import Columns

__all__ = ["JND", "ConditionCurves", "effect_numbers", "fit_curves"]

JND = 0.6745  #: spreads from the middle to where the comparison is called the stronger in 75 % of the trials


@dataclass(frozen=True)
class ConditionCurves:
    """How often the comparison was called the stronger, over its level."""

    answered: LevelCounts
    people: dict[str, PersonFit]  #: by participant's code
    group: Population | None  #: None where fewer than two people answered at two levels

    @property
    def group_curve(self) -> PsychometricCurve | None:
        """The function of the person in the middle of the group."""
        if self.group is None:
            return None
        lapse = self.group.lapse
        return PsychometricCurve(self.group.threshold.mean, math.exp(self.group.log_spread.mean), lapse, lapse)

    @property
    def group_notes(self) -> list[str]:
        """What the answers of all people together cannot tell, because hardly anybody's can."""
        if self.group is None:
            return []
        known = [fit.notes for fit in self.people.values() if ONE_LEVEL not in fit.notes]
        found = []
        for what, name in (("threshold", "threshold"), ("spread", "JND")):
            if 2 * sum(any(note.startswith(f"{TOO_FEW}{what}") for note in notes) for notes in known) > len(known):
                found.append(f"group: too few trials for the {name}: trust neither it nor its interval")
        if all(UPPER_LIMIT in notes for notes in known):
            found.append("group: nobody answered against the order of the levels: the JND has an upper limit only")
        return found

    @property
    def misfits(self) -> int:
        """Number of people whom the function fits worse than 95 % of simulated repetitions."""
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
            found["group"] = {
                "people": group.people, "middle": effect_numbers(group.threshold), "log_spread": effect_numbers(spread),
                "spread": math.exp(spread.mean), "spread_95": [math.exp(end) for end in spread.mean_95],
                "jnd_75_percent": JND * math.exp(spread.mean),
                "jnd_75_percent_95": [JND * math.exp(end) for end in spread.mean_95], "lapse": group.lapse,
            }  # fmt: skip
        return found


def effect_numbers(effect: NormalEffect) -> dict[str, Any]:
    """A mean and a standard deviation over people as plain JSON types."""
    return {
        "mean": effect.mean, "mean_95": list(effect.mean_95), "between_people_sd": effect.sd,
        "between_people_sd_95": list(effect.sd_95),
    }  # fmt: skip


def fit_curves(
    main: Columns, progress: Callable[[int, int], None] | None = None
) -> tuple[dict[str, ConditionCurves], list[str]]:
    """By condition; and in words what could not be fitted. `progress` receives (people fitted, people in all)."""
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
        grid = PsychometricGrid.enclose(answered)
        fits = {}
        for n, code in enumerate(people.tolist()):
            fits[str(code)] = fit_person(grid, n)
            done += 1
            if progress is not None:
                progress(done, total)
        known = np.count_nonzero((answered.of > 0).sum(axis=1) > 1)
        found[name] = ConditionCurves(answered, fits, fit_population(grid) if known > 1 else None)
    return found, notes
