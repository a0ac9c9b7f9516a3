"""Who may come in: only pages of this server itself, under the name of this computer, that know the token.

A page of another site could otherwise open a WebSocket to 127.0.0.1 (browsers let it) and move a powered machine; one
that has its own name resolved to 127.0.0.1 could pretend to be this server; and so could any program of another account
of this computer. Origin stops the first, Host the second, the token the third.
"""

from __future__ import annotations

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from haptorb.apps.web.token import is_authorized

__all__ = ["LOOPBACK", "AccessGate"]

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


class AccessGate:
    """ASGI middleware: checks Host, Origin and token on the way in, and adds the content policy on the way out.

    token   empty: none is needed
    free    paths that need no token, as the files in /static/ never do: a page alone says nothing about the device
    framed  whether pages of this server may stand in frames of each other; of others they never may, but for
    framed_by  the origin of another server of this program, whose pages may frame these; empty: none may
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
    ) -> None:
        self.app = app
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
        refusal = self.refusal(headers)
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
    def refusal(headers: Headers) -> str | None:
        """Why this request may not come in, or None."""
        host = headers.get("host", "")
        if _host(host) not in LOOPBACK:
            return f"this server answers on 127.0.0.1 only, not as '{host}'"
        origin = headers.get("origin")
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
