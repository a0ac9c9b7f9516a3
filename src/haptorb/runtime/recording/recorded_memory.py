"""The memory of worlds in a recording: the row's numbers by the names that each world gave them."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from math import prod
from typing import Any, Protocol

import numpy as np

from haptorb.errors import RecordingError, quote
from haptorb.numerics.arrays import Array
from haptorb.runtime.row import Field

__all__ = ["memory_units", "read_memory"]


class RecordedRows(Protocol):
    """What is read of a recording."""

    fields: tuple[Field, ...]

    @property
    def worlds(self) -> list[dict[str, str]]:
        """The worlds that were felt, in order."""

    def __getitem__(self, name: str) -> Array:
        """A field of all ticks, in the field's own unit [SI]."""

    def __len__(self) -> int: ...


def read_memory(recording: RecordedRows) -> dict[str, Array]:
    """World and field → its numbers in all ticks, (n, ...) in the field's unit [SI]; NaN in ticks of other worlds. A
    field for which rows had no room is left out. Raises RecordingError for a note of a world that haptorb did not
    write."""
    found: dict[str, Array] = {}
    room = sum(field.width for field in recording.fields if field.name == "memory")
    if not room:
        return found
    numbers = recording["memory"].reshape(len(recording), room)
    changes = recording["world"]
    for change, name, fields in _list_fields(recording.worlds):
        rows, start = changes == change, 0
        for field in fields:
            shape = tuple(field["shape"])
            first, start = start, start + prod(shape)
            if start > room:
                break
            values = found.setdefault(f"{name}.{field['name']}", np.full((len(recording), *shape), np.nan))
            if values.shape[1:] == shape:  # a file that was saved anew may have changed it
                values[rows] = numbers[rows, first:start].reshape(-1, *shape)
    return found


def memory_units(worlds: Sequence[Mapping[str, str]]) -> dict[str, str]:
    """World and field → unit [SI], of the notes of all `worlds` of a recording."""
    return {f"{name}.{field['name']}": field["unit"] for _, name, fields in _list_fields(worlds) for field in fields}


def _list_fields(worlds: Sequence[Mapping[str, str]]) -> Iterator[tuple[int, str, list[Any]]]:
    """(change, name, fields) of each world with memory."""
    for note in worlds:
        try:
            world = json.loads(note["world"])
            fields = world.get("memory", [])
            if fields:
                _check_fields(fields)
                yield int(note["change"]), str(world["name"]), fields
        except (KeyError, TypeError, ValueError, AttributeError, RecursionError) as cause:
            raise RecordingError(f"a note of a world is not one that haptorb wrote: {quote(note)}") from cause


def _check_fields(fields: Sequence[Mapping[str, Any]]) -> None:
    """Raise ValueError for a field that no memory has: another program may have written the file."""
    for field in fields:
        if not isinstance(field["name"], str) or not isinstance(field["unit"], str):
            raise ValueError("name and unit must be texts")
        if len(field["shape"]) > 4 or any(type(n) is not int or not 1 <= n <= 65_536 for n in field["shape"]):
            raise ValueError("a shape must be whole numbers")
        if prod(field["shape"]) > 65_536:
            raise ValueError("a field has too many numbers")
