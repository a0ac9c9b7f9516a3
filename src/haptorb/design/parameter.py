"""What a design leaves free: one number or choice, and the places in the device file that it is written to."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from haptorb.errors import InputError

__all__ = ["DesignParameter", "ParameterPlace"]


@dataclass(frozen=True)
class ParameterPlace:
    """A key of a device file, and how the parameter's value is written there: factor × value + offset.

    key  dotted; lists are counted from 1, as messages about device files do: "electromagnets.rings.2.latitude"
    """

    key: str
    factor: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class DesignParameter:
    """One free parameter: a range (`low` to `high`, in `unit`, perhaps in steps), or `choices` by label.

    A choice may be anything that the key takes: a number, a text, or a whole list of tables.
    """

    name: str
    places: tuple[ParameterPlace, ...]
    unit: str = ""
    low: float = 0.0
    high: float = 0.0
    step: float = 0.0  #: 0: continuous
    choices: tuple[tuple[str, Any], ...] = ()  #: (label, what is written)

    @property
    def labels(self) -> tuple[str, ...]:
        """The choices' labels; none for a range."""
        return tuple(label for label, _ in self.choices)

    def choice(self, label: str) -> Any:
        """What is written for `label`; InputError for another."""
        for one, value in self.choices:
            if one == label:
                return value
        raise InputError(f"parameter '{self.name}': '{label}' is not one of its choices: {', '.join(self.labels)}")
