"""Server of a study: the participant's and the experimenter's page, their files and WebSockets, on one port."""

from __future__ import annotations

import asyncio
import secrets
import sys
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self, final

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route, WebSocketRoute

from haptorb.errors import InputError, ServoError
from haptorb.web.access import AccessGate
from haptorb.web.server import PageAddress, bind_socket, page_files, prioritize, respond, run_beside, server, signals
from haptorb_study.pages.page_views import describe_study, list_places
from haptorb_study.pages.session_manager import SessionManager
from haptorb_study.pages.socket_hub import StudySocketHub

__all__ = ["PORT", "STATIC", "StudyServer", "application"]


#: output of the web build
STATIC = Path(__file__).parent.parent / "static"


def application(hub: StudySocketHub, where: PageAddress = PageAddress()) -> Starlette:
    """The ASGI application; InputError if the pages have not been built."""
    files = page_files(STATIC)
    if not {"participant.html", "experimenter.html"} <= set(files):
        raise InputError(
            "the study's pages have not been built: run `cd web && npm ci && npm run build`, or use --terminal"
        )

    async def participant(request: Request) -> Response:
        return respond(files, "participant.html")

    async def experimenter(request: Request) -> Response:
        return respond(files, "experimenter.html")

    async def file(request: Request) -> Response:
        return respond(files, request.path_params["name"])

    return Starlette(
        routes=[
            Route("/", participant),
            Route("/experimenter", experimenter),
            Route("/static/{name}", file),
            WebSocketRoute("/ws/participant", hub.join_participant),
            WebSocketRoute("/ws/experimenter", hub.join_experimenter),
        ],
        middleware=[Middleware(AccessGate, exposed=where.exposed, origin=where.origin)],
        lifespan=run_beside(hub.repeat_pen_goal),
    )


PORT = 8766  #: default; the console has another
_POLL_INTERVAL_S = 0.05  #: polling interval of the session thread [s]
_THREAD_SWITCH_S = 0.0005  #: longest time that another thread delays a Stop [s]
_FAILURE_DISPLAY_S = 0.5  #: for the pages to show that the session thread failed [s]


@final
class StudyServer:
    """Serves the pages of `manager` at `participant` and `experimenter`, each with a token of its own in it.

    Other accounts of this computer reach the port, too, so that even alone on loopback a page needs its token.

    port   0: any free port
    more   additional constants of the experimenter's page: database and forecast
    where  listening address and public address
    Raises InputError if the port is not available or the pages have not been built.
    """

    def __init__(
        self,
        manager: SessionManager,
        port: int = PORT,
        *,
        simulated: bool = True,
        more: Mapping[str, Any] | None = None,
        where: PageAddress = PageAddress(),
    ) -> None:
        self._socket = bind_socket(port, where.host)
        self._manager = manager
        token, participant_token = secrets.token_urlsafe(16), secrets.token_urlsafe(16)
        self.port = int(self._socket.getsockname()[1])
        # In the fragment (#), which browsers do not send: so it is in no request, log or referrer.
        self.participant = f"{where.url(self.port)}#{participant_token}"
        self.experimenter = f"{where.url(self.port, 'experimenter')}#{token}"
        try:
            everything = {"places": list_places(manager.study), **(more or {})}
            about = describe_study(manager.study, simulated)
            hub = StudySocketHub(manager, token, participant_token, about, everything, where)
            self._viewers = hub.viewers
            self._server = server(application(hub, where))
        except BaseException:
            self._socket.close()
            raise

    def serve(self) -> int | None:
        """Serve until `close`, SIGINT or SIGTERM; returns the signal's number.

        Raises ServoError, with the coils off, if the session thread ended unexpectedly.
        """
        signals_seen: list[int] = []

        def end(number: int) -> None:
            signals_seen.append(number)
            self.close()

        before = sys.getswitchinterval()
        sys.setswitchinterval(_THREAD_SWITCH_S)
        self._manager.open()
        try:
            with signals(end), prioritize():
                dead = asyncio.run(self._serve())
        finally:
            self._manager.close()
            self._viewers.close()
            sys.setswitchinterval(before)
        if dead:
            raise ServoError(
                f"the thread that runs the sessions ended: {self._manager.trouble}; the coils are off, and all "
                "answers are stored: start again and enter the same code to continue"
            )
        return signals_seen[0] if signals_seen else None

    async def _serve(self) -> bool:
        """Serve until `close`, or until the session thread has ended; returns whether it has."""
        serving = asyncio.create_task(self._server.serve(sockets=[self._socket]))
        dead = False
        try:
            while not serving.done():
                if dead := self._manager.dead:
                    self._manager.halt.stop(None)
                    await asyncio.sleep(_FAILURE_DISPLAY_S)  # the pages show it
                    self._server.should_exit = True
                    break
                await asyncio.sleep(_POLL_INTERVAL_S)
        finally:
            self._manager.halt.stop(None)  # whatever ends it: no page can stop the device any more
        await serving
        return dead

    def close(self) -> None:
        """End `serve`, coils off first; may be called from any thread, repeatedly."""
        self._manager.halt.stop(None)
        self._server.should_exit = True

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()
        self._socket.close()
