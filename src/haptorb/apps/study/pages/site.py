"""The addresses of the study's server: two pages, their files, and a socket for each."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route, WebSocketRoute

from haptorb.apps.study.pages.room import Room
from haptorb.apps.web.doors import Doors
from haptorb.errors import InputError

__all__ = ["STATIC", "application"]

#: where the build hook puts the pages
STATIC = Path(__file__).parent / "static"

_KINDS = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".svg": "image/svg+xml",
}


def application(room: Room) -> Starlette:
    """The ASGI application; InputError if the pages have not been built."""
    files = {path.name: (path.read_bytes(), _KINDS[path.suffix]) for path in STATIC.glob("*") if path.suffix in _KINDS}
    if not {"participant.html", "experimenter.html"} <= set(files):
        raise InputError(
            "the study's pages have not been built: run `cd web && npm ci && npm run build`, or use --terminal"
        )

    def page(name: str) -> Response:
        if name not in files:
            return Response("there is no such file\n", status_code=404, media_type="text/plain")
        content, kind = files[name]
        return Response(content, media_type=kind)

    async def participant(request: Request) -> Response:
        return page("participant.html")

    async def experimenter(request: Request) -> Response:
        return page("experimenter.html")

    async def file(request: Request) -> Response:
        return page(request.path_params["name"])

    @asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        keeping = asyncio.create_task(room.keep())
        try:
            yield
        finally:
            keeping.cancel()
            with suppress(asyncio.CancelledError):
                await keeping

    return Starlette(
        routes=[
            Route("/", participant),
            Route("/experimenter", experimenter),
            Route("/static/{name}", file),
            WebSocketRoute("/ws/participant", room.join_participant),
            WebSocketRoute("/ws/experimenter", room.join_experimenter),
        ],
        middleware=[Middleware(Doors)],
        lifespan=lifespan,
    )
