"""Connections that cannot wear the server out: few before they are pages, none for long, and none that only fills up.

Every program of this computer can connect, from any account. The cost is bounded here: how many connections may
make requests at once, for how long, and how much is read from one before the others have their turn. What is
sent, at worst that connection ends.
"""

from __future__ import annotations

import asyncio
import logging
from typing import Any, cast, final

from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

__all__ = ["LIFE", "MOST", "OwnErrorFilter", "Request", "Socket"]

#: connections that ask for something, and as many that become a page or are being closed; a browser needs six. A newer
#: one takes the place of the oldest
MOST = 32
LIFE = 5.0  #: of such a connection [s]
_PIECE = 16384  #: read from one connection before the others have their turn [bytes]
_END = 1.0  #: for the other side to take the last words [s]


@final
class Request(H11Protocol):
    """A connection that asks for files, or to become a page's `Socket`; `waiting`: all of one server, oldest first."""

    def __init__(self, *args: Any, waiting: list[asyncio.Transport], **more: Any) -> None:
        super().__init__(*args, **more)
        self._waiting = waiting

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Make room for it, and limit its life."""
        super().connection_made(transport)
        _read_in_pieces(transport)
        self._waiting[:] = [one for one in self._waiting if isinstance(one.get_protocol(), Request)]
        while len(self._waiting) >= MOST:  # safety: few-connections
            self._waiting.pop(0).abort()
        self._waiting.append(transport)
        self.loop.call_later(LIFE, self._end_request, transport)

    def _end_request(self, transport: asyncio.Transport) -> None:
        if transport.get_protocol() is self:  # and has not become a page
            transport.close()
            self.loop.call_later(_END, transport.abort)

    def connection_lost(self, exc: Exception | None) -> None:
        """Give its place back."""
        if self.transport in self._waiting:
            self._waiting.remove(self.transport)
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """What cannot even be refused ends the connection."""
        try:
            super().data_received(data)
        except Exception:  # of parsers, over bytes that anybody may send
            self.transport.abort()


@final
class Socket(WebSocketsSansIOProtocol):
    """A page's connection."""

    _since = 0.0  # by the loop's clock

    @property
    def passes(self) -> bool:
        """Whether it is no page yet, or none any more."""
        return self.close_sent or not self.handshake_complete or self.transport.is_closing()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Look from time to time whether it is to end and cannot."""
        super().connection_made(transport)
        self._since = self.loop.time()
        passing = [one for one in self.connections if isinstance(one, Socket) and one is not self and one.passes]
        for one in sorted(passing, key=lambda one: one._since)[: max(0, len(passing) - MOST + 1)]:
            one.transport.abort()
        _read_in_pieces(cast("asyncio.Transport", transport))
        self.loop.call_later(_END, self._abort_if_closing, False)
        self.loop.call_later(LIFE, self._abort_handshake)

    def _abort_handshake(self) -> None:
        """A handshake that failed."""
        if not self.handshake_complete:
            self.transport.abort()

    def _abort_if_closing(self, closing: bool) -> None:
        """A page that never reads also keeps what is to be said last: two looks later it is cut off."""
        if closing:
            self.transport.abort()
        elif not self.disconnected:
            self.loop.call_later(_END, self._abort_if_closing, self.transport.is_closing())

    def data_received(self, data: bytes) -> None:
        """What cannot even be refused ends the connection."""
        try:
            super().data_received(data)
        except Exception:  # of parsers, over bytes that anybody may send
            self.transport.abort()


class OwnErrorFilter(logging.Filter):
    """Keeps a log to this program's own mistakes: what others send is answered, and is no news."""

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether to log `record`."""
        mistake = record.exc_info[1] if record.exc_info else None
        return record.levelno >= logging.ERROR and not isinstance(mistake, UnicodeDecodeError)


def _read_in_pieces(transport: asyncio.Transport) -> None:
    transport.max_size = _PIECE  # type: ignore[attr-defined]  # of asyncio's own transports; elsewhere it says nothing
