"""Everyone who looks at the device: one page holds the hand, the others watch; anyone may stop."""

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
from haptorb.web.server import command as read_command
from haptorb.web.server import is_stop_request
from haptorb.web.session import PointerRelay, describe_world, prepare, press_buttons, read_world, worlds
from haptorb.web.wire import Columns, encode_force_frame, mesh_frame, pointer, rows_frame

__all__ = [
    "BACKLOG",
    "MOST",
    "PATIENCE",
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
# One connected page: its socket, and what it has not got yet; who does not listen is left.


PATIENCE = 5.0  #: for a page that does not take what is sent [s]


@final
class ConsolePage:
    """Of every kind of event only the newest waits to be sent, so a slow page costs no more than a quick one."""

    def __init__(self, socket: WebSocket) -> None:
        self.socket = socket
        self.events: dict[str, dict[str, Any]] = {}
        self.force_version = -1  #: version of the force map that it has
        self.dropped = 0  #: rows that it will never get
        self.soon = asyncio.Event()  #: something is worth sending before the frame is full

    def tell(self, event: str, **what: Any) -> None:
        """Send `event`; a newer one of the same kind replaces it if it has not left yet."""
        self.events[event] = {"event": event, **what}
        self.soon.set()

    async def send_events(self) -> None:
        """Every message to the page; TimeoutError as in `send`."""
        while self.events:
            event = self.events.pop(next(iter(self.events)))
            async with asyncio.timeout(PATIENCE):
                await self.socket.send_text(json.dumps(event, allow_nan=False, default=to_json))
            await asyncio.sleep(0)  # if that failed, the server sees it now

    async def send(self, frame: bytes) -> None:
        """One frame; TimeoutError if the page has not taken the earlier ones after five seconds."""
        async with asyncio.timeout(PATIENCE):
            await self.socket.send_bytes(frame)
        await asyncio.sleep(0)


def to_json(value: Any) -> Any:
    """`value` as JSON has it."""
    if isinstance(value, tuple | list | np.ndarray):
        return [float(number) for number in value]
    return value.item() if isinstance(value, np.generic) else value


async def wait_for_first(*ways: Coroutine[Any, Any, None]) -> None:
    """Until one of `ways` ends; the others are cancelled."""
    tasks = [asyncio.create_task(way) for way in ways]
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    for task in done:
        task.result()


# --------------------------------------------------------------------------------------------------
# How well the loop keeps its time, over the last seconds, and what is amiss: what the page's header says.


#: seconds of the past that count
WINDOW = 5.0
#: what one look reads at the most [s]: copying all rows that the loop keeps would hold up a Stop by tens of ms
_READ = 1.0


def describe_troubles(servo: Servo) -> dict[str, Any]:
    """Whether the loop runs, texts that are empty while all is well, and which programs are connected."""
    return {
        "alive": servo.alive,
        "recording_trouble": servo.recording_trouble,
        "warning": servo.warning,
        "world_trouble": servo.world_trouble,
        "missing_pose": servo.missing_pose,
        "connections": servo.connections,
    }


@final
class Health:
    """Looks at every row twice a second and keeps five seconds of it."""

    def __init__(self, servo: Servo) -> None:
        self._servo = servo
        layout = servo.layout
        self._t, self._missed, self._lateness = (layout[name].start for name in ("t", "missed", "lateness"))
        self._valid, self._age = layout["valid"].start, layout["age"].start
        self._stages = layout["stages"]
        self._cursor = 0
        self._window: deque[Array] = deque()  # each (n, 5): t, missed, lateness, compute time, age of the pose

    def look(self) -> dict[str, float | None]:
        """Rate [Hz], share of deadlines met, 50th and 99th percentile of lateness and median compute time [µs], 99th
        percentile of the age of valid poses [ms]."""
        before = self._cursor
        self._cursor, rows = self._servo.rows(before, int(_READ * self._servo.rate))
        if self._cursor - before > len(rows):  # nobody looked for a while
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
            while len(self._window) > 1 and float(self._window[0][-1, 0]) < newest - WINDOW:
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
# The rows of the last two seconds, read from the servo once for all pages.


#: rows older than this are not worth sending to a page that was too slow [s]
BACKLOG = 2.0
#: what one look reads at the most [s], as in `Health`
_AT_ONCE = 0.25


@final
class RecentRows:
    """A page says up to which row it has seen them, and gets what is newer; who is too slow misses the oldest."""

    def __init__(self, servo: Servo) -> None:
        self._servo = servo
        self._t = servo.layout["t"].start
        self._pieces: deque[tuple[int, Array]] = deque()  # number of the first row, rows (n, width)
        self.end = 0  #: how many rows there were in all

    def look(self) -> int:
        """Read what is new, forget what is old; returns `end`."""
        before = self.end
        self.end, rows = self._servo.rows(before, int(_AT_ONCE * self._servo.rate))
        if not len(rows):
            return self.end
        if self.end - before > len(rows):  # nobody looked for a while; what lies before the gap is old
            self._pieces.clear()
        self._pieces.append((self.end - len(rows), rows))
        while self._pieces[0][1][-1, self._t] < rows[-1, self._t] - BACKLOG:
            self._pieces.popleft()
        return self.end

    def read_since(self, index: int) -> Array:
        """(n, width) the rows after the first `index`, oldest first; at least one must be newer."""
        wanted = []
        for first, rows in reversed(self._pieces):
            if first + len(rows) <= index:
                break
            wanted.append(rows[max(index - first, 0) :])
        return np.concatenate(wanted[::-1])


# --------------------------------------------------------------------------------------------------
# What the console needs of a session in which designs are felt and rated, and nothing else of it.


class DesignSession(Protocol):
    """A session that chooses the worlds: pages show it and send its commands. Methods may be called in any thread."""

    @property
    def version(self) -> int:
        """Another number after every change."""
        ...

    @property
    def hidden(self) -> bool:
        """Whether name, values and picture of the design are hidden from every page."""
        ...

    def describe(self) -> Mapping[str, Any]:
        """What a page shows of it, as plain JSON types."""
        ...

    def execute(self, command: Mapping[str, Any]) -> None:
        """What a page asks for; HaptorbError if it cannot be."""
        ...


# --------------------------------------------------------------------------------------------------
# Between pages and a session in which designs are felt: its commands one after another, its state to every page.
#
# Everything of it waits for disk or servo in threads: nothing of a feel session may hold up a Stop.


@final
class DesignRelay:
    """The part of a hub that joins its `pages` to `designs`.

    notice_world   sends the world to the pages if it has changed
    """

    def __init__(self, designs: DesignSession, pages: list[ConsolePage], notice_world: Callable[[], None]) -> None:
        self._designs, self._pages, self._notice_world = designs, pages, notice_world
        self._version = -1  # as the pages know it
        self._choosing = asyncio.Lock()
        self._tasks: set[asyncio.Task[None]] = set()

    @property
    def hidden(self) -> bool:
        """Whether name, values and picture of the design are hidden from every page."""
        return self._designs.hidden

    def notice(self) -> None:
        """Tell everyone if page or terminal changed anything."""
        if self._designs.version != self._version:
            self._version = self._designs.version
            self._begin(self.tell(self._pages))

    def execute(self, page: ConsolePage, command: dict[str, Any]) -> None:
        """Do what `page` asks for, after what was asked before."""
        self._begin(self._execute(page, command))

    async def tell(self, pages: list[ConsolePage]) -> None:
        """Tell `pages` what is felt now."""
        try:
            now = await asyncio.to_thread(self._designs.describe)
        except HaptorbError as mistake:  # the file of ratings cannot be read any more
            for page in list(pages):
                page.tell("mistake", text=str(mistake))
            return
        for page in list(pages):
            page.tell("feel", **now)
        self._notice_world()

    async def _execute(self, page: ConsolePage, command: dict[str, Any]) -> None:
        async with self._choosing:
            try:
                await asyncio.to_thread(self._designs.execute, command)
            except HaptorbError as mistake:
                page.tell("mistake", text=str(mistake))
                await self.tell([page])

    def _begin(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)


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

    def __init__(self, servo: Servo, painter: ForceMapWorker | None, designs: DesignSession | None = None) -> None:
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
            if self._pages:
                self._recent.look()  # in small pieces, also while every page is slow
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
