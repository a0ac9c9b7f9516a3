"""HTTP and WebSocket server of the pages: connection limits, socket, priority, signals, and message parsing."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import gc
import html
import json
import logging
import os
import re
import signal
import socket
import threading
import webbrowser
from collections.abc import AsyncIterator, Callable, Coroutine, Generator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import sleep
from types import FrameType
from typing import TYPE_CHECKING, Any, Literal, Never, cast, final

import uvicorn
from starlette.responses import Response
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from uvicorn.server import ServerState

from haptorb.errors import InputError
from haptorb.files import private_temporary_folder
from haptorb.runtime.linux import END_SIGNALS, is_linux

if TYPE_CHECKING:
    import h11

__all__ = [
    "HOST",
    "MAX_CONNECTIONS",
    "MAX_LIFETIME_S",
    "MAX_PAGES",
    "TRY_AGAIN_LATER",
    "OwnErrorFilter",
    "PageAddress",
    "Request",
    "Server",
    "Socket",
    "bind_socket",
    "command",
    "configure",
    "find_own_address",
    "freeze_garbage",
    "is_request",
    "limit_read_size",
    "make_connections",
    "open_browser_at",
    "page_files",
    "prioritize",
    "respond",
    "run_beside",
    "server",
    "signals",
]


# --------------------------------------------------------------------------------------------------
# Connection limits (protection against denial of service).
#
# Every program of this computer can connect, from any account. The cost is bounded here: how many connections may make
# requests at the same time, for how long, and how much is read from one before the others have their turn. The worst
# effect of any client's data is the end of its own connection.


MAX_PAGES = 16  #: pages of one kind at the same time: of the console, of a recording, of a person in a study
TRY_AGAIN_LATER = 1013  #: close code of a WebSocket, for a page too many

#: connections with HTTP requests, and as many WebSockets that are opening or closing; a browser needs six. A new one
#: replaces the oldest
MAX_CONNECTIONS = 32
MAX_LIFETIME_S = 5.0  #: maximum lifetime of such a connection [s]
_READ_BYTES = 16384  #: read from one connection before the others have their turn [bytes]
_CLOSE_TIMEOUT_S = 1.0  #: for the client to complete the close [s]


@final
class Request(H11Protocol):
    """HTTP connection, before a possible upgrade to a WebSocket.

    waiting  all of one server, oldest first
    life     maximum lifetime [s]; renewed: counted from the last answer
    """

    def __init__(self, *args: Any, waiting: list[asyncio.Transport], life: float, renewed: bool, **more: Any) -> None:
        super().__init__(*args, **more)
        self._waiting, self._life, self._renewed = waiting, life, renewed
        self._end = 0.0  # by the loop's clock

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Abort the oldest connection if there are too many, and limit the lifetime of the new one."""
        super().connection_made(transport)
        limit_read_size(transport)
        self._waiting[:] = [one for one in self._waiting if isinstance(one.get_protocol(), Request)]
        while len(self._waiting) >= MAX_CONNECTIONS:  # safety: few-connections
            self._waiting.pop(0).abort()
        self._waiting.append(transport)
        self._end = self.loop.time() + self._life
        self.loop.call_at(self._end, self._end_request, transport)

    def _end_request(self, transport: asyncio.Transport) -> None:
        if transport.get_protocol() is not self or transport.is_closing():  # it may have been upgraded to a WebSocket
            return
        if self.loop.time() < self._end:
            self.loop.call_at(self._end, self._end_request, transport)
            return
        transport.close()
        self.loop.call_later(_CLOSE_TIMEOUT_S, transport.abort)

    def on_response_complete(self) -> None:
        """Renew the lifetime after an answer, if it counts from there."""
        if self._renewed:
            self._end = self.loop.time() + self._life
        super().on_response_complete()

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        """Hand the connection over to the protocol of WebSockets, with what has been received behind the request."""
        super().handle_websocket_upgrade(event)
        behind = bytes(self.conn.trailing_data[0])
        if behind:
            cast("asyncio.Protocol", self.transport.get_protocol()).data_received(behind)

    def connection_lost(self, exc: Exception | None) -> None:
        """Remove the connection from the list."""
        if self.transport in self._waiting:
            self._waiting.remove(self.transport)
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Process received data; end the connection on data that the parser cannot even reject."""
        try:
            super().data_received(data)
        except Exception:  # of parsers, over arbitrary bytes
            self.transport.abort()


@final
class Socket(WebSocketsSansIOProtocol):
    """WebSocket connection of a page, aborted if handshake or close take too long."""

    _since = 0.0  # by the loop's clock

    @property
    def passes(self) -> bool:
        """Whether it is opening or closing."""
        return self.close_sent or not self.handshake_complete or self.transport.is_closing()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Abort the oldest opening or closing connections above the limit, and start the timeouts of the new one."""
        super().connection_made(transport)
        self._since = self.loop.time()
        passing = [one for one in self.connections if isinstance(one, Socket) and one is not self and one.passes]
        for one in sorted(passing, key=lambda one: one._since)[: max(0, len(passing) - MAX_CONNECTIONS + 1)]:
            one.transport.abort()
        limit_read_size(cast("asyncio.Transport", transport))
        self.loop.call_later(_CLOSE_TIMEOUT_S, self._abort_if_closing, False)
        self.loop.call_later(MAX_LIFETIME_S, self._abort_handshake)

    def _abort_handshake(self) -> None:
        """Abort the connection if its handshake has not completed in time."""
        if not self.handshake_complete:
            self.transport.abort()

    def _abort_if_closing(self, closing: bool) -> None:
        """Abort a connection that is still closing at the second check: its client does not read."""
        if closing:
            self.transport.abort()
        elif not self.disconnected:
            self.loop.call_later(_CLOSE_TIMEOUT_S, self._abort_if_closing, self.transport.is_closing())

    def data_received(self, data: bytes) -> None:
        """Process received data; end the connection on data that the parser cannot even reject."""
        try:
            super().data_received(data)
        except Exception:  # of parsers, over arbitrary bytes
            self.transport.abort()


