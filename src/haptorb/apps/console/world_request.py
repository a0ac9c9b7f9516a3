"""The world that a page asks for, by a name that the servo knows: a page cannot name a file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from haptorb.errors import InputError

__all__ = ["read_world"]

_NAME = 64  #: of a world or a value [characters]
_VALUES = 64  #: of a world


def read_world(command: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """Name and values of the world that a page asks for; InputError if they cannot be one's."""
    name, values = command.get("name"), command.get("values", {})
    if not isinstance(name, str) or not isinstance(values, dict):
        raise InputError("a world needs a name (text) and values (an object)")
    if len(name) > _NAME or len(values) > _VALUES or any(len(key) > _NAME for key in values):
        raise InputError(f"a world has a name of at most {_NAME} characters, and at most {_VALUES} values with such")
    for key, value in values.items():
        numbers = value if isinstance(value, list) else [value]
        if len(numbers) > _VALUES or not all(type(one) in (int, float) for one in numbers):
            raise InputError(f"a world's value is a number or a list of numbers; {key} is neither")
    return name, values
