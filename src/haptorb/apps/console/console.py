"""The console's server: one port on this computer only, served until the servo or the user ends it."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from types import TracebackType
from typing import Self, final

from haptorb.apps.console.designs.design_session import DesignSession
from haptorb.apps.console.force_map import ForceMapSource
from haptorb.apps.console.force_map_process import ForceMapProcess
from haptorb.apps.console.running_servo import RunningServo
from haptorb.apps.console.site import application
from haptorb.apps.web.browser import open_browser_at
from haptorb.apps.web.server import HOST, bind_socket, prioritize, server, signals

__all__ = ["PORT", "Console"]

PORT = 8765  #: default
_LOOK = 0.01  #: between two looks whether to end: a duration that is over leaves the coils on for so long [s]


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
    Raises InputError at once if the port is taken or cannot be had, or the page has not been built.
    """

    def __init__(
        self,
        servo: RunningServo,
        port: int = PORT,
        *,
        force_map: ForceMapSource | None = None,
        designs: DesignSession | None = None,
        framed_by: str = "",
    ) -> None:
        self._servo = servo
        self._socket = bind_socket(port)
        try:
            app = application(servo, force_map, designs, framed_by)
        except BaseException:
            self._socket.close()
            raise
        self._force_map: ForceMapProcess | None = app.state.force_map
        self.port = int(self._socket.getsockname()[1])
        self.token: str = app.state.token  #: what a program says instead: `Authorization: Bearer TOKEN`
        self.origin = f"http://{HOST}:{self.port}"
        self.url = f"{self.origin}/#{self.token}"
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
            await asyncio.sleep(_LOOK)
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
