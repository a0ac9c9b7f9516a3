"""Both pages of a study on one port of this computer, until a signal or `close`."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Mapping
from types import TracebackType
from typing import Any, Self, final

from haptorb.apps.study.pages.reception import Reception
from haptorb.apps.study.pages.room import Room
from haptorb.apps.study.pages.site import application
from haptorb.apps.study.pages.views import about, places
from haptorb.apps.web.server import HOST, bound, hurry, server, signals

__all__ = ["PORT", "Host"]

PORT = 8766  #: unless told otherwise; the console's is another


@final
class Host:
    """Serves `reception` at `participant` and, to whoever knows the token in it, at `experimenter`.

    port   0 takes any free one
    more   what the experimenter's page shows besides: where answers are kept, what was foretold
    Raises InputError at once if the port cannot be had or the pages have not been built.
    """

    def __init__(
        self, reception: Reception, port: int = PORT, *, simulated: bool = True, more: Mapping[str, Any] | None = None
    ) -> None:
        self._socket = bound(port)
        self._reception = reception
        token = secrets.token_urlsafe(16)
        self.port = int(self._socket.getsockname()[1])
        self.participant = f"http://{HOST}:{self.port}/"
        # Behind the #: browsers keep that to themselves, so it is in no request, no log and no referrer.
        self.experimenter = f"http://{HOST}:{self.port}/experimenter#{token}"
        try:
            everything = {"places": places(reception.study), **(more or {})}
            room = Room(reception, token, about(reception.study, simulated), everything)
            self._server = server(application(room))
        except BaseException:
            self._socket.close()
            raise

    def serve(self) -> int | None:
        """Serve until `close`, SIGINT or SIGTERM; the signal's number is returned."""
        heard: list[int] = []

        def end(number: int) -> None:
            heard.append(number)
            self.close()

        self._reception.open()
        try:
            with signals(end), hurry():
                asyncio.run(self._server.serve(sockets=[self._socket]))
        finally:
            self._reception.close()
        return heard[0] if heard else None

    def close(self) -> None:
        """End `serve`; may be called from any thread, and twice."""
        self._server.should_exit = True

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()
        self._socket.close()
