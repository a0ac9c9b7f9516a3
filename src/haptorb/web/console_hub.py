"""WebSocket hub of the console: one page controls the device, the others observe; every page can stop it."""

from __future__ import annotations

import asyncio
import json
import math
import time
from collections import deque
from collections.abc import Callable, Coroutine, Mapping
from typing import Any, Protocol, final

import numpy as np
from starlette.websockets import WebSocket, WebSocketDisconnect

from haptorb.arrays import Array
from haptorb.errors import HaptorbError, InputError
from haptorb.runtime.servo import Servo
from haptorb.runtime.trackers.pose_filter import REASONS
from haptorb.web.access import PROTOCOL
from haptorb.web.force_map import ForceMapWorker
from haptorb.web.server import MAX_PAGES, TRY_AGAIN_LATER, is_request
from haptorb.web.server import command as read_command
from haptorb.web.session import PointerRelay, describe_world, prepare, press_buttons, read_world, worlds
from haptorb.web.wire import Columns, encode_force_frame, mesh_frame, pointer, rows_frame

__all__ = [
    "MAX_BACKLOG_S",
    "SEND_TIMEOUT_S",
    "ConsolePage",
    "ConsoleSocketHub",
    "DesignRelay",
    "DesignSession",
    "Health",
    "RecentRows",
    "describe_troubles",
    "to_json",
    "wait_for_first",
]


# --------------------------------------------------------------------------------------------------
# Connection of one page: its socket, and the events to send; a page that does not read is disconnected.


SEND_TIMEOUT_S = 5.0  #: send timeout of a page that does not read [s]


@final
class ConsolePage:
    """Connection of one page; of each kind of event only the newest is queued, which bounds the cost of a slow page."""

    def __init__(self, socket: WebSocket) -> None:
        self.socket = socket
        self.events: dict[str, dict[str, Any]] = {}
        self.force_version = -1  #: version of the last force map sent
        self.dropped = 0  #: rows not sent because the page was too slow
        self.soon = asyncio.Event()  #: set to send before the next frame is due

    def enqueue(self, event: str, **values: Any) -> None:
        """Enqueue `event`; it replaces one of the same kind that was not sent yet."""
        self.events[event] = {"event": event, **values}
        self.soon.set()

    async def send_events(self) -> None:
        """Send all queued events. Raises TimeoutError as `send` does."""
        while self.events:
            event = self.events.pop(next(iter(self.events)))
            async with asyncio.timeout(SEND_TIMEOUT_S):
                await self.socket.send_text(json.dumps(event, allow_nan=False, default=to_json))
            await asyncio.sleep(0)  # lets the server process a failure now

    async def send(self, frame: bytes) -> None:
        """Send one frame. Raises TimeoutError if the page has not read the earlier ones after 5 s."""
        async with asyncio.timeout(SEND_TIMEOUT_S):
            await self.socket.send_bytes(frame)
        await asyncio.sleep(0)


def to_json(value: Any) -> Any:
    """Convert arrays and numpy scalars to JSON types."""
    if isinstance(value, tuple | list | np.ndarray):
        return [float(number) for number in value]
    return value.item() if isinstance(value, np.generic) else value


async def wait_for_first(*coroutines: Coroutine[Any, Any, None]) -> None:
    """Run the coroutines until one of them ends; cancel the others."""
    tasks = [asyncio.create_task(coroutine) for coroutine in coroutines]
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    for task in done:
        task.result()


# --------------------------------------------------------------------------------------------------
# Health of the loop for the page's header: timing over the last seconds, and warnings.


#: length of the window of the statistics [s]
WINDOW_S = 5.0
#: rows read per call at most [s]: copying all rows in the ring would delay a Stop by tens of ms
_MAX_HEALTH_READ_S = 1.0


def describe_troubles(servo: Servo) -> dict[str, Any]:
    """Whether the loop runs, warning texts (empty: none), the connected programs, and which commanded at the last
    trip."""
    return {
        "alive": servo.alive,
        "recording_trouble": servo.recording_trouble,
        "warning": servo.warning,
        "world_trouble": servo.world_trouble,
        "missing_pose": servo.missing_pose,
        "connections": servo.connections,
        "trip_program": servo.trip_program,
    }


