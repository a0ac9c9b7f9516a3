"""The viewer's server: one port on this computer only, served until the user ends it."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self, final

from haptorb.apps.console.force_map import ForceMapSource
from haptorb.apps.view.painted_worlds import PaintedWorlds
from haptorb.apps.view.played_recording import PlayedRecording
from haptorb.apps.view.site import application
from haptorb.apps.web.browser import open_browser_at
from haptorb.apps.web.server import HOST, bind_socket, server, signals
from haptorb.errors import InputError

__all__ = ["PORT", "Viewer"]

PORT = 8767  #: default; the console's and the study's are others
_LOOK = 0.1  #: between two looks whether to end [s]


@final
class Viewer:
    """A page that plays one recording, or two side by side, at `url`: only who knows the part behind its # may look.

        with Viewer(["run.mcap"]) as viewer:
            print(viewer.url)
            viewer.serve()

    paths     of one or two recordings
    port      0 takes any free one
    at        time after the first tick at which it begins [s]; None: where `span` does
    span      first and last time of the part that is repeated, on the loop's clock [s]; None: nothing is
    offset    how much later the second recording begins than the first [s]; below 0: earlier
    device    name or path of the device that is drawn; None: that of the recording
    force_map  answers what a device would give at points in space; None: the device's own simulation
    Raises RecordingError or InputError for files that cannot be played, a port that cannot be had, or pages that are
    not built.
    """

    def __init__(
        self,
        paths: Sequence[Path | str],
        port: int = PORT,
        *,
        at: float | None = None,
        span: tuple[float, float] | None = None,
        offset: float = 0.0,
        device: str | None = None,
        force_map: ForceMapSource | None = None,
    ) -> None:
        if not 1 <= len(paths) <= 2:
            raise InputError(f"one or two recordings can be played; got {len(paths)}")
        self._socket = bind_socket(port)
        self.recordings: list[PlayedRecording] = []
        self._painted: list[PaintedWorlds | None] = []
        try:
            for path in paths:
                self.recordings.append(PlayedRecording(Path(path), device))
            self._painted = [_paint(recording, force_map) for recording in self.recordings]
            part = self._clip(span)
            begin = (part[0] if part else 0.0) if at is None else at
            self.opening = {"at": begin, "range": part, "offset": offset}  #: what the page begins with [s]
            app = application(self.recordings, self._painted, self.opening)
        except BaseException:
            self._end()
            raise
        self.port = int(self._socket.getsockname()[1])
        self.token: str = app.state.token
        self.url = f"http://{HOST}:{self.port}/#{self.token}"
        self._server = server(app)

    def serve(
        self, *, open_browser: bool = False, ready: Callable[[], None] = lambda: None, until: float | None = None
    ) -> int | None:
        """Serve until `close`, SIGINT or SIGTERM (the signal's number is returned), or for `until` seconds.

        `ready` is called once a browser gets a reply. Signals are received only in the main thread.
        """
        signals_seen: list[int] = []

        def end(number: int) -> None:
            signals_seen.append(number)
            self.close()

        with signals(end):
            asyncio.run(self._serve(open_browser, ready, until))
        return signals_seen[0] if signals_seen else None

    async def _serve(self, open_browser: bool, ready: Callable[[], None], until: float | None) -> None:
        clock = asyncio.get_running_loop().time
        end = float("inf") if until is None else clock() + until
        serving = asyncio.create_task(self._server.serve(sockets=[self._socket]))
        answers = False
        while not serving.done():
            if self._server.started and not answers:
                answers = True
                ready()
                if open_browser:
                    threading.Thread(target=open_browser_at, args=(self.url,), daemon=True).start()
            if clock() > end:
                self._server.should_exit = True
            await asyncio.sleep(_LOOK if answers else _LOOK / 10)
        await serving
        for painted in self._painted:  # a map that is being computed would be waited for
            if painted is not None:
                painted.close()

    def close(self) -> None:
        """End `serve`; may be called from any thread, and twice."""
        self._server.should_exit = True

    def _clip(self, span: tuple[float, float] | None) -> tuple[float, float] | None:
        """`span` on the loop's clock, in times after the first tick of the first recording, within it."""
        if span is None:
            return None
        one = self.recordings[0]
        first, last = (min(max(time - one.start, 0.0), one.seconds) for time in span)
        if last <= first:
            raise InputError(
                f"{one.name} has no ticks from {span[0]:g} s to {span[1]:g} s: it is from {one.start:g} s to "
                f"{one.start + one.seconds:g} s"
            )
        return first, last

    def _end(self) -> None:
        self._socket.close()
        for recording in self.recordings:
            recording.close()
        for painted in self._painted:
            if painted is not None:
                painted.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()
        self._end()


def _paint(recording: PlayedRecording, force_map: ForceMapSource | None) -> PaintedWorlds | None:
    compute = recording.device.kind.part("force_map")
    if compute is None or recording.device.shell is None:
        return None
    if force_map is not None:
        return PaintedWorlds(recording, force_map)
    process = compute(recording.device)
    process.render = recording.render
    return PaintedWorlds(recording, process, process.close)
