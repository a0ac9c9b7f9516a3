"""Access control of all servers: pages such as the console, and servers for other programs.

Three attacks are prevented. A page of another site could open a WebSocket to 127.0.0.1 (browsers allow it) and move a
powered machine: checked by Origin. A page whose host name resolves to 127.0.0.1 could pass as this server: checked by
Host. A program of another account of this computer could connect: checked by the token, or by the account that owns its
socket.
"""

from __future__ import annotations

import os
import re
import secrets
import socket
from collections.abc import Mapping, Sequence
from ipaddress import ip_address
from typing import TYPE_CHECKING, Any, final
from urllib.parse import urlsplit

from haptorb.errors import InputError

if TYPE_CHECKING:
    from starlette.datastructures import Headers
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

__all__ = [
    "LOOPBACK",
    "PROTOCOL",
    "SERVE_TOKEN",
    "TOKEN",
    "Access",
    "AccessGate",
    "choose_serve_token",
    "choose_token",
    "is_authorized",
    "is_loopback",
    "is_own_connection",
]


# --------------------------------------------------------------------------------------------------
# Names of this computer.


LOOPBACK = "127.0.0.1"
_LOOPBACK_NAMES = frozenset({LOOPBACK, "localhost", "[::1]"})


def is_loopback(host: str) -> bool:
    """Whether `host` is reachable only from this computer.

    >>> is_loopback("localhost"), is_loopback("127.0.0.1"), is_loopback("::1"), is_loopback("0.0.0.0")
    (True, True, True, False)
    """
    if host == "localhost":
        return True
    try:
        return ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def _parse_host(authority: str) -> str:
    """Host of `host:port`, lower case, without a trailing dot."""
    host = authority.rsplit(":", 1)[0] if not authority.endswith("]") and ":" in authority else authority
    return host.lower().rstrip(".")


def _is_own_name(host: str) -> bool:
    """Whether `host` is a numerical address, which cannot be a spoofed host name, or the name of this computer."""
    name = socket.gethostname().lower()
    if host in (name, f"{name.partition('.')[0]}.local"):
        return True
    try:
        ip_address(host.strip("[]"))
    except ValueError:
        return False
    return True


# --------------------------------------------------------------------------------------------------
# Token: requests without it, such as those of other accounts of this computer, are refused.
#
# The address ends in `#TOKEN`. The fragment after # stays in the browser: it is in no request line, log or referrer.
# The page sends the token with every request in the header `Authorization: Bearer TOKEN`, or, because a browser does
# not let a page add headers to a WebSocket, as a subprotocol, `haptorb, token.TOKEN`.


TOKEN = "HAPTORB_TOKEN"  #: environment variable with a token of the pages that stays the same across restarts
SERVE_TOKEN = "HAPTORB_SERVE_TOKEN"  #: the same for the servers of `--serve`
PROTOCOL = "haptorb"  #: the subprotocol that is accepted; the token is offered as a second one

_MIN_TOKEN_CHARACTERS = 16  #: a shorter token could be guessed [characters]
_TOKEN_PATTERN = re.compile(r"[A-Za-z0-9_-]*")


def choose_token() -> str:
    """Return HAPTORB_TOKEN of the environment, or a new token. Raises InputError if the variable is not valid."""
    return _read_token(TOKEN) or secrets.token_urlsafe(_MIN_TOKEN_CHARACTERS)


def choose_serve_token(host: str, *, always: bool = False) -> str:
    """Return the token that clients of other accounts must send: HAPTORB_SERVE_TOKEN of the environment, or a new one.

    Without that variable it is empty for a loopback `host`, except with `always`: only this account may connect.
    Raises InputError if the variable is not a valid token.
    """
    new = always or not is_loopback(host)
    return _read_token(SERVE_TOKEN) or (secrets.token_urlsafe(_MIN_TOKEN_CHARACTERS) if new else "")


def _read_token(variable: str) -> str:
    """Token in the environment `variable`; empty if it is not set."""
    given = os.environ.get(variable, "")
    if given and (len(given) < _MIN_TOKEN_CHARACTERS or not _TOKEN_PATTERN.fullmatch(given)):
        raise InputError(
            f"{variable} must have at least {_MIN_TOKEN_CHARACTERS} letters, digits, - or _; got {len(given)} "
            "characters"
        )
    return given


