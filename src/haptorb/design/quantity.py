"""A number that can be computed of a candidate: to be made small or great, or to be bounded by a constraint."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from haptorb.design.candidate import DesignCandidate

__all__ = ["DesignQuantity", "Sense"]

Sense = Literal["minimise", "maximise"]


@dataclass(frozen=True)
class DesignQuantity:
    """A number of a candidate, in SI.

    name      as design files call it
    unit      in which it is shown and stored, such as "W/(N·m)²"; SI without prefix; "" for a plain number
    sense     what an optimiser does with it unless the design file says otherwise
    text      one sentence: what it is, over what it is the worst or the mean
    kinds     names of the kinds of device that have it
    compute   (DesignCandidate) → number; InputError where this device has no such number
    """

    name: str
    unit: str
    sense: Sense
    text: str
    kinds: tuple[str, ...]
    compute: Callable[[DesignCandidate], float]
