"""What a page asks for: one JSON object per text message."""

from __future__ import annotations

import json
from typing import Any

from haptorb.errors import InputError

__all__ = ["command"]


def command(text: str) -> dict[str, Any]:
    """The command in a text message, or InputError.

    >>> command('{"do": "stop"}')
    {'do': 'stop'}
    """
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as mistake:
        raise InputError(f"a command must be JSON: {mistake}") from mistake
    if not isinstance(found, dict):
        raise InputError("a command must be a JSON object")
    return found