def _is_token(offered: Sequence[str], token: str) -> bool:
    """Whether one of the first two texts is the `token`; compared in constant time."""
    known = False
    for one in offered[:2]:
        known |= secrets.compare_digest(one.encode(), token.encode())
    return known


def is_authorized(headers: Headers, token: str) -> bool:
    """Whether a request has `token` in a header or as a subprotocol.

    >>> from starlette.datastructures import Headers
    >>> is_authorized(Headers({"authorization": "Bearer abc"}), "abc")
    True
    >>> is_authorized(Headers({"sec-websocket-protocol": "haptorb, token.abd"}), "abc")
    False
    """
    shown = [one.removeprefix("Bearer ") for one in headers.getlist("authorization") if one.startswith("Bearer ")]
    for line in headers.getlist("sec-websocket-protocol"):
        offered = (one.strip() for one in line.split(","))
        shown += [one.removeprefix("token.") for one in offered if one.startswith("token.")]
    return _is_token(shown, token)


# --------------------------------------------------------------------------------------------------
# Pages: only those of this server, under a name of this computer, with the token.


#: content security policy: only this server's own files may be loaded, run, framed or connected to
POLICY = "; ".join(
    (
        "default-src 'none'",
        "script-src 'self'",
        "worker-src 'self'",
        "style-src 'self'",
        "img-src 'self' data: blob:",
        "connect-src 'self'",
        "base-uri 'none'",
        "form-action 'none'",
        "frame-ancestors 'none'",
    )
)

_FRAMED_POLICY = "frame-ancestors 'self'; frame-src 'self'"


class AccessGate:
    """ASGI middleware: checks Host, Origin and token of requests, and adds the content security policy to responses.

    token      empty: no token required
    free       paths without a token, like the files in /static/: the pages contain no data of the device
    framed     whether pages of this server may frame each other; pages of other origins may not, except
    framed_by  origin of another server of this program, whose pages may frame these; empty: none
    exposed    whether other computers reach the server: then any numerical address or its name is a valid Host
    origin     public origin behind a proxy, such as https://lab.example; empty: none
    frames     origins of servers of this program that pages of this one may frame; empty: none
    """

    def __init__(
        self,
        app: ASGIApp,
        *,
        token: str = "",
        free: tuple[str, ...] = ("/",),
        framed: bool = False,
        framed_by: str = "",
        frames: str = "",
        exposed: bool = False,
        origin: str = "",
    ) -> None:
        self.app = app
        self._exposed, self._origin = exposed, origin
        self._policy = POLICY.replace("frame-ancestors 'none'", _FRAMED_POLICY) if framed else POLICY
        if framed_by:
            self._policy = self._policy.replace("frame-ancestors 'none'", f"frame-ancestors {framed_by}")
        if frames:
            self._policy += f"; frame-src {frames}"
        self._token = token
        self._free = free

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        from starlette.datastructures import Headers
        from starlette.responses import PlainTextResponse

        headers = Headers(scope=scope)
        refusal = self.refusal(headers, self._exposed, self._origin)
        # safety: console-token
        if refusal is None and not self._needs_no_token(scope["path"]) and not is_authorized(headers, self._token):
            refusal = "open the full address that the terminal printed, with the part after its #"
        if refusal is None:
            await self.app(scope, receive, _add_policy(send, self._policy))
        elif scope["type"] == "websocket":
            # Closing before accepting makes the server answer 403.
            await send({"type": "websocket.close", "code": 1008, "reason": refusal})
        else:
            await PlainTextResponse(refusal + "\n", status_code=403)(scope, receive, send)

    def _needs_no_token(self, path: str) -> bool:
        return not self._token or path in self._free or path.startswith("/static/")

    @staticmethod
    def refusal(headers: Headers, exposed: bool = False, public: str = "") -> str | None:
        """Reason to refuse a request, or None; arguments are `exposed` and `origin` of the gate."""
        host = headers.get("host", "")
        known = _parse_host(host) in _LOOPBACK_NAMES or (exposed and _is_own_name(_parse_host(host)))
        if not known and not (public and host.lower() == public.partition("://")[2]):
            return f"this server answers on 127.0.0.1 only, not as '{host}'"
        origin = headers.get("origin")
        if public and origin is not None and origin.lower() == public:
            return None
        # Programs send no Origin; browsers always send it with a WebSocket. It is compared as a whole, not parsed.
        if origin is not None and origin.lower() != f"http://{host.lower()}":
            return f"pages of '{origin}' may not use this server"
        return None


