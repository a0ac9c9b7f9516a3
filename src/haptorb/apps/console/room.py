"""Everyone who looks at the device: one page holds the hand, the others watch; anyone may stop."""

from __future__ import annotations

import asyncio
import json
import math
import time
from collections.abc import Mapping
from typing import Any, final

import numpy as np
from starlette.websockets import WebSocket, WebSocketDisconnect

from haptorb.apps.console.felt import Painter
from haptorb.apps.console.hand import Hand
from haptorb.apps.console.health import Health
from haptorb.apps.console.servant import Servant
from haptorb.apps.console.target import prepare, target_scene
from haptorb.apps.console.wire import Columns, felt_frame, mesh_frame, pointer, rows_frame
from haptorb.apps.web.command import command as read_command
from haptorb.errors import HaptorbError, InputError

__all__ = ["Room"]

FRAME = 1 / 60  #: between two frames [s]
SOON = 1 / 500  #: between two looks at the rows while an answer to the pointer is awaited [s]
REFRESH = 1 / 100  #: between two refreshes of a hand at rest [s]
LOOK = 0.5  #: between two looks at the loop's health [s]
FRESH = 0.1  #: from steadying the hand to engaging [s]
BACKLOG = 2.0  #: rows older than this are not worth sending to a page that was too slow [s]


@final
class Page:
    """One connected page: its socket, and the newest of every kind of event that it has not got yet."""

    def __init__(self, socket: WebSocket) -> None:
        self.socket = socket
        self.events: dict[str, dict[str, Any]] = {}
        self.felt = -1  #: version of the felt map that it has
        self.dropped = 0  #: rows that it will never get
        self.soon = asyncio.Event()  #: something is worth sending before the frame is full

    def tell(self, event: str, **what: Any) -> None:
        """Send `event`; a newer one of the same kind replaces it if it has not left yet."""
        self.events[event] = {"event": event, **what}
        self.soon.set()


