"""The console as an ASGI application: one page, its files, what it must know, and one WebSocket."""

from __future__ import annotations

import asyncio
from pathlib import Path
from uuid import uuid4

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route, WebSocketRoute

from haptorb.apps.console.designs.design_session import DesignSession
from haptorb.apps.console.force_map import ForceMapSource, ForceMapWorker
from haptorb.apps.console.running_servo import RunningServo
from haptorb.apps.console.session import session, worlds_now
from haptorb.apps.console.socket_hub import ConsoleSocketHub
from haptorb.apps.web.access import AccessGate
from haptorb.apps.web.files import page_files, respond
from haptorb.apps.web.server import run_beside
from haptorb.apps.web.token import choose_token
from haptorb.errors import InputError

__all__ = ["STATIC", "application"]

#: where the build hook puts the page
STATIC = Path(__file__).parent / "static"


def application(
    servo: RunningServo,
    force_map: ForceMapSource | None = None,
    designs: DesignSession | None = None,
    framed_by: str = "",
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
    compute = device.kind.part("force_map")
    if compute is not None and device.shell is not None:
        if force_map is None:
            force_map = process = compute(device)
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
        middleware=[Middleware(AccessGate, token=token, framed_by=framed_by)],
        lifespan=run_beside(hub.keep),
    )
    app.state.force_map = process
    app.state.token = token
    return app
