"""What a page asks for: one JSON object per text message, read strictly, and the Stop in it before anything else.

Every message becomes a command, or an InputError that can be sent back: no number is too long
to be handled, nothing is nested deeper than a command is, every text can be written into a file.
"""

from __future__ import annotations

import json
import re
from typing import Any, Never

from haptorb.errors import InputError

__all__ = ["command", "is_stop_request"]

_LONGEST = 65536  #: of a message [characters]; the server's own limit is the same in bytes
_DIGITS = 18  #: of a whole number: what fits into 64 bits
_DEPTH = 6  #: of lists and objects in each other; a world's values need three
_NAME = 64  #: of a command [characters]

_STOP = re.compile(r'"do"\s*:\s*"stop"')


def is_stop_request(text: str) -> bool:
    """Whether a text message is a Stop, however malformed the rest.

    To be asked before `command`: a Stop is obeyed even when the message cannot be read as JSON.

    >>> [is_stop_request(text) for text in ('{"do": "stop"}', '{"do":"stop", "why": 1e999', '{"do": "engage"}')]
    [True, True, False]
    """
    return _STOP.search(text) is not None


def command(text: str) -> dict[str, Any]:
    """The command in a text message, or InputError; its `do` is a text.

    Numbers are finite, whole ones have at most 18 digits.

    >>> command('{"do": "stop"}')
    {'do': 'stop'}
    """
    if len(text) > _LONGEST:
        raise InputError(f"a command must have at most {_LONGEST} characters; got {len(text)}")
    try:
        found = json.loads(text, parse_int=_parse_whole, parse_float=_parse_real, parse_constant=_constant)
    except (ValueError, RecursionError) as mistake:
        raise InputError(f"a command must be JSON: {mistake}") from mistake
    if not isinstance(found, dict):
        raise InputError("a command must be a JSON object")
    _check(found)
    do = found.get("do")
    if not isinstance(do, str) or len(do) > _NAME:
        raise InputError(f'a command must state its action: {{"do": NAME}} with a name of at most {_NAME} characters')
    return found


def _parse_whole(digits: str) -> int:
    if len(digits) > _DIGITS + digits.startswith("-"):
        raise InputError(f"a whole number in a command must have at most {_DIGITS} digits; got {len(digits)}")
    return int(digits)


def _parse_real(digits: str) -> float:
    number = float(digits)
    if number in (float("inf"), float("-inf")):
        raise InputError("a number in a command must be finite; one is too large")
    return number


def _constant(name: str) -> Never:
    raise InputError(f"a number in a command must be finite; got {name}")


def _check(found: dict[str, Any]) -> None:
    """Refuse what is nested too deep, and texts that are none: half of a surrogate pair cannot be stored or sent."""
    level: list[Any] = [found]
    for _ in range(_DEPTH):
        below: list[Any] = []
        for one in level:
            if isinstance(one, dict):
                below.extend(one)
                below.extend(one.values())
            elif isinstance(one, list):
                below.extend(one)
            elif isinstance(one, str) and not _is_storable(one):
                raise InputError("a text in a command must be Unicode; one has half of a surrogate pair")
        level = below
    if level:
        raise InputError(f"a command must not be nested deeper than {_DEPTH} levels")


def _is_storable(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True
