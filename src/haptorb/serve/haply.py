"""Server of `--serve haply[:HOST][:PORT[:EVENTS]]`: transport for clients of the Haply Inverse Service.

Two ports: WebSocket and HTTP for clients, WebSocket for events.
"""

from __future__ import annotations

import asyncio
import json
import re
import socket
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from fnmatch import fnmatchcase
from functools import partial
from itertools import cycle
from time import monotonic
from typing import Any, TypeAlias, cast, final
from urllib.parse import parse_qs, unquote, urlsplit

from starlette.responses import Response
from starlette.types import ASGIApp, Receive, Scope, Send
from websockets.frames import Frame, Opcode
from websockets.http11 import Request as UpgradeRequest
from websockets.http11 import Response as UpgradeResponse
from websockets.protocol import OPEN
from websockets.server import ServerProtocol

from haptorb.arrays import record
from haptorb.control.trip_reasons import Trip
from haptorb.errors import HaptorbError, InputError
from haptorb.runtime.sockets import STALL, StreamTimes
from haptorb.serve.base import (
    KINDS,
    OTHER_LOOPBACK,
    ServedDevice,
    ServerPreparation,
    ServerPriority,
    check_port,
    has_other_loopback,
    open_port,
)
from haptorb.serve.haply_protocol import Cursor, DeviceIds, Service, Session, Settings, Space, default_space
from haptorb.version import __version__
from haptorb.web.access import LOOPBACK, Access, choose_serve_token, is_loopback, is_own_connection
from haptorb.web.server import configure, limit_read_size, make_connections

__all__ = [
    "GRIP",
    "TOOL",
    "AmbiguousDevice",
    "Connection",
    "DeviceWatcher",
    "Endpoint",
    "Event",
    "HttpReply",
    "find_kind",
    "find_session",
    "make_application",
    "prepare",
    "reply",
    "serve",
    "write_event",
]


# --------------------------------------------------------------------------------------------------
# HTTP on the port of the WebSocket: short requests with JSON replies, by the server of the pages.


_MAX_BODY_BYTES = 65536  #: longest body of a request [bytes]


@record
class HttpReply:
    """HTTP reply: status, and body to be encoded as JSON; a body of None is empty."""

    status: int
    body: Any


