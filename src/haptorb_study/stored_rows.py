"""Validation of the rows of a study database, which may be damaged or foreign.

Rows are checked once, when a database is opened, so that commands need not handle invalid values.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from math import isfinite
from typing import Any

from sqlalchemy import Connection, Table, select, type_coerce
from sqlalchemy.types import NullType

from haptorb.errors import RecordingError, quote
from haptorb.files import parse_json
from haptorb_study.prompts import Prompt

__all__ = ["MAX_PLAN_CHARACTERS", "check_rows"]

Check = Callable[[Any], bool]

_MAX_TEXT_CHARACTERS = 256 * 1024  #: maximum length of a text [characters]
MAX_PLAN_CHARACTERS = 64 * 1024 * 1024  #: maximum length of a session's plan [characters], about 240 for each trial
_MAX_NUMBER = 1e15  #: maximum of any number
_PROMPT = {field.name: field.default for field in fields(Prompt)}


def _is_text(value: Any) -> bool:
    return isinstance(value, str) and len(value) <= _MAX_TEXT_CHARACTERS and "\0" not in value


def _is_word(value: Any) -> bool:
    return _is_text(value) and 0 < len(value) <= 200 and value.isprintable()


def _is_path(value: Any) -> bool:
    return _is_text(value) and 0 < len(value) <= 4200 and value.isprintable()


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and isfinite(value) and abs(value) < _MAX_NUMBER


def _is_count(value: Any) -> bool:
    return isinstance(value, int) and 0 <= value < _MAX_NUMBER


def _is_flag(value: Any) -> bool:
    return value in (0, 1) and isinstance(value, int)


def _is_object(value: Any) -> bool:
    return isinstance(_read(value), Mapping)


def _is_plan(value: Any) -> bool:
    return isinstance(value, str) and isinstance(_read(value, MAX_PLAN_CHARACTERS), Mapping)


def _is_prompt(value: Any) -> bool:
    found = _read(value)
    if not isinstance(found, Mapping):
        return False
    for key, usual in _PROMPT.items():
        one = found.get(key, usual)
        if isinstance(usual, tuple):
            fits = isinstance(one, list | tuple) and all(_is_number(number) for number in one)
        elif isinstance(usual, bool):
            fits = isinstance(one, bool)
        elif isinstance(usual, str):
            fits = _is_text(one)
        else:
            fits = _is_number(one) and not isinstance(one, bool) and (isinstance(usual, float) or one == int(one))
        if not fits:
            return False
    return {"phase", "condition", "other", "set_point", "level", "interval"} <= set(found)


def _is_trips(value: Any) -> bool:
    found = _read(value)
    return isinstance(found, list) and len(found) < 10_000 and all(isinstance(one, dict | str) for one in found)


def _is_copy_kind(value: Any) -> bool:
    return value in ("export", "backup", "source", "merged")


def _is_copy_settings(value: Any) -> bool:
    found = _read(value, MAX_PLAN_CHARACTERS)
    if not isinstance(found, Mapping):
        return False
    codes, kind = found.get("codes", {}), found.get("data")
    return isinstance(codes, Mapping) and all(map(_is_word, codes.values())) and (kind is None or _is_word(kind))


def _or_nothing(check: Check) -> Check:
    return lambda value: value is None or check(value)


def _read(value: Any, most: int = _MAX_TEXT_CHARACTERS) -> Any:
    try:
        return parse_json(value) if isinstance(value, str) and len(value) <= most and "\0" not in value else None
    except ValueError:
        return None


#: table → column → (expected value, check)
_RULES: Mapping[str, Mapping[str, tuple[str, Check]]] = {
    "studies": {"name": ("a name", _is_word), "text": ("a study file", _is_text)},
    "participants": {"code": ("a code", _is_word), "ordinal": ("a whole number from 0", _is_count)},
    "sessions": {
        "plan": ("a plan (JSON)", _is_plan),
        "simulated": ("0 or 1", _is_flag),
        "aborted": ("0 or 1", _is_flag),
        "started": ("a time", _is_word),
        "ended": ("a time, or nothing", _or_nothing(_is_word)),
        "versions": ("versions (JSON)", _is_object),
    },
    "trials": {
        "number": ("a whole number from 0", _is_count),
        "prompt": ("what was asked (JSON)", _is_prompt),
        "answer": ("a number, or nothing", _or_nothing(_is_number)),
        **{axis: ("a position in metres, or nothing", _or_nothing(_is_number)) for axis in "xyz"},
        "seconds": ("a time in seconds", _is_number),
        "safety": ("a list of trips (JSON)", _is_trips),
        "recording": ("the file of a recording, or nothing", _or_nothing(_is_path)),
        "answered": ("a time", _is_word),
        "driver": ("a driver, or nothing", _or_nothing(_is_word)),
    },
    "events": {
        "kind": ("a word", _is_word),
        "trial": ("a whole number from 0", _is_count),
        "text": ("a text", _is_text),
    },
    "replies": {"question": ("a name", _is_word), "reply": ("a text", _is_text)},
    "withdrawn": {
        "code": ("a code", _is_word),
        "ordinal": ("a whole number from 0", _is_count),
        "at": ("a time", _is_word),
        "text": ("a text", _is_text),
    },
    "copies": {
        "kind": ("export, backup, source or merged", _is_copy_kind),
        "place": ("a path or an address", _is_path),
        "study": ("a name, or an empty text", _is_text),
        "settings": ("settings (JSON)", _is_copy_settings),
    },
}


def check_rows(connection: Connection, tables: Mapping[str, Table], where: str) -> None:
    """Raise RecordingError for the first invalid value in the `tables`; `where` names the database.

    Values are read as stored, without the conversion of the column's type.
    """
    known: set[tuple[str, str, Any]] = set()  # prompts recur
    for name, rules in _RULES.items():
        keys = [column.name for column in tables[name].primary_key]
        columns = [*keys, *(one for one in rules if one not in keys)]
        raw = (type_coerce(tables[name].c[one], NullType()).label(one) for one in columns)
        for row in connection.execute(select(*raw)).yield_per(1000):
            values = row._mapping
            for column, (what, check) in rules.items():
                value = values[column]
                if isinstance(value, str) and (name, column, value) in known:
                    continue
                if not check(value):  # safety: database-rows
                    place = ", ".join(f"{key} {quote(values[key])}" for key in keys)
                    raise RecordingError(
                        f"{where} is damaged, or not written by haptorb: '{column}' in table '{name}' ({place}) "
                        f"must be {what}; got {quote(value)}. Nothing was changed; use a copy from before"
                    )
                if isinstance(value, str) and len(known) < 100_000:
                    known.add((name, column, value))
