"""Viewer of recordings: the pages that play them and their server, reachable only from this computer."""

from __future__ import annotations

import asyncio
import json
import math
import re
import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self, final
from uuid import uuid4

import numpy as np
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import HTTPConnection, Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from haptorb.arrays import Array, whole_number
from haptorb.control.registry import has_choice
from haptorb.devices.base import Device, DeviceText
from haptorb.devices.loader import catalogue, load, parse
from haptorb.errors import HaptorbError, InputError, quote
from haptorb.recording.export import column_heads
from haptorb.recording.recording import Recording
from haptorb.recording.row import Field, RowLayout
from haptorb.version import __version__
from haptorb.web.access import PROTOCOL, AccessGate, choose_token
from haptorb.web.console_hub import SEND_TIMEOUT_S, to_json, wait_for_first
from haptorb.web.force_map import ForceMapSource, shell
from haptorb.web.force_map_process import ForceMapProcess
from haptorb.web.overview import Overview
from haptorb.web.server import (
    MAX_PAGES,
    TRY_AGAIN_LATER,
    PageAddress,
    bind_socket,
    open_browser_at,
    page_files,
    respond,
    server,
    signals,
)
from haptorb.web.server import command as read_command
from haptorb.web.session import RecordedServo, list_shapes, object_scene, session, world_remarks, worlds
from haptorb.web.wire import COLUMNS, MODED, encode_force_frame, mesh_frame, rows_frame
from haptorb.worlds import CATALOGUE
from haptorb.worlds.base import parameters

__all__ = [
    "MOST_ROWS",
    "PORT",
    "STATIC",
    "PaintedWorlds",
    "PlayedRecording",
    "RecordingPart",
    "RowColumns",
    "RowSocket",
    "Viewer",
    "application",
    "describe_world",
    "find_device",
    "find_row",
    "list_worlds",
    "parse_part",
    "read_worlds",
]


# --------------------------------------------------------------------------------------------------
# Device of a recording, from the text of the device file in its metadata.


def find_device(path: Path, note: Mapping[str, str], name: str | None) -> tuple[Device, str]:
    """Find the device of a recording, with a notice for the user about its origin (else "").

    note  metadata of the recording on its device
    name  name or file of a device that overrides it; None: the device of the recording

    Raises DeviceError or UnknownName for a wrong `name`, InputError if the device is unknown.
    """
    if name is not None:
        device = load(name)
        digest = note.get("digest", device.digest)
        return (
            device,
            "" if digest == device.digest else f"drawn as '{device.name}'; it was recorded with another device",
        )
    if text := DeviceText.from_note(note):
        try:
            # a recorded device did run, even if it fails today's checks
            return parse(text.own, note.get("name", "of the recording"), bases=text.bases, override=True), ""
        except HaptorbError as cause:
            if note.get("name", "") not in catalogue():
                raise InputError(
                    f"{path}: this version of haptorb cannot read its device: {cause}; name one with --as"
                ) from cause
            trouble = f"device '{note['name']}' is drawn as in this version, not as in the recording: {cause}"
            return load(note["name"]), trouble
    # The recording of a trip has no device metadata; its file name begins with the device's name.
    known = sorted(catalogue(), key=len, reverse=True)
    for one in (note.get("name", ""), *(one for one in known if path.name.startswith(f"{one}-"))):
        if one in known:
            return load(one), f"the recording does not describe its device: '{one}' is assumed"
    raise InputError(f"{path} does not state its device: name one with --as")


# --------------------------------------------------------------------------------------------------
# Worlds of a recording, described for the page: values, bodies, scene of the object and remarks.


_UNKNOWN_WORLD_TEXT = "your own world: its code does not run here, so neither its force map nor its bodies are drawn"


def read_worlds(notes: Sequence[Mapping[str, str]]) -> dict[int, tuple[str, dict[str, Any]]]:
    """Read the worlds: number of the change → name and values; invalid notes are ignored."""
    found: dict[int, tuple[str, dict[str, Any]]] = {}
    for note in notes:
        try:
            world = json.loads(note["world"])
            name, values = world["name"], world["values"]
            if not isinstance(name, str) or not isinstance(values, dict):
                continue
            found[int(note["change"])] = name, _adapt_values(name, values)
        except (KeyError, TypeError, ValueError, RecursionError):
            continue
    return found


