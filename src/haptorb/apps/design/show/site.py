"""The chooser as an ASGI application: one page, the designs, which one is wanted, and what runs."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.routing import Route

from haptorb.apps.design.show.selection import Selection
from haptorb.apps.web.access import AccessGate
from haptorb.apps.web.files import page_files, respond
from haptorb.apps.web.server import HOST
from haptorb.apps.web.token import choose_token
from haptorb.errors import InputError

__all__ = ["application"]

_STATIC = Path(__file__).parents[1] / "static"
_LONGEST = 1000  #: of what a page asks for [bytes]


def application(designs: Mapping[str, Any], selection: Selection) -> Starlette:
    """The ASGI application in which pages choose among `designs` (plain JSON types), for those who know
    `app.state.token`.

    Raises InputError if the page has not been built, or the environment's HAPTORB_TOKEN cannot be one.
    """
    token = choose_token()
    files = page_files(_STATIC)
    if "chooser.html" not in files:
        raise InputError(
            "the chooser's page has not been built: run `cd web && npm ci && npm run build`, or `make run`"
        )
    known = json.dumps(designs, separators=(",", ":")).encode()

    async def file(request: Request) -> Response:
        return respond(files, request.path_params.get("name", "chooser.html"))

    async def describe(request: Request) -> Response:
        return Response(known, media_type="application/json")

    async def tell(request: Request) -> Response:
        return JSONResponse(selection.describe())

    async def choose(request: Request) -> Response:
        try:
            await asyncio.to_thread(selection.choose, await _read_row(request))
        except InputError as mistake:
            return PlainTextResponse(f"{mistake}\n", status_code=409)
        return JSONResponse(selection.describe())

    async def stop(request: Request) -> Response:
        await asyncio.to_thread(selection.stop)
        return JSONResponse(selection.describe())

    app = Starlette(
        routes=[
            Route("/", file),
            Route("/static/{name}", file),
            Route("/api/designs", describe),
            Route("/api/now", tell),
            Route("/api/choose", choose, methods=["POST"]),
            Route("/api/stop", stop, methods=["POST"]),
        ],
        middleware=[Middleware(AccessGate, token=token, frames=f"http://{HOST}:*")],
    )
    app.state.token = token
    return app


async def _read_row(request: Request) -> Any:
    """What a page asks for; InputError for anything but a small JSON object."""
    body = b""
    async for part in request.stream():
        body += part
        if len(body) > _LONGEST:
            raise InputError(f"a choice must have at most {_LONGEST} bytes")
    try:
        asked = json.loads(body)
    except (ValueError, RecursionError) as cause:
        raise InputError(f"a choice must be JSON: {cause}") from cause
    if not isinstance(asked, dict):
        raise InputError("a choice must be a JSON object, such as {'row': 3}")
    return asked.get("row")