@final
class Health:
    """Timing statistics over the last 5 s, updated twice a second from all rows."""

    def __init__(self, servo: Servo) -> None:
        self._servo = servo
        layout = servo.layout
        self._t, self._missed, self._lateness = (layout[name].start for name in ("t", "missed", "lateness"))
        self._valid, self._age = layout["valid"].start, layout["age"].start
        self._stages = layout["stages"]
        self._cursor = 0
        self._window: deque[Array] = deque()  # each (n, 5): t, missed, lateness, compute time, age of the pose

    def measure(self) -> dict[str, float | None]:
        """Timing statistics of the window.

        Rate [Hz], share of deadlines met, 50th and 99th percentile of lateness and median compute time [µs], 99th
        percentile of the age of valid poses [ms]."""
        before = self._cursor
        self._cursor, rows = self._servo.rows(before, int(_MAX_HEALTH_READ_S * self._servo.rate))
        if self._cursor - before > len(rows):  # a gap: not called for a while
            self._window.clear()
        if len(rows):
            compute = rows[:, self._stages].sum(axis=1)
            self._window.append(
                np.column_stack(
                    [
                        rows[:, self._t],
                        rows[:, self._missed],
                        rows[:, self._lateness],
                        compute,
                        np.where(rows[:, self._valid] == 1.0, rows[:, self._age], np.nan),
                    ]
                )
            )
            newest = float(rows[-1, self._t])
            while len(self._window) > 1 and float(self._window[0][-1, 0]) < newest - WINDOW_S:
                self._window.popleft()
        else:
            self._window.clear()
        if not self._window:
            return {
                "rate_hz": None,
                "success": None,
                "lateness_p50_us": None,
                "lateness_p99_us": None,
                "compute_us": None,
                "pose_age_ms": None,
            }
        window = np.concatenate(list(self._window))
        span = float(window[-1, 0] - window[0, 0])
        missed = float(np.nansum(window[1:, 1]))
        late = window[:, 2][np.isfinite(window[:, 2])]
        spent = window[:, 3][np.isfinite(window[:, 3])]
        ages = window[:, 4][np.isfinite(window[:, 4])]
        return {
            "rate_hz": (len(window) - 1) / span if span > 0 else None,
            "success": (len(window) - 1) / (len(window) - 1 + missed) if len(window) > 1 else None,
            "lateness_p50_us": float(np.percentile(late, 50)) * 1e6 if len(late) else None,
            "lateness_p99_us": float(np.percentile(late, 99)) * 1e6 if len(late) else None,
            "compute_us": float(np.median(spent)) * 1e6 if len(spent) else None,
            "pose_age_ms": float(np.percentile(ages, 99)) * 1e3 if len(ages) else None,
        }


# --------------------------------------------------------------------------------------------------
# Buffer of the rows of the last 2 s, read from the servo once for all pages.


#: rows older than this are dropped instead of being sent to a slow page [s]
MAX_BACKLOG_S = 2.0
#: rows read per call at most, for the same reason as in `Health` [s]
_MAX_ROWS_READ_S = 0.25


@final
class RecentRows:
    """Row buffer shared by all pages; each page reads the rows after an index, a slow one misses the oldest."""

    def __init__(self, servo: Servo) -> None:
        self._servo = servo
        self._t = servo.layout["t"].start
        self._pieces: deque[tuple[int, Array]] = deque()  # number of the first row, rows (n, width)
        self.end = 0  #: total number of rows so far

    def poll(self) -> int:
        """Read new rows from the servo and drop old ones; returns `end`."""
        before = self.end
        self.end, rows = self._servo.rows(before, int(_MAX_ROWS_READ_S * self._servo.rate))
        if not len(rows):
            return self.end
        if self.end - before > len(rows):  # a gap: not called for a while, so earlier rows are old
            self._pieces.clear()
        self._pieces.append((self.end - len(rows), rows))
        while self._pieces[0][1][-1, self._t] < rows[-1, self._t] - MAX_BACKLOG_S:
            self._pieces.popleft()
        return self.end

    def read_since(self, index: int) -> Array:
        """Rows (n, width) from `index` on, oldest first; there must be at least one."""
        wanted = []
        for first, rows in reversed(self._pieces):
            if first + len(rows) <= index:
                break
            wanted.append(rows[max(index - first, 0) :])
        return np.concatenate(wanted[::-1])


