"""One port on this computer only, and a server on it that leaves signals to the program."""

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
import sys
import tempfile
import threading
import webbrowser
from collections.abc import AsyncIterator, Callable, Coroutine, Generator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import sleep
from types import FrameType
from typing import Any, Never, cast, final

import uvicorn
from starlette.responses import Response
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from haptorb.errors import InputError

__all__ = [
    "HOST",
    "LIFE",
    "MOST",
    "OwnErrorFilter",
    "PageAddress",
    "Request",
    "Server",
    "Socket",
    "bind_socket",
    "command",
    "find_own_address",
    "freeze_garbage",
    "is_stop_request",
    "open_browser_at",
    "page_files",
    "prioritize",
    "respond",
    "run_beside",
    "server",
    "signals",
]


# --------------------------------------------------------------------------------------------------
# Connections that cannot wear the server out: few before they are pages, none for long, and none that only fills up.
#
# Every program of this computer can connect, from any account. The cost is bounded here: how many connections may
# make requests at once, for how long, and how much is read from one before the others have their turn. What is
# sent, at worst that connection ends.


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


HOST = "127.0.0.1"
_URGENT = -10  #: niceness of the serving thread, and of its session
_AUTOGROUP = Path("/proc/self/autogroup")
_LINUX = sys.platform.startswith("linux")
_AT_ONCE = 4  #: connections that are taken at once: a page's pose has its turn in between
_QUEUE = 128  #: connections that may wait to be taken
_UNREAD = 262144  #: bytes that the system keeps for a page that is slow


class Server(uvicorn.Server):
    """uvicorn, without its own idea of what a signal means: ending a servo is the program's business."""

    @contextlib.contextmanager
    def capture_signals(self) -> Generator[None, None, None]:
        """Leave every signal to its present handler."""
        yield

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begin to take connections; more may wait for it than are taken at once."""
        await super().startup(sockets)
        for one in sockets or ():
            one.listen(_QUEUE)


def server(app: Any) -> Server:
    """`app` (ASGI) as it is served here, its modules loaded: later a servo may count on this process."""
    config = uvicorn.Config(
        app,
        log_level="warning",
        access_log=False,
        backlog=_AT_ONCE,
        http=cast("type[Request]", partial(Request, waiting=[])),
        ws=Socket,
        ws_max_size=65536,
        ws_per_message_deflate=False,
        timeout_graceful_shutdown=1,
        server_header=False,
    )
    config.load()
    log = logging.getLogger("uvicorn.error")
    if not any(isinstance(one, OwnErrorFilter) for one in log.filters):
        log.addFilter(OwnErrorFilter())
    return Server(config)


def run_beside(
    work: Callable[[], Coroutine[Any, Any, None]],
) -> Callable[[Any], contextlib.AbstractAsyncContextManager[None]]:
    """The lifespan of an ASGI application that runs `work()` until it ends."""

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
    """Where a page listens, and how browsers reach it.

    host     address of this computer; other than 127.0.0.1: other computers reach the page, too
    address  of the page behind a proxy, such as https://lab.example/haptorb/; empty: the host's own
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
        """Whether more than the programs of this computer reach the page."""
        return bool(self.address) or self.host not in LOCAL

    @property
    def origin(self) -> str:
        """Scheme, host and port of `address`; empty if there is none."""
        return "/".join(self.address.split("/")[:3]).lower()

    def url(self, port: int, path: str = "") -> str:
        """What is opened in a browser."""
        if self.address:
            return f"{self.address.rstrip('/')}/{path}"
        host = find_own_address() if self.host in ANYWHERE else self.host
        return f"http://{f'[{host}]' if ':' in host else host}:{port}/{path}"

    @property
    def warning(self) -> str:
        """What should be said before it is used; empty for this computer alone."""
        if not self.exposed:
            return ""
        secret = "" if self.address.startswith("https:") else " The connection is not encrypted."
        return (
            "Warning: other computers can reach the page. Whoever has its whole address can move the device and start "
            f"it.{secret}"
        )


LOCAL = ("127.0.0.1", "localhost", "::1")  #: only programs of this computer
ANYWHERE = ("0.0.0.0", "::")  #: all addresses of this computer


