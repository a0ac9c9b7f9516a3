"""The console's server: one port on this computer only, served until the servo or the user ends it."""

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
# The console as an ASGI application: one page, its files, what it must know, and one WebSocket.


#: where the build hook puts the page
STATIC = Path(__file__).parent / "console_static"


def application(
    servo: Servo,
    force_map: ForceMapSource | None = None,
    designs: DesignSession | None = None,
    framed_by: str = "",
    where: PageAddress = PageAddress(),
) -> Starlette:
    """The ASGI application for one running servo, for those who know `app.state.token`.

    With `designs`, pages choose and rate those, and neither world nor parameters. Pages of the origin `framed_by`, of
    this program, may frame the console's.

    `force_map` answers what the device would give at points in space; by default the simulation of `servo.device` does.
    `app.state.force_map` is the process behind that, to be closed at the end, or None.
    Raises InputError if the page has not been built, or the environment's HAPTORB_TOKEN cannot be one.
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
        lifespan=run_beside(hub.keep),
    )
    app.state.force_map = process
    app.state.token = token
    return app


PORT = 8765  #: default
_END_CHECK_INTERVAL_S = (
    0.01  #: between two looks whether to end: a duration that is over leaves the coils on for so long [s]
)


@final
class Console:
    """A page for a running servo, at `url`: the address of this computer, and behind its # the token of this run.

    Who does not know the token, such as another account of this computer, gets neither numbers nor control.

        servo = Servo(device, world)
        with Console(servo) as console, servo:
            print(console.url)
            console.serve()

    Best made before the servo starts: then the process that paints the force map loads at the same time.

    port      0 takes any free one
    designs   a session in which designs are felt and rated; its panel stands in place of the world's
    framed_by  origin of another server of this program whose pages may frame the console's; empty: none may
    where     the address that it listens on, and the one at which browsers find it; else this computer's own
    Raises InputError at once if the port is taken or cannot be had, or the page has not been built.
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
        self.token: str = app.state.token  #: what a program says instead: `Authorization: Bearer TOKEN`
        self.origin = f"http://{HOST}:{self.port}"
        self.url = f"{where.url(self.port)}#{self.token}"
        self._server = server(app)

    @property
    def answers(self) -> bool:
        """Whether a browser that opens `url` now gets the page."""
        return self._server.started

    def serve(self, *, open_browser: bool = False, until: Callable[[], bool] = lambda: False) -> int | None:
        """Serve until `close`, SIGINT, SIGTERM or SIGHUP (the signal's number is returned), `until()`, or the servo's
        end.

        The loop ends with it, coils off first: nobody could stop it from the page any more. Signals are received only
        in the main thread; the former handlers are restored.
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
        while not serving.done():
            if self._server.started and not opened:
                opened = True
                threading.Thread(target=open_browser_at, args=(self.url,), daemon=True).start()
            if not self._servo.alive:
                await asyncio.sleep(0.7)  # one more moment, so that the page can show it before the socket closes
                self._server.should_exit = True
                break
            if until():
                self._servo.end_loop()
                self._server.should_exit = True
                break
            await asyncio.sleep(_END_CHECK_INTERVAL_S)
        await serving

    def close(self) -> None:
        """End `serve`, and the loop with it; may be called from any thread, and twice."""
        self._servo.end_loop()
        self._server.should_exit = True

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._server.should_exit = True
        self._socket.close()
        if self._force_map is not None:
            self._force_map.close()
