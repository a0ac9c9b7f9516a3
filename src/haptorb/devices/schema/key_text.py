"""Keys of a file as the reference lists them: value, unit, range and default in words, from type, bounds and marks."""

from __future__ import annotations

import typing
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

import annotated_types as at
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from haptorb.devices.schema.key import Form, Meaning, Unit, Without, find_table, unwrap
from haptorb.devices.schema.quantity import QuantityKind
from haptorb.devices.schema.unit_help import usual_units
from haptorb.devices.schema.units import convert

__all__ = ["KeyText", "bound_text", "list_keys", "meaning_of"]


@dataclass(frozen=True)
class KeyText:
    """One row of the reference; an empty text where nothing is known, which a test refuses."""

    path: str  #: coils.heat.ambient
    meaning: str
    value: str  #: length, list of 3 lengths, text, table
    unit: str  #: usual ones, "1" for a plain number, "none" for what has no unit
    range: str
    default: str  #: "required", the value, or what holds without the key


def list_keys(model: type[BaseModel], prefix: str = "") -> Iterator[KeyText]:
    """Every key of `model` and of the tables in it, in the order of the file; tables before their keys."""
    for name, field in model.model_fields.items():
        yield _describe_key(prefix + name, field)
        inner = find_table(field.annotation)
        if inner is not None:
            yield from list_keys(inner, f"{prefix}{name}.")


def meaning_of(marks: list[Any]) -> str:
    """The meaning of a key with these marks; empty where none is given."""
    return next((mark.text for mark in marks if isinstance(mark, Meaning)), "")


def bound_text(bound: float, marks: list[Any]) -> str:
    """`bound` of a value with these marks, in the first of its usual units.

    >>> from haptorb.devices.schema import quantity as q
    >>> bound_text(0.5, unwrap(q.Length)[1]), bound_text(0, unwrap(q.Length)[1])
    ('500 mm', '0')
    """
    quantity = next((mark for mark in marks if isinstance(mark, QuantityKind)), None)
    if bound == 0 or quantity is None or quantity.unit == "":
        return f"{bound:.15g}"
    unit = usual_units(quantity.unit)[0]
    converted = convert(float(bound), quantity.unit, unit)
    return f"{bound:g} {quantity.unit}" if converted is None else f"{converted:.12g} {unit}"


def _describe_key(path: str, field: FieldInfo) -> KeyText:
    bare, marks = unwrap(field.annotation, field.metadata)
    value, unit, span = _describe_value(bare, marks)
    return KeyText(path, meaning_of(marks), value, unit, span, _describe_default(field, marks))


def _describe_default(field: FieldInfo, marks: list[Any]) -> str:
    without = next((mark.text for mark in marks if isinstance(mark, Without)), None)
    if without is not None:
        return without
    if field.is_required():
        return "required"
    default = field.get_default(call_default_factory=True)
    if isinstance(default, bool | int | float):
        return str(default).lower() if isinstance(default, bool) else f"{default:g}"
    return f'"{default}"' if isinstance(default, str) else ""


def _describe_value(bare: Any, marks: list[Any]) -> tuple[str, str, str]:
    """Kind of value, unit and range."""
    form = next((mark.text for mark in marks if isinstance(mark, Form)), None)
    quantity = next((mark for mark in marks if isinstance(mark, QuantityKind)), None)
    unit = next((mark.name for mark in marks if isinstance(mark, Unit)), "1")
    if quantity is not None:
        usual = ", ".join(usual_units(quantity.unit)[:3]) or "1"
        return quantity.kind.removeprefix("an ").removeprefix("a ").removeprefix("plain "), usual, form or _span(marks)
    origin = typing.get_origin(bare)
    if find_table(bare) is not None:
        return ("list of tables" if origin is tuple else "table", "none", form or _length(marks) or "the keys below")
    if origin is tuple:
        return _describe_list(bare, marks, form)
    if origin is Literal:
        return "text", "none", ", ".join(f'"{one}"' for one in typing.get_args(bare))
    if origin is dict:
        return "table", "none", form or ""
    plain = {bool: ("true or false", "none", "true, false"), str: ("text", "none", form or "")}
    if bare in plain:
        return plain[bare]
    if bare in (int, float):
        return "whole number" if bare is int else "number", unit, form or _span(marks)
    return "value", unit if any(isinstance(mark, Unit) for mark in marks) else "none", form or ""


def _describe_list(bare: Any, marks: list[Any], form: str | None) -> tuple[str, str, str]:
    parts = [part for part in typing.get_args(bare) if part is not Ellipsis]
    value, unit, span = _describe_value(*unwrap(parts[0]))
    unit = next((mark.name for mark in marks if isinstance(mark, Unit)), unit)
    count = f"{len(parts)} " if Ellipsis not in typing.get_args(bare) else f"{_length(marks)} ".lstrip()
    return f"list of {count}{_plural(value)}", unit, form or span


def _plural(value: str) -> str:
    """Of the first noun: lists of 3 lengths, moments of inertia, flux densities."""
    for link in (" of ", " per ", " or "):
        head, found, tail = value.partition(link)
        if found:
            return f"{_plural(head)}{found}{tail}"
    return f"{value[:-1]}ies" if value.endswith("ty") else f"{value}s"


def _length(marks: list[Any]) -> str:
    """How many elements: "3", "1 to 100"; empty where that is free."""
    low, high = 0, None
    for mark in marks:
        if isinstance(mark, at.Len | at.MinLen):
            low = mark.min_length
        if isinstance(mark, at.Len | at.MaxLen):
            high = mark.max_length
    if high is None:
        return f"at least {low}" if low else ""
    return f"{low}" if low == high else f"{low} to {high}"


def _span(marks: list[Any]) -> str:
    signs = ((at.Gt, "gt", ">"), (at.Ge, "ge", "≥"), (at.Lt, "lt", "<"), (at.Le, "le", "≤"))
    bounds = [
        f"{sign} {bound_text(getattr(mark, name), marks)}"
        for kind, name, sign in signs
        for mark in marks
        if isinstance(mark, kind)
    ]
    return ", ".join(bounds) or "any"