class OwnErrorFilter(logging.Filter):
    """Log filter that passes only errors of this program, not those caused by invalid input of clients."""

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether to log `record`: an error that is not caused by input."""
        mistake = record.exc_info[1] if record.exc_info else None
        return record.levelno >= logging.ERROR and not isinstance(mistake, UnicodeDecodeError)


def limit_read_size(transport: asyncio.Transport, size: int = _READ_BYTES) -> None:
    """Read at most `size` [bytes] at once, before other connections have their turn."""
    transport.max_size = size  # type: ignore[attr-defined]  # of asyncio's own transports; ignored by others


HOST = "127.0.0.1"
_URGENT = -10  #: niceness of the serving thread, and of its session
_AUTOGROUP = Path("/proc/self/autogroup")
_MAX_ACCEPTS = 4  #: connections accepted at once, so that a page's pose is not delayed
_MAX_PENDING_CONNECTIONS = 128  #: backlog of connections that are not accepted yet
_SEND_BUFFER_BYTES = 262144  #: the kernel's buffer for a slow page [bytes]


class Server(uvicorn.Server):
    """uvicorn server that leaves signals to the program, which must end the servo first."""

    @contextlib.contextmanager
    def capture_signals(self) -> Generator[None, None, None]:
        """Keep the present signal handlers."""
        yield

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start to accept connections, with a longer backlog than the number accepted at once."""
        await super().startup(sockets)
        for one in sockets or ():
            one.listen(_MAX_PENDING_CONNECTIONS)


def server(app: Any) -> Server:
    """Configure a server for `app` (ASGI) and load its modules now, before a servo depends on this process."""
    return Server(configure(app))


def configure(
    app: Any,
    socket: Callable[..., asyncio.Protocol] = Socket,
    *,
    life: float | None = None,
    renewed: bool = False,
    **more: Any,
) -> uvicorn.Config:
    """Settings of a server for `app` (ASGI), whose WebSockets become a `socket`.

    `life` (None: MAX_LIFETIME_S) and `renewed` are those of `Request`, all others uvicorn's."""
    request = partial(Request, waiting=[], life=MAX_LIFETIME_S if life is None else life, renewed=renewed)
    config = uvicorn.Config(
        app,
        log_level="warning",
        access_log=False,
        backlog=_MAX_ACCEPTS,
        http=cast("type[Request]", request),
        ws=cast("type[Socket]", socket),
        ws_max_size=65536,
        ws_per_message_deflate=False,
        timeout_graceful_shutdown=1,
        server_header=False,
        **more,
    )
    config.load()
    log = logging.getLogger("uvicorn.error")
    if not any(isinstance(one, OwnErrorFilter) for one in log.filters):
        log.addFilter(OwnErrorFilter())
    return config


