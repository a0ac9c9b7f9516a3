"""`--serve foxglove[:PORT]`: the live view over WebSocket, to programs of this account on this computer only.

The messages are foxglove-sdk's; the server is haptorb's own. That of the SDK (0.30.3) lets a page of any origin read
along, and drops messages for a slow reader without telling how many.
"""

from __future__ import annotations

import asyncio
import contextlib
import http
import json
import re
import socket
from time import monotonic, time_ns
from typing import Any, final

from websockets.asyncio.server import Server, ServerConnection
from websockets.asyncio.server import serve as serve_websocket
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.typing import Subprotocol

from haptorb.apps.serve.access import Access, choose_serve_token, is_own_connection
from haptorb.apps.serve.foxglove.live_view import LiveView
from haptorb.apps.serve.foxglove.viewer_connection import ViewerConnection
from haptorb.apps.serve.ports import LOOPBACK, check_port, open_port
from haptorb.apps.serve.preparation import ServerPreparation
from haptorb.apps.serve.served_device import ServedDevice

__all__ = ["FORM", "PORT", "is_trusted", "prepare", "serve"]

FORM = "foxglove[:PORT]"
PORT = 8766  #: unless another is given; 8765, which Foxglove proposes, is the console's

_PROTOCOLS = (Subprotocol("foxglove.sdk.v1"), Subprotocol("foxglove.websocket.v1"))
_EVERY = 0.005  #: between two looks for rows [s]
_REPORT = 0.25  #: between two reports [s]
_MOST = 16  #: viewers
_LONGEST = 65536  #: of a viewer's message [bytes]
_UNSENT = 65536  #: bytes that wait in a connection; behind them, messages wait in the viewer's own queue

#: Foxglove in the browser and on the desktop, and pages of this computer, such as a viewer of one's own
_ORIGIN = re.compile(r"https://([a-z0-9-]+\.)*foxglove\.dev|file://|https?://(localhost|127\.0\.0\.1|\[::1\])(:\d+)?")
_HOST = re.compile(r"(localhost|127\.0\.0\.1|\[::1\])(:\d+)?")


def prepare(where: str) -> ServerPreparation:
    """Open the PORT. Raises InputError if it cannot be had."""
    opened = open_port(check_port(where, FORM) if where else PORT, f"--serve {FORM}")
    address = f"ws://{LOOPBACK}:{opened.getsockname()[1]}"
    return ServerPreparation({"address": address, "token": choose_serve_token(LOOPBACK)}, address, [opened.detach()])


def serve(spec: dict[str, Any], descriptors: list[int], served: ServedDevice) -> None:
    """Serve until `served.over`; `spec` and `descriptors` are those of `prepare`."""
    asyncio.run(_FoxgloveServer(served, spec["address"], spec["token"]).run(socket.socket(fileno=descriptors[0])))


def is_trusted(origin: str | None, host: str | None) -> bool:
    """Whether a connection with these headers may look on: a program (no origin), Foxglove, a page of this computer.

    >>> is_trusted("https://app.foxglove.dev", "localhost:8766"), is_trusted("https://example.org", "localhost:8766")
    (True, False)
    """
    if host is None or not _HOST.fullmatch(host.lower()):  # safety: foxglove-host
        return False
    if origin is not None and not _ORIGIN.fullmatch(origin.lower()):  # noqa: SIM103  # safety: foxglove-origin
        return False
    return True


