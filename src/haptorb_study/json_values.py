"""Values of results and records as plain JSON types, in which NaN and infinity are null; the time of a record."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from typing import Any

__all__ = ["json_number", "to_json", "utc_now"]


def json_number(value: float) -> float | None:
    """`value` as a float of Python; NaN and infinity become None.

    >>> json_number(0.5), json_number(float("inf"))
    (0.5, None)
    """
    return float(value) if math.isfinite(value) else None


def to_json(value: Any) -> Any:
    """`value` with every float in it converted by `json_number`, and tuples as lists.

    >>> to_json({"mean": float("nan"), "limits": (0.5, float("inf"))})
    {'mean': None, 'limits': [0.5, None]}
    """
    if isinstance(value, dict):
        return {key: to_json(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [to_json(part) for part in value]
    return json_number(value) if isinstance(value, float) else value


def utc_now() -> str:
    """Time of day in UTC to the millisecond, as records and databases store it."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")