def make_connections(config: uvicorn.Config) -> Callable[[], asyncio.Protocol]:
    """Make a factory of connections for the `create_server` of a loop that is not run by uvicorn."""
    state = ServerState()

    def connect() -> asyncio.Protocol:
        made = cast("Callable[..., Request]", config.http_protocol_class)  # `configure` has bound the rest
        return made(config=config, server_state=state, app_state={})

    return connect


def run_beside(
    work: Callable[[], Coroutine[Any, Any, None]],
) -> Callable[[Any], contextlib.AbstractAsyncContextManager[None]]:
    """Make the lifespan of an ASGI application that runs `work()` until the application ends."""

    @contextlib.asynccontextmanager
    async def lifespan(app: Any) -> AsyncIterator[None]:
        task = asyncio.create_task(work())
        try:
            yield
        finally:
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await task

    return lifespan


@dataclass(frozen=True)
class PageAddress:
    """Listening address of a page, and its public address.

    host     address of this computer; other than loopback: other computers reach the page, too
    address  public address behind a proxy, such as https://lab.example/haptorb/; empty: that of the host
    """

    host: str = HOST
    address: str = ""

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[0-9A-Za-z.:_-]{1,100}", self.host):
            raise InputError(f"--host must be an address of this computer, such as 0.0.0.0; got {self.host!r}")
        if self.address and not re.fullmatch(r"https?://[0-9A-Za-z.:_\[\]-]+(/[^?#\s]*)?", self.address):
            raise InputError(
                f"--address must be the page's address without what stands behind a ?, such as https://lab/haptorb/; "
                f"got {self.address!r}"
            )

    @property
    def exposed(self) -> bool:
        """Whether other computers can reach the page."""
        return bool(self.address) or self.host not in LOCAL

    @property
    def origin(self) -> str:
        """Scheme, host and port of `address`; empty if there is none."""
        return "/".join(self.address.split("/")[:3]).lower()

    def page_origin(self, port: int | Literal["*"]) -> str:
        """Origin of the page in a browser: `origin`, or that of `url`; "*" stands for any port of its host."""
        return self.origin or "/".join(self.url(port).split("/")[:3])

    def url(self, port: int | Literal["*"], path: str = "") -> str:
        """Address to open in a browser."""
        if self.address:
            return f"{self.address.rstrip('/')}/{path}"
        host = find_own_address() if self.host in ANYWHERE else self.host
        return f"http://{f'[{host}]' if ':' in host else host}:{port}/{path}"

    @property
    def warning(self) -> str:
        """Security warning for the user; empty if only this computer reaches the page."""
        return self.describe_exposure("move the device and start it")

    def describe_exposure(self, ability: str) -> str:
        """Warning that whoever has the page's address has an `ability`; empty if only this computer reaches it."""
        if not self.exposed:
            return ""
        secret = "" if self.address.startswith("https:") else " The connection is not encrypted."
        return f"Warning: other computers can reach the page. Whoever has its whole address can {ability}.{secret}"


LOCAL = ("127.0.0.1", "localhost", "::1")  #: hosts reachable only from this computer
ANYWHERE = ("0.0.0.0", "::")  #: hosts for all addresses of this computer


def find_own_address() -> str:
    """Address at which other computers reach this one; 127.0.0.1 without a network. Sends nothing."""
    with contextlib.suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asked:
        asked.connect(("192.0.2.1", 9))  # address reserved for documentation: only the route is looked up
        return str(asked.getsockname()[0])
    return HOST


