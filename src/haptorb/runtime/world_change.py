"""A world by name and values, as it travels from host to servo and into recordings: JSON there and back.

A clients' force beside it (`haptorb run --serve`) stays through every change, and is no part of name and values.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from haptorb import worlds
from haptorb.errors import HaptorbError, InputError, UnknownName
from haptorb.worlds.base import World
from haptorb.worlds.base import values as parameter_values
from haptorb.worlds.dynamic import DynamicWorld, join_remote, split_remote

__all__ = [
    "answer",
    "change_world",
    "description",
    "name_of",
    "parse_answer",
    "parse_postponement",
    "parse_request",
    "postponement",
    "request",
    "values_of",
]


def name_of(world: World) -> str:
    """The catalogue's name of a world, else its own.

    >>> name_of(worlds.Nothing())
    'nothing'
    """
    plain, _ = split_remote(world)
    for name, known in worlds.CATALOGUE.items():
        if known is type(plain):
            return name
    return plain.name


def values_of(world: World) -> dict[str, float | tuple[float, ...]]:
    """The values of the parameters of `world` by name, each in its own unit.

    >>> values_of(worlds.Nothing() + worlds.Remote())
    {}
    """
    return parameter_values(split_remote(world)[0])


def description(world: World) -> str:
    """Name and present values as JSON, and what it promises; of a world with memory, its fields as rows have them; and
    the values of the clients' force beside it.

    >>> description(worlds.Nothing())
    '{"name": "nothing", "values": {}, "asks": "force"}'
    """
    message: dict[str, Any] = {"name": name_of(world), "values": values_of(world)}
    if (remote := split_remote(world)[1]) is not None:
        message["remote"] = parameter_values(remote)
    if isinstance(world, DynamicWorld):
        message["memory"] = [
            {"name": field.name, "unit": field.unit, "about": field.about, "shape": list(field.shape)}
            for field in world.memory_fields
        ]
        if world.stores_energy != any(field.name == "energy" for field in world.memory_fields):
            message["stores_energy"] = world.stores_energy
    # What a replay must know of a world whose code it has not.
    message |= {} if world.passive else {"passive": False}
    message |= {"asks": world.asks} if world.asks else {}
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
    plain, remote = split_remote(world)
    if name == name_of(world):
        known = plain
    elif own and name in own:
        known = own[name]
    else:
        known = worlds.find_world(name)()
    changed = known.replace(**values) if values else known  # creating it could take several ticks
    return world if changed is plain else join_remote(changed, remote)


def answer(number: int, error: HaptorbError | None = None) -> str:
    """The answer to request `number` as JSON: accepted, or refused with which error and its text."""
    if error is None:
        return json.dumps({"number": number})
    kind = UnknownName if isinstance(error, UnknownName) else InputError
    return json.dumps({"number": number, "refused": kind.__name__, "text": str(error)[:4000]})


def parse_answer(text: str) -> tuple[int, InputError | None]:
    """(number, the error or None) of an `answer`; number 0 for no answer at all, or not yet."""
    message = json.loads(text) if text else {}
    if "number" not in message:
        return 0, None
    if "refused" not in message:
        return message["number"], None
    kind = UnknownName if message["refused"] == "UnknownName" else InputError
    error = kind.__new__(kind)  # the text is complete: UnknownName's own constructor would compose another
    error.args = (message["text"],)
    return message["number"], error


def postponement(number: int) -> str:
    """What comes before the answer to request `number` if that must wait for compiled code, as JSON."""
    return json.dumps({"postponed": number})


def parse_postponement(text: str) -> int:
    """The number of the request that must wait; 0 if `text` is no `postponement`."""
    number: int = json.loads(text).get("postponed", 0) if text else 0
    return number