def make_application(endpoint: Endpoint) -> ASGIApp:
    """ASGI application that checks the access of HTTP requests and has them answered by `endpoint`."""

    async def answer(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            return
        headers = {name.decode("latin-1"): value.decode("latin-1") for name, value in scope["headers"]}
        query = scope["query_string"].decode("latin-1")
        target = scope["raw_path"].decode("latin-1") + (f"?{query}" if query else "")
        peer, own = scope["client"], is_own_connection(scope["client"], scope["server"])
        if refusal := endpoint.access.refuse(str((peer or ("",))[0]), headers, target, own=own):
            response = _encode(HttpReply(403, {"ok": False, "error": refusal}), None)
        elif (body := await _read_body(receive)) is None:
            response = _encode(HttpReply(413, {"ok": False, "error": "the body is too long"}), None)
            response.headers["Connection"] = "close"
        elif scope["method"] == "OPTIONS":
            response = _encode(HttpReply(204, None), headers.get("origin"))
        else:
            response = _encode(endpoint.reply(scope["method"], target, body), headers.get("origin"))
        await response(scope, receive, send)

    return answer


async def _read_body(receive: Receive) -> bytes | None:
    """Body of a request; None if it is too long."""
    body, more = b"", True
    while more:
        message = await receive()
        body += message.get("body", b"")
        more = message.get("more_body", False)
        if len(body) > _MAX_BODY_BYTES:
            return None
    return body


def _encode(reply: HttpReply, origin: str | None) -> Response:
    """Encode `reply`, with CORS headers for a page of the accepted `origin`; None: for a program."""
    headers = {}
    if origin is not None:
        headers = {
            "Access-Control-Allow-Origin": origin,
            "Access-Control-Allow-Methods": "GET, POST, DELETE",
            "Access-Control-Allow-Headers": "content-type, authorization",
        }
    content = b"" if reply.body is None else json.dumps(reply.body).encode()
    return Response(content, reply.status, headers, "application/json")


# --------------------------------------------------------------------------------------------------
# WebSocket connection on one of the two ports, with limits so that no client starves the others.
#
# It takes over from the HTTP connection that requested it. An ASGI application would receive a message through a queue
# and a task, and without the time at which its bytes arrived, from which the age of a command counts. Here messages are
# answered in the receive callback. After two answers other connections have their turn. A client that does not read its
# replies is no longer read, and is closed after ten seconds. After an invalid message reading is paused for a moment, a
# refusal is sent with a delay, and data after a message that is too long is discarded.


_READ_BYTES = 4096  #: read at once; limits how long a flood of small messages delays the others [bytes]
_MAX_MESSAGE_BYTES = 65536  #: longest message [bytes]
_MAX_FRAGMENTS = 256  #: per message: endless empty fragments must not fill the memory
_MAX_HEAD_BYTES = 16384  #: longest head of a request [bytes]
_MAX_CONSECUTIVE_ANSWERS = 2  #: answers to one client before other connections have their turn
_MAX_UNREAD_BYTES = 65536  #: write buffer for a client that does not read [bytes]
_CLIENT_TIMEOUT_S = 10.0  #: for a request, or for a client to read [s]
_INVALID_MESSAGE_DELAY_S = 0.005  #: pause in reading after an invalid message [s]
_REFUSAL_DELAY_S = 0.05  #: before a refusal is sent: limits a client that retries at once to 20 attempts per second [s]
_DISCARD_BYTES = 262144  #: data discarded at once [bytes]
_CLOSE_TIMEOUT_S = 1.0  #: for a client to read why its message was refused as too long [s]


class Endpoint(ABC):
    """Handler of the connections on one port."""

    access: Access
    alive: float  #: last time at which this process was seen running, on the monotonic clock [s]
    connections: set[Connection]
    room: int  #: connections at most

    @abstractmethod
    def open(self, connection: Connection) -> None:
        """Send the initial message of a new WebSocket."""

    @abstractmethod
    def answer(self, connection: Connection, message: bytes, arrival: float) -> str | None:
        """Answer a message that arrived at `arrival` on the monotonic clock [s]; None: no answer.

        After an invalid message it calls `delay_reading` of the connection."""

    @abstractmethod
    def close(self, connection: Connection) -> None:
        """Release the resources of a closed connection."""

    @abstractmethod
    def reply(self, method: str, target: str, body: bytes) -> HttpReply:
        """Answer an HTTP request."""


@final
class Connection(asyncio.Protocol):
    """WebSocket connection of one client of `endpoint`; `peer` is its IP address. The other arguments are uvicorn's."""

    def __init__(self, endpoint: Endpoint, **_: Any) -> None:
        self.endpoint, self.peer, self._own = endpoint, "", False
        self._times, self._descriptor, self._arrival = StreamTimes(), -1, 0.0
        self._websocket = ServerProtocol(max_size=_MAX_MESSAGE_BYTES)
        self._open = self._paused = self._failed = self._delayed = False
        self._parts: list[bytes] = []  # of a fragmented message
        self._waiting: deque[tuple[float, bytes]] = deque()  # complete messages, each with its arrival [s]
        self._timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Register a new connection; refuse it if there are too many."""
        self._transport = cast(asyncio.Transport, transport)
        self._transport.set_write_buffer_limits(high=_MAX_UNREAD_BYTES)
        limit_read_size(self._transport, _READ_BYTES)
        peer, self._descriptor = transport.get_extra_info("peername"), transport.get_extra_info("socket").fileno()
        self.peer = str((peer or ("",))[0])
        self._own = is_own_connection(peer, transport.get_extra_info("sockname"))
        self.endpoint.connections.add(self)
        self._start_timeout()
        if len(self.endpoint.connections) > self.endpoint.room:
            self._failed = True
            self._transport.write(b"HTTP/1.1 503 Service Unavailable\r\nContent-Length: 0\r\nConnection: close\r\n\r\n")
            self._transport.close()

    def data_received(self, data: bytes) -> None:
        """Process received bytes, with the time at which they arrived."""
        if self._failed:
            return
        now = monotonic()
        if now - self.endpoint.alive > STALL:
            self._times.wait(self.endpoint.alive)
        self._arrival = self._times.find(self._descriptor, now)
        self._receive(data)

    def _receive(self, data: bytes) -> None:
        websocket = self._websocket
        websocket.receive_data(data)
        for event in websocket.events_received():
            if isinstance(event, UpgradeRequest):
                self._handle_handshake(websocket, event)
            elif isinstance(event, Frame):
                self._collect_frame(event)
        self._flush()
        if websocket.parser_exc is not None:
            self._failed = True
            limit_read_size(self._transport, _DISCARD_BYTES)
            self._start_timeout(_CLOSE_TIMEOUT_S)
            return
        self._answer_waiting()

    def _handle_handshake(self, websocket: ServerProtocol, request: UpgradeRequest) -> None:
        headers = {name.lower(): value for name, value in request.headers.raw_items()}
        refusal = self.endpoint.access.refuse(self.peer, headers, request.path, own=self._own)
        if refusal:
            self._transport.pause_reading()
            asyncio.get_running_loop().call_later(_REFUSAL_DELAY_S, self._refuse, websocket.reject(403, f"{refusal}\n"))
            return
        websocket.send_response(websocket.accept(request))
        self._flush()
        if websocket.state is OPEN:
            self._open = True
            self._cancel_timeout()
            self.endpoint.open(self)

    def _refuse(self, response: UpgradeResponse) -> None:
        if not self._transport.is_closing():
            self._websocket.send_response(response)
            self._flush()

    def _collect_frame(self, frame: Frame) -> None:
        """Collect a text or binary frame; a complete message is appended to the waiting ones."""
        if frame.opcode not in (Opcode.TEXT, Opcode.BINARY, Opcode.CONT):
            return  # a ping is answered by the protocol library
        if frame.fin and not self._parts:
            self._waiting.append((self._arrival, bytes(frame.data)))
            return
        self._parts.append(bytes(frame.data))
        if len(self._parts) > _MAX_FRAGMENTS:
            self.end(1009, "a message has too many fragments")
            return
        if frame.fin:
            self._waiting.append((self._arrival, b"".join(self._parts)))
            self._parts = []

    def _answer_waiting(self) -> None:
        """Answer a few waiting messages, then yield to other connections."""
        if self._delayed:
            return
        for _ in range(_MAX_CONSECUTIVE_ANSWERS):
            if not self._waiting or self._paused or self._delayed or not self._open:
                break
            arrival, message = self._waiting.popleft()
            answer = self.endpoint.answer(self, message, arrival)
            if answer is not None:
                self.send(answer)
        if self._delayed:
            self._pause_reading()
            asyncio.get_running_loop().call_later(_INVALID_MESSAGE_DELAY_S, self._end_delay)
        elif self._waiting and self._open and not self._paused:
            self._pause_reading()
            asyncio.get_running_loop().call_soon(self._continue)
        elif not self._paused and self._open:
            self._transport.resume_reading()

    def _pause_reading(self) -> None:
        """Pause reading; data that arrives meanwhile waits in the kernel, and its age is counted."""
        if self._transport.is_reading():
            self._times.wait(monotonic())
        self._transport.pause_reading()

    def delay_reading(self) -> None:
        """Pause reading for a moment, after an invalid message."""
        self._delayed = True

    def _end_delay(self) -> None:
        self._delayed = False
        self._continue()

    def _continue(self) -> None:
        if self._open and not self._paused:
            self._answer_waiting()

    def send(self, text: str) -> None:
        """Send one text message, if the WebSocket is open."""
        if self._open and self._websocket.state is OPEN:
            self._websocket.send_text(text.encode())
            self._flush()

    @property
    def unread(self) -> int:
        """Bytes in the write buffer, not yet read by the client."""
        return self._transport.get_write_buffer_size()

    def _flush(self) -> None:
        for data in self._websocket.data_to_send():
            if data:
                self._transport.write(data)
            else:
                self._transport.close()
        if self._websocket.close_expected() and self._timer is None:
            self._start_timeout()

    def end(self, code: int, why: str) -> None:
        """Close the WebSocket with `code` and the reason `why`."""
        if self._open and self._websocket.state is OPEN:
            self._websocket.send_close(code, why)
            self._flush()
        self._transport.close()

    def pause_writing(self) -> None:
        """Pause reading from a client that does not read, and close it after a timeout."""
        self._paused = True
        self._pause_reading()
        self._start_timeout()

    def resume_writing(self) -> None:
        """Continue with a client that reads again."""
        self._paused = False
        if self._failed:
            return
        self._cancel_timeout()
        self._continue()

    def eof_received(self) -> bool:
        """Close the connection when the client has closed its side."""
        return False

    def connection_lost(self, exc: Exception | None) -> None:
        """Cancel the timeout, unregister the connection and notify the endpoint."""
        self._cancel_timeout()
        self.endpoint.connections.discard(self)
        if self._open:
            self._open = False
            self.endpoint.close(self)

    def _start_timeout(self, timeout: float = _CLIENT_TIMEOUT_S) -> None:
        self._cancel_timeout()
        self._timer = asyncio.get_running_loop().call_later(timeout, self._transport.abort)

    def _cancel_timeout(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None


# --------------------------------------------------------------------------------------------------
# Selectors of an HTTP request: the device in its path, and the sessions of its ?session=.


TOOL, GRIP = "inverse3", "wireless_verse_grip"
_FAMILIES = {TOOL: TOOL, "*inverse": TOOL, GRIP: GRIP, "*verse_grip": GRIP}
_MAX_SELECTOR_CHARACTERS = 100  #: longest selector that is used or quoted [characters]
_NUMBER_PATTERN = re.compile(r"#?(\d{1,9})")
_INDEX_PATTERN = re.compile(r"(.*?):(-?\d{1,4})")
_DEFAULT_PROFILE = "default"  #: profile of a session without a name


class AmbiguousDevice(InputError):
    """Raised for a request that needs one device and selects several."""


def find_kind(identity: DeviceIds, kind: str, which: str, *, one: bool) -> str:
    """Find the device type of a path `kind`/`which`: a type or a family, and an id, an index or *.

    Raises InputError if there is no such device, AmbiguousDevice for * where `one` is needed.
    """
    found = _FAMILIES.get(kind, "")
    ids = {TOOL: identity.device, GRIP: identity.grip}
    if not found or which.upper() not in ("0", "-1", "*", ids[found]):
        asked = f"{kind[:_MAX_SELECTOR_CHARACTERS]}/{which[:_MAX_SELECTOR_CHARACTERS]}"
        raise InputError(f"no device {asked}; there is {TOOL}/{ids[TOOL]} and {GRIP}/{ids[GRIP]}")
    if one and which == "*":
        raise AmbiguousDevice(f"* may mean several devices; name one: {kind}/0 or {kind}/{ids[found]}")
    return found


def find_session(sessions: Sequence[Session], text: str) -> Session:
    """Find the session that `text` selects: by number (7 or #7), by index (:0, :-1), or by profile.

    A profile may contain the wildcards * and ?; of several matches an index selects one (name:1).

    Raises InputError if there is none.
    """
    if (number := _NUMBER_PATTERN.fullmatch(text)) is not None:
        found = [one for one in sessions if one.number == int(number[1])]
        return _choose(found, 0, text, sessions)
    parts = _INDEX_PATTERN.fullmatch(text)
    pattern, place = (parts[1], int(parts[2])) if parts else (text, 0)
    pattern = pattern.removeprefix(":")[:_MAX_SELECTOR_CHARACTERS].replace("[", "[[]")  # a bracket is literal
    found = [one for one in sessions if not pattern or fnmatchcase(one.name or _DEFAULT_PROFILE, pattern)]
    return _choose(found, place, text, sessions)


def _choose(found: Sequence[Session], place: int, text: str, sessions: Sequence[Session]) -> Session:
    if not -len(found) <= place < len(found):
        raise InputError(
            f"no session {text[:_MAX_SELECTOR_CHARACTERS]}; there are {len(sessions)}: /sessions lists them"
        )
    return found[place]


# --------------------------------------------------------------------------------------------------
# HTTP routes of the Inverse Service: version, devices, sessions, settings, and the config of a device.


_PROTOCOL_VERSION = "3.5.0"  #: version of the Inverse Service whose documentation this follows
_UNSUPPORTED_CONFIGS = (
    "torque_scaling",
    "gravity_compensation",
    "home_return",
)  #: configs that this device does not support
_CONFIG_NAMES = ("basis", "preset", "mount", "transform", "workspace", "filters", "damping", "force_gate", "handedness",
           "navigation", *_UNSUPPORTED_CONFIGS)  # fmt: skip
_RENAMED_CONFIGS = {"device_handedness": "handedness"}  #: names of version 3.0 → present names
_OLDER_VERSIONS = ("3.1", "3.0")  #: versions that some programs put before a route


def reply(service: Service, method: str, target: str, body: bytes) -> HttpReply:
    """Answer an HTTP request: /version and /devices with plain data, all others with {ok: true, data}.

    Errors are {ok: false, error}.
    """
    parts = urlsplit(target)
    query = parse_qs(parts.query)
    words = [unquote(word) for word in parts.path.split("/") if word]
    if words and words[0] in _OLDER_VERSIONS:
        del words[0]
    try:
        return _route(service, method, words, query, body)
    except AmbiguousDevice as cause:
        return _refuse(400, str(cause))
    except InputError as cause:
        return _refuse(404, str(cause))


def _route(service: Service, method: str, words: list[str], query: Mapping[str, list[str]], body: bytes) -> HttpReply:
    if method == "GET" and len(words) == 1:
        match words[0]:
            case "version":
                return HttpReply(200, _describe_version())
            case "devices":
                return HttpReply(200, service.list_devices(_find_space(service, query)))
            case "sessions":
                sessions = [_describe_session(service, one) for one in service.sessions.values()]
                return _answer({"session_count": len(sessions), "sessions": sessions})
            case "settings":
                return _answer({})
    if len(words) in (3, 4) and words[2] == "config":
        return _route_config(service, method, words, query, body)
    if words and len(words) < 3 and (name := _RENAMED_CONFIGS.get(words[-1], words[-1])) in _CONFIG_NAMES:
        service.send_event("http-route-deprecated", "system", "warning", {"route": "/".join(words)[:100]})
        return _refuse(404, f"'{words[-1]}' has another route now: /{TOOL}/0/config/{name}")
    return _refuse(404, "no such route; there are /version, /devices, /sessions, /settings and /TYPE/ID/config/NAME")


def _route_config(
    service: Service, method: str, words: list[str], query: Mapping[str, list[str]], body: bytes
) -> HttpReply:
    kind = find_kind(service.identity, words[0], words[1], one=method == "GET")
    name = words[3] if len(words) == 4 else ""
    if name and (name not in _CONFIG_NAMES or kind != TOOL):
        return _refuse(404, f"{kind} has no config '{name}'; {TOOL} has {', '.join(_CONFIG_NAMES)}")
    session = _find_session(service, query)
    try:
        if method == "POST" and name:
            service.configure(session, {name: json.loads(body)})
        elif method == "DELETE" and name:
            _restore(service, session, name)
        elif method != "GET":
            return _refuse(405, f"{method} is not allowed for this route")
    except HaptorbError as cause:
        return _refuse(400, str(cause))
    except (ValueError, RecursionError) as cause:
        return _refuse(400, f"the body is no JSON: {str(cause)[:200]}")
    if kind != TOOL:
        return _answer({"type": kind, "handedness": "right"})
    space = service.space if session is None else session.space
    if name:
        return _answer(service.settings.as_command(name, service.identity, space))
    return _answer(service.settings.as_json(service.identity, space))


def _restore(service: Service, session: Session | None, name: str) -> None:
    """Reset the config `name` to its default."""
    if name in _UNSUPPORTED_CONFIGS:
        return
    first = default_space(service.served.device)
    name = "preset" if name == "mount" else name
    service.configure(session, {name: Settings().as_command(name, service.identity, first)})


def _find_session(service: Service, query: Mapping[str, list[str]]) -> Session | None:
    """Session of the query ?session=; None without it: all sessions, present and future."""
    given = query.get("session", [])
    return find_session(list(service.sessions.values()), given[0]) if given else None


def _find_space(service: Service, query: Mapping[str, list[str]]) -> Space:
    session = _find_session(service, query)
    return service.space if session is None else session.space


def _describe_version() -> dict[str, Any]:
    return {
        "project_name": "haptorb",
        "project_version": f"{_PROTOCOL_VERSION}.0",
        "git_tag": _PROTOCOL_VERSION,
        "git_describe": f"{_PROTOCOL_VERSION}-haptorb-{__version__}",
        "git_branch": "",
        "git_hash": "",
        "build_time": "",
    }


def _describe_session(service: Service, session: Session) -> dict[str, Any]:
    return {
        "session_id": session.number,
        "profile": {"name": session.name},
        "rate_hz": round(session.rate, 1),
        "holds": service.served.holder == session.number,
    }


def _answer(data: Mapping[str, Any]) -> HttpReply:
    return HttpReply(200, {"ok": True, "data": dict(data)})


def _refuse(status: int, error: str) -> HttpReply:
    return HttpReply(status, {"ok": False, "error": error})


# --------------------------------------------------------------------------------------------------
# Events of the Inverse Service about the device and its clients, for listeners on the second port.
#
# A trip is reported as its emergency brake (ebrake), damping by the passivity control as its stability ceiling. It has
# no event for a force reduced by warm coils: `thermal_derating` is specific to this server.


Event: TypeAlias = tuple[str, str, str, dict[str, Any], str]  #: name, category, level, data, message


def write_event(name: str, category: str, level: str, data: dict[str, Any], message: str = "") -> str:
    """Encode one event in the format of the Inverse Service."""
    return json.dumps({"name": name, "category": category, "level": level, "data": data, "message": message})


_ONSET_GAP_S = 1.0  #: a condition that was absent for this long is reported again [s]


@final
class _Onset:
    """Onset detector for a condition in the rows: `has_begun` is true once per onset."""

    def __init__(self) -> None:
        self._last = float("-inf")

    def has_begun(self, there: bool, t: float) -> bool:
        """Whether the condition begins at the time `t` [s], given whether it is `there` now."""
        first = there and not self._last <= t < self._last + _ONSET_GAP_S
        self._last = t if there else self._last
        return first


@final
class DeviceWatcher:
    """Derives events from the rows: connection, trip, recovery, derating and added damping."""

    def __init__(self, served: ServedDevice, identity: DeviceIds) -> None:
        self._served, self._identity, self._cursor = served, identity, Cursor(served)
        self._tripped = False
        self._warm, self._damped = _Onset(), _Onset()

    def poll(self) -> list[Event]:
        """Events since the last call: name, category, level, data, message."""
        cursor, found = self._cursor, list[Event]()
        cursor.update()
        if cursor.tripped and not self._tripped:
            reason = Trip(cursor.trip)
            found.append(self._make_safety_event("ebrake_triggered", "error", reason.text, reason=reason.name.lower()))
        elif self._tripped and cursor.ready:
            found.append(self._make_safety_event("ebrake_released", "notice", "a person has switched the coils on"))
            self._tripped = False
        self._tripped = self._tripped or cursor.tripped
        if self._warm.has_begun(cursor.derated, cursor.t):
            found.append(
                self._make_safety_event("thermal_derating", "warning", "the coils are warm: less force is rendered")
            )
        if self._damped.has_begun(cursor.damped, cursor.t):
            found.append(
                self._make_safety_event("stability_ceiling", "warning", "damping is added: the force gave energy away")
            )
        return found

    def _make_safety_event(self, kind: str, level: str, message: str, **more: str) -> Event:
        return (
            "device-safety-triggered",
            "device",
            level,
            {**self._device_fields(), "safety_type": kind, **more},
            message,
        )

    def _device_fields(self) -> dict[str, Any]:
        return {"device_family": "inverse", "device_id": self._identity.device}

    def connected_event(self) -> str:
        """Encode the event of the connected device, for a new listener."""
        text = f"{self._served.device.title} is connected"
        return write_event("device-connected", "device", "info", self._device_fields(), text)

    def end(self) -> Event:
        """Event for the end of the servo."""
        return ("device-disconnected", "device", "warning", self._device_fields(), "the servo has ended")


PORT, EVENTS = 10001, 10020  #: default ports of the Inverse Service
_FORM = KINDS["haply"].form
_MAX_CONNECTIONS = 128  #: on each port
_EVENT_CHECK_INTERVAL_S = 0.02  #: between two polls of the device's events [s]
_REPORT_INTERVAL_S = 0.5  #: between two reports of the clients [s]
_MAX_EVENT_BACKLOG_BYTES = 32768  #: unread bytes of a listener above which its events are dropped [bytes]


def prepare(where: str) -> ServerPreparation:
    """Open both ports; `where` is PORT or PORT:EVENTS, optionally after an address of this computer to listen on."""
    host, ports = _split_address(where)
    if len(ports) > 2:
        raise InputError(f"--serve {_FORM}: at most an address and two ports; got '{where}'")
    token = choose_serve_token(host)
    first = check_port(ports[0], _FORM) if ports else PORT
    second = check_port(ports[1], _FORM) if len(ports) > 1 else (EVENTS if first in (PORT, EVENTS) else 0)
    main = open_port(first, "--serve haply:PORT", host=host)
    try:
        events = open_port(second, f"--serve haply:{first}:EVENTS", host=host)
    except BaseException:
        main.close()
        raise
    place = f"[{host}]" if ":" in host else host
    numbers = [int(one.getsockname()[1]) for one in (main, events)]
    opened = [main, events]
    try:
        opened += _open_other_loopback(host, numbers, (first, second))
    except BaseException:
        for one in opened:
            one.close()
        raise
    beyond = not is_loopback(host)
    remarks = (f"haply: clients on other computers must send this token: {token}",) if beyond else ()
    return ServerPreparation(
        {"token": token, "address": f"ws://{place}:{numbers[0]}"},
        f"ws://{place}:{numbers[0]}, events ws://{place}:{numbers[1]}",
        [one.detach() for one in opened],
        remarks,
    )


def _open_other_loopback(host: str, numbers: list[int], asked: tuple[int, int]) -> list[socket.socket]:
    """Open both ports on ::1 too, which many programs try first for `localhost`; none if this computer has no ::1.

    Raises InputError if another program uses a requested port there: clients would connect to it instead.
    """
    opened = list[socket.socket]()
    try:
        for number in numbers if host == LOOPBACK and has_other_loopback() else ():
            opened.append(open_port(number, "--serve haply:PORT:EVENTS", host=OTHER_LOOPBACK))
    except InputError:
        for one in opened:
            one.close()
        if all(asked):
            raise
        return []
    return opened


def _split_address(where: str) -> tuple[str, list[str]]:
    """Split 10001:10020, HOST:10001 or [::1]:10001 into the host and the ports as texts."""
    if where.startswith("["):
        host, _, rest = where[1:].partition("]")
        return host, [one for one in rest.removeprefix(":").split(":") if one]
    words = where.split(":") if where else []
    host = words.pop(0) if words and not words[0].isdecimal() else LOOPBACK
    return host or LOOPBACK, words


def serve(spec: dict[str, Any], descriptors: list[int], served: ServedDevice) -> None:
    """Serve on the open sockets until `served.over`."""
    asyncio.run(_serve(spec, [socket.socket(fileno=one) for one in descriptors], served))


async def _serve(spec: dict[str, Any], sockets: list[socket.socket], served: ServedDevice) -> None:
    access, loop = Access(spec["token"]), asyncio.get_running_loop()
    listeners = _EventEndpoint(access)
    service = Service(served, listeners.broadcast)
    clients = _ClientEndpoint(access, service)
    endpoints: list[Endpoint] = [clients, listeners]
    watcher = DeviceWatcher(served, service.identity)
    listeners.first = watcher.connected_event
    servers = [
        await loop.create_server(_make_connections(endpoint), sock=one)
        for endpoint, one in zip(cycle(endpoints), sockets, strict=False)
    ]
    report, priority = 0.0, ServerPriority()
    while not served.over:
        clients.alive = listeners.alive = loop.time()
        for event in watcher.poll():
            listeners.broadcast(*event)
        if loop.time() >= report:
            report = loop.time() + _REPORT_INTERVAL_S
            _report(service, spec["address"])
            priority.update()
        await asyncio.sleep(_EVENT_CHECK_INTERVAL_S / 4)
        clients.alive = listeners.alive = loop.time()
        await asyncio.sleep(_EVENT_CHECK_INTERVAL_S / 4)
    listeners.broadcast(*watcher.end())
    for server in servers:
        server.close()
    for endpoint in endpoints:
        for connection in list(endpoint.connections):
            connection.end(1001, "the servo has ended")
    await asyncio.sleep(_EVENT_CHECK_INTERVAL_S)


def _make_connections(endpoint: Endpoint) -> Callable[[], asyncio.Protocol]:
    """Factory of the connections on one port: HTTP, of which some become a `Connection`."""
    return make_connections(
        configure(
            make_application(endpoint), partial(Connection, endpoint), life=_CLIENT_TIMEOUT_S, renewed=True,
            h11_max_incomplete_event_size=_MAX_HEAD_BYTES, timeout_keep_alive=int(_CLIENT_TIMEOUT_S),
        )
    )  # fmt: skip


def _report(service: Service, address: str) -> None:
    holder = service.served.holder
    clients = [
        {
            "name": one.name or f"{one.peer} #{one.number}",
            "session": one.number,
            "rate_hz": round(one.measure(), 1),
            "holds": one.number == holder,
        }
        for one in service.sessions.values()
    ]
    service.served.report("haply", address, clients)


@final
class _ClientEndpoint(Endpoint):
    def __init__(self, access: Access, service: Service) -> None:
        self.access, self.connections, self.room, self.alive = access, set(), _MAX_CONNECTIONS, monotonic()
        self._service = service
        self._sessions: dict[Connection, Session] = {}

    def open(self, connection: Connection) -> None:
        session = self._service.open(connection.peer)
        self._sessions[connection] = session
        connection.send(self._service.inventory(session))

    def answer(self, connection: Connection, message: bytes, arrival: float) -> str | None:
        session = self._sessions[connection]
        unreadable = session.unreadable
        answer = self._service.answer(session, message, arrival)
        if session.unreadable > unreadable:
            connection.delay_reading()
        return answer

    def close(self, connection: Connection) -> None:
        if (session := self._sessions.pop(connection, None)) is not None:
            self._service.close(session)

    def reply(self, method: str, target: str, body: bytes) -> HttpReply:
        return reply(self._service, method, target, body)


@final
class _EventEndpoint(Endpoint):
    """Endpoint of the event port; messages of listeners are ignored."""

    def __init__(self, access: Access) -> None:
        self.access, self.connections, self.room, self.alive = access, set(), _MAX_CONNECTIONS, monotonic()
        self.first: Callable[[], str] = str  #: returns the first message to a new listener

    def broadcast(self, name: str, category: str, level: str, data: dict[str, Any], message: str = "") -> None:
        """Send one event to all listeners, except those that read too slowly."""
        text = write_event(name, category, level, data, message)
        for connection in list(self.connections):
            if connection.unread < _MAX_EVENT_BACKLOG_BYTES:
                connection.send(text)

    def open(self, connection: Connection) -> None:
        connection.send(self.first())

    def answer(self, connection: Connection, message: bytes, arrival: float) -> str | None:
        return None

    def close(self, connection: Connection) -> None:
        return

    def reply(self, method: str, target: str, body: bytes) -> HttpReply:
        return HttpReply(404, {"ok": False, "error": "this port has events only, over a WebSocket"})