def bind_socket(port: int, host: str = HOST) -> socket.socket:
    """Open a listening socket on `host`, an address of this computer. Raises InputError with reason and remedy."""
    if isinstance(port, bool) or not isinstance(port, int) or not 0 <= port <= 65535:
        raise InputError(f"port must be a whole number from 0 to 65535; got {port!r}")
    try:
        family, kind, protocol, _, place = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    except OSError as cause:
        raise InputError(f"--host: there is no address '{host}' ({cause.strerror})") from cause
    listening = socket.socket(family, kind, protocol)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
        listening.bind(place)
        listening.listen(_MAX_PENDING_CONNECTIONS)
    except OSError as cause:
        listening.close()
        if cause.errno == errno.EADDRINUSE:
            raise InputError(
                f"port {port} of {host} is in use: end the program that uses it (`ss -ltnp 'sport = :{port}'` shows "
                "which), or choose another with --port (0 takes any free one)"
            ) from cause
        raise InputError(
            f"port {port} of {host} cannot be opened: {cause.strerror}; choose another with --port, or an address of "
            "this computer with --host"
        ) from cause
    return listening


@contextlib.contextmanager
def prioritize() -> Generator[None, None, None]:
    """Raise the priority of this thread, which refreshes the hand's pose, above ordinary programs if permitted (Linux).

    The priority of its session is raised, too: Linux first divides processor time among sessions, whatever the niceness
    of the threads in them.

    Existing objects are excluded from garbage collection, which takes as long as a pose is valid; new objects are still
    collected.
    """
    frozen = gc.get_freeze_count() > 0  # by other code, which will unfreeze
    if not frozen:  # else a servo may run already, and the collection could delay the heartbeat of its host
        gc.collect()
    gc.freeze()
    before = os.getpriority(os.PRIO_PROCESS, 0) if is_linux() else 0  # 0: the calling thread
    with contextlib.suppress(OSError):
        if is_linux():
            os.setpriority(os.PRIO_PROCESS, 0, _URGENT)
    session = _set_session_niceness(_URGENT) if is_linux() else None
    try:
        yield
    finally:
        if not frozen:
            gc.unfreeze()
        if session is not None:
            _set_session_niceness(session)
        with contextlib.suppress(OSError):
            if is_linux():
                os.setpriority(os.PRIO_PROCESS, 0, before)


def _set_session_niceness(niceness: int) -> int | None:
    """Set the niceness of this session's autogroup (sched(7)); returns the previous one.

    None if it cannot be set, or is already set: then another program of the session has set it, and restores it."""
    with contextlib.suppress(OSError, ValueError):
        before = int(_AUTOGROUP.read_text(encoding="utf-8").rpartition("nice")[2])
        if before != niceness:
            _AUTOGROUP.write_text(str(niceness))
            return before
    return None


@contextlib.contextmanager
def freeze_garbage() -> Generator[None, None, None]:
    """Collect garbage now and exclude existing objects later, when a collection could delay a servo's heartbeat."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


@contextlib.contextmanager
def signals(handle: Callable[[int], None]) -> Generator[None, None, None]:
    """Handle signals that end a program with `handle` in the main thread; no effect in others."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def handler(number: int, frame: FrameType | None) -> None:
        handle(number)

    # Ignored signals stay ignored, as with nohup.
    caught = [number for number in END_SIGNALS if signal.getsignal(number) is not signal.SIG_IGN]
    before = {number: signal.signal(number, handler) for number in caught}
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)


# --------------------------------------------------------------------------------------------------
# Opening a browser at an address with a token, without revealing the token to other accounts of this computer.


_BROWSER_START_S = 30.0  #: time for a starting browser to read the file [s]


def open_browser_at(url: str) -> None:
    """Open the browser at `url`; blocks for 30 s, so call it in a daemon thread.

    All accounts can read the arguments of a program (`ps`), so the browser opens a file, readable only by this account,
    that redirects to the address. A sandboxed browser that cannot read it shows an error; then use the printed address.
    """
    with contextlib.suppress(OSError, AttributeError):
        os.setpriority(os.PRIO_PROCESS, 0, 0)  # the browser is an ordinary program
    with private_temporary_folder("page") as folder:
        path = folder / "open.html"
        path.write_text(
            '<!doctype html><meta charset="utf-8"><title>haptorb</title>'
            f'<meta http-equiv="refresh" content="0; url={html.escape(url)}">'
            f'<a href="{html.escape(url)}">Open the console</a>',
            encoding="utf-8",
        )
        webbrowser.open(path.as_uri())
        sleep(_BROWSER_START_S)


# --------------------------------------------------------------------------------------------------
# Parsing of a page's commands: one JSON object per text message, with a separate check for a Stop.
#
# Every message becomes a command, or an InputError that can be sent back. The length of numbers and the nesting depth
# are limited, and every text can be encoded as UTF-8.


