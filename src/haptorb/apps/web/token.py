"""The token in a program's address: who does not know it is another account of this computer, and may do nothing.

The address ends in `#TOKEN`. What stands behind the # stays in the browser: it is in no request line, no log and no
referrer. The page shows the token in a header of every request, `Authorization: Bearer TOKEN`, or, because a browser
lets a page add no header to a WebSocket, as a subprotocol, `haptorb, token.TOKEN`.
"""

from __future__ import annotations

import os
import re
import secrets

from starlette.datastructures import Headers

from haptorb.errors import InputError

__all__ = ["PROTOCOL", "TOKEN", "choose_token", "is_authorized"]

TOKEN = "HAPTORB_TOKEN"  #: of the environment: a token that stays the same from one start to the next
PROTOCOL = "haptorb"  #: the subprotocol that is accepted; the token is offered as a second one

_SHORTEST = 16  #: a token that cannot be guessed [characters]
_SHAPE = re.compile(r"[A-Za-z0-9_-]*")


def choose_token() -> str:
    """A new token, or the one in the environment's HAPTORB_TOKEN; InputError if that cannot be one."""
    given = os.environ.get(TOKEN, "")
    if not given:
        return secrets.token_urlsafe(_SHORTEST)
    if len(given) < _SHORTEST or not _SHAPE.fullmatch(given):
        raise InputError(f"{TOKEN} must have at least {_SHORTEST} letters, digits, - or _; got {len(given)} characters")
    return given


def is_authorized(headers: Headers, token: str) -> bool:
    """Whether a request shows `token`, in a header or as a subprotocol; compared in constant time.

    >>> is_authorized(Headers({"authorization": "Bearer abc"}), "abc")
    True
    >>> is_authorized(Headers({"sec-websocket-protocol": "haptorb, token.abd"}), "abc")
    False
    """
    shown = [one.removeprefix("Bearer ") for one in headers.getlist("authorization") if one.startswith("Bearer ")]
    for line in headers.getlist("sec-websocket-protocol"):
        offered = (one.strip() for one in line.split(","))
        shown += [one.removeprefix("token.") for one in offered if one.startswith("token.")]
    known = False
    for one in shown[:2]:
        known |= secrets.compare_digest(one.encode(), token.encode())
    return known
