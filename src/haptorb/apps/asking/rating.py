"""A rating on a scale: studies ask for it after a trial, the design loop after a design was felt."""

from __future__ import annotations

from haptorb.apps.asking.prompt import Prompt

__all__ = ["SCALE", "rating"]

SCALE = (1, 7)  #: from "not at all" to "just right", unless a study file says otherwise


def rating(of: str, scale: tuple[int, int] = SCALE, set_point: int = 0) -> Prompt:
    """Ask for a whole number on `scale` for what is called `of`.

    >>> from haptorb.apps.asking.prompt import Answer
    >>> rating("soft").check_answer(Answer(7)).value
    7
    """
    low, high = scale
    return Prompt(condition=of, set_point=set_point, low=low, high=high)
