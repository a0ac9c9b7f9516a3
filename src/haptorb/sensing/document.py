"""A JSON file that people keep: of one format, with all of its keys and no others."""

from __future__ import annotations

import json
from collections.abc import Mapping, Set
from typing import Any

from haptorb.errors import CalibrationError

__all__ = ["document"]


def document(text: str, name: str, kind: str, wanted: str, keys: Set[str], remedy: str) -> Mapping[str, Any]:
    """What `text` says, a `kind` of format `wanted` with `keys`; `name` is what mistakes are reported under.

    Raises CalibrationError, with what to do about it, for anything else.

    >>> document('{"format": "a 1", "x": 2}', "FILE", "a", "a 1", {"format", "x"}, "make it again")["x"]
    2
    """
    try:
        raw = json.loads(text)
    except ValueError as cause:
        raise CalibrationError(f"{name} is not JSON: {cause}") from cause
    if not isinstance(raw, Mapping) or raw.get("format") != wanted:
        found = raw.get("format") if isinstance(raw, Mapping) else type(raw).__name__
        raise CalibrationError(f"{name} is no {kind} that this version reads: format must be '{wanted}'; got {found!r}")
    missing, strange = keys - set(raw), set(raw) - keys
    if missing or strange:
        what = f"{min(missing)} is missing" if missing else f"{min(strange)} is not a key that is known"
        raise CalibrationError(f"{name}: {what}; {remedy}")
    return raw
