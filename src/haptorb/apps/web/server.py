"""One port on this computer only, and a server on it that leaves signals to the program."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import gc
import logging
import os
import signal
import socket
import sys
import threading
from collections.abc import AsyncIterator, Callable, Coroutine, Generator
from functools import partial
from types import FrameType
from typing import Any, cast

import uvicorn

from haptorb.apps.web.connection import OwnErrorFilter, Request, Socket
from haptorb.errors import InputError

__all__ = ["HOST", "Server", "bind_socket", "freeze_garbage", "prioritize", "run_beside", "server", "signals"]

HOST = "127.0.0.1"
_URGENT = -10  #: niceness of the serving thread
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


def bind_socket(port: int) -> socket.socket:
    """A listening socket on this computer's own address, or InputError that says who to ask."""
    if isinstance(port, bool) or not isinstance(port, int) or not 0 <= port <= 65535:
        raise InputError(f"port must be a whole number from 0 to 65535; got {port!r}")
    listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _UNREAD)
        listening.bind((HOST, port))
        listening.listen(_QUEUE)
    except OSError as cause:
        listening.close()
        if cause.errno == errno.EADDRINUSE:
            raise InputError(
                f"port {port} of {HOST} is in use: end the program that uses it (`ss -ltnp 'sport = :{port}'` shows "
                "which), or choose another with --port (0 takes any free one)"
            ) from cause
        raise InputError(
            f"port {port} of {HOST} cannot be opened: {cause.strerror}; choose another with --port"
        ) from cause
    return listening


@contextlib.contextmanager
def prioritize() -> Generator[None, None, None]:
    """This thread keeps a hand's pose fresh: it goes before ordinary programs, where that is permitted (on Linux).

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
    try:
        yield
    finally:
        if not frozen:
            gc.unfreeze()
        with contextlib.suppress(OSError):
            if _LINUX:
                os.setpriority(os.PRIO_PROCESS, 0, before)


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
