"""The console's server: one port on this computer only, served until the servo or the user ends it."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import signal
import socket
import sys
import threading
import webbrowser
from collections.abc import Callable, Generator
from types import FrameType, TracebackType
from typing import Self, final

import uvicorn

from haptorb.apps.console.felt import FeltMap
from haptorb.apps.console.felt_process import FeltProcess
from haptorb.apps.console.servant import Servant
from haptorb.apps.console.site import application
from haptorb.errors import InputError

__all__ = ["PORT", "Console"]

PORT = 8765  #: unless told otherwise
_HOST = "127.0.0.1"
_URGENT = -10  #: niceness of the serving thread


class _Server(uvicorn.Server):
    """uvicorn, without its own idea of what a signal means: ending a servo is the program's business."""

    @contextlib.contextmanager
    def capture_signals(self) -> Generator[None, None, None]:
        yield


@final
class Console:
    """A page for a running servo, at `url`.

        servo = Servo(device, world)
        with Console(servo) as console, servo:
            print(console.url)
            console.serve()

    Best made before the servo starts: then the process that paints the felt map loads at the same time.

    port   0 takes any free one
    Raises InputError at once if the port is taken or cannot be had, or the page has not been built.
    """

    def __init__(self, servo: Servant, port: int = PORT, *, felt: FeltMap | None = None) -> None:
        self._servo = servo
        self._socket = _bound(port)
        try:
            app = application(servo, felt)
        except BaseException:
            self._socket.close()
            raise
        self._felt: FeltProcess | None = app.state.felt
        self.port = int(self._socket.getsockname()[1])
        self.url = f"http://{_HOST}:{self.port}/"
        config = uvicorn.Config(
            app,
            log_level="warning",
            access_log=False,
            ws="websockets-sansio",
            ws_max_size=65536,
            ws_per_message_deflate=False,
            timeout_graceful_shutdown=1,
            server_header=False,
        )
        config.load()  # its modules now, not while a servo counts on this process
        self._server = _Server(config)

    def serve(self, *, open_browser: bool = False, until: Callable[[], bool] = lambda: False) -> int | None:
        """Serve until `close`, SIGINT or SIGTERM (the signal's number is returned), `until()`, or the servo's end.

        Signals are only heard in the main thread; the handlers of before are put back.
        """
        heard: list[int] = []

        def end(number: int) -> None:
            heard.append(number)
            self.close()

        with _signals(end), _hurry():
            asyncio.run(self._serve(open_browser, until))
        return heard[0] if heard else None

    async def _serve(self, open_browser: bool, until: Callable[[], bool]) -> None:
        serving = asyncio.create_task(self._server.serve(sockets=[self._socket]))
        opened = not open_browser
        while not serving.done():
            if self._server.started and not opened:
                opened = True
                threading.Thread(target=_opened, args=(self.url,), daemon=True).start()
            if not self._servo.alive or until():
                # One more moment, so that the page can say so before the socket closes.
                await asyncio.sleep(0.7 if not self._servo.alive else 0.0)
                self._server.should_exit = True
                break
            await asyncio.sleep(0.05)
        await serving

    def close(self) -> None:
        """End `serve`; may be called from any thread, and twice."""
        self._server.should_exit = True

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()
        self._socket.close()
        if self._felt is not None:
            self._felt.close()


def _bound(port: int) -> socket.socket:
    """A listening socket on this computer's own address, or InputError that says who to ask."""
    if isinstance(port, bool) or not isinstance(port, int) or not 0 <= port <= 65535:
        raise InputError(f"port must be a whole number from 0 to 65535; got {port!r}")
    listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind((_HOST, port))
        listening.listen(16)
    except OSError as cause:
        listening.close()
        if cause.errno == errno.EADDRINUSE:
            raise InputError(
                f"port {port} of {_HOST} is taken: end the program that holds it (`ss -ltnp 'sport = :{port}'` shows "
                "which), or choose another with --port (0 takes any free one)"
            ) from cause
        raise InputError(
            f"port {port} of {_HOST} cannot be had: {cause.strerror}; choose another with --port"
        ) from cause
    return listening


@contextlib.contextmanager
def _hurry() -> Generator[None, None, None]:
    """This thread keeps a hand's pose fresh: it goes before ordinary programs, where that is permitted (on Linux)."""
    if not sys.platform.startswith("linux"):
        yield
        return
    before = os.getpriority(os.PRIO_PROCESS, 0)  # 0: the calling thread
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, _URGENT)
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, 0, before)


def _opened(url: str) -> None:
    """Open the browser, which is an ordinary program."""
    with contextlib.suppress(OSError, AttributeError):
        os.setpriority(os.PRIO_PROCESS, 0, 0)
    webbrowser.open(url)


@contextlib.contextmanager
def _signals(heard: Callable[[int], None]) -> Generator[None, None, None]:
    """SIGINT and SIGTERM call `heard`, in the main thread; elsewhere nothing changes."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def handler(number: int, frame: FrameType | None) -> None:
        heard(number)

    before = {number: signal.signal(number, handler) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)
