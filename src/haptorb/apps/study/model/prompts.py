"""What a study asks in one condition, in no order yet, and without intervals."""

from __future__ import annotations

from itertools import combinations

from haptorb.apps.asking.prompt import Prompt
from haptorb.apps.asking.rating import rating
from haptorb.apps.study.model.study_file import Study

__all__ = ["GREATEST", "ask_number", "has_set_points", "is_comparison", "list_pairs", "list_prompts"]

GREATEST = 1_000_000  #: number that answers a magnitude estimation; any above zero does


def is_comparison(study: Study) -> bool:
    """Whether its trials have two intervals."""
    return study.procedure in ("constant", "staircase", "bayesian", "forced-choice")


def has_set_points(study: Study) -> bool:
    """Whether its trials ask about set-points; the others present everything at the first one."""
    return study.procedure in ("identification", "localisation")


def ask_number(study: Study) -> str:
    """What is asked for a number in, without the numbers that may be answered."""
    return "How strong does it push?" if study.procedure == "magnitude" else study.rating.question


def list_pairs(study: Study) -> list[tuple[str, str]]:
    """Conditions that a forced choice compares, each with each."""
    return list(combinations([condition.name for condition in study.conditions], 2))


def list_prompts(study: Study, name: str) -> list[Prompt]:
    """All trials of a listed procedure in condition `name`; a forced choice belongs to its first condition.

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
            cells = [Prompt(condition=name, set_point=top, level=v, high=GREATEST, decimal=True) for v in values]
        case "forced-choice":
            pairs = [other for first, other in list_pairs(study) if first == name]
            cells = [Prompt(condition=name, other=other, set_point=top, low=1, high=2) for other in pairs]
        case _:
            cells = [rating(name, (study.rating.low, study.rating.high), top)]
    return [cell for cell in cells for _ in range(repetitions)]