@final
class _FoxgloveServer:
    def __init__(self, served: ServedDevice, address: str, token: str) -> None:
        self._served, self._address, self._access = served, address, Access(token)
        self._view = LiveView(served)
        self._refused = self._dropped = 0
        self._last = monotonic()
        self._counts: dict[ViewerConnection, int] = {}

    async def run(self, opened: socket.socket) -> None:
        async with serve_websocket(
            self._attend, sock=opened, subprotocols=_PROTOCOLS, process_request=self._check, compression=None,
            max_size=_LONGEST, max_queue=4, write_limit=_UNSENT, server_header=None, logger=_make_silent_logger(),
        ) as server:  # fmt: skip
            while not self._served.over:
                self._view.show(self._served.read_rows())
                if monotonic() - self._last >= _REPORT:
                    self._report()
                await asyncio.sleep(_EVERY)
            self._report()
            _abort(server)

    def _check(self, connection: ServerConnection, request: Request) -> Response | None:
        """Refuse pages of other sites, programs of other accounts, and one viewer too many."""
        headers = request.headers
        try:
            trusted = is_trusted(headers.get("Origin"), headers.get("Host"))
        except LookupError:  # a header that stands there twice
            trusted = False
        if not trusted:
            self._refused += 1
            return connection.respond(http.HTTPStatus.FORBIDDEN, "pages of other sites may not connect\n")
        names = {name.lower(): value for name, value in headers.raw_items()}
        names.pop("origin", None)  # `is_trusted` knows Foxglove's own
        transport = connection.transport
        own = is_own_connection(transport.get_extra_info("peername"), transport.get_extra_info("sockname"))
        if refusal := self._access.refuse(LOOPBACK, names, request.path, own=own):
            self._refused += 1
            return connection.respond(http.HTTPStatus.FORBIDDEN, f"{refusal}\n")
        if len(self._view.viewers) >= _MOST:
            self._refused += 1
            return connection.respond(http.HTTPStatus.SERVICE_UNAVAILABLE, f"{_MOST} viewers are already connected\n")
        return None

    async def _attend(self, connection: ServerConnection) -> None:
        address = connection.remote_address or ("?", 0)
        viewer = ViewerConnection(f"{address[0]}:{address[1]}", self._served.open_session(), len(self._view.topics))
        with contextlib.suppress(ConnectionClosed):
            await connection.send(json.dumps(self._describe_server()))
            channels = [topic.describe(number) for number, topic in enumerate(self._view.topics, 1)]
            await connection.send(json.dumps({"op": "advertise", "channels": channels}))
            sending = asyncio.create_task(_send(connection, viewer))
            self._view.viewers.add(viewer)
            try:
                async for text in connection:
                    self._view.welcome(viewer, viewer.take_message(text))
            finally:
                self._view.viewers.discard(viewer)
                self._dropped += viewer.dropped
                self._counts.pop(viewer, None)
                sending.cancel()

    def _describe_server(self) -> dict[str, Any]:
        facts = {key: str(self._served.facts.get(key, "")) for key in ("driver", "tracker", "haptorb")}
        return {
            "op": "serverInfo",
            "name": f"haptorb, {self._served.device.name}",
            "capabilities": [],
            "supportedEncodings": [],
            "metadata": facts,
            "sessionId": str(time_ns()),
        }

    def _report(self) -> None:
        now = monotonic()
        seconds, self._last = max(now - self._last, 1e-3), now
        clients, dropped = [], self._dropped
        for viewer in self._view.viewers:
            rate = (viewer.sent - self._counts.get(viewer, 0)) / seconds
            self._counts[viewer] = viewer.sent
            clients.append({"name": viewer.name, "session": viewer.session, "rate_hz": round(rate, 1), "holds": False})
            dropped += viewer.dropped
        self._served.report("foxglove", self._address, clients, not_sent=dropped, refused=self._refused)


async def _send(connection: ServerConnection, viewer: ViewerConnection) -> None:
    with contextlib.suppress(ConnectionClosed):
        while True:
            await connection.send(await viewer.take())


def _abort(server: Server) -> None:
    """End all connections at once: a viewer that does not read would be waited for."""
    for connection in list(server.connections):
        connection.transport.abort()


def _make_silent_logger() -> Any:
    import logging

    silent = logging.getLogger("haptorb.foxglove")
    silent.addHandler(logging.NullHandler())
    silent.propagate = False
    return silent
