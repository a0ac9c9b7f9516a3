"""One connection on one of the two ports: a WebSocket that is answered at once, or a request over HTTP.

Messages are answered where they arrive, without a task or a queue between. Two are answered in a row, then another
connection has its turn; a client that does not read its replies is no longer read, and is closed after ten seconds.
A client that sends unreadable messages is read again a little later, a refused one is told so a little later, and
what follows a message
that is too long is thrown away: none of them takes the processor from the others.
"""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from collections import deque
from time import monotonic
from typing import cast, final

from websockets.frames import Frame, Opcode
from websockets.http11 import Request, Response
from websockets.protocol import OPEN
from websockets.server import ServerProtocol

from haptorb.apps.serve.access import Access, is_own_connection
from haptorb.apps.serve.haply.http_exchange import HttpExchange, HttpReply, read_headers
from haptorb.runtime.realtime.arrival_time import STALL, StreamTimes

__all__ = ["Connection", "Endpoint"]

_ROOM = 4096  #: bytes that are read at once: a flood of small messages does not keep the others waiting
_MESSAGE = 65536  #: longest message [bytes]
_PARTS = 256  #: of one message: a client that never ends it must not fill the memory with empty ones
_HEAD = 16384  #: of a request [bytes]
_IN_A_ROW = 2  #: messages of one client that are answered before others have their turn
_UNREAD = 65536  #: bytes of answers that may wait for a client that does not read
_PATIENCE = 10.0  #: for a request, or for a client to read [s]
_REST = 0.005  #: after a message that cannot be read [s]
_REFUSAL = 0.05  #: before a refusal: a client that retries at once does so twenty times a second [s]
_WASTE = 262144  #: bytes that are thrown away at once
_FAREWELL = 1.0  #: for a client whose message was too long to read why [s]


class Endpoint(ABC):
    """What stands behind a port."""

    access: Access
    alive: float  #: when this process last looked for what came, on the monotonic clock [s]
    connections: set[Connection]
    room: int  #: how many connections there may be at once

    @abstractmethod
    def open(self, connection: Connection) -> None:
        """A WebSocket is open: send it what it must know."""

    @abstractmethod
    def answer(self, connection: Connection, message: bytes, arrival: float) -> str | None:
        """The answer to a message that came at `arrival` on the monotonic clock [s]; None: there is none. A message
        that cannot be read lets the connection `rest`."""

    @abstractmethod
    def close(self, connection: Connection) -> None:
        """The connection is lost, however it ended."""

    @abstractmethod
    def reply(self, method: str, target: str, body: bytes) -> HttpReply:
        """The answer to a request over HTTP."""


