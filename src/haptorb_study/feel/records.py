"""Records of a session's file: ratings, presentations, choice; one JSON object per line, parsed strictly."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import MISSING, asdict, dataclass, fields
from typing import Any

from haptorb.files import parse_json

__all__ = ["Choice", "DesignRating", "Feeling", "Record", "parse_records", "write_line"]


@dataclass(frozen=True)
class DesignRating:
    """A person's rating of a design."""

    design: str
    digest: str
    score: int
    person: str
    comment: str
    time: str
    trace: str = ""
    feeling: str = ""  #: presentation that was rated; a later rating of the same presentation replaces an earlier one
    blind: bool = False  #: whether the designs were hidden from the person


@dataclass(frozen=True)
class Feeling:
    """One presentation of a design to one person."""

    design: str
    digest: str
    person: str
    time: str
    trace: str
    feeling: str = ""
    blind: bool = False
    scale: float = 1.0  #: factor of all torques of the handle


@dataclass(frozen=True)
class Choice:
    """The selected design, and the reason."""

    design: str
    digest: str
    person: str
    comment: str
    time: str


Record = DesignRating | Feeling | Choice

_KINDS: dict[str, type[Record]] = {"rating": DesignRating, "feeling": Feeling, "choice": Choice}
_TYPES: dict[str, tuple[type, ...]] = {"score": (int,), "blind": (bool,), "scale": (int, float)}  # others are strings


def write_line(record: Record) -> str:
    """`record` as one line of JSON, without line end."""
    kind = next(name for name, known in _KINDS.items() if isinstance(record, known))
    return json.dumps({"kind": kind, **asdict(record)}, ensure_ascii=False)


def parse_records(lines: Iterable[str]) -> tuple[list[Record], int]:
    """Records in `lines`, and the number of invalid lines: truncated by a crash, or foreign."""
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