def _add_policy(send: Send, policy: str) -> Send:
    """Wrap `send` to add the content security `policy` and further security headers to every response."""

    from starlette.datastructures import MutableHeaders

    async def send_with_policy(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            headers["content-security-policy"] = policy
            headers["x-content-type-options"] = "nosniff"
            headers["referrer-policy"] = "no-referrer"
            headers["cross-origin-resource-policy"] = "same-origin"
            headers["cross-origin-opener-policy"] = "same-origin"
            headers["cache-control"] = "no-cache"
        await send(message)

    return send_with_policy


# --------------------------------------------------------------------------------------------------
# Servers for other programs: those of this account on this computer; all others need the token of the run.


@final
class Access:
    """Access control of one server with its `token`; empty: only programs of this account may use it.

    pages: regular expression of other origins whose pages may use it, beside those of this computer; initially none.
    pages_with_token: the same for origins whose pages may use it with the token.

    A page of another site could open a WebSocket to this computer (browsers allow it) and move the device: the check
    of Origin prevents it. A page whose host name resolves to 127.0.0.1 is refused by the check of Host.
    """

    def __init__(self, token: str = "", pages: str = "(?!)", pages_with_token: str = "(?!)") -> None:
        self._token, self._pages = token, re.compile(pages)
        self._pages_with_token = re.compile(pages_with_token)

    def refuse(self, peer: str, headers: Mapping[str, str], target: str, *, own: bool) -> str:
        """Reason to refuse a request from the address `peer` for `target`; empty: it is accepted.

        headers: names in lower case; own: the client is a program of this account on this computer.
        """
        near = is_loopback(peer)
        origin = headers.get("origin")
        known = origin is None or _is_local_origin(origin) or self._pages.fullmatch(origin.lower()) is not None
        if not known and origin is not None and self._pages_with_token.fullmatch(origin.lower()):
            known = self._is_authorized(headers, target)  # safety: file-page-token
            if not known:
                return (
                    f"pages of '{origin[:100]}' need the token that `haptorb run` printed, in the address as "
                    "?token=TOKEN"
                )
        if not known:  # safety: serve-origin
            return f"pages of '{str(origin)[:100]}' may not use this server; open the page from this computer"
        host = headers.get("host", "")
        if near and not is_loopback(_parse_host(host)):  # safety: serve-host
            return f"programs of this computer reach this server as localhost or 127.0.0.1, not as '{host[:100]}'"
        if self._is_authorized(headers, target):
            return ""
        if near and own:  # safety: serve-account
            return ""
        if near:
            return (
                "this server is for programs of the account that runs the servo; another account needs the token "
                f"that was set with {SERVE_TOKEN}, as ?token=TOKEN or as header 'Authorization: Bearer TOKEN'"
            )
        return (
            "from another computer this server needs the token that `haptorb run` printed: as header "
            "'Authorization: Bearer TOKEN', or in the address as ?token=TOKEN"
        )

    def _is_authorized(self, headers: Mapping[str, str], target: str) -> bool:
        if not self._token:
            return False
        tokens = [headers.get("authorization", "").removeprefix("Bearer ")]
        query = target.partition("?")[2].split("&")
        tokens += [one.removeprefix("token=") for one in query if one.startswith("token=")]
        return _is_token(tokens, self._token)


def is_own_connection(peer: Sequence[Any] | None, own: Sequence[Any] | None) -> bool:
    """Whether the client of a TCP connection from `peer` (host, port) to `own` runs under this account on this
    computer."""
    from haptorb.runtime.sockets import is_own_account, tcp_owner  # imported here: pages need none of it

    if not peer or not own or not is_loopback(str(peer[0])):
        return False
    return is_own_account(tcp_owner((peer[0], peer[1]), (own[0], own[1])))


def _is_local_origin(origin: str) -> bool:
    """Whether this Origin is a page of this computer, on any port."""
    try:
        parts = urlsplit(origin)
        return parts.scheme in ("http", "https") and is_loopback(parts.hostname or "")
    except ValueError:
        return False
