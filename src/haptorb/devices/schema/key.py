"""What stands beside each key of a file, for the reference and for messages: meaning, unit, range and default.

A key's annotation carries these marks next to its type and bounds; pydantic passes over them.

    radius: Annotated[q.Length, Positive, Meaning("outer radius of the dome")]
"""

from __future__ import annotations

import types
import typing
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import BaseModel
from pydantic.fields import FieldInfo

__all__ = ["Form", "Meaning", "Unit", "Without", "find_key", "find_table", "unwrap"]


@dataclass(frozen=True)
class Meaning:
    """What a key is, in a few words without a full stop."""

    text: str


@dataclass(frozen=True)
class Form:
    """What a value may be, where its type and bounds do not say it in words that people use."""

    text: str


@dataclass(frozen=True)
class Unit:
    """Unit of a plain number, which the file fixes: "deg", "s"."""

    name: str


@dataclass(frozen=True)
class Without:
    """What holds where the key is left out, instead of a default value."""

    text: str


def unwrap(annotation: Any, metadata: typing.Iterable[Any] = ()) -> tuple[Any, list[Any]]:
    """The bare type of `annotation`, without None, and all marks on it, those of `metadata` first."""
    marks = list(_flatten(metadata))
    while True:
        origin = typing.get_origin(annotation)
        if origin is Annotated:
            marks += _flatten(annotation.__metadata__)
            annotation = annotation.__origin__
        elif origin in (typing.Union, types.UnionType):
            inner = [part for part in typing.get_args(annotation) if part is not type(None)]
            if len(inner) > 1:
                return annotation, marks
            annotation = inner[0]
        else:
            return annotation, marks


def _flatten(metadata: typing.Iterable[Any]) -> Iterator[Any]:
    for mark in metadata:
        if isinstance(mark, FieldInfo):
            yield from _flatten(mark.metadata)
        else:
            yield mark


def find_table(annotation: Any) -> type[BaseModel] | None:
    """The table that a key of this type holds, or each element of its list or table; None for a plain value."""
    bare, _ = unwrap(annotation)
    if isinstance(bare, type) and issubclass(bare, BaseModel):
        return bare
    parts = [part for part in typing.get_args(bare) if part is not Ellipsis]
    return find_table(parts[-1]) if typing.get_origin(bare) in (tuple, dict) and parts else None


def find_key(model: type[BaseModel], path: typing.Iterable[int | str]) -> tuple[Any, list[Any]] | None:
    """Type and marks of the value at `path`, as pydantic's errors have it; None where the path leaves the model."""
    bare: Any = model
    marks: list[Any] = []
    for part in path:
        if isinstance(bare, type) and issubclass(bare, BaseModel):
            field = bare.model_fields.get(str(part))
            if field is None:
                return None
            bare, marks = unwrap(field.annotation, field.metadata)
            continue
        inner = [one for one in typing.get_args(bare) if one is not Ellipsis]
        if typing.get_origin(bare) not in (tuple, dict) or not inner:
            return None
        number = part if isinstance(part, int) and part < len(inner) else -1
        bare, marks = unwrap(inner[number])
    return bare, marks
