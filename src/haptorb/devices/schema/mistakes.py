"""pydantic's errors as sentences: where, what was expected in the file's own words and units, and what was got."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sized
from difflib import get_close_matches
from typing import Any

from pydantic import BaseModel

from haptorb.devices.schema.key import Form, find_key, find_table
from haptorb.devices.schema.key_text import bound_text, meaning_of
from haptorb.errors import quote

__all__ = ["explain_mistakes"]

_BOUNDS = {
    "greater_than": ("gt", "greater than"),
    "greater_than_equal": ("ge", "at least"),
    "less_than": ("lt", "less than"),
    "less_than_equal": ("le", "at most"),
}
_KINDS = {
    "string_type": "text in quotes",
    "bool_type": "true or false",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "float_type": "a number",
    "finite_number": "a finite number",
    "tuple_type": "a list",
    "dict_type": "a table",
    "model_type": "a table",
    "model_attributes_type": "a table",
}


def explain_mistakes(errors: Iterable[Any], model: type[BaseModel], most: int = 40) -> list[str]:
    """One sentence per error of `model`, each beginning with the key; elements of lists count from 1.

    After `most` of them the rest is counted. Left out: that a list is too short where only its elements are wrong,
    which pydantic says as well.
    """
    sentences = list(dict.fromkeys(_explain(error, model) for error in errors if not _is_echo(error)))
    if len(sentences) > most:
        sentences[most:] = [f"and {len(sentences) - most} more mistakes"]
    return sentences


def _is_echo(error: Any) -> bool:
    """Whether the list that "has 0 items" has enough of them in the file."""
    got, least = error.get("input"), error.get("ctx", {}).get("min_length")
    return error["type"] == "too_short" and isinstance(got, list | tuple | dict) and len(got) >= least


def _explain(error: Any, model: type[BaseModel]) -> str:
    path = [part for part in error["loc"] if part != "[key]"]
    where = ".".join(quote(part)[1:-1] if isinstance(part, str) else str(part + 1) for part in path)
    what = _explain_value(error, model, path)
    return f"{where} {what}" if where else what


def _explain_value(error: Any, model: type[BaseModel], path: list[Any]) -> str:
    kind, got, context = error["type"], error.get("input"), error.get("ctx", {})
    found = find_key(model, path)
    marks = [] if found is None else found[1]
    if kind == "extra_forbidden":
        known = _list_keys(model, path[:-1])
        near = get_close_matches(str(path[-1])[:60], known, n=1, cutoff=0.5)
        return "is not a known key" + (f"; did you mean '{near[0]}'?" if near else "")
    if kind == "missing":
        meaning = meaning_of(marks)
        return f"is missing: {meaning}" if meaning else "is missing"
    if kind == "value_error":
        return str(context["error"])
    if kind in ("too_short", "too_long"):
        return _length(kind, got, context)
    if kind in _BOUNDS:
        name, words = _BOUNDS[kind]
        return f"must be {words} {bound_text(float(context[name]), marks)}; got {quote(got)}"
    form = next((mark.text for mark in marks if isinstance(mark, Form)), None)
    if kind.startswith("string_") and kind != "string_type" and form:
        return f"must be {form}; got {quote(got)}"
    if kind == "literal_error":
        near = get_close_matches(str(got)[:60], [part.strip(" '") for part in _alternatives(context)], n=1, cutoff=0.5)
        hint = f"; did you mean '{near[0]}'?" if near else ""
        return f"must be {context['expected']}; got {quote(got)}{hint}"
    if kind in _KINDS:
        return f"must be {_KINDS[kind]}; got {quote(got)}"
    return f"{error['msg'].replace('Input should', 'must')}; got {quote(got)}"


def _length(kind: str, got: Any, context: Mapping[str, Any]) -> str:
    """How many elements a list, or names a table, must have; never pydantic's count, which leaves out wrong ones."""
    word, bound = ("at least", "min_length") if kind == "too_short" else ("at most", "max_length")
    count = context[bound]
    things = "entry" if count == 1 else "entries"
    many = len(got) if isinstance(got, Sized) else 0
    return f"must have {word} {count} {things}; got {many or 'none'}"


def _alternatives(context: Mapping[str, Any]) -> list[str]:
    return str(context["expected"]).replace(" or ", ",").split(",")


def _list_keys(model: type[BaseModel], path: list[Any]) -> list[str]:
    found = find_key(model, path)
    inner = None if found is None else find_table(found[0])
    return [] if inner is None else list(inner.model_fields)
