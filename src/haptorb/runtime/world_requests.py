"""Worlds by name and parameter values as JSON, between host and servo and in recordings.

A clients' force beside it (`haptorb run --serve`) is retained through every change, and is not in name and values.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from haptorb import worlds
from haptorb.errors import HaptorbError, InputError, UnknownName
from haptorb.worlds.base import World
from haptorb.worlds.base import values as parameter_values
from haptorb.worlds.client_force import join_remote, split_remote
from haptorb.worlds.dynamic import DynamicWorld

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
    """Name of a world in the catalogue, else its own.

    >>> name_of(worlds.Nothing())
    'nothing'
    """
    plain, _ = split_remote(world)
    for name, known in worlds.CATALOGUE.items():
        if known is type(plain):
            return name
    return plain.name


def values_of(world: World) -> dict[str, float | tuple[float, ...]]:
    """Parameter values of `world` by name, each in its own unit.

    >>> values_of(worlds.Nothing() + worlds.Remote())
    {}
    """
    return parameter_values(split_remote(world)[0])


def description(world: World) -> str:
    """Description of a world as JSON: name, current values, declared properties; of a world with memory, its fields as
    rows have them; and the values of the clients' force beside it.

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
    # Required by a replay without the code of the world.
    message |= {} if world.passive else {"passive": False}
    message |= {"asks": world.asks} if world.asks else {}
    return json.dumps(message)


def request(number: int, name: str, values: Mapping[str, Any], file: str = "") -> str:
    """Request for another world, or other values, as JSON. Raises InputError for values that are not numbers.

    file: path of a packed world that replaces the user's world `name`; only the host's own code may set it.
    """
    try:
        return json.dumps({"number": number, "name": name, "values": dict(values), "file": file}, default=list)
    except (TypeError, ValueError, RecursionError) as cause:
        raise InputError(f"the values of world '{name}' must be numbers or lists of numbers: {cause}") from cause


def parse_request(text: str) -> tuple[int, str, dict[str, Any], str]:
    """Parse a `request` to (number, name, values, file)."""
    message = json.loads(text)
    return message["number"], message["name"], message["values"], message["file"]


def change_world(world: World, name: str, values: Mapping[str, Any], own: Mapping[str, World] | None = None) -> World:
    """Return `world` with other `values` if that is its name, else one of the `own` or the catalogue's worlds.

    Raises UnknownName for a world or value that does not exist, InputError for an invalid value.
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
    """Answer to request `number` as JSON: accepted, or rejected with class and text of the error."""
    if error is None:
        return json.dumps({"number": number})
    kind = UnknownName if isinstance(error, UnknownName) else InputError
    return json.dumps({"number": number, "refused": kind.__name__, "text": str(error)[:4000]})


def parse_answer(text: str) -> tuple[int, InputError | None]:
    """Parse an `answer` to (number, error or None); number 0 if there is no answer, or not yet."""
    message = json.loads(text) if text else {}
    if "number" not in message:
        return 0, None
    if "refused" not in message:
        return message["number"], None
    kind = UnknownName if message["refused"] == "UnknownName" else InputError
    error = kind.__new__(kind)  # the text is complete: the constructor of UnknownName would compose another
    error.args = (message["text"],)
    return message["number"], error


def postponement(number: int) -> str:
    """Interim answer to request `number` if it must wait for compiled code, as JSON."""
    return json.dumps({"postponed": number})


def parse_postponement(text: str) -> int:
    """Parse the number of a postponed request; 0 if `text` is no `postponement`."""
    number: int = json.loads(text).get("postponed", 0) if text else 0
    return number
