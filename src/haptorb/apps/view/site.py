"""The viewer as an ASGI application: a page with the timeline, in it one page for each recording, and their rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from uuid import uuid4

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import HTTPConnection, Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket

from haptorb.apps.view.painted_worlds import PaintedWorlds
from haptorb.apps.view.played_recording import PlayedRecording
from haptorb.apps.view.row_socket import RowSocket
from haptorb.apps.web.access import AccessGate
from haptorb.apps.web.files import page_files, respond
from haptorb.apps.web.token import choose_token
from haptorb.errors import InputError
from haptorb.version import __version__

__all__ = ["STATIC", "application"]

#: where the build hook puts the pages
STATIC = Path(__file__).parent / "static"

MOST = 16  #: pages of a recording at the same time
_FULL = 1013  #: of a WebSocket that is closed: try again later
_NONE = 4404  #: of one for a recording that there is not


def application(
    recordings: Sequence[PlayedRecording], painted: Sequence[PaintedWorlds | None], opening: Mapping[str, Any]
) -> Starlette:
    """The ASGI application that plays `recordings`, for those who know `app.state.token`.

    painted   the force maps of each recording, None where its device has none
    opening   what the page begins with: `at` [s], `range` ([s, s] or None), `offset` [s] of the second recording

    Raises InputError if the pages have not been built, or the environment's HAPTORB_TOKEN cannot be one.
    """
    token = choose_token()
    files = page_files(STATIC)
    if not {"view.html", "player.html"} <= set(files):
        raise InputError(
            "the viewer's pages have not been built: run `cd web && npm ci && npm run build`, or `make run`"
        )
    started = uuid4().hex
    known = [recording.describe(started) for recording in recordings]
    open_pages = [0 for _ in recordings]

    def number_of(asked: HTTPConnection) -> int | None:
        text = asked.query_params.get("recording", "0")
        return int(text) if text in map(str, range(len(recordings))) else None

    async def file(request: Request) -> Response:
        return respond(files, request.path_params.get("name", "view.html"))

    async def player(request: Request) -> Response:
        return respond(files, "player.html")

    async def describe(request: Request) -> Response:
        descriptions = [one["played"] | {"gives": one["scene"]["gives"], "trips": one["trips"]} for one in known]
        return JSONResponse({"version": __version__, "started": started, "recordings": descriptions, **opening})

    async def describe_one(request: Request) -> Response:
        number = number_of(request)
        return _refuse() if number is None else JSONResponse(known[number])

    async def overview(request: Request) -> Response:
        number = number_of(request)
        if number is None:
            return _refuse()
        recordings[number].overview.start()
        return Response(recordings[number].overview.encode(), media_type="application/octet-stream")

    async def rows(socket: WebSocket) -> None:
        number = number_of(socket)
        if number is None or open_pages[number] >= MOST:
            await socket.accept()
            await socket.close(*((_NONE, "no such recording") if number is None else (_FULL, "too many pages")))
            return
        open_pages[number] += 1
        try:
            await RowSocket(socket, recordings[number], painted[number]).serve()
        finally:
            open_pages[number] -= 1

    app = Starlette(
        routes=[
            Route("/", file),
            Route("/player", player),
            Route("/static/{name}", file),
            Route("/api/view", describe),
            Route("/api/session", describe_one),
            Route("/api/overview", overview),
            WebSocketRoute("/ws", rows),
        ],
        middleware=[Middleware(AccessGate, token=token, free=("/", "/player"), framed=True)],
    )
    app.state.token = token
    return app


def _refuse() -> Response:
    return Response("there is no such recording\n", status_code=404, media_type="text/plain")
