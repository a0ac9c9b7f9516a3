"""The order of a session's trials: drawn once from a seed, stored, and never drawn again."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np

from haptorb.apps.asking.procedure import FixedOrder, ProcedureSequence
from haptorb.apps.asking.prompt import Prompt
from haptorb.apps.asking.rating import rating
from haptorb.apps.study.model.bayesian import Bayesian
from haptorb.apps.study.model.staircase import Staircase
from haptorb.apps.study.model.study_file import Study

__all__ = ["balance_conditions", "plan", "procedure_of"]


def balance_conditions(conditions: int, participant: int) -> list[int]:
    """Order of `conditions` for the participant-th person: a Williams square, so that first-order carry-over evens out.

    >>> [balance_conditions(4, n) for n in range(4)]
    [[0, 1, 3, 2], [1, 2, 0, 3], [2, 3, 1, 0], [3, 0, 2, 1]]
    """
    first = [0]
    low, high = 1, conditions - 1
    while low <= high:
        first.append(low)
        if low < high:
            first.append(high)
        low, high = low + 1, high - 1
    row = [(n + participant) % conditions for n in first]
    # With an odd number every row is needed forwards and backwards.
    return row[::-1] if conditions % 2 and (participant // conditions) % 2 else row


def plan(study: Study, participant: int) -> dict[str, Any]:
    """The session of the participant-th person (from 0) as plain JSON types; the seed is the study's and theirs."""
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
        main = [prompt for name in names for prompt in _shuffle(_prompts(study, name, draw), draw)]
        if study.trials.order == "random":
            main = _shuffle(main, draw)
        every = study.trials.break_every
        main = [
            replace(prompt, pause=study.trials.break_seconds) if every and n and n % every == 0 else prompt
            for n, prompt in enumerate(main)
        ]
        warm = [
            replace(main[int(n)], phase="practice", pause=0.0) for n in draw.integers(0, len(main), _practice(study))
        ]
        parts.append({"kind": "listed", "prompts": [prompt.row() for prompt in [*warm, *main]]})
    return {"participant": participant, "seed": [study.trials.seed, participant], "parts": parts}


def procedure_of(study: Study, stored: dict[str, Any]) -> ProcedureSequence:
    """The procedure at its start, from a stored plan."""
    parts: list[FixedOrder | Staircase | Bayesian] = []
    for part in stored["parts"]:
        levels = study.levels
        if part["kind"] == "listed" or levels is None:
            parts.append(FixedOrder(tuple(Prompt.read(prompt) for prompt in part["prompts"])))
            continue
        least, most = float(levels.least or 0), float(levels.most or 0)
        intervals = tuple(part["intervals"])
        if part["kind"] == "staircase":
            start = float(levels.start or most)
            parts.append(
                Staircase(
                    levels.reference, start, least, most, levels.step, levels.reversals, intervals, part["condition"]
                )
            )
        else:
            parts.append(Bayesian(levels.reference, least, most, intervals, part["condition"]))
    return ProcedureSequence(tuple(parts))


def _practice(study: Study) -> int:
    return study.trials.practice


def _prompts(study: Study, name: str, draw: np.random.Generator) -> list[Prompt]:
    """What is asked in one condition, unordered; a forced choice is asked where its first condition comes."""
    repetitions = study.trials.repetitions
    numbers = tuple(point.number for point in study.points)
    if study.procedure == "identification":
        return [Prompt(condition=name, set_point=n, numbers=numbers) for n in numbers] * repetitions
    if study.procedure == "localisation":
        return [Prompt(condition=name, set_point=n) for n in numbers] * repetitions
    top = study.points[0].number
    if study.procedure == "constant":
        values = study.levels.values if study.levels else ()
        return [
            Prompt(condition=name, set_point=top, level=v, interval=int(draw.integers(1, 3)), low=1, high=2)
            for v in values
            for _ in range(repetitions)
        ]
    if study.procedure == "forced-choice":
        pairs = combinations([condition.name for condition in study.conditions], 2)
        return [
            Prompt(condition=a, other=b, set_point=top, interval=int(draw.integers(1, 3)), low=1, high=2)
            for a, b in pairs
            if a == name
            for _ in range(repetitions)
        ]
    scale = study.rating
    return [rating(name, (scale.low, scale.high), top)] * repetitions


def _shuffle(prompts: list[Prompt], draw: np.random.Generator) -> list[Prompt]:
    return [prompts[int(n)] for n in draw.permutation(len(prompts))]
