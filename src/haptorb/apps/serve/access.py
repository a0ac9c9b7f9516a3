"""Who may connect: programs and pages of this account on this computer; all others only with the token of this run."""

from __future__ import annotations

import os
import re
import secrets
from collections.abc import Mapping, Sequence
from typing import Any, final
from urllib.parse import urlsplit

from haptorb.apps.serve.ports import is_loopback
from haptorb.errors import InputError
from haptorb.runtime.realtime.socket_owner import is_own_account, tcp_owner

__all__ = ["TOKEN", "Access", "choose_serve_token", "is_own_connection"]

TOKEN = "HAPTORB_SERVE_TOKEN"  #: of the environment: a token that stays the same from one start to the next

_SHORTEST = 16  #: a token that cannot be guessed [characters]
_SHAPE = re.compile(r"[A-Za-z0-9_-]*")


def choose_serve_token(host: str) -> str:
    """What clients beyond this account must show: the one in the environment's HAPTORB_SERVE_TOKEN, else a new one;
    empty, and only this account may connect, without it for a `host` that only this computer reaches.

    Raises InputError if the given one cannot be one.
    """
    given = os.environ.get(TOKEN, "")
    if not given:
        return "" if is_loopback(host) else secrets.token_urlsafe(_SHORTEST)
    if len(given) < _SHORTEST or not _SHAPE.fullmatch(given):
        raise InputError(f"{TOKEN} must have at least {_SHORTEST} letters, digits, - or _; got {len(given)} characters")
    return given


@final
class Access:
    """The rules of one server with its `token`; empty: only programs of this account use it.

    A page of another site could otherwise open a WebSocket to this computer (browsers let it) and move the device: its
    Origin stops it. One that has its own name resolved to 127.0.0.1 is stopped by Host.
    """

    def __init__(self, token: str = "") -> None:
        self._token = token

    def refuse(self, peer: str, headers: Mapping[str, str], target: str, *, own: bool) -> str:
        """Why a request from the address `peer` for `target` may not come in; empty if it may.

        headers: their names in lower case; own: a program of this account on this computer has the connection.
        """
        near = is_loopback(peer)
        origin = headers.get("origin")
        if origin is not None and not _is_local_origin(origin):  # safety: serve-origin
            return f"pages of '{origin[:100]}' may not use this server; open the page from this computer"
        host = headers.get("host", "")
        if near and not is_loopback(_host_of(host)):  # safety: serve-host
            return f"programs of this computer reach this server as localhost or 127.0.0.1, not as '{host[:100]}'"
        if self._is_authorized(headers, target):
            return ""
        if not near:  # safety: serve-token
            return (
                "from another computer this server needs the token that `haptorb run` printed: as header "
                "'Authorization: Bearer TOKEN', or in the address as ?token=TOKEN"
            )
        if not own:  # safety: serve-account
            return (
                "this server is for programs of the account that runs the servo; another account needs the token "
                f"that was set with {TOKEN}, as ?token=TOKEN or as header 'Authorization: Bearer TOKEN'"
            )
        return ""

    def _is_authorized(self, headers: Mapping[str, str], target: str) -> bool:
        if not self._token:
            return False
        tokens = [headers.get("authorization", "").removeprefix("Bearer ")]
        query = target.partition("?")[2].split("&")
        tokens += [one.removeprefix("token=") for one in query if one.startswith("token=")]
        return any(secrets.compare_digest(one.encode(), self._token.encode()) for one in tokens[:2])


def is_own_connection(peer: Sequence[Any] | None, own: Sequence[Any] | None) -> bool:
    """Whether a program of this account on this computer has the other end of a TCP connection, from the address `peer`
    (host, port) to `own`."""
    if not peer or not own or not is_loopback(str(peer[0])):
        return False
    return is_own_account(tcp_owner((peer[0], peer[1]), (own[0], own[1])))


def _host_of(authority: str) -> str:
    """The host in `host:port`, lower case, without a final dot."""
    host = authority.rsplit(":", 1)[0] if not authority.endswith("]") and ":" in authority else authority
    return host.lower().rstrip(".")


def _is_local_origin(origin: str) -> bool:
    """Whether a page with this Origin comes from this computer, through whichever port."""
    try:
        return is_loopback(urlsplit(origin).hostname or "")
    except ValueError:
        return False
