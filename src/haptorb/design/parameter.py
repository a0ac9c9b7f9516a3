"""What a design leaves free: one number or choice, and the places in the device file that it is written to."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from haptorb.errors import InputError

__all__ = ["WHOLE", "DesignParameter", "ParameterPlace", "list_entries"]

WHOLE = "*"  #: key of a place whose choices are tables that replace values all over the device file


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

    A choice may be anything that the key takes: a number, a text, or a whole list of tables. At the place `WHOLE` it is
    a table of tables, so that one choice writes several keys.
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

    def list_keys(self) -> dict[str, None]:
        """Every key that the parameter may write, in order."""
        found: dict[str, None] = {}
        for place in self.places:
            choices = [value for _, value in self.choices] if place.key == WHOLE else []
            found |= dict.fromkeys(key for value in choices for key, _ in list_entries(value))
            found |= {} if place.key == WHOLE else {place.key: None}
        return found


def list_entries(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted key and value of everything in `table`; a table with a "value" is a value.

    >>> list(list_entries({"coils": {"names": ["a"]}, "supply": {"voltage": {"value": "12 V"}}}))
    [('coils.names', ['a']), ('supply.voltage', {'value': '12 V'})]
    """
    for name, inner in table.items():
        if isinstance(inner, Mapping) and "value" not in inner:
            yield from list_entries(inner, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", inner
