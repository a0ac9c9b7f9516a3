"""HTTP on the port of the WebSocket: short requests, answered in JSON."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any, final

import h11

from haptorb.apps.serve.access import Access
from haptorb.numerics.record import record

__all__ = ["HttpExchange", "HttpReply", "read_headers"]

_BODY = 65536  #: longest body of a request [bytes]


@record
class HttpReply:
    """The answer to a request: a status, and what its body says as JSON."""

    status: int
    body: Any


def read_headers(head: bytes) -> dict[str, str]:
    """The headers in the `head` of a request, their names in lower case.

    >>> read_headers(b"GET / HTTP/1.1\\r\\nHost: localhost\\r\\nUpgrade: websocket")
    {'host': 'localhost', 'upgrade': 'websocket'}
    """
    found = {}
    for line in head.decode("latin-1").split("\r\n")[1:]:
        name, colon, value = line.partition(":")
        if colon:
            found[name.strip().lower()] = value.strip()
    return found


@final
class HttpExchange:
    """Requests from `peer`, one after the other, each answered by `reply(method, target, body)`.

    own   whether a program of this account has the connection

    over  whether the connection is to be closed
    """

    def __init__(self, access: Access, peer: str, reply: Callable[[str, str, bytes], HttpReply], *, own: bool) -> None:
        self.over = False
        self._access, self._peer, self._reply, self._own = access, peer, reply, own
        self._connection = h11.Connection(h11.SERVER)
        self._request: h11.Request | None = None
        self._body = b""

    def receive(self, data: bytes) -> bytes:
        """What is to be sent after `data` has come."""
        answer = b""
        try:
            self._connection.receive_data(data)
            while True:
                event = self._connection.next_event()
                if event is h11.NEED_DATA or event is h11.PAUSED:
                    return answer
                if isinstance(event, h11.Request):
                    self._request, self._body = event, b""
                elif isinstance(event, h11.Data):
                    self._body += bytes(event.data)
                    if len(self._body) > _BODY:
                        return answer + self._write(
                            HttpReply(413, {"ok": False, "error": "the body is too long"}), None
                        )
                elif isinstance(event, h11.EndOfMessage):
                    answer += self._answer()
                    if self._connection.our_state is not h11.DONE:
                        self.over = True
                        return answer
                    self._connection.start_next_cycle()
                else:
                    self.over = True
                    return answer
        except h11.RemoteProtocolError as cause:
            self.over = True
            return answer + self._write(HttpReply(cause.error_status_hint, {"ok": False, "error": str(cause)}), None)
        except h11.LocalProtocolError:  # it has closed already
            self.over = True
            return answer

    def _answer(self) -> bytes:
        assert self._request is not None
        headers = {name.decode("latin-1"): value.decode("latin-1") for name, value in self._request.headers}
        target, method = self._request.target.decode("latin-1"), self._request.method.decode("latin-1")
        if refusal := self._access.refuse(self._peer, headers, target, own=self._own):
            return self._write(HttpReply(403, {"ok": False, "error": refusal}), None)
        origin = headers.get("origin")
        if method == "OPTIONS":
            return self._write(HttpReply(204, None), origin)
        return self._write(self._reply(method, target, self._body), origin)

    def _write(self, reply: HttpReply, origin: str | None) -> bytes:
        """`reply` for a page of `origin`, which was let in; None: for a program."""
        body = b"" if reply.body is None else json.dumps(reply.body).encode()
        headers = [("Content-Type", "application/json"), ("Content-Length", str(len(body)))]
        if origin is not None:
            headers += [
                ("Access-Control-Allow-Origin", origin),
                ("Access-Control-Allow-Methods", "GET, POST, DELETE"),
                ("Access-Control-Allow-Headers", "content-type, authorization"),
            ]
        if reply.status >= 400 and self._request is None:
            headers.append(("Connection", "close"))
        if self._connection.our_state not in (h11.IDLE, h11.SEND_RESPONSE):
            self.over = True
            return b""
        parts = [
            self._connection.send(h11.Response(status_code=reply.status, headers=headers)),
            self._connection.send(h11.Data(data=body)) if body else b"",
            self._connection.send(h11.EndOfMessage()),
        ]
        return b"".join(part or b"" for part in parts)
