"""A design as data: a base device, free parameters, objectives and constraints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from haptorb.design.parameter import Parameter
from haptorb.design.quantity import Quantity, Sense

__all__ = ["Bound", "Design", "Goal"]


@dataclass(frozen=True)
class Goal:
    """An objective of a design, and what is wanted of it."""

    quantity: Quantity
    sense: Sense


@dataclass(frozen=True)
class Bound:
    """A constraint of a design: `low` ≤ quantity ≤ `high`, SI; None where there is no bound."""

    name: str
    quantity: Quantity
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True)
class Design:
    """What a design file says.

    text    of the file, with the text of the user's own objectives: `digest` is made of it
    base    name in the catalogue, or path, of the base device
    options the table [evaluation]
    """

    name: str
    title: str
    base: str
    parameters: tuple[Parameter, ...]
    goals: tuple[Goal, ...]
    bounds: tuple[Bound, ...]
    options: Mapping[str, Any]
    text: str
    digest: str
