"""Who may come in: only pages of this server itself, under the name of this computer, that know the token.

A page of another site could otherwise open a WebSocket to 127.0.0.1 (browsers let it) and move a powered machine; one
that has its own name resolved to 127.0.0.1 could pretend to be this server; and so could any program of another account
of this computer. Origin stops the first, Host the second, the token the third.
"""

from __future__ import annotations

import os
import re
import secrets
import socket
from ipaddress import ip_address

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from haptorb.errors import InputError

__all__ = ["LOOPBACK", "PROTOCOL", "TOKEN", "AccessGate", "choose_token", "is_authorized"]


# --------------------------------------------------------------------------------------------------
# The token in a program's address: who does not know it is another account of this computer, and may do nothing.
#
# The address ends in `#TOKEN`. What stands behind the # stays in the browser: it is in no request line, no log and no
# referrer. The page shows the token in a header of every request, `Authorization: Bearer TOKEN`, or, because a browser
# lets a page add no header to a WebSocket, as a subprotocol, `haptorb, token.TOKEN`.


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


#: the names of this computer for itself
LOOPBACK = frozenset({"127.0.0.1", "localhost", "[::1]"})

#: nothing but this server's own files may be loaded, run, framed or talked to
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

_FRAMED = "frame-ancestors 'self'; frame-src 'self'"


def _host(authority: str) -> str:
    """The host in `host:port`, lower case, without a final dot."""
    host = authority.rsplit(":", 1)[0] if not authority.endswith("]") and ":" in authority else authority
    return host.lower().rstrip(".")


def _is_own_name(host: str) -> bool:
    """Whether `host` is a numerical address, which no other site can have resolved to this computer, or its name."""
    name = socket.gethostname().lower()
    if host in (name, f"{name.partition('.')[0]}.local"):
        return True
    try:
        ip_address(host.strip("[]"))
    except ValueError:
        return False
    return True


class AccessGate:
    """ASGI middleware: checks Host, Origin and token on the way in, and adds the content policy on the way out.

    token   empty: none is needed
    free    paths that need no token, as the files in /static/ never do: a page alone says nothing about the device
    framed  whether pages of this server may stand in frames of each other; of others they never may, but for
    framed_by  the origin of another server of this program, whose pages may frame these; empty: none may
    exposed  the server listens beyond this computer: it may be called by any numerical address, or by its name
    origin  where browsers find it behind a proxy, such as https://lab.example; empty: nowhere else
    frames  origins of servers of this program that pages of this one may frame; empty: none
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
        self._policy = POLICY.replace("frame-ancestors 'none'", _FRAMED) if framed else POLICY
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
        headers = Headers(scope=scope)
        refusal = self.refusal(headers, self._exposed, self._origin)
        # safety: console-token
        if refusal is None and not self._open(scope["path"]) and not is_authorized(headers, self._token):
            refusal = "open the full address that the terminal printed, with the part after its #"
        if refusal is None:
            await self.app(scope, receive, _add_policy(send, self._policy))
        elif scope["type"] == "websocket":
            # Closing before accepting makes the server answer 403.
            await send({"type": "websocket.close", "code": 1008, "reason": refusal})
        else:
            await PlainTextResponse(refusal + "\n", status_code=403)(scope, receive, send)

    def _open(self, path: str) -> bool:
        return not self._token or path in self._free or path.startswith("/static/")

    @staticmethod
    def refusal(headers: Headers, exposed: bool = False, public: str = "") -> str | None:
        """Why this request may not come in, or None; arguments as `exposed` and `origin` of the gate."""
        host = headers.get("host", "")
        known = _host(host) in LOOPBACK or (exposed and _is_own_name(_host(host)))
        if not known and not (public and host.lower() == public.partition("://")[2]):
            return f"this server answers on 127.0.0.1 only, not as '{host}'"
        origin = headers.get("origin")
        if public and origin is not None and origin.lower() == public:
            return None
        # Programs send no Origin; browsers always send it with a WebSocket. It is compared, never taken apart.
        if origin is not None and origin.lower() != f"http://{host.lower()}":
            return f"pages of '{origin}' may not use this server"
        return None


def _add_policy(send: Send, policy: str) -> Send:
    """`send`, with the content `policy` on every answer."""

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