def find_own_address() -> str:
    """The address at which other computers reach this one; this computer's own where it has no network. Nothing is
    sent."""
    with contextlib.suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asked:
        asked.connect(("192.0.2.1", 9))  # an address for documentation: only the route is looked up
        return str(asked.getsockname()[0])
    return HOST


def bind_socket(port: int, host: str = HOST) -> socket.socket:
    """A listening socket on `host`, this computer's own address, or InputError that says who to ask."""
    if isinstance(port, bool) or not isinstance(port, int) or not 0 <= port <= 65535:
        raise InputError(f"port must be a whole number from 0 to 65535; got {port!r}")
    try:
        family, kind, protocol, _, place = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    except OSError as cause:
        raise InputError(f"--host: there is no address '{host}' ({cause.strerror})") from cause
    listening = socket.socket(family, kind, protocol)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _UNREAD)
        listening.bind(place)
        listening.listen(_QUEUE)
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
    """This thread keeps a hand's pose fresh: it goes before ordinary programs, where that is permitted (on Linux).

    So does its session: Linux shares processors among sessions first, whatever the niceness of a thread within one.

    Nor is it held up by a search for garbage in what exists now, which takes as long as a pose is valid; what is made
    from now on is still collected.
    """
    frozen = gc.get_freeze_count() > 0  # by other code, which will undo it
    if not frozen:  # else a servo may run already, and the search could silence its host
        gc.collect()
    gc.freeze()
    before = os.getpriority(os.PRIO_PROCESS, 0) if _LINUX else 0  # 0: the calling thread
    with contextlib.suppress(OSError):
        if _LINUX:
            os.setpriority(os.PRIO_PROCESS, 0, _URGENT)
    session = _set_session_niceness(_URGENT) if _LINUX else None
    try:
        yield
    finally:
        if not frozen:
            gc.unfreeze()
        if session is not None:
            _set_session_niceness(session)
        with contextlib.suppress(OSError):
            if _LINUX:
                os.setpriority(os.PRIO_PROCESS, 0, before)


def _set_session_niceness(niceness: int) -> int | None:
    """Set that of this session's autogroup (sched(7)); the one before, None where it cannot be set or is that already:
    then another program of the session has set it, and puts it back."""
    with contextlib.suppress(OSError, ValueError):
        before = int(_AUTOGROUP.read_text().rpartition("nice")[2])
        if before != niceness:
            _AUTOGROUP.write_text(str(niceness))
            return before
    return None


@contextlib.contextmanager
def freeze_garbage() -> Generator[None, None, None]:
    """Search for garbage now, and no more in what exists now: once a servo runs, a search could silence its host."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


@contextlib.contextmanager
def signals(handle: Callable[[int], None]) -> Generator[None, None, None]:
    """SIGINT, SIGTERM and SIGHUP call `handle`, in the main thread; elsewhere nothing changes."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def handler(number: int, frame: FrameType | None) -> None:
        handle(number)

    ends = (signal.SIGINT, signal.SIGTERM, *((signal.SIGHUP,) if hasattr(signal, "SIGHUP") else ()))
    caught = [number for number in ends if signal.getsignal(number) is not signal.SIG_IGN]  # nohup stays nohup
    before = {number: signal.signal(number, handler) for number in caught}
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)


# --------------------------------------------------------------------------------------------------
# Opening a browser at an address with a token, without telling the token to the other accounts of this computer.


_LOADED = 30.0  #: a browser that starts has read the file by then [s]


def open_browser_at(url: str) -> None:
    """Open the browser at `url`; blocks for half a minute, for a thread that may be left.

    A program's arguments can be read by everybody (`ps`), so the browser is given a file that leads to the address and
    that only this account may read. A sandboxed browser that cannot read it shows an error; then use the printed
    address.
    """
    with contextlib.suppress(OSError, AttributeError):
        os.setpriority(os.PRIO_PROCESS, 0, 0)  # the browser is an ordinary program
    with tempfile.TemporaryDirectory(prefix="haptorb-") as folder:
        path = Path(folder, "open.html")
        path.write_text(
            '<!doctype html><meta charset="utf-8"><title>haptorb</title>'
            f'<meta http-equiv="refresh" content="0; url={html.escape(url)}">'
            f'<a href="{html.escape(url)}">Open the console</a>',
            encoding="utf-8",
        )
        webbrowser.open(path.as_uri())
        sleep(_LOADED)


