"""A design as data: a base device, free parameters, objectives and constraints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from haptorb.design.parameter import DesignParameter
from haptorb.design.quantity import DesignQuantity, Sense
from haptorb.devices.loader import DeviceTables, read_tables
from haptorb.errors import UnknownName

__all__ = ["Bound", "Design", "DesignGoal"]


@dataclass(frozen=True)
class DesignGoal:
    """An objective of a design, and its sense; `name` is that of the design file."""

    quantity: DesignQuantity
    sense: Sense
    name: str = ""

    def __post_init__(self) -> None:
        if not self.name:
            object.__setattr__(self, "name", self.quantity.name)


@dataclass(frozen=True)
class Bound:
    """A constraint of a design: `low` ≤ quantity ≤ `high`, SI; None where there is no bound."""

    name: str
    quantity: DesignQuantity
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True)
class Design:
    """What a design file says.

    text    of the file
    digest  of the file, of the user's own objectives with what they import from beside them, and of the base device:
            results belong to one digest
    base    name in the catalogue, or path, of the base device
    options the table [evaluation]
    tables  what the base device's file says; None: it is read when it is needed
    base_values  the base device's own numbers, as results keep them: see `compute_base_values`; None: not computed yet
    """

    name: str
    title: str
    base: str
    parameters: tuple[DesignParameter, ...]
    goals: tuple[DesignGoal, ...]
    bounds: tuple[Bound, ...]
    options: Mapping[str, Any]
    text: str
    digest: str
    tables: DeviceTables | None = field(default=None, repr=False)
    base_values: Mapping[str, float] | None = field(default=None, repr=False)

    @property
    def base_tables(self) -> DeviceTables:
        """What the base device's file says."""
        return read_tables(self.base) if self.tables is None else self.tables

    def parameter(self, name: str) -> DesignParameter:
        """The parameter of that name; UnknownName for another."""
        for one in self.parameters:
            if one.name == name:
                return one
        raise UnknownName(f"parameter of design '{self.name}'", name, [one.name for one in self.parameters])
