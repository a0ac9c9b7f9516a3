"""Unordered trial list of one condition."""

from __future__ import annotations

from itertools import combinations

from haptorb_study.prompts import Prompt, rating
from haptorb_study.study_file import Study

__all__ = ["MAX_MAGNITUDE", "has_set_points", "is_comparison", "list_pairs", "list_prompts", "numeric_prompt"]


MAX_MAGNITUDE = 1_000_000  #: largest answer of a magnitude estimation; the smallest is above zero


def is_comparison(study: Study) -> bool:
    """Whether its trials have two intervals."""
    return study.procedure in ("constant", "staircase", "bayesian", "forced-choice")


def has_set_points(study: Study) -> bool:
    """Whether its trials prompt set-points; other procedures present every stimulus at the first one."""
    return study.procedure in ("identification", "localisation")


def numeric_prompt(study: Study) -> str:
    """Prompt for a numeric answer, without the range."""
    return "How strong does it push?" if study.procedure == "magnitude" else study.rating.question


def list_pairs(study: Study) -> list[tuple[str, str]]:
    """Pairs of conditions of a forced choice."""
    return list(combinations([condition.name for condition in study.conditions], 2))


def list_prompts(study: Study, name: str) -> list[Prompt]:
    """All trials of a procedure with a fixed list in condition `name`; a pair belongs to its first condition.

    The trials of a cell (a set-point, a level, a pair) follow one another.
    """
    repetitions = study.trials.repetitions
    numbers = tuple(point.number for point in study.points)
    top = study.points[0].number
    match study.procedure:
        case "identification":
            return [Prompt(condition=name, set_point=n, numbers=numbers) for n in numbers] * repetitions
        case "localisation":
            return [Prompt(condition=name, set_point=n) for n in numbers] * repetitions
        case "constant":
            values = study.levels.values if study.levels else ()
            cells = [Prompt(condition=name, set_point=top, level=v, low=1, high=2) for v in values]
        case "magnitude":
            values = study.levels.values if study.levels else ()
            cells = [Prompt(condition=name, set_point=top, level=v, high=MAX_MAGNITUDE, decimal=True) for v in values]
        case "forced-choice":
            pairs = [other for first, other in list_pairs(study) if first == name]
            cells = [Prompt(condition=name, other=other, set_point=top, low=1, high=2) for other in pairs]
        case _:
            cells = [rating(name, (study.rating.low, study.rating.high), top)]
    return [cell for cell in cells for _ in range(repetitions)]
