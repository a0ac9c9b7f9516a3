"""The order that older versions drew, for people who join a study that began then: its design does not change.

Intervals were drawn trial by trial, tracks followed one another, and adaptive procedures had no practice and no breaks.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from haptorb.apps.asking.prompt import Prompt
from haptorb.apps.study.model.balance import balance_conditions
from haptorb.apps.study.model.prompts import list_prompts
from haptorb.apps.study.model.study_file import Study

__all__ = ["plan_as_before"]


def plan_as_before(study: Study, participant: int) -> dict[str, Any]:
    """The session of the participant-th person (from 0) as plain JSON types, as schema 1 to 3 stored it."""
    draw = np.random.default_rng([study.trials.seed, participant])
    names = [condition.name for condition in study.conditions]
    if study.trials.order == "counter-balanced":
        names = [names[n] for n in balance_conditions(len(names), participant)]
    parts: list[dict[str, Any]] = []
    if study.procedure in ("staircase", "bayesian"):
        for name in names:
            intervals = draw.integers(1, 3, study.levels.trials if study.levels else 0)
            parts.append({"kind": study.procedure, "condition": name, "intervals": intervals.tolist()})
    else:
        main = [prompt for name in names for prompt in _shuffle(_draw_intervals(study, name, draw), draw)]
        if study.trials.order == "random":
            main = _shuffle(main, draw)
        every = study.trials.break_every
        main = [
            replace(prompt, pause=study.trials.break_seconds) if every and n and n % every == 0 else prompt
            for n, prompt in enumerate(main)
        ]
        warm = [
            replace(main[int(n)], phase="practice", pause=0.0)
            for n in draw.integers(0, len(main), study.trials.practice)
        ]
        parts.append({"kind": "listed", "prompts": [prompt.row() for prompt in [*warm, *main]]})
    return {"participant": participant, "seed": [study.trials.seed, participant], "parts": parts}


def _draw_intervals(study: Study, name: str, draw: np.random.Generator) -> list[Prompt]:
    """The prompts in condition `name`; a forced choice was asked where its first condition came."""
    return [
        replace(prompt, interval=int(draw.integers(1, 3))) if prompt.high == 2 and study.procedure != "rating"
        else prompt
        for prompt in list_prompts(study, name)
    ]  # fmt: skip


def _shuffle(prompts: list[Prompt], draw: np.random.Generator) -> list[Prompt]:
    return [prompts[int(n)] for n in draw.permutation(len(prompts))]
