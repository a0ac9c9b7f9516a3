"""The lines of a session's file: ratings, feelings, the choice; one JSON object each, read strictly."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import MISSING, asdict, dataclass, fields
from datetime import UTC, datetime
from typing import Any

from haptorb.files.text_file import parse_json

__all__ = ["Choice", "DesignRating", "Feeling", "Record", "parse_records", "utc_now", "write_line"]


@dataclass(frozen=True)
class DesignRating:
    """What a person said of a design after feeling it."""

    design: str
    digest: str
    score: int
    person: str
    comment: str
    time: str
    trace: str = ""
    feeling: str = ""  #: which time it was felt; a later rating of the same feeling replaces an earlier one
    blind: bool = False  #: whether the designs were hidden from the person


@dataclass(frozen=True)
class Feeling:
    """One design felt once by one person, from when it was chosen until the next one."""

    design: str
    digest: str
    person: str
    time: str
    trace: str
    feeling: str = ""
    blind: bool = False
    scale: float = 1.0  #: all torques of the handle times this


@dataclass(frozen=True)
class Choice:
    """The design that was settled on, and why."""

    design: str
    digest: str
    person: str
    comment: str
    time: str


Record = DesignRating | Feeling | Choice

_KINDS: dict[str, type[Record]] = {"rating": DesignRating, "feeling": Feeling, "choice": Choice}
_TYPES: dict[str, tuple[type, ...]] = {"score": (int,), "blind": (bool,), "scale": (int, float)}  # others are texts


def write_line(record: Record) -> str:
    """`record` as one line of JSON, without its end."""
    kind = next(name for name, known in _KINDS.items() if isinstance(record, known))
    return json.dumps({"kind": kind, **asdict(record)}, ensure_ascii=False)


def parse_records(lines: Iterable[str]) -> tuple[list[Record], int]:
    """The records in `lines`, and how many lines that are not empty hold none: cut short by a crash, or foreign."""
    found: list[Record] = []
    skipped = 0
    for line in lines:
        record = _parse_record(line)
        if record is None:
            skipped += bool(line.strip())
        else:
            found.append(record)
    return found, skipped


def _parse_record(line: str) -> Record | None:
    try:
        values: dict[str, Any] = parse_json(line)
        kind = _KINDS[values.pop("kind")]
    except (ValueError, AttributeError, KeyError, TypeError):
        return None
    known = {field.name: field.default is MISSING for field in fields(kind)}
    needed = {name for name, must in known.items() if must}
    if not needed <= set(values) <= set(known):
        return None
    for name, value in values.items():
        wanted = _TYPES.get(name, (str,))
        if not isinstance(value, wanted) or (isinstance(value, bool) and bool not in wanted):
            return None
    return kind(**values)


def utc_now() -> str:
    """The time of a record."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")
