"""The memory of worlds in a recording: the row's numbers by the names that each world gave them."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from math import prod
from typing import Any

import numpy as np

from haptorb.errors import RecordingError, quote
from haptorb.files.foreign_text import foreign_name, foreign_text
from haptorb.numerics.arrays import Array
from haptorb.runtime.row import Field

__all__ = ["memory_columns", "memory_units", "split_memory"]


def split_memory(numbers: Array, changes: Array, worlds: Sequence[Mapping[str, str]]) -> dict[str, Array]:
    """World and field → its numbers in all ticks, (n, ...) in the field's unit [SI]; NaN in ticks of other worlds.

    numbers (n, room) are the rows' memory, changes (n,) the number of the world in each of these ticks, worlds the
    notes of all. A field for which rows had no room is left out. Raises RecordingError for a note of a world that
    haptorb did not write.
    """
    found: dict[str, Array] = {}
    for change, name, fields in _list_fields(worlds):
        rows = changes == change
        for key, shape, place in _place_fields(name, fields, numbers.shape[1]):
            values = found.setdefault(key, np.full((len(numbers), *shape), np.nan))
            if values.shape[1:] == shape:  # a file that was saved again may have changed it
                values[rows] = numbers[rows, place].reshape(-1, *shape)
    return found


def memory_columns(worlds: Sequence[Mapping[str, str]], room: int) -> tuple[Field, ...]:
    """One Field [SI] for each that `split_memory` finds in rows with `room` numbers of memory."""
    units: dict[str, str] = memory_units(worlds)
    found: dict[str, Field] = {}
    for _, name, fields in _list_fields(worlds):
        for key, shape, _ in _place_fields(name, fields, room):
            found.setdefault(key, Field(key, prod(shape), units[key], "remembered by the world"))
    return tuple(found.values())


def _place_fields(
    world: str, fields: Sequence[Mapping[str, Any]], room: int
) -> Iterator[tuple[str, tuple[int, ...], slice]]:
    """(key, shape, numbers) of the fields for which there is room."""
    start = 0
    for field in fields:
        shape = tuple(field["shape"])
        first, start = start, start + prod(shape)
        if start > room:
            return
        yield _name_column(world, field), shape, slice(first, start)


def memory_units(worlds: Sequence[Mapping[str, str]]) -> dict[str, str]:
    """World and field → unit [SI], of the notes of all `worlds` of a recording."""
    return {
        _name_column(name, field): foreign_text(field["unit"], 40)
        for _, name, fields in _list_fields(worlds)
        for field in fields
    }


def _name_column(world: str, field: Mapping[str, Any]) -> str:
    """Of tables and archives: the recording may be anybody's."""
    return f"{foreign_name(world)}.{foreign_name(field['name'])}"  # safety: foreign-column


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
            raise RecordingError(f"a note of a world was not written by haptorb: {quote(note)}") from cause


def _check_fields(fields: Sequence[Mapping[str, Any]]) -> None:
    """Raise ValueError for a field that no memory has: another program may have written the file."""
    for field in fields:
        if not isinstance(field["name"], str) or not isinstance(field["unit"], str):
            raise ValueError("name and unit must be texts")
        if len(field["shape"]) > 4 or any(type(n) is not int or not 1 <= n <= 65_536 for n in field["shape"]):
            raise ValueError("a shape must be whole numbers")
        if prod(field["shape"]) > 65_536:
            raise ValueError("a field has too many numbers")
