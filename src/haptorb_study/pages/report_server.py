"""Server of a report on this computer, with a link beside each recorded trial that plays it as `haptorb view` does.

The page is plain HTML, so the token is in its path: requests without it are rejected.
"""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Callable, Sequence
from html import escape
from pathlib import Path
from typing import final

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import HTMLResponse, RedirectResponse, Response
from starlette.routing import Route

from haptorb.errors import InputError
from haptorb.web.access import AccessGate, choose_token
from haptorb.web.server import HOST, bind_socket, server, signals
from haptorb_study.pages.trial_viewers import TrialViewers

__all__ = ["REPORT_SERVER_PORT", "ReportServer"]


REPORT_SERVER_PORT = 8768  #: default

_HEADERS = {
    "content-security-policy": "default-src 'none'; img-src data:; style-src 'unsafe-inline'; frame-ancestors 'none'",
    "referrer-policy": "no-referrer",
    "x-content-type-options": "nosniff",
    "cache-control": "no-store",
}


@final
class ReportServer:
    """Serves the page `html`; its link `play/N` plays part N, from 0, of `parts` (FILE#t=FROM,TO).

    url  on this computer only. Raises InputError for a `port` that is not available.
    """

    def __init__(self, html: str, parts: Sequence[str], port: int = REPORT_SERVER_PORT) -> None:
        self._html, self._parts = html, list(parts)
        self._token, self._troubles = choose_token(), dict[int, str]()
        self._viewers = TrialViewers()
        self._socket = bind_socket(port)
        self.url = f"http://{HOST}:{self._socket.getsockname()[1]}/{self._token}/"
        routes = [Route("/{token}/", self._report), Route("/{token}/play/{number:int}", self._play)]
        self._server = server(Starlette(routes=routes))

    def serve(self, ready: Callable[[], None] = lambda: None) -> int | None:
        """Serve until `close`, SIGINT or SIGTERM, and return the signal's number; `ready` is called first."""
        numbers: list[int] = []

        def end(number: int) -> None:
            numbers.append(number)
            self.close()

        try:
            with signals(end):
                ready()
                asyncio.run(self._server.serve(sockets=[self._socket]))
        finally:
            self._viewers.close()
            self._socket.close()
        return numbers[0] if numbers else None

    def close(self) -> None:
        """End `serve`; may be called from any thread, repeatedly."""
        self._server.should_exit = True

    def _refuse(self, request: Request) -> Response | None:
        refusal = AccessGate.refusal(request.headers)
        known = secrets.compare_digest(request.path_params["token"].encode(), self._token.encode())
        if not known:  # safety: report-token
            refusal = "open the full address that the terminal printed"
        return None if refusal is None else Response(f"{refusal}\n", 403, _HEADERS)

    async def _report(self, request: Request) -> Response:
        return self._refuse(request) or HTMLResponse(self._html, headers=_HEADERS)

    async def _play(self, request: Request) -> Response:
        """Start a viewer; the page reloads until its URL is known, then redirects."""
        if (refusal := self._refuse(request)) is not None:
            return refusal
        number = int(request.path_params["number"])
        if not 0 <= number < len(self._parts):
            return HTMLResponse(_message_page("There is no such recording.", again=False), 404, _HEADERS)
        part, trouble = self._parts[number], self._troubles.pop(number, "")
        if not trouble:
            try:
                self._viewers.open(part, lambda text: self._troubles.update({number: text}))
            except InputError as cause:
                trouble = str(cause)
        if trouble:
            return HTMLResponse(_message_page(trouble, again=False), 404, _HEADERS)
        url = self._viewers.urls.get(part, "")
        if url:
            return RedirectResponse(url, 303, _HEADERS)
        return HTMLResponse(_message_page(f"Opening {Path(part).name} ...", again=True), headers=_HEADERS)


def _message_page(text: str, *, again: bool) -> str:
    refresh = "<meta http-equiv='refresh' content='1'>" if again else ""
    return (
        "<!doctype html><html lang='en'><head><meta charset='utf-8'><meta name='color-scheme' content='light dark'>"
        f"<title>haptorb</title>{refresh}</head><body><p>{escape(text)}</p></body></html>"
    )