def _adapt_values(name: str, values: Mapping[str, Any]) -> dict[str, Any]:
    """Adapt the values of a world to this version: defaults for missing parameters, unknown ones removed."""
    known = {key: value for key, value in values.items() if _is_number(value) or _are_numbers(value)}
    if name not in CATALOGUE:
        return known
    defaults = {key: one.default for key, one in parameters(CATALOGUE[name]).items()}
    return {
        key: known[key] if key in known and isinstance(known[key], list) == isinstance(default, tuple) else default
        for key, default in defaults.items()
    }


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e300


def _are_numbers(value: Any) -> bool:
    return isinstance(value, list) and all(map(_is_number, value))


def list_worlds(device: Device, names: Sequence[str]) -> list[dict[str, Any]]:
    """Describe the worlds `names`: those of the catalogue with their parameters, a user's world without."""
    known = {one["name"]: one for one in worlds(device, {}) if one["name"] in names}
    return [known.get(name, {"name": name, "about": "", "parameters": []}) for name in names]


def describe_world(name: str, values: Mapping[str, Any], model: str, device: Device) -> dict[str, Any]:
    """Describe a world in the format of the console's event: parameters in their units, lengths of the drawing [m]."""
    return {
        "name": name,
        "values": {key: list(value) if isinstance(value, tuple) else value for key, value in values.items()},
        "model": model,
        "scene": object_scene(name, values) if device.kind.modes else None,
        "shapes": list_shapes(name, values, {}, device),
        "remarks": world_remarks(name, values) if name in CATALOGUE else [f"'{name}': {_UNKNOWN_WORLD_TEXT}."],
    }


# --------------------------------------------------------------------------------------------------
# Columns of the console's frames, mapped by name from the fields of a recording, in any order.


@final
class RowColumns:
    """Columns of a recording's rows for the page; a column that the recording lacks is NaN."""

    def __init__(self, recording: Recording, layout: RowLayout, *, moded: bool) -> None:
        """`layout`: row layout of the device in this version; `moded`: whether the device has modes."""
        self._recording = recording
        found = {field.name: field for field in recording.fields}
        usual = {field.name: field for field in layout.fields}
        free = ("memory", "contacts")  #: of any width
        self._fields: list[tuple[Field, bool]] = []
        for name in COLUMNS + (MODED if moded else ()):
            field = found.get(name, usual[name])
            fits = name in found and (name in free or field.width == usual[name].width)
            self._fields.append((field if fits else usual[name], fits))
        self.missing = [field.name for field, fits in self._fields if not fits and field.width]
        self.width = sum(field.width for field, _ in self._fields)
        self._names = [field.name for field, fits in self._fields if fits]
        self._all: Any = np.arange(self.width)
        self._places = np.concatenate(
            [np.arange(at, at + field.width) for (field, fits), at in zip(self._fields, self._offsets(), strict=True)
             if fits] or [np.empty(0, dtype=np.int64)]
        )  # fmt: skip

    def _offsets(self) -> Sequence[int]:
        widths = [field.width for field, _ in self._fields]
        return [0, *np.cumsum(widths).tolist()][:-1]

    def describe(self) -> list[dict[str, Any]]:
        """Name, offset, width, unit, meaning and headings of each column, in the format of the page."""
        return [
            {
                "name": field.name,
                "offset": offset,
                "width": field.width,
                "unit": field.unit,
                "about": field.about,
                "heads": list(column_heads(field)),
            }
            for (field, _), offset in zip(self._fields, self._offsets(), strict=True)
        ]

    def read(self, first: int, last: int) -> Array:
        """Read rows `first` up to `last`: (last − first, width), in the units of the columns; missing values: NaN."""
        read = self._recording.read(first, last, self._names)
        if len(self._places) == self.width:
            return read
        rows = np.full((len(read), self.width), np.nan)
        rows[:, self._places] = read
        return rows

    def frame(self, first: int, last: int, question: float) -> bytes:
        """Encode rows `first` up to `last`, at least one, as a frame of the console.

        Its `echo` is the number of the page's request, `question`, its `dropped` the number of the first row.
        """
        with np.errstate(over="ignore", invalid="ignore"):  # a number from another program may overflow float32
            return rows_frame(self.read(first, last), self._all, 0, 1, question, first)