# --------------------------------------------------------------------------------------------------
# Interface of a session in which designs are rated, as far as the console uses it.


class DesignSession(Protocol):
    """Session that selects the worlds; pages display it and send commands to it. Methods must be thread-safe."""

    @property
    def version(self) -> int:
        """Version number, which changes with every change of the session."""
        ...

    @property
    def hidden(self) -> bool:
        """Whether name, values and drawing of the design are hidden on all pages."""
        ...

    def describe(self) -> Mapping[str, Any]:
        """State for the pages, plain JSON types."""
        ...

    def execute(self, command: Mapping[str, Any]) -> None:
        """Execute a page's command. Raises HaptorbError if it is invalid."""
        ...


# --------------------------------------------------------------------------------------------------
# Relay between pages and such a session: commands are executed one after another, the state is sent to all pages.
#
# Waiting for disk and servo is done in threads, so that a session never delays a Stop.


@final
class DesignRelay:
    """Relay between the `pages` of a hub and the session `designs`.

    publish_world   sends the world to the pages if it has changed
    """

    def __init__(self, designs: DesignSession, pages: list[ConsolePage], publish_world: Callable[[], None]) -> None:
        self._designs, self._pages, self._publish_world = designs, pages, publish_world
        self._version = -1  # as sent to the pages
        self._command_lock = asyncio.Lock()
        self._tasks: set[asyncio.Task[None]] = set()

    @property
    def hidden(self) -> bool:
        """Whether name, values and drawing of the design are hidden on all pages."""
        return self._designs.hidden

    def poll(self) -> None:
        """Send the state to all pages if a page or the terminal changed it."""
        if self._designs.version != self._version:
            self._version = self._designs.version
            self._start_task(self.send_state(self._pages))

    def execute(self, page: ConsolePage, command: dict[str, Any]) -> None:
        """Execute a command of `page`, after earlier commands."""
        self._start_task(self._execute(page, command))

    async def send_state(self, pages: list[ConsolePage]) -> None:
        """Send the state of the session to `pages`."""
        try:
            now = await asyncio.to_thread(self._designs.describe)
        except HaptorbError as mistake:  # the file of ratings is no longer readable
            for page in list(pages):
                page.enqueue("mistake", text=str(mistake))
            return
        for page in list(pages):
            page.enqueue("feel", **now)
        self._publish_world()

    async def _execute(self, page: ConsolePage, command: dict[str, Any]) -> None:
        async with self._command_lock:
            try:
                await asyncio.to_thread(self._designs.execute, command)
            except HaptorbError as mistake:
                page.enqueue("mistake", text=str(mistake))
                await self.send_state([page])

    def _start_task(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)


FRAME_INTERVAL_S = 1 / 60  #: between two frames [s]
ECHO_POLL_INTERVAL_S = 1 / 500  #: polling interval of the rows while an echo of the pointer is pending [s]
HAND_REFRESH_INTERVAL_S = 1 / 100  #: between two refreshes of a hand at rest [s]
HEALTH_INTERVAL_S = 0.5  #: between two measurements of the loop's health [s]
ENGAGE_DELAY_S = 0.1  #: delay of engaging, for the guard to get a fresh pose [s]

_REPORTED_REFUSALS = (
    "another_sender",
    "another_account",
    "stranger",
    "jump",
)  # reasons of refused poses that are reported to the user
_COMMANDS = "stop, engage, home, drop, mode, model, clutch, cool, buttons, world"
_MAX_NAME_CHARACTERS = 64  #: of a mode or a model [characters]


