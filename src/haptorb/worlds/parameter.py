"""The parameters of a world: range, unit and description, checked at every input.

Parameters are the fields of the world's dataclass; those declared with `parameter(...)` get a slider in the console, a
line in `haptorb worlds NAME` and a check in every constructor.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields
from typing import Any

from haptorb.errors import InputError, UnknownName, quote

__all__ = ["Parameter", "check", "parameter", "parameters", "values"]


@dataclass(frozen=True)
class Parameter:
    """A parameter: `size` numbers (1, or 3 for a direction) between `low` and `high` in `unit`."""

    name: str
    unit: str
    low: float
    high: float
    about: str
    default: float | tuple[float, ...]

    @property
    def size(self) -> int:
        """Number of elements."""
        return len(self.default) if isinstance(self.default, tuple) else 1


def parameter(default: float | tuple[float, ...], unit: str, low: float, high: float, about: str) -> Any:
    """A dataclass field that is a parameter: see `Parameter`."""
    return field(default=default, metadata={"unit": unit, "low": low, "high": high, "about": about})


def parameters(world: type[Any]) -> dict[str, Parameter]:
    """The parameters of a world's class, by name, in the order of declaration."""
    found = {}
    for item in fields(world):
        if "about" in item.metadata and item.default is not MISSING:
            found[item.name] = Parameter(item.name, default=item.default, **item.metadata)
    return found


def values(world: Any) -> dict[str, float | tuple[float, ...]]:
    """The current values of a world's parameters."""
    return {name: getattr(world, name) for name in parameters(type(world))}


def check(world: Any) -> None:
    """Raise InputError if a parameter of `world` is not finite or outside its range; called by every constructor."""
    kind = type(world).__name__
    for name, known in parameters(type(world)).items():
        value = getattr(world, name)
        several = isinstance(value, tuple | list)
        # safety: list-no-number
        if several is not isinstance(known.default, tuple) or (several and len(value) != known.size):
            wanted = f"{known.size} numbers" if isinstance(known.default, tuple) else "a finite number, not a list"
            raise InputError(f"{kind}.{name} must be {wanted}; got {quote(value)}")
        for number in value if several else (value,):
            if isinstance(number, bool) or not isinstance(number, int | float) or not _is_finite(number):
                raise InputError(f"{kind}.{name} must be a finite number; got {quote(value)}")
            if not known.low <= number <= known.high:
                raise InputError(
                    f"{kind}.{name} must lie between {known.low:g} and {known.high:g} {known.unit}; got {number:g}"
                )


def _is_finite(number: float) -> bool:
    try:
        return math.isfinite(number)
    except OverflowError:  # an integer that no float can hold
        return False


def check_names(world: type[Any], given: Mapping[str, Any]) -> None:
    """Raise UnknownName for the first key of `given` that is not a parameter of `world`."""
    known = parameters(world)
    for name in given:
        if name not in known:
            raise UnknownName(f"parameter of {world.__name__}", name, known)
