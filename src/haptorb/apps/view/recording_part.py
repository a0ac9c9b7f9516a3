"""Which part of which recording is meant: FILE, or FILE#t=FROM,TO as studies note their trials."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import NamedTuple

from haptorb.errors import InputError, quote

__all__ = ["RecordingPart", "parse_part"]

_PART = re.compile(r"(?P<path>.+)#t=(?P<first>[0-9.eE+-]{1,32}),(?P<last>[0-9.eE+-]{1,32})")


class RecordingPart(NamedTuple):
    """A recording, and what of it: from and to on the loop's clock [s], or None for all of it."""

    path: Path
    span: tuple[float, float] | None


def parse_part(text: str) -> RecordingPart:
    """The part that `text` names; InputError for one whose times are none.

    >>> parse_part("a.mcap#t=1.5,3").span, parse_part("a.mcap").span
    ((1.5, 3.0), None)
    """
    path, mark, _ = text.partition("#t=")
    if not mark or Path(text).exists():  # a file may be called so
        return RecordingPart(Path(text), None)
    found = _PART.fullmatch(text)
    try:
        first, last = (float(found[one]) for one in ("first", "last")) if found else (math.nan, math.nan)
    except ValueError:
        first = last = math.nan
    if not 0 <= last - first < math.inf:
        raise InputError(f"part of a recording must be FILE#t=FROM,TO in seconds, FROM first; got {quote(text)}")
    return RecordingPart(Path(path), (first, last))