@final
class ConsoleSocketHub:
    """Connects pages to one servo, which must run before the first page connects."""

    def __init__(self, servo: Servo, painter: ForceMapWorker | None, designs: DesignSession | None = None) -> None:
        self._servo = servo
        self._painter = painter
        self._pages: list[ConsolePage] = []  # the first one has control
        self._designs = None if designs is None else DesignRelay(designs, self._pages, self._publish_world)
        self._hand = PointerRelay(servo)
        self._health = Health(servo)
        self._recent = RecentRows(servo)
        columns = Columns(servo.layout, bool(servo.modes))
        self._index = columns.index
        layout = servo.layout
        self._t, self._tick, self._target = layout["t"].start, layout["tick"].start, layout["hand_goal"]
        self._turn = layout["hand_goal_q"]
        if servo.modes:
            prepare()
        self._world: tuple[str, dict[str, Any], str, bool] = ("", {}, "", False)
        self._own = servo.own_worlds  # as sent to the pages
        self._version = 0
        self._requested_world: tuple[ConsolePage, str, dict[str, Any]] | None = None
        self._map_failure = ""  # why there is no map of this world
        self._world_task: asyncio.Task[None] | None = None
        self._refused = dict.fromkeys(_REPORTED_REFUSALS, 0)
        self._engaging: asyncio.TimerHandle | None = None

    async def run(self) -> None:
        """Run periodic tasks until cancelled: refresh the hand, publish health and changes of the world."""
        next_look = 0.0
        while True:
            self._hand.refresh()
            if time.monotonic() >= next_look:
                next_look = time.monotonic() + HEALTH_INTERVAL_S
                if self._pages:
                    self._send_to_all("health", **self._health.measure(), **describe_troubles(self._servo))
                self._publish_world()
                self._report_refused_poses()
            if self._designs is not None:
                self._designs.poll()
            if self._pages:
                self._recent.poll()  # in small portions, even if all pages are slow
            await asyncio.sleep(HAND_REFRESH_INTERVAL_S)

    async def join(self, socket: WebSocket) -> None:
        """Serve one page until it disconnects or stops reading; refuse pages above the maximum with the reason."""
        await socket.accept(PROTOCOL if PROTOCOL in socket.scope["subprotocols"] else None)
        if len(self._pages) >= MAX_PAGES:
            await socket.close(TRY_AGAIN_LATER, f"{MAX_PAGES} pages are open already: close one of them")
            return
        page = ConsolePage(socket)
        self._pages.append(page)
        try:
            self._publish_world()
            self._send_roles()
            page.enqueue("world", **self._world_event())
            if self._designs is not None:
                await self._designs.send_state([page])
            if self._map_failure:
                page.enqueue("mistake", text=self._map_failure)
            await wait_for_first(self._send(page), self._listen(page))
        except (WebSocketDisconnect, RuntimeError, TimeoutError):
            pass  # the page disconnected during a send, or does not read
        finally:
            had_control = self._pages[0] is page
            self._pages.remove(page)
            if had_control:
                self._servo.press(())
                self._cancel_engage()
                self._hand.release()
            self._send_roles()

    async def _listen(self, page: ConsolePage) -> None:
        while True:
            message = await page.socket.receive()
            if message["type"] == "websocket.disconnect":
                return
            self._handle_message(page, message)
            await asyncio.sleep(0)  # let other pages have their turn, however much one sends

    def _handle_message(self, page: ConsolePage, message: Mapping[str, Any]) -> None:
        """Handle one message of a page: a Stop first, from any page and even if malformed; else command or pointer."""
        try:
            text, data = message.get("text"), message.get("bytes") or b""
            if is_request(data if text is None else text, "stop"):  # safety: console-stop-first
                self._stop()
            elif text is not None:
                self._execute(page, read_command(text))
            elif page is self._pages[0]:
                self._hand.point(pointer(data))
                page.soon.set()
        except HaptorbError as mistake:
            page.enqueue("mistake", text=str(mistake))

    def _stop(self) -> None:
        self._servo.stop()
        self._cancel_engage()  # safety: console-stop-cancels
        self._send_to_all("stopped", by="you" if len(self._pages) == 1 else "a page")

    def _execute(self, page: ConsolePage, command: dict[str, Any]) -> None:
        """Execute one command; only the page in control may do more than stop."""
        match command["do"]:
            case _ if page is not self._pages[0]:
                raise InputError("another page is in control; this one only watches, and can still stop")
            case "engage":
                self._hand.end_expired_drag()
                self._cancel_engage()
                # The guard engages only on a fresh pose, so wait for one. A stop in between cancels.
                # safety: console-engage-stops
                self._engaging = asyncio.get_running_loop().call_later(
                    ENGAGE_DELAY_S, self._engage, page, self._servo.stops
                )
            case "home":
                self._hand.home()
            case "drop":
                self._hand.drop()
            case "mode":
                self._servo.set_mode(str(command.get("mode"))[:_MAX_NAME_CHARACTERS])
            case "model":
                self._servo.set_model(str(command.get("model"))[:_MAX_NAME_CHARACTERS])
                self._publish_world()
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
                self._requested_world = (page, *read_world(command))
                if self._world_task is None or self._world_task.done():
                    self._world_task = asyncio.create_task(self._request_world())
            case other:
                raise InputError(f"unknown command {other!r} (known: {_COMMANDS})")

    def _engage(self, page: ConsolePage, stops: int) -> None:
        self._engaging = None
        try:
            self._servo.engage(stops)
        except HaptorbError as mistake:
            page.enqueue("mistake", text=str(mistake))

    def _cancel_engage(self) -> None:
        if self._engaging is not None:
            self._engaging.cancel()
            self._engaging = None

    async def _request_world(self) -> None:
        """Request the most recently selected world from the servo, which replies within a tick or two."""
        while self._requested_world is not None:
            (page, name, values), self._requested_world = self._requested_world, None
            try:
                await asyncio.to_thread(self._servo.set_world, name, values)
            except HaptorbError as mistake:
                page.enqueue("mistake", text=str(mistake))
                page.enqueue("world", **self._world_event())
            self._publish_world()

    def _publish_world(self) -> None:
        """Notify all pages and request a force map if the world or the inverted model has changed."""
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
            self._painter.request(name, dict(values), now[2], self._version, self._send_map, self._report_map_failure)

    def _report_refused_poses(self) -> None:
        """Notify all pages of poses refused because of another sender or a jump, which nothing else shows."""
        counted = self._servo.tracker_refusals
        refused = {why: counted.get(why, 0) for why in _REPORTED_REFUSALS}
        news = [f"{refused[why] - n} poses {REASONS[why]}" for why, n in self._refused.items() if refused[why] > n]
        self._refused = refused
        if news:
            self._send_to_all("mistake", text=f"tracker {self._servo.tracker}: refused {', '.join(news)}")

    def _world_event(self) -> dict[str, Any]:
        name, values, model, hidden = self._world
        return describe_world(self._servo, name, values, model, shown=not hidden)

    def _send_map(self) -> None:
        self._map_failure = ""
        for page in self._pages:
            page.soon.set()

    def _report_map_failure(self, why: str) -> None:
        self._map_failure = why
        self._send_to_all("mistake", text=why)

    def _send_to_all(self, event: str, **what: Any) -> None:
        for page in self._pages:
            page.enqueue(event, **what)

    def _send_roles(self) -> None:
        for place, page in enumerate(self._pages):
            page.enqueue("role", control=place == 0, watchers=len(self._pages) - 1)

    async def _send(self, page: ConsolePage) -> None:
        """Send frames to one page at 60 Hz, and at once when there is an echo of its pointer or an event."""
        sent = newest = self._recent.poll()
        if self._painter is not None:
            await page.send(mesh_frame(self._painter.directions, self._painter.triangles))
        due = time.monotonic()
        while True:
            await page.send_events()
            if self._painter is not None and self._painter.version > page.force_version:
                page.force_version = self._painter.version
                await page.send(encode_force_frame(self._painter.force, self._painter.saturated, page.force_version))
            end = self._recent.poll()
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
                due = now + FRAME_INTERVAL_S
            await self._pause(page, max(due - time.monotonic(), 0.0) if end == sent or due > now else 0.0)

    async def _pause(self, page: ConsolePage, rest: float) -> None:
        """Wait until the next frame is due or an event is queued."""
        if page is self._pages[0] and self._hand.waiting:
            await asyncio.sleep(min(rest, ECHO_POLL_INTERVAL_S))
            return
        page.soon.clear()
        if page.events:
            return
        try:
            await asyncio.wait_for(page.soon.wait(), max(rest, 1e-3))
        except TimeoutError:
            return
