"""The addresses of the study's server: two pages, their files, and a socket for each."""

from __future__ import annotations

from pathlib import Path

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route, WebSocketRoute

from haptorb.apps.study.pages.socket_hub import StudySocketHub
from haptorb.apps.web.access import AccessGate
from haptorb.apps.web.files import page_files, respond
from haptorb.apps.web.server import run_beside
from haptorb.errors import InputError

__all__ = ["STATIC", "application"]

#: where the build hook puts the pages
STATIC = Path(__file__).parent / "static"


def application(hub: StudySocketHub) -> Starlette:
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
        middleware=[Middleware(AccessGate)],
        lifespan=run_beside(hub.keep),
    )
