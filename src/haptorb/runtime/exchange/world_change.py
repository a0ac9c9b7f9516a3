"""A world by name and values, as it travels from host to servo and into recordings: JSON there and back."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from haptorb import worlds
from haptorb.errors import HaptorbError, InputError, UnknownName
from haptorb.worlds.dynamic_world import DynamicWorld
from haptorb.worlds.parameter import values as parameter_values
from haptorb.worlds.world import World

__all__ = ["answer", "change_world", "description", "name_of", "parse_answer", "parse_request", "request"]


def name_of(world: World) -> str:
    """The catalogue's name of a world, else its own.

    >>> name_of(worlds.Nothing())
    'nothing'
    """
    kind = type(world)
    for name, known in worlds.CATALOGUE.items():
        if known is kind:
            return name
    return world.name


def description(world: World) -> str:
    """Name and present values as JSON; of a world with memory, also the fields of that as rows have them.

    >>> description(worlds.Nothing())
    '{"name": "nothing", "values": {}}'
    """
    message: dict[str, Any] = {"name": name_of(world), "values": parameter_values(world)}
    if isinstance(world, DynamicWorld):
        message["memory"] = [
            {"name": field.name, "unit": field.unit, "about": field.about, "shape": list(field.shape)}
            for field in world.memory_fields
        ]
    return json.dumps(message)


def request(number: int, name: str, values: Mapping[str, Any], file: str = "") -> str:
    """The wish for another world, or other values, as JSON. Raises InputError for values that are not numbers.

    file: path of a packed world that replaces the own world `name`; only the host's own code may give one.
    """
    try:
        return json.dumps({"number": number, "name": name, "values": dict(values), "file": file}, default=list)
    except (TypeError, ValueError, RecursionError) as cause:
        raise InputError(f"the values of world '{name}' must be numbers or lists of numbers: {cause}") from cause


def parse_request(text: str) -> tuple[int, str, dict[str, Any], str]:
    """(number, name, values, file) of a `request`."""
    message = json.loads(text)
    return message["number"], message["name"], message["values"], message["file"]


def change_world(world: World, name: str, values: Mapping[str, Any], own: Mapping[str, World] | None = None) -> World:
    """`world` with other `values` if that is its name, else one of the `own` or the catalogue's worlds with them.

    Raises UnknownName for a world or value that does not exist, InputError for a value that cannot be.
    """
    if name == name_of(world):
        known = world
    elif own and name in own:
        known = own[name]
    else:
        known = worlds.find_world(name)()
    return known.replace(**values) if values else known  # to make it anew could take several ticks


def answer(number: int, error: HaptorbError | None = None) -> str:
    """The answer to request `number` as JSON: accepted, or refused with which error and its text."""
    if error is None:
        return json.dumps({"number": number})
    kind = UnknownName if isinstance(error, UnknownName) else InputError
    return json.dumps({"number": number, "refused": kind.__name__, "text": str(error)[:4000]})


def parse_answer(text: str) -> tuple[int, InputError | None]:
    """(number, the error or None) of an `answer`; number 0 for no answer at all."""
    if not text:
        return 0, None
    message = json.loads(text)
    if "refused" not in message:
        return message["number"], None
    kind = UnknownName if message["refused"] == "UnknownName" else InputError
    error = kind.__new__(kind)  # the text is complete: UnknownName's own constructor would compose another
    error.args = (message["text"],)
    return message["number"], error
