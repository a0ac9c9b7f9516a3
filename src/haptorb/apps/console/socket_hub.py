"""Everyone who looks at the device: one page holds the hand, the others watch; anyone may stop."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Mapping
from typing import Any, final

from starlette.websockets import WebSocket, WebSocketDisconnect

from haptorb.apps.console.designs.design_relay import DesignRelay
from haptorb.apps.console.designs.design_session import DesignSession
from haptorb.apps.console.force_map import ForceMapWorker
from haptorb.apps.console.health import Health, describe_troubles
from haptorb.apps.console.page import ConsolePage, to_json, wait_for_first
from haptorb.apps.console.pointer_relay import PointerRelay
from haptorb.apps.console.recent import RecentRows
from haptorb.apps.console.running_servo import RunningServo
from haptorb.apps.console.session import describe_world, press_buttons, read_world, worlds
from haptorb.apps.console.target import prepare
from haptorb.apps.console.wire import Columns, encode_force_frame, mesh_frame, pointer, rows_frame
from haptorb.apps.web.command import command as read_command
from haptorb.apps.web.command import is_stop_request
from haptorb.apps.web.token import PROTOCOL
from haptorb.errors import HaptorbError, InputError
from haptorb.runtime.trackers.pose_filter import REASONS

__all__ = ["MOST", "ConsoleSocketHub"]

MOST = 16  #: pages at the same time
FRAME = 1 / 60  #: between two frames [s]
SOON = 1 / 500  #: between two looks at the rows while an answer to the pointer is awaited [s]
REFRESH = 1 / 100  #: between two refreshes of a hand at rest [s]
LOOK = 0.5  #: between two looks at the loop's health [s]
FRESH = 0.1  #: from steadying the hand to engaging [s]

_TELLING = (
    "another_sender",
    "another_account",
    "stranger",
    "jump",
)  # what a tracker refuses and a person should know of
_FULL = 1013  #: of a WebSocket that is closed: try again later
_COMMANDS = "stop, engage, home, drop, mode, model, clutch, cool, buttons, world"
_NAME = 64  #: of a world, a mode or a value [characters]


@final
class ConsoleSocketHub:
    """Joins pages to one servo, which must run before the first page comes."""

    def __init__(
        self, servo: RunningServo, painter: ForceMapWorker | None, designs: DesignSession | None = None
    ) -> None:
        self._servo = servo
        self._painter = painter
        self._pages: list[ConsolePage] = []  # the first has the control
        self._designs = None if designs is None else DesignRelay(designs, self._pages, self._notice_world)
        self._hand = PointerRelay(servo)
        self._health = Health(servo)
        self._recent = RecentRows(servo)
        columns = Columns(servo.layout, bool(servo.modes))
        self._index = columns.index
        layout = servo.layout
        self._t, self._tick, self._target = layout["t"].start, layout["tick"].start, layout["target"]
        self._turn = layout["target_q"]
        if servo.modes:
            prepare()
        self._world: tuple[str, dict[str, Any], str, bool] = ("", {}, "", False)
        self._own = servo.own_worlds  # as the pages know them
        self._version = 0
        self._asked: tuple[ConsolePage, str, dict[str, Any]] | None = None
        self._trouble = ""  # why there is no map of this world
        self._asking: asyncio.Task[None] | None = None
        self._refused = dict.fromkeys(_TELLING, 0)
        self._engaging: asyncio.TimerHandle | None = None

    async def keep(self) -> None:
        """Housekeeping for as long as the server runs: the resting hand, the loop's health, the world."""
        next_look = 0.0
        while True:
            self._hand.keep()
            if time.monotonic() >= next_look:
                next_look = time.monotonic() + LOOK
                if self._pages:
                    self._send_to_all("health", **self._health.look(), **describe_troubles(self._servo))
                self._notice_world()
                self._report_refused_poses()
            if self._designs is not None:
                self._designs.notice()
            await asyncio.sleep(REFRESH)

    async def join(self, socket: WebSocket) -> None:
        """Serve one page until it goes away, or does not listen; a seventeenth is sent away with the reason."""
        await socket.accept(PROTOCOL if PROTOCOL in socket.scope["subprotocols"] else None)
        if len(self._pages) >= MOST:
            await socket.close(_FULL, f"{MOST} pages are open already: close one of them")
            return
        page = ConsolePage(socket)
        self._pages.append(page)
        try:
            self._notice_world()
            self._tell_roles()
            page.tell("world", **self._world_event())
            if self._designs is not None:
                await self._designs.tell([page])
            if self._trouble:
                page.tell("mistake", text=self._trouble)
            await wait_for_first(self._send(page), self._listen(page))
        except (WebSocketDisconnect, RuntimeError, TimeoutError):
            pass  # the page went away while something was on its way, or it does not listen
        finally:
            had_control = self._pages[0] is page
            self._pages.remove(page)
            if had_control:
                self._servo.press(())
                self._cancel_engage()
                self._hand.release()
            self._tell_roles()

    async def _listen(self, page: ConsolePage) -> None:
        while True:
            message = await page.socket.receive()
            if message["type"] == "websocket.disconnect":
                return
            self._handle_message(page, message)
            await asyncio.sleep(0)  # however much one page says, the others have their turn

    def _handle_message(self, page: ConsolePage, message: Mapping[str, Any]) -> None:
        """One message of a page: its pointer, or a command; a stop before all else, from any page and in any form."""
        try:
            if (text := message.get("text")) is not None:
                if is_stop_request(text):  # safety: console-stop-first
                    self._stop()
                else:
                    self._execute(page, read_command(text))
            elif page is self._pages[0]:
                self._hand.point(pointer(message.get("bytes") or b""))
                page.soon.set()
        except HaptorbError as mistake:
            page.tell("mistake", text=str(mistake))

    def _stop(self) -> None:
        self._servo.stop()
        self._cancel_engage()  # safety: console-stop-cancels
        self._send_to_all("stopped", by="you" if len(self._pages) == 1 else "a page")

    def _execute(self, page: ConsolePage, command: dict[str, Any]) -> None:
        """One command; only the page that has the control may do more than stop."""
        match command["do"]:
            case "stop":  # in letters that `is_stop_request` does not read
                self._stop()
            case _ if page is not self._pages[0]:
                raise InputError("another page is in control; this one only watches, and can still stop")
            case "engage":
                self._hand.end_expired_drag()
                self._cancel_engage()
                # The guard engages only on a fresh pose; give it time to see one. A stop in between counts.
                # safety: console-engage-stops
                self._engaging = asyncio.get_running_loop().call_later(FRESH, self._engage, page, self._servo.stops)
            case "home":
                self._hand.let_go()
            case "drop":
                self._hand.drop()
            case "mode":
                self._servo.set_mode(str(command.get("mode"))[:_NAME])
            case "model":
                self._servo.set_model(str(command.get("model"))[:_NAME])
                self._notice_world()
            case "clutch":
                if not isinstance(command.get("engaged"), bool):
                    raise InputError("the clutch is set by `engaged`, true or false")
                self._servo.clutch(command["engaged"])
            case "world" if self._designs is not None:
                raise InputError("in a feel session choose designs in the panel 'Designs'")
            case "feel" if self._designs is not None:
                self._designs.execute(page, command)
            case "cool":
                self._servo.cool()
            case "buttons":
                press_buttons(self._servo, command)
            case "world":
                self._asked = (page, *read_world(command))
                if self._asking is None or self._asking.done():
                    self._asking = asyncio.create_task(self._ask())
            case other:
                raise InputError(f"unknown command {other!r} (known: {_COMMANDS})")

    def _engage(self, page: ConsolePage, stops: int) -> None:
        self._engaging = None
        try:
            self._servo.engage(stops)
        except HaptorbError as mistake:
            page.tell("mistake", text=str(mistake))

    def _cancel_engage(self) -> None:
        if self._engaging is not None:
            self._engaging.cancel()
            self._engaging = None

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
        """Tell everyone, and repaint, if the world or the model that is inverted is another one than before."""
        name, values = self._servo.world
        hidden = self._designs is not None and self._designs.hidden
        now = (name, {key: to_json(value) for key, value in values.items()}, self._servo.model, hidden)
        own = self._servo.own_worlds
        loaded = own is not self._own
        if now == self._world and not loaded:
            return
        self._world, self._own = now, own
        self._version += 1
        if loaded:
            self._send_to_all("worlds", worlds=worlds(self._servo.device, own))
        self._send_to_all("world", **self._world_event())
        if self._painter is not None:
            self._painter.want(name, dict(values), now[2], self._version, self._send_map, self._report_map_failure)

    def _report_refused_poses(self) -> None:
        """Inform every page when another sender feeds the tracker, or it jumps: nothing else would show it."""
        counted = self._servo.tracker_refusals
        refused = {why: counted.get(why, 0) for why in _TELLING}
        news = [f"{refused[why] - n} poses {REASONS[why]}" for why, n in self._refused.items() if refused[why] > n]
        self._refused = refused
        if news:
            self._send_to_all("mistake", text=f"tracker {self._servo.tracker}: refused {', '.join(news)}")

    def _world_event(self) -> dict[str, Any]:
        name, values, model, hidden = self._world
        return describe_world(self._servo, name, values, model, shown=not hidden)

    def _send_map(self) -> None:
        self._trouble = ""
        for page in self._pages:
            page.soon.set()

    def _report_map_failure(self, why: str) -> None:
        self._trouble = why
        self._send_to_all("mistake", text=why)

    def _send_to_all(self, event: str, **what: Any) -> None:
        for page in self._pages:
            page.tell(event, **what)

    def _tell_roles(self) -> None:
        for place, page in enumerate(self._pages):
            page.tell("role", control=place == 0, watchers=len(self._pages) - 1)

    async def _send(self, page: ConsolePage) -> None:
        """Frames to one page, sixty times a second; at once when they answer its pointer or tell of an event."""
        sent = newest = self._recent.look()
        if self._painter is not None:
            await page.send(mesh_frame(self._painter.directions, self._painter.triangles))
        due = time.monotonic()
        while True:
            await page.send_events()
            if self._painter is not None and self._painter.version > page.force_version:
                page.force_version = self._painter.version
                await page.send(encode_force_frame(self._painter.force, self._painter.saturated, page.force_version))
            end = self._recent.look()
            echo = math.nan
            if end > newest and page is self._pages[0]:
                new = self._recent.read_since(newest)
                echo = self._hand.echo(new[:, self._target], new[:, self._turn])
            newest = end
            now = time.monotonic()
            if end > sent and (now >= due or math.isfinite(echo)):
                rows = self._recent.read_since(sent)
                page.dropped += end - sent - len(rows)
                sent = end
                await page.send(rows_frame(rows, self._index, self._t, self._tick, echo, page.dropped))
                due = now + FRAME
            await self._pause(page, max(due - time.monotonic(), 0.0) if end == sent or due > now else 0.0)

    async def _pause(self, page: ConsolePage, rest: float) -> None:
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
