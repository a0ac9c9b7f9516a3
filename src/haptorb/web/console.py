"""Console: the page for a running servo and its server, by default reachable only from this computer."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Self, final
from uuid import uuid4

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route, WebSocketRoute

from haptorb.control.registry import has_choice
from haptorb.errors import InputError
from haptorb.runtime.servo import Servo
from haptorb.web.access import AccessGate, choose_token
from haptorb.web.console_hub import ConsoleSocketHub, DesignSession
from haptorb.web.force_map import ForceMapSource, ForceMapWorker
from haptorb.web.force_map_process import ForceMapProcess
from haptorb.web.server import (
    HOST,
    PageAddress,
    bind_socket,
    open_browser_at,
    page_files,
    prioritize,
    respond,
    run_beside,
    server,
    signals,
)
from haptorb.web.session import session, worlds_now

__all__ = ["PORT", "STATIC", "Console", "application"]


# --------------------------------------------------------------------------------------------------
# ASGI application of the console: the page, its files, the session description, and one WebSocket.


#: folder into which the build hook writes the page
STATIC = Path(__file__).parent / "console_static"


def application(
    servo: Servo,
    force_map: ForceMapSource | None = None,
    designs: DesignSession | None = None,
    framed_by: str = "",
    where: PageAddress = PageAddress(),
) -> Starlette:
    """Build the ASGI application of the console for one running servo; requests need `app.state.token`.

    With `designs`, pages select and rate designs, and cannot set world or parameters. Pages of the origin `framed_by`,
    another server of this program, may frame the console.

    `force_map` computes the force of the device at points in space; by default a simulation of `servo.device`.
    `app.state.force_map` is the process of that simulation, to be closed at the end, or None.
    Raises InputError if the page has not been built, or HAPTORB_TOKEN of the environment is not a valid token.
    """
    token = choose_token()
    files = page_files(STATIC)
    if "index.html" not in files:
        raise InputError(
            "the console's page has not been built: run `cd web && npm ci && npm run build`, or `make run`"
        )
    device = servo.device
    painter, process = None, None
    if device.shell is not None and has_choice(device):
        if force_map is None:
            force_map = process = ForceMapProcess(device)
            process.start()
            process.own_worlds = lambda: servo.own_worlds
            process.render = servo.render
        painter = ForceMapWorker(device, force_map)
    hub = ConsoleSocketHub(servo, painter, designs)
    known = session(servo, uuid4().hex)

    async def file(request: Request) -> Response:
        return respond(files, request.path_params.get("name", "index.html"))

    async def describe(request: Request) -> Response:
        shown = designs is None or not designs.hidden
        now = {"feel": None if designs is None else dict(await asyncio.to_thread(designs.describe))}
        return JSONResponse(known | now | worlds_now(servo, shown=shown))

    app = Starlette(
        routes=[
            Route("/", file),
            Route("/static/{name}", file),
            Route("/api/session", describe),
            WebSocketRoute("/ws", hub.join),
        ],
        middleware=[
            Middleware(AccessGate, token=token, framed_by=framed_by, exposed=where.exposed, origin=where.origin)
        ],
        lifespan=run_beside(hub.run),
    )
    app.state.force_map = process
    app.state.token = token
    return app


PORT = 8765  #: default port
#: polling interval of the end condition: after the duration of a run the coils stay on for at most this long [s]
_END_POLL_INTERVAL_S = 0.01


@final
class Console:
    """Console page of a running servo at `url`, which contains the token of this run after #.

    Clients without the token, such as other accounts of this computer, get neither data nor control.

        servo = Servo(device, world)
        with Console(servo) as console, servo:
            print(console.url)
            console.serve()

    Create it before the servo starts, so that the process of the force map loads at the same time.

    port       0: any free port
    designs    session in which designs are rated; its panel replaces that of the world
    framed_by  origin of another server of this program whose pages may frame the console; empty: none
    where      address that it listens on, and public address; by default loopback only
    Raises InputError at once if the port is not available or the page has not been built.
    """

    def __init__(
        self,
        servo: Servo,
        port: int = PORT,
        *,
        force_map: ForceMapSource | None = None,
        designs: DesignSession | None = None,
        framed_by: str = "",
        where: PageAddress = PageAddress(),
    ) -> None:
        self._servo = servo
        self._socket = bind_socket(port, where.host)
        try:
            app = application(servo, force_map, designs, framed_by, where)
        except BaseException:
            self._socket.close()
            raise
        self._force_map: ForceMapProcess | None = app.state.force_map
        self.port = int(self._socket.getsockname()[1])
        self.token: str = app.state.token  #: for programs: header `Authorization: Bearer TOKEN`
        self.origin = f"http://{HOST}:{self.port}"
        self.url = f"{where.url(self.port)}#{self.token}"
        self._server = server(app)

    @property
    def answers(self) -> bool:
        """Whether the server answers requests."""
        return self._server.started

    def serve(self, *, open_browser: bool = False, until: Callable[[], bool] = lambda: False) -> int | None:
        """Serve until `close`, a signal (its number is returned), `until()`, or the end of the servo.

        The loop ends with the server, coils off first, because the page could not stop it any more. Signals are
        handled only in the main thread; the previous handlers are restored.
        """
        signals_seen: list[int] = []

        def end(number: int) -> None:
            self._servo.end_loop()
            signals_seen.append(number)
            self.close()

        try:
            with signals(end), prioritize():
                asyncio.run(self._serve(open_browser, until))
        finally:
            self._servo.end_loop()
        return signals_seen[0] if signals_seen else None

    async def _serve(self, open_browser: bool, until: Callable[[], bool]) -> None:
        serving = asyncio.create_task(self._server.serve(sockets=[self._socket]))
        opened = not open_browser
        try:
            while not serving.done():
                if self._server.started and not opened:
                    opened = True
                    threading.Thread(target=open_browser_at, args=(self.url,), daemon=True).start()
                if not self._servo.alive:
                    await asyncio.sleep(0.7)  # so that the page can show the end before the socket closes
                    break
                if until():
                    break
                await asyncio.sleep(_END_POLL_INTERVAL_S)
        finally:  # also where `until` fails: the end of an event loop waits for the threads of its executor
            self._servo.end_loop()  # safety: console-loop-first
            self._server.should_exit = True
        await serving

    def close(self) -> None:
        """End `serve` and the loop. Thread-safe; may be called twice."""
        self._servo.end_loop()
        self._server.should_exit = True

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._server.should_exit = True
        self._socket.close()
        if self._force_map is not None:
            self._force_map.close()