@final
class Connection(asyncio.BufferedProtocol):
    """A client of `endpoint`, at the address `peer`."""

    def __init__(self, endpoint: Endpoint) -> None:
        self.endpoint, self.peer, self._own = endpoint, "", False
        self._times, self._descriptor, self._arrival = StreamTimes(), -1, 0.0
        self._buffer = bytearray(_ROOM)
        self._head = b""
        self._websocket: ServerProtocol | None = None
        self._exchange: HttpExchange | None = None
        self._open = self._paused = self._failed = self._rests = False
        self._parts: list[bytes] = []  # of a message that comes in several frames
        self._waiting: deque[tuple[float, bytes]] = deque()  # whole messages, each with its arrival [s]
        self._timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """A client has connected."""
        self._transport = cast(asyncio.Transport, transport)
        self._transport.set_write_buffer_limits(high=_UNREAD)
        peer, self._descriptor = transport.get_extra_info("peername"), transport.get_extra_info("socket").fileno()
        self.peer = str((peer or ("",))[0])
        self._own = is_own_connection(peer, transport.get_extra_info("sockname"))
        self.endpoint.connections.add(self)
        self._wait()
        if len(self.endpoint.connections) > self.endpoint.room:
            self._transport.write(b"HTTP/1.1 503 Service Unavailable\r\nContent-Length: 0\r\nConnection: close\r\n\r\n")
            self._transport.close()

    def get_buffer(self, sizehint: int) -> bytearray:
        """Where the next bytes go."""
        return self._buffer

    def buffer_updated(self, nbytes: int) -> None:
        """Bytes have come."""
        if self._failed:
            return
        now = monotonic()
        if now - self.endpoint.alive > STALL:
            self._times.wait(self.endpoint.alive)
        self._arrival = self._times.find(self._descriptor, now)
        data = bytes(self._buffer[:nbytes])
        if self._websocket is not None:
            self._receive(data)
        elif self._exchange is not None:
            self._serve_http(data)
        else:
            self._read_head(data)

    def _read_head(self, data: bytes) -> None:
        """Until the head of the first request has arrived, its kind is unknown."""
        self._head += data
        end = self._head.find(b"\r\n\r\n")
        if end < 0 and len(self._head) <= _HEAD:
            return
        data, self._head = self._head, b""
        headers = read_headers(data[: max(end, 0)])
        if headers.get("upgrade", "").lower() == "websocket":
            self._websocket = ServerProtocol(max_size=_MESSAGE)
            self._receive(data)
        else:
            self._exchange = HttpExchange(self.endpoint.access, self.peer, self.endpoint.reply, own=self._own)
            self._serve_http(data)

    def _serve_http(self, data: bytes) -> None:
        assert self._exchange is not None
        self._wait()
        self._transport.write(self._exchange.receive(data))
        if self._exchange.over:
            self._transport.close()

    def _receive(self, data: bytes) -> None:
        websocket = self._websocket
        assert websocket is not None
        websocket.receive_data(data)
        for event in websocket.events_received():
            if isinstance(event, Request):
                self._shake_hands(websocket, event)
            elif isinstance(event, Frame):
                self._collect(event)
        self._flush()
        if websocket.parser_exc is not None:
            self._failed, self._buffer = True, bytearray(_WASTE)
            self._wait(_FAREWELL)
            return
        self._work()

    def _shake_hands(self, websocket: ServerProtocol, request: Request) -> None:
        headers = {name.lower(): value for name, value in request.headers.raw_items()}
        refusal = self.endpoint.access.refuse(self.peer, headers, request.path, own=self._own)
        if refusal:
            self._transport.pause_reading()
            asyncio.get_running_loop().call_later(_REFUSAL, self._refuse, websocket.reject(403, f"{refusal}\n"))
            return
        websocket.send_response(websocket.accept(request))
        self._flush()
        if websocket.state is OPEN:
            self._open = True
            self._stop_waiting()
            self.endpoint.open(self)

    def _refuse(self, response: Response) -> None:
        assert self._websocket is not None
        if not self._transport.is_closing():
            self._websocket.send_response(response)
            self._flush()

    def _collect(self, frame: Frame) -> None:
        """Text or binary, in one frame or in several."""
        if frame.opcode not in (Opcode.TEXT, Opcode.BINARY, Opcode.CONT):
            return  # the protocol itself answers a ping
        if frame.fin and not self._parts:
            self._waiting.append((self._arrival, bytes(frame.data)))
            return
        self._parts.append(bytes(frame.data))
        if len(self._parts) > _PARTS:
            self.end(1009, "a message has too many fragments")
            return
        if frame.fin:
            self._waiting.append((self._arrival, b"".join(self._parts)))
            self._parts = []

    def _work(self) -> None:
        """Answer what waits: a few messages, then others have their turn."""
        if self._rests:
            return
        for _ in range(_IN_A_ROW):
            if not self._waiting or self._paused or self._rests or not self._open:
                break
            arrival, message = self._waiting.popleft()
            answer = self.endpoint.answer(self, message, arrival)
            if answer is not None:
                self.send(answer)
        if self._rests:
            self._pause()
            asyncio.get_running_loop().call_later(_REST, self._wake)
        elif self._waiting and self._open and not self._paused:
            self._pause()
            asyncio.get_running_loop().call_soon(self._go_on)
        elif not self._paused and self._open:
            self._transport.resume_reading()

    def _pause(self) -> None:
        """Read nothing: what comes meanwhile waits, and grows old."""
        if self._transport.is_reading():
            self._times.wait(monotonic())
        self._transport.pause_reading()

    def rest(self) -> None:
        """Read nothing for a while: the message was nonsense."""
        self._rests = True

    def _wake(self) -> None:
        self._rests = False
        self._go_on()

    def _go_on(self) -> None:
        if self._open and not self._paused:
            self._work()

    def send(self, text: str) -> None:
        """One message, in text."""
        if self._open and self._websocket is not None and self._websocket.state is OPEN:
            self._websocket.send_text(text.encode())
            self._flush()

    @property
    def unread(self) -> int:
        """Bytes that were sent and that the client has not fetched."""
        return self._transport.get_write_buffer_size()

    def _flush(self) -> None:
        assert self._websocket is not None
        for data in self._websocket.data_to_send():
            if data:
                self._transport.write(data)
            else:
                self._transport.close()
        if self._websocket.close_expected() and self._timer is None:
            self._wait()

    def end(self, code: int, why: str) -> None:
        """Close it in order."""
        if self._open and self._websocket is not None and self._websocket.state is OPEN:
            self._websocket.send_close(code, why)
            self._flush()
        self._transport.close()

    def pause_writing(self) -> None:
        """The client does not read: nothing is read from it either, and after a while it is closed."""
        self._paused = True
        self._pause()
        self._wait()

    def resume_writing(self) -> None:
        """It reads again."""
        self._paused = False
        if self._failed:
            return
        self._stop_waiting()
        self._go_on()

    def eof_received(self) -> bool:
        """The client has nothing more to say: this side closes as well."""
        return False

    def connection_lost(self, exc: Exception | None) -> None:
        """It is gone, however it ended."""
        self._stop_waiting()
        self.endpoint.connections.discard(self)
        if self._open:
            self._open = False
            self.endpoint.close(self)

    def _wait(self, patience: float = _PATIENCE) -> None:
        self._stop_waiting()
        self._timer = asyncio.get_running_loop().call_later(patience, self._transport.abort)

    def _stop_waiting(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
