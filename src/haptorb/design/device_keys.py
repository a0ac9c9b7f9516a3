"""Dotted keys of a device file: looked up, named if they are not there, and written to."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from typing import Any

from haptorb.devices.kind import kind_of_name
from haptorb.devices.loader import DeviceTables
from haptorb.devices.schema.key import find_key
from haptorb.errors import InputError, quote

__all__ = ["check_key", "split_key", "write_key"]

_FIXED = frozenset({"kind", "name", "title", "source", "based_on"})  #: keys that say which device it is


def split_key(key: str) -> list[str | int]:
    """The parts of a dotted key; what is a number counts the entries of a list from 1.

    >>> split_key("electromagnets.rings.2.latitude")
    ['electromagnets', 'rings', 2, 'latitude']
    """
    return [int(part) if part.isascii() and part.isdigit() else part for part in key.split(".")]


def check_key(tables: DeviceTables, key: str) -> None:
    """InputError, with the nearest key, unless the device of `tables` has `key`, or could have it."""
    path = split_key(key)
    if path[0] in _FIXED:
        raise InputError(f"'{key}' identifies the device; a parameter must change its construction")
    node: Any = tables.values
    for depth, part in enumerate(path):
        node = _strip(node)
        if isinstance(part, int) and isinstance(node, list):
            if not 1 <= part <= len(node):
                where = ".".join(map(str, path[:depth]))
                raise InputError(f"'{key}': {where} of device '{tables.name}' has {len(node)} entries, from 1")
            node = node[part - 1]
        elif isinstance(node, Mapping) and part in node:
            node = node[str(part)]
        else:
            _check_schema(tables, key, path)
            return


def write_key(values: dict[str, Any], path: list[str | int], value: Any, reason: str) -> list[str | int]:
    """Write `value` at `path` of the tables `values`, which must not be shared, and say `reason` as its provenance.

    Returns the path of the outermost entry that a file laid over the old tables must name: lists are replaced whole.
    """
    node: Any = values
    outermost: list[str | int] | None = None
    for depth, part in enumerate(path[:-1]):
        if isinstance(node, dict) and "value" in node:  # with a unit for all its elements, and a reason that ends here
            node.pop("source", None)
            node["assumed"] = reason
            outermost = outermost or path[:depth]
            node = node["value"]
        if isinstance(node, list):
            outermost = outermost or path[:depth]
            node = node[int(part) - 1]
        else:
            node = node.setdefault(part, {})
    last = path[-1]
    if isinstance(node, dict) and "value" in node:
        node.pop("source", None)
        node["assumed"] = reason
        outermost = outermost or path[:-1]
        node = node["value"]
    if isinstance(node, list):
        node[int(last) - 1] = value
        return outermost or path[:-1]
    plain = isinstance(value, dict) or (isinstance(value, list) and any(isinstance(one, dict) for one in value))
    if isinstance(value, dict) and isinstance(node.get(last), dict) and "value" not in node[last]:
        node[last] = {**node[last], **value}
    else:
        node[last] = value if plain else {"value": value, "assumed": reason}
    return outermost or path


def _strip(node: Any) -> Any:
    return node["value"] if isinstance(node, Mapping) and "value" in node else node


def _check_schema(tables: DeviceTables, key: str, path: list[str | int]) -> None:
    """InputError unless the file of such a device may have the key, though this one has not."""
    kind = tables.values.get("kind")
    if isinstance(kind, str):
        model = kind_of_name(kind).require_part("file", tables.name, "a device file")
        if find_key(model, [part - 1 if isinstance(part, int) else part for part in path]) is not None:
            return
    known = list(dict.fromkeys(_list_keys(tables.values, "")))
    near = get_close_matches(key[:100], known, n=1, cutoff=0.5)
    hint = f"; did you mean '{near[0]}'?" if near else ""
    raise InputError(f"device '{tables.name}' has no key {quote(key)}{hint}")


def _list_keys(node: Any, prefix: str) -> Iterator[str]:
    node = _strip(node)
    if isinstance(node, Mapping):
        for name, inner in node.items():
            yield f"{prefix}{name}"
            yield from _list_keys(inner, f"{prefix}{name}.")
    elif isinstance(node, list):
        for number, inner in enumerate(node, 1):
            yield f"{prefix}{number}"
            yield from _list_keys(inner, f"{prefix}{number}.")