@final
class Room:
    """Joins pages to one servo, which must run before the first page comes."""

    def __init__(self, servo: Servant, painter: Painter | None) -> None:
        self._servo = servo
        self._painter = painter
        self._pages: list[Page] = []  # the first has the control
        self._hand = Hand(servo)
        self._health = Health(servo)
        columns = Columns(servo.layout, bool(servo.modes))
        self._index = columns.index
        layout = servo.layout
        self._t, self._tick, self._target = layout["t"].start, layout["tick"].start, layout["target"]
        self._turn = layout["target_q"]
        if servo.modes:
            prepare()
        self._world: tuple[str, dict[str, Any]] = ("", {})
        self._version = 0
        self._asked: tuple[Page, str, dict[str, Any]] | None = None
        self._trouble = ""  # why there is no map of this world
        self._asking: asyncio.Task[None] | None = None

    async def keep(self) -> None:
        """Housekeeping for as long as the server runs: the resting hand, the loop's health, the world."""
        next_look = 0.0
        while True:
            self._hand.keep()
            if time.monotonic() >= next_look:
                next_look = time.monotonic() + LOOK
                if self._pages:
                    self._tell_all("health", alive=self._servo.alive, **self._health.look())
                self._notice_world()
            await asyncio.sleep(REFRESH)

    async def join(self, socket: WebSocket) -> None:
        """Serve one page until it goes away."""
        await socket.accept()
        page = Page(socket)
        self._pages.append(page)
        self._notice_world()
        self._tell_roles()
        page.tell("world", **self._world_event())
        if self._trouble:
            page.tell("mistake", text=self._trouble)
        sending = asyncio.create_task(self._send(page))
        try:
            while True:
                message = await socket.receive()
                if message["type"] == "websocket.disconnect":
                    break
                self._hear(page, message)
        except (WebSocketDisconnect, RuntimeError):
            pass  # the page went away while something was on its way
        finally:
            had_control = self._pages[0] is page
            self._pages.remove(page)
            if had_control:
                self._hand.gone()
            self._tell_roles()
            sending.cancel()
            await asyncio.gather(sending, return_exceptions=True)

    def _hear(self, page: Page, message: Mapping[str, Any]) -> None:
        """One message of a page: its pointer, or a command."""
        try:
            if message.get("bytes") is not None:
                if page is self._pages[0]:
                    self._hand.point(pointer(message["bytes"]))
                    page.soon.set()
            else:
                self._obey(page, read_command(message.get("text") or ""))
        except HaptorbError as mistake:
            page.tell("mistake", text=str(mistake))

    def _obey(self, page: Page, command: dict[str, Any]) -> None:
        """One command; only the page that has the control may do more than stop."""
        match command.get("do"):
            case "stop":
                self._servo.stop()
                self._tell_all("stopped", by="you" if len(self._pages) == 1 else "a page")
            case _ if page is not self._pages[0]:
                raise InputError("another page has the control; this one watches (it may still stop)")
            case "engage":
                self._hand.steady()
                # The guard engages only on a fresh pose; give it time to see one.
                asyncio.get_running_loop().call_later(FRESH, self._servo.engage)
            case "home":
                self._hand.home()
            case "mode":
                self._servo.set_mode(str(command.get("mode")))
            case "clutch":
                if not isinstance(command.get("engaged"), bool):
                    raise InputError("the clutch is set by `engaged`, true or false")
                self._servo.clutch(command["engaged"])
            case "world":
                values = command.get("values", {})
                if not isinstance(command.get("name"), str) or not isinstance(values, dict):
                    raise InputError("a world is set by its name (text) and its values (an object)")
                self._asked = (page, command["name"], values)
                if self._asking is None or self._asking.done():
                    self._asking = asyncio.create_task(self._ask())
            case other:
                raise InputError(f"unknown command {other!r} (known: stop, engage, home, mode, clutch, world)")

    async def _ask(self) -> None:
        """Ask the servo for the world that was wished for last; it answers within a tick or two, or refuses."""
        while self._asked is not None:
            (page, name, values), self._asked = self._asked, None
            try:
                await asyncio.to_thread(self._servo.set_world, name, values)
            except HaptorbError as mistake:
                page.tell("mistake", text=str(mistake))
                page.tell("world", **self._world_event())
            self._notice_world()

    def _notice_world(self) -> None:
        """Tell everyone, and repaint, if the world is another one than before."""
        name, values = self._servo.world
        now = (name, {key: _plain(value) for key, value in values.items()})
        if now == self._world:
            return
        self._world = now
        self._version += 1
        self._tell_all("world", **self._world_event())
        if self._painter is not None:
            self._painter.want(name, dict(values), self._version, self._painted, self._not_painted)

    def _world_event(self) -> dict[str, Any]:
        name, values = self._world
        return {"name": name, "values": values, "scene": target_scene(name, values) if self._servo.modes else None}

    def _painted(self) -> None:
        self._trouble = ""
        for page in self._pages:
            page.soon.set()

    def _not_painted(self, why: str) -> None:
        self._trouble = why
        self._tell_all("mistake", text=why)

    def _tell_all(self, event: str, **what: Any) -> None:
        for page in self._pages:
            page.tell(event, **what)

    def _tell_roles(self) -> None:
        for place, page in enumerate(self._pages):
            page.tell("role", control=place == 0, watchers=len(self._pages) - 1)

    async def _send(self, page: Page) -> None:
        """Frames to one page, sixty times a second; at once when they answer its pointer or tell of an event."""
        cursor, _ = self._servo.rows(0)
        if self._painter is not None:
            await page.socket.send_bytes(mesh_frame(self._painter.directions, self._painter.triangles))
        due = time.monotonic()
        unsent: list[Any] = []
        while True:
            while page.events:
                event = page.events.pop(next(iter(page.events)))
                await page.socket.send_text(json.dumps(event, allow_nan=False, default=_plain))
            if self._painter is not None and self._painter.version > page.felt:
                page.felt = self._painter.version
                await page.socket.send_bytes(felt_frame(self._painter.force, self._painter.saturated, page.felt))
            before = cursor
            cursor, rows = self._servo.rows(cursor)
            if len(rows):
                page.dropped += max(cursor - before - len(rows), 0)
                unsent.append(rows)
            echo = math.nan
            if unsent and page is self._pages[0]:
                new = np.concatenate(unsent)
                echo = self._hand.echo(new[:, self._target], new[:, self._turn])
            now = time.monotonic()
            if unsent and (now >= due or math.isfinite(echo)):
                rows, late = _newest(np.concatenate(unsent), self._t)
                unsent.clear()
                page.dropped += late
                await page.socket.send_bytes(rows_frame(rows, self._index, self._t, self._tick, echo, page.dropped))
                due = now + FRAME
            await self._pause(page, max(due - time.monotonic(), 0.0) if not unsent or due > now else 0.0)

    async def _pause(self, page: Page, rest: float) -> None:
        """Wait until the next frame is due, or until there is something to say sooner."""
        if page is self._pages[0] and self._hand.waiting:
            await asyncio.sleep(min(rest, SOON))
            return
        page.soon.clear()
        if page.events:
            return
        try:
            await asyncio.wait_for(page.soon.wait(), max(rest, 1e-3))
        except TimeoutError:
            return


def _newest(rows: Any, t: int) -> tuple[Any, int]:
    """The rows of the last seconds, and how many older ones were left out."""
    first = int(np.searchsorted(rows[:, t], rows[-1, t] - BACKLOG))
    return rows[first:], first


def _plain(value: Any) -> Any:
    """`value` as JSON has it."""
    if isinstance(value, tuple | list | np.ndarray):
        return [float(number) for number in value]
    return value.item() if isinstance(value, np.generic) else value