# --------------------------------------------------------------------------------------------------
# Search for the row of a time by interpolation and bisection, with few reads in a recording of any length.


_ROWS_PER_READ = 64  #: rows read at once, about as many as in a chunk of a recording


def find_row(read: Callable[[int, int], Array], rows: int, value: float, ends: tuple[float, float]) -> int:
    """Find the last of `rows` ≥ 1 rows whose number is at most `value`; the first row if there is none.

    read  (first, last) → (n,) increasing numbers of these rows, in any unit
    ends  numbers of the first and the last row

    Times are almost evenly spaced, so the first interpolation is nearly always right. Otherwise every second step
    bisects; for numbers that do not increase the result is arbitrary, after at most as many steps.

    >>> find_row(lambda a, b: np.arange(a, b) / 1000.0, 10_000, 1.2345, (0.0, 9.999))
    1234
    """
    low, high = 0, rows - 1
    least, most = ends
    if not value > least:
        return 0
    if value >= most:
        return rows - 1
    halve = False
    while high - low > 1:
        guess = (low + high) // 2
        if not halve and most > least and math.isfinite(most - least):
            guess = low + int((value - least) / (most - least) * (high - low))
        first = min(max(guess - _ROWS_PER_READ // 2, low), high)
        last = min(first + _ROWS_PER_READ, high + 1)
        piece = read(first, last)
        count = int(np.searchsorted(piece, value, side="right"))
        if 0 < count < len(piece):
            return first + count - 1
        if count == 0:
            high, most = first, float(piece[0])
        else:
            low, least = last - 1, float(piece[-1])
        halve = not halve
    return low


# --------------------------------------------------------------------------------------------------
# Recording opened for playback: device, columns, worlds, and search by time.


_TIME_TOLERANCE_S = 2e-6  #: times of the page are rounded to float32 and must still find their tick [s]
_MAX_VERSION_CHARACTERS = 64  #: shown of a version [characters]


@final
class PlayedRecording:
    """Recording at `path`, drawn with the device in its metadata or with `device` (name or path of a device file).

    recording  the recording; damaged rows are skipped
    device     device that is drawn
    start      time of the first tick on the loop's clock [s]
    seconds    from the first tick to the last [s]
    notices    notices for the user: truncated, another version, no device, missing fields

    Raises RecordingError for a file that is not a recording, InputError for one without rows or times.
    """

    def __init__(self, path: Path, device: str | None = None) -> None:
        self.recording = recording = Recording(path)
        recording.check()
        if not len(recording):
            cut = "it was cut short before its first ticks" if recording.truncated else "nothing was recorded"
            raise InputError(f"{path} has no ticks to play: {cut}")
        recording.require("t")
        self._t = recording["t"]
        self.start, end = self._ends = float(self._t[0]), float(self._t[-1])
        self.seconds = end - self.start
        if not math.isfinite(self.seconds) or self.seconds < 0:
            raise InputError(
                f"{path} cannot be played: its times must increase; the first is {self.start:g} s, the last {end:g} s"
            )
        self.device, trouble = find_device(path, recording.metadata.get("device", {}), device)
        run = recording.metadata.get("run", {})
        self.device = self.device.with_recorded_models(tuple(run.get("models", "").split()))
        self._servo = RecordedServo(self.device, run)
        self._columns = RowColumns(recording, self._servo.layout, moded=bool(self._servo.modes))
        self._worlds = read_worlds(recording.worlds)
        self.overview = Overview(recording, self.start, end)
        self.notices = [*self._list_notices(), *([trouble] if trouble else [])]

    @property
    def name(self) -> str:
        """Name of its file."""
        return self.recording.path.name

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.recording)

    @property
    def render(self) -> str | None:
        """Rendered part of the wrench, if it overrode that of the world; else None."""
        return self._servo.render

    def _list_notices(self) -> list[str]:
        notices = list(self.recording.damage)
        if self.recording.truncated:
            notices.append(f"the file is truncated: recorded up to {self.seconds:.2f} s, the rest was cut off")
        made = self.recording.metadata.get("versions", {}).get("haptorb", "")[:_MAX_VERSION_CHARACTERS]
        if _version_key(made) > _version_key(__version__):
            notices.append(f"made by haptorb {made}, newer than this one ({__version__}): new fields are not shown")
        if self._columns.missing:
            notices.append(f"not in the recording, so not shown: {', '.join(self._columns.missing)}")
        notices += [f"at tick {one.get('tick', '?')}: {one.get('text', '')[:300]}" for one in self.recording.errors[:3]]
        return notices

    def find_row(self, seconds: float) -> int:
        """Find the last row not later than `seconds` after the first tick. Raises RecordingError for damaged data."""
        return find_row(self._read_times, len(self), self.start + seconds + _TIME_TOLERANCE_S, self._ends)

    def _read_times(self, first: int, last: int) -> Array:
        times: Array = self._t[first:last]
        return times

    def frame(self, first: int, last: int, question: float) -> bytes:
        """Encode the existing rows from `first` up to `last` as a frame; see `RowColumns.frame`."""
        first = min(max(first, 0), len(self) - 1)
        return self._columns.frame(first, min(max(last, first + 1), len(self)), question)

    def find_world(self, change: int) -> tuple[str, dict[str, Any]] | None:
        """Name and values of the world after `change`, or of the latest known one before; None if there is none."""
        known = [number for number in self._worlds if number <= change]
        return self._worlds[max(known)] if known else None

    def describe_world(self, change: int, model: str) -> dict[str, Any]:
        """Describe the world after `change` for the page, for a controller that inverts `model`."""
        found = self.find_world(change)
        if found is None:
            return {"name": "unknown", "values": {}, "model": model, "scene": None, "shapes": [],
                    "remarks": ["The recording does not state which world this was."]}  # fmt: skip
        return describe_world(*found, model, self.device)

    def describe(self, started: str) -> dict[str, Any]:
        """Describe the session of this recording in the console's format, with playback facts in `played`."""
        names = list(dict.fromkeys(name for name, _ in self._worlds.values()))
        known = session(self._servo, started)
        return known | {
            "columns": self._columns.describe(),
            "worlds": list_worlds(self.device, names),
            "world": self.describe_world(min(self._worlds, default=0), self._servo.model),
            "feel": None,
            "played": {
                "name": self.name,
                "rows": len(self),
                "start": self.start,
                "seconds": self.seconds,
                "notices": self.notices,
                "changes": {str(number): name for number, (name, _) in self._worlds.items()},
            },
        }

    def close(self) -> None:
        """Close the overview, which may still read the file."""
        self.overview.close()


def _version_key(version: str) -> tuple[int, ...]:
    """Sort key of a version such as 0.2.1; empty for anything else.

    >>> _version_key("0.10.0") > _version_key("0.9.3"), _version_key("unknown")
    (True, ())
    """
    parts = [whole_number(part) for part in version.split(".")[:3]]
    return tuple(part for part in parts if part is not None) if None not in parts else ()


# --------------------------------------------------------------------------------------------------
# Force maps of a recording's worlds, each computed once, with a cache.


_MAX_MAPS = 32  #: maps in the cache


@final
class PaintedWorlds:
    """Cache of force maps of `recording`, whose device must have a dome, computed by `force_map`; `end` closes that."""

    def __init__(
        self, recording: PlayedRecording, force_map: ForceMapSource, end: Callable[[], None] = lambda: None
    ) -> None:
        self._recording, self._force_map, self.close = recording, force_map, end
        self.directions, self.triangles = shell()
        self._points = self.directions * recording.device.shell.contact_distance if recording.device.shell else None
        self._frames: OrderedDict[tuple[str, str, str], bytes] = OrderedDict()

    async def paint(self, change: int, model: str) -> bytes | None:
        """Compute the frame of the force map after `change`, for a controller that inverts `model`.

        None for a world that is unknown or not in the catalogue. Raises HaptorbError if it cannot be computed.
        """
        found = self._recording.find_world(change)
        if found is None or self._points is None or found[0] not in CATALOGUE:
            return None  # the page shows a remark for such a world
        name, values = found
        key = name, repr(sorted(values.items())), model
        if key not in self._frames:
            force, saturated = await asyncio.to_thread(self._force_map, name, values, model, self._points)
            self._frames[key] = encode_force_frame(force, saturated, change)
            while len(self._frames) > _MAX_MAPS:
                self._frames.popitem(last=False)
        return self._frames[key]


# --------------------------------------------------------------------------------------------------
# WebSocket of one page: requests for rows and worlds of a recording, answered with the console's frames.


MOST_ROWS = 4000  #: rows per reply
_COMMANDS = "at, rows, world"


@final
class RowSocket:
    """WebSocket of one page; replies are sent in the order of the requests, a force map once it is computed.

    {"do": "at", "n": N, "t": SECONDS} → one row, the last that is not later than SECONDS after the first tick
    {"do": "rows", "n": N, "first": ROW, "count": COUNT} → these rows, at most 4000
    {"do": "world", "change": CHANGE, "model": MODEL} → the event `world`, and its force map if it has one

    An invalid request is answered with the event `mistake` and the request's number.
    """

    def __init__(self, socket: WebSocket, recording: PlayedRecording, painted: PaintedWorlds | None) -> None:
        self._socket, self._recording, self._painted = socket, recording, painted
        self._requested: tuple[int, str] | None = None
        self._changed = asyncio.Event()
        self._sending = asyncio.Lock()

    async def serve(self) -> None:
        """Serve until the page disconnects or stops reading."""
        await self._socket.accept(PROTOCOL if PROTOCOL in self._socket.scope["subprotocols"] else None)
        try:
            if self._painted is not None:
                await self._send(mesh_frame(self._painted.directions, self._painted.triangles))
            await wait_for_first(self._listen(), self._paint())
        except (WebSocketDisconnect, RuntimeError, TimeoutError):
            pass  # the page disconnected during a send, or does not read

    async def _listen(self) -> None:
        while True:
            message = await self._socket.receive()
            if message["type"] == "websocket.disconnect":
                return
            question: Mapping[str, Any] = {}
            try:
                question = read_command(message.get("text") or "")
                await self._answer(question)
            except HaptorbError as mistake:
                number = question.get("n")
                await self._send_event("mistake", text=str(mistake), n=number if _is_whole(number) else -1)
            await asyncio.sleep(0)  # let other pages have their turn, however much one requests

    async def _answer(self, question: Mapping[str, Any]) -> None:
        match question["do"]:
            case "at":
                seconds = question.get("t")
                if not isinstance(seconds, int | float) or isinstance(seconds, bool):
                    raise InputError("`t` must be a number of seconds after the first tick")
                self._recording.overview.pause()
                row = self._recording.find_row(float(seconds))
                await self._send(self._recording.frame(row, row + 1, _read_whole(question, "n")))
            case "rows":
                first, count = _read_whole(question, "first"), _read_whole(question, "count")
                if not 1 <= count <= MOST_ROWS:
                    raise InputError(f"`count` must be from 1 to {MOST_ROWS}; got {count}")
                await self._send(self._recording.frame(first, first + count, _read_whole(question, "n")))
            case "world":
                change, model = _read_whole(question, "change"), question.get("model")
                if not isinstance(model, str) or model not in self._recording.device.models:
                    raise InputError(f"`model` must be one of {', '.join(self._recording.device.models)}")
                await self._send_event("world", change=change, **self._recording.describe_world(change, model))
                self._requested = change, model
                self._changed.set()
            case other:
                raise InputError(f"unknown command {other!r} (known: {_COMMANDS})")

    async def _paint(self) -> None:
        """Send the force map of the most recently requested world."""
        while True:
            await self._changed.wait()
            self._changed.clear()
            if self._requested is None or self._painted is None:
                continue
            change, model = self._requested
            try:
                frame = await self._painted.paint(change, model)
            except HaptorbError as mistake:
                await self._send_event("unpainted", change=change, text=f"no force map of this world: {mistake}")
                continue
            if frame is not None and self._requested == (change, model):
                await self._send(frame)

    async def _send(self, frame: bytes) -> None:
        async with self._sending, asyncio.timeout(SEND_TIMEOUT_S):
            await self._socket.send_bytes(frame)

    async def _send_event(self, event: str, **what: Any) -> None:
        text = json.dumps({"event": event, **what}, allow_nan=False, default=to_json)
        async with self._sending, asyncio.timeout(SEND_TIMEOUT_S):
            await self._socket.send_text(text)


def _is_whole(number: object) -> bool:
    return isinstance(number, int) and not isinstance(number, bool)


def _read_whole(question: Mapping[str, Any], key: str) -> int:
    number = question.get(key)
    if not isinstance(number, int) or isinstance(number, bool) or abs(number) > 2**53:
        raise InputError(f"`{key}` must be a whole number")
    return number


# --------------------------------------------------------------------------------------------------
# ASGI application of the viewer: a page with the timeline, one framed page per recording, and their WebSockets.


#: folder into which the build hook writes the pages
STATIC = Path(__file__).parent / "view_static"

_NO_RECORDING = 4404  #: close code of a WebSocket for an unknown recording


def application(
    recordings: Sequence[PlayedRecording],
    painted: Sequence[PaintedWorlds | None],
    opening: Mapping[str, Any],
    where: PageAddress = PageAddress(),
) -> Starlette:
    """Build the ASGI application that plays `recordings`; requests need `app.state.token`.

    painted   force maps of each recording, None if its device has none
    opening   initial state of the page: `at` [s], `range` ([s, s] or None), `offset` [s] of the second recording
    where     listening and public address of the page

    Raises InputError if the pages have not been built, or HAPTORB_TOKEN of the environment is not a valid token.
    """
    token = choose_token()
    files = page_files(STATIC)
    if not {"view.html", "player.html"} <= set(files):
        raise InputError(
            "the viewer's pages have not been built: run `cd web && npm ci && npm run build`, or `make run`"
        )
    started = uuid4().hex
    known = [recording.describe(started) for recording in recordings]
    open_pages = [0 for _ in recordings]

    def number_of(asked: HTTPConnection) -> int | None:
        text = asked.query_params.get("recording", "0")
        return int(text) if text in map(str, range(len(recordings))) else None

    async def file(request: Request) -> Response:
        return respond(files, request.path_params.get("name", "view.html"))

    async def player(request: Request) -> Response:
        return respond(files, "player.html")

    async def describe(request: Request) -> Response:
        descriptions = [one["played"] | {"gives": one["scene"]["gives"], "trips": one["trips"]} for one in known]
        return JSONResponse({"version": __version__, "started": started, "recordings": descriptions, **opening})

    async def describe_one(request: Request) -> Response:
        number = number_of(request)
        return _refuse() if number is None else JSONResponse(known[number])

    async def overview(request: Request) -> Response:
        number = number_of(request)
        if number is None:
            return _refuse()
        recordings[number].overview.start()
        return Response(recordings[number].overview.encode(), media_type="application/octet-stream")

    async def rows(socket: WebSocket) -> None:
        number = number_of(socket)
        if number is None or open_pages[number] >= MAX_PAGES:
            await socket.accept()
            full = TRY_AGAIN_LATER, f"{MAX_PAGES} pages are open already: close one of them"
            await socket.close(*((_NO_RECORDING, "no such recording") if number is None else full))
            return
        open_pages[number] += 1
        try:
            await RowSocket(socket, recordings[number], painted[number]).serve()
        finally:
            open_pages[number] -= 1

    app = Starlette(
        routes=[
            Route("/", file),
            Route("/player", player),
            Route("/static/{name}", file),
            Route("/api/view", describe),
            Route("/api/session", describe_one),
            Route("/api/overview", overview),
            WebSocketRoute("/ws", rows),
        ],
        middleware=[
            Middleware(
                AccessGate, token=token, free=("/", "/player"), framed=True, exposed=where.exposed, origin=where.origin
            )
        ],
    )
    app.state.token = token
    return app


def _refuse() -> Response:
    return Response("there is no such recording\n", status_code=404, media_type="text/plain")


PORT = 8767  #: default port, different from those of console and study
_END_POLL_INTERVAL_S = 0.1  #: polling interval of the end condition [s]


@final
class Viewer:
    """Page that plays one recording, or two side by side, at `url`, which contains the token after #.

        with Viewer(["run.mcap"]) as viewer:
            print(viewer.url)
            viewer.serve()

    paths      one or two recordings
    port       0: any free port
    at         initial time after the first tick [s]; None: the start of `span`
    span       first and last time of the part to repeat, on the loop's clock [s]; None: no repetition
    offset     delay of the second recording relative to the first [s]; negative: it begins earlier
    device     name or path of the device to draw; None: that of the recording
    force_map  computes the force of a device at points in space; None: a simulation of the device
    where      listening and public address; by default loopback only
    Raises RecordingError or InputError for files that cannot be played, a port that is not available, or pages that
    have not been built.
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
        where: PageAddress = PageAddress(),
    ) -> None:
        if not 1 <= len(paths) <= 2:
            raise InputError(f"one or two recordings can be played; got {len(paths)}")
        self._socket = bind_socket(port, where.host)
        self.recordings: list[PlayedRecording] = []
        self._painted: list[PaintedWorlds | None] = []
        try:
            for path in paths:
                self.recordings.append(PlayedRecording(Path(path), device))
            self._painted = [_paint(recording, force_map) for recording in self.recordings]
            part = self._clip(span)
            begin = (part[0] if part else 0.0) if at is None else at
            self.opening = {"at": begin, "range": part, "offset": offset}  #: initial state of the page [s]
            app = application(self.recordings, self._painted, self.opening, where)
        except BaseException:
            self._end()
            raise
        self.port = int(self._socket.getsockname()[1])
        self.token: str = app.state.token
        self.url = f"{where.url(self.port)}#{self.token}"
        self._server = server(app)

    def serve(
        self, *, open_browser: bool = False, ready: Callable[[], None] = lambda: None, until: float | None = None
    ) -> int | None:
        """Serve until `close`, SIGINT or SIGTERM (the signal's number is returned), or for `until` seconds.

        `ready` is called once the server answers requests. Signals are handled only in the main thread.
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
            await asyncio.sleep(_END_POLL_INTERVAL_S if answers else _END_POLL_INTERVAL_S / 10)
        await serving
        for painted in self._painted:  # else the end would wait for a map that is being computed
            if painted is not None:
                painted.close()

    def close(self) -> None:
        """End `serve`. Thread-safe; may be called twice."""
        self._server.should_exit = True

    def _clip(self, span: tuple[float, float] | None) -> tuple[float, float] | None:
        """Convert `span` from the loop's clock to times after the first tick of the first recording, clipped to it."""
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
    if recording.device.shell is None or not has_choice(recording.device):
        return None
    if force_map is not None:
        return PaintedWorlds(recording, force_map)
    process = ForceMapProcess(recording.device)
    process.render = recording.render
    return PaintedWorlds(recording, process, process.close)


# --------------------------------------------------------------------------------------------------
# Part of a recording on the command line: FILE, or FILE#t=FROM,TO as studies write their trials.


_PART_PATTERN = re.compile(r"(?P<path>.+)#t=(?P<first>[0-9.eE+-]{1,32}),(?P<last>[0-9.eE+-]{1,32})")


class RecordingPart(NamedTuple):
    """Part of a recording: start and end on the loop's clock [s], or None for all of it."""

    path: Path
    span: tuple[float, float] | None


def parse_part(text: str) -> RecordingPart:
    """Parse FILE or FILE#t=FROM,TO. Raises InputError for invalid times.

    >>> parse_part("a.mcap#t=1.5,3").span, parse_part("a.mcap").span
    ((1.5, 3.0), None)
    """
    path, mark, _ = text.partition("#t=")
    if not mark or Path(text).exists():  # the name of an existing file may contain the mark
        return RecordingPart(Path(text), None)
    found = _PART_PATTERN.fullmatch(text)
    try:
        first, last = (float(found[one]) for one in ("first", "last")) if found else (math.nan, math.nan)
    except ValueError:
        first = last = math.nan
    if not 0 <= last - first < math.inf:
        raise InputError(f"part of a recording must be FILE#t=FROM,TO in seconds, FROM first; got {quote(text)}")
    return RecordingPart(Path(path), (first, last))