_MAX_MESSAGE_CHARACTERS = 65536  #: of a message [characters]; the server's own limit is the same in bytes
_MAX_DIGITS = 18  #: of an integer, which then fits into 64 bits
_MAX_DEPTH = 6  #: of nested lists and objects; values of a world need three
_MAX_NAME_CHARACTERS = 64  #: of a command [characters]

_REQUEST = re.compile(r'"do"\s*:\s*"([a-z]+)"')
_ESCAPED_LETTER = re.compile(r"\\u00([46][1-9a-fA-F]|[57][0-9aA])")


def is_request(message: str | bytes, *names: str) -> bool:
    """Whether a text or binary message requests a command of `names`, even if the rest is malformed.

    Call it with "stop" before `command`: a Stop is executed even if the message is not valid JSON. Letters may be
    spelled with JSON's escapes.

    >>> [is_request(text, "stop") for text in ('{"do": "stop"}', '{"do":"stop", "why": 1e999', '{"do": "engage"}')]
    [True, True, False]
    >>> is_request(rb'{"\u0064o": "s\u0074op"}', "stop"), is_request('{"do": "leave"}', "leave", "abort")
    (True, True)
    """
    text = message if isinstance(message, str) else message.decode("latin-1")
    if "\\u00" in text:
        text = _ESCAPED_LETTER.sub(lambda found: chr(int(found[1], 16)), text)
    return any(found[1] in names for found in _REQUEST.finditer(text))


def command(text: str) -> dict[str, Any]:
    """Parse the command in a text message, with its name in `do`. Raises InputError.

    Numbers must be finite, integers have at most 18 digits.

    >>> command('{"do": "stop"}')
    {'do': 'stop'}
    """
    if len(text) > _MAX_MESSAGE_CHARACTERS:
        raise InputError(f"a command must have at most {_MAX_MESSAGE_CHARACTERS} characters; got {len(text)}")
    try:
        found = json.loads(text, parse_int=_parse_integer, parse_float=_parse_float, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as mistake:  # safety: web-message
        raise InputError(f"a command must be JSON: {mistake}") from mistake
    if not isinstance(found, dict):
        raise InputError("a command must be a JSON object")
    _check_content(found)
    do = found.get("do")
    if not isinstance(do, str) or len(do) > _MAX_NAME_CHARACTERS:
        raise InputError(
            f'a command must state its action: {{"do": NAME}} with a name of at most {_MAX_NAME_CHARACTERS} characters'
        )
    return found


def _parse_integer(digits: str) -> int:
    if len(digits) > _MAX_DIGITS + digits.startswith("-"):
        raise InputError(f"a whole number in a command must have at most {_MAX_DIGITS} digits; got {len(digits)}")
    return int(digits)


def _parse_float(digits: str) -> float:
    number = float(digits)
    if number in (float("inf"), float("-inf")):
        raise InputError("a number in a command must be finite; one is too large")
    return number


def _refuse_constant(name: str) -> Never:
    raise InputError(f"a number in a command must be finite; got {name}")


def _check_content(found: dict[str, Any]) -> None:
    """Check nesting depth and texts: a lone surrogate cannot be stored or sent. Raises InputError."""
    level: list[Any] = [found]
    for _ in range(_MAX_DEPTH):
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
        raise InputError(f"a command must not be nested deeper than {_MAX_DEPTH} levels")


def _is_storable(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


# --------------------------------------------------------------------------------------------------
# Files of the built pages, kept in memory: they are small, and disk access could delay the hand's pose.


_MEDIA_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".svg": "image/svg+xml",
    ".txt": "text/plain; charset=utf-8",
}


def page_files(folder: Path) -> dict[str, tuple[bytes, str]]:
    """Read all files of pages in `folder`: name → (content, media type); empty if nothing was built."""
    return {
        path.name: (path.read_bytes(), _MEDIA_TYPES[path.suffix])
        for path in folder.glob("*")
        if path.suffix in _MEDIA_TYPES
    }


def respond(files: dict[str, tuple[bytes, str]], name: str) -> Response:
    """Respond with the file `name`, or 404."""
    if name not in files:
        return Response("there is no such file\n", status_code=404, media_type="text/plain")
    content, kind = files[name]
    return Response(content, media_type=kind)
