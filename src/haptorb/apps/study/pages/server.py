"""Both pages of a study on one port of this computer, until a signal or `close`."""

from __future__ import annotations

import asyncio
import secrets
import sys
from collections.abc import Mapping
from types import TracebackType
from typing import Any, Self, final

from haptorb.apps.study.pages.session_manager import SessionManager
from haptorb.apps.study.pages.site import application
from haptorb.apps.study.pages.socket_hub import StudySocketHub
from haptorb.apps.study.pages.views import describe_study, places
from haptorb.apps.web.server import HOST, bind_socket, prioritize, server, signals
from haptorb.errors import ServoError

__all__ = ["PORT", "StudyServer"]

PORT = 8766  #: default; the console's is another
_LOOK = 0.05  #: between two looks whether the session manager runs [s]
_SWITCH = 0.0005  #: for which another thread of this program may compute on while a Stop has come [s]
_LAST_WORDS = 0.5  #: for the pages to show that it is not [s]


@final
class StudyServer:
    """Serves `manager` at `participant` and, to clients with the token in it, at `experimenter`.

    port   0 takes any free one
    more   what the experimenter's page shows besides: where answers are stored, and the forecast
    Raises InputError at once if the port cannot be had or the pages have not been built.
    """

    def __init__(
        self,
        manager: SessionManager,
        port: int = PORT,
        *,
        simulated: bool = True,
        more: Mapping[str, Any] | None = None,
    ) -> None:
        self._socket = bind_socket(port)
        self._manager = manager
        token = secrets.token_urlsafe(16)
        self.port = int(self._socket.getsockname()[1])
        self.participant = f"http://{HOST}:{self.port}/"
        # Behind the #: browsers keep that to themselves, so it is in no request, no log and no referrer.
        self.experimenter = f"http://{HOST}:{self.port}/experimenter#{token}"
        try:
            everything = {"places": places(manager.study), **(more or {})}
            hub = StudySocketHub(manager, token, describe_study(manager.study, simulated), everything)
            self._viewers = hub.viewers
            self._server = server(application(hub))
        except BaseException:
            self._socket.close()
            raise

    def serve(self) -> int | None:
        """Serve until `close`, SIGINT or SIGTERM; the signal's number is returned.

        Raises ServoError, with the coils off, if the thread that runs the sessions ended by itself.
        """
        signals_seen: list[int] = []

        def end(number: int) -> None:
            signals_seen.append(number)
            self._manager.halt.stop(None)
            self.close()

        before = sys.getswitchinterval()
        sys.setswitchinterval(_SWITCH)
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
                f"the thread that runs the sessions ended: {self._reception.trouble}; the coils are off, and all "
                "answers are stored: start again and enter the same code to continue"
            )
        return signals_seen[0] if signals_seen else None

    async def _serve(self) -> bool:
        """Serve until `close`, or until the session's thread has ended; returns whether it was that."""
        serving = asyncio.create_task(self._server.serve(sockets=[self._socket]))
        dead = False
        while not serving.done():
            if dead := self._manager.dead:
                self._manager.halt.stop(None)
                await asyncio.sleep(_LAST_WORDS)  # the pages show it
                self._server.should_exit = True
                break
            await asyncio.sleep(_LOOK)
        await serving
        return dead

    def close(self) -> None:
        """End `serve`; may be called from any thread, and twice."""
        self._server.should_exit = True

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()
        self._socket.close()