# --------------------------------------------------------------------------------------------------
# What a page asks for: one JSON object per text message, read strictly, and the Stop in it before anything else.
#
# Every message becomes a command, or an InputError that can be sent back: no number is too long
# to be handled, nothing is nested deeper than a command is, every text can be written into a file.


_MAX_MESSAGE_CHARACTERS = 65536  #: of a message [characters]; the server's own limit is the same in bytes
_DIGITS = 18  #: of a whole number: what fits into 64 bits
_DEPTH = 6  #: of lists and objects in each other; a world's values need three
_NAME = 64  #: of a command [characters]

_STOP = re.compile(r'"do"\s*:\s*"stop"')


def is_stop_request(text: str) -> bool:
    """Whether a text message is a Stop, however malformed the rest.

    To be asked before `command`: a Stop is obeyed even when the message cannot be read as JSON.

    >>> [is_stop_request(text) for text in ('{"do": "stop"}', '{"do":"stop", "why": 1e999', '{"do": "engage"}')]
    [True, True, False]
    """
    return _STOP.search(text) is not None


def command(text: str) -> dict[str, Any]:
    """The command in a text message, or InputError; its `do` is a text.

    Numbers are finite, whole ones have at most 18 digits.

    >>> command('{"do": "stop"}')
    {'do': 'stop'}
    """
    if len(text) > _MAX_MESSAGE_CHARACTERS:
        raise InputError(f"a command must have at most {_MAX_MESSAGE_CHARACTERS} characters; got {len(text)}")
    try:
        found = json.loads(text, parse_int=_parse_whole, parse_float=_parse_real, parse_constant=_constant)
    except (ValueError, RecursionError) as mistake:  # safety: web-message
        raise InputError(f"a command must be JSON: {mistake}") from mistake
    if not isinstance(found, dict):
        raise InputError("a command must be a JSON object")
    _check(found)
    do = found.get("do")
    if not isinstance(do, str) or len(do) > _NAME:
        raise InputError(f'a command must state its action: {{"do": NAME}} with a name of at most {_NAME} characters')
    return found


def _parse_whole(digits: str) -> int:
    if len(digits) > _DIGITS + digits.startswith("-"):
        raise InputError(f"a whole number in a command must have at most {_DIGITS} digits; got {len(digits)}")
    return int(digits)


def _parse_real(digits: str) -> float:
    number = float(digits)
    if number in (float("inf"), float("-inf")):
        raise InputError("a number in a command must be finite; one is too large")
    return number


def _constant(name: str) -> Never:
    raise InputError(f"a number in a command must be finite; got {name}")


def _check(found: dict[str, Any]) -> None:
    """Refuse what is nested too deep, and texts that are none: half of a surrogate pair cannot be stored or sent."""
    level: list[Any] = [found]
    for _ in range(_DEPTH):
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
        raise InputError(f"a command must not be nested deeper than {_DEPTH} levels")


def _is_storable(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


# --------------------------------------------------------------------------------------------------
# The files of built pages, in memory: they are small, and nothing waits for a disk while a hand is on the device.


_KINDS = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".svg": "image/svg+xml",
    ".txt": "text/plain; charset=utf-8",
}


def page_files(folder: Path) -> dict[str, tuple[bytes, str]]:
    """Name → (content, media type) of every file in `folder` that a page may ask for; empty if nothing was built."""
    return {path.name: (path.read_bytes(), _KINDS[path.suffix]) for path in folder.glob("*") if path.suffix in _KINDS}


def respond(files: dict[str, tuple[bytes, str]], name: str) -> Response:
    """The file `name`, or that there is none."""
    if name not in files:
        return Response("there is no such file\n", status_code=404, media_type="text/plain")
    content, kind = files[name]
    return Response(content, media_type=kind)
