"""The server of `--serve haply[:HOST][:PORT[:EVENTS]]`: its two ports, and the loop that serves them."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable
from functools import partial
from itertools import cycle
from time import monotonic
from typing import Any, final

from haptorb.apps.serve.access import Access, choose_serve_token
from haptorb.apps.serve.haply.connection import Connection, Endpoint
from haptorb.apps.serve.haply.events import DeviceWatcher, write_event
from haptorb.apps.serve.haply.http_exchange import HttpReply
from haptorb.apps.serve.haply.routes import reply
from haptorb.apps.serve.haply.service import Service
from haptorb.apps.serve.haply.session import Session
from haptorb.apps.serve.ports import LOOPBACK, OTHER_LOOPBACK, check_port, has_other_loopback, is_loopback, open_port
from haptorb.apps.serve.preparation import ServerPreparation
from haptorb.apps.serve.served_device import ServedDevice
from haptorb.apps.serve.server_kinds import KINDS
from haptorb.apps.serve.server_priority import ServerPriority
from haptorb.errors import InputError

__all__ = ["prepare", "serve"]

PORT, EVENTS = 10001, 10020  #: where that service is found
_FORM = KINDS["haply"].form
_CLIENTS = 128  #: connections at once, on each port
_LOOK = 0.02  #: between two looks for what happened [s]
_REPORT = 0.5  #: between two reports of who is connected [s]
_BEHIND = 32768  #: bytes that wait for a listener, behind which events are dropped


def prepare(where: str) -> ServerPreparation:
    """Both ports, open; `where` is PORT, PORT:EVENTS, or these behind an address of this computer to be reached at."""
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
    """Both ports on ::1 too, where `localhost` leads many programs first; none where this computer has no ::1.

    Raises InputError if another program has a port that was asked for: programs would reach it instead.
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
    """(host, ports as texts): 10001:10020, HOST:10001, [::1]:10001."""
    if where.startswith("["):
        host, _, rest = where[1:].partition("]")
        return host, [one for one in rest.removeprefix(":").split(":") if one]
    words = where.split(":") if where else []
    host = words.pop(0) if words and not words[0].isdecimal() else LOOPBACK
    return host or LOOPBACK, words


def serve(spec: dict[str, Any], descriptors: list[int], served: ServedDevice) -> None:
    """Serve on both sockets until the servo ends."""
    asyncio.run(_serve(spec, [socket.socket(fileno=one) for one in descriptors], served))


async def _serve(spec: dict[str, Any], sockets: list[socket.socket], served: ServedDevice) -> None:
    access, loop = Access(spec["token"]), asyncio.get_running_loop()
    listeners = _EventEndpoint(access)
    service = Service(served, listeners.tell)
    clients = _ClientEndpoint(access, service)
    endpoints: list[Endpoint] = [clients, listeners]
    watcher = DeviceWatcher(served, service.identity)
    listeners.first = watcher.introduce
    servers = [
        await loop.create_server(partial(Connection, endpoint), sock=one)
        for endpoint, one in zip(cycle(endpoints), sockets, strict=False)
    ]
    report, priority = 0.0, ServerPriority()
    while not served.over:
        clients.alive = listeners.alive = loop.time()
        for event in watcher.look():
            listeners.tell(*event)
        if loop.time() >= report:
            report = loop.time() + _REPORT
            _report(service, spec["address"])
            priority.look()
        await asyncio.sleep(_LOOK / 4)
        clients.alive = listeners.alive = loop.time()
        await asyncio.sleep(_LOOK / 4)
    listeners.tell(*watcher.end())
    for server in servers:
        server.close()
    for endpoint in endpoints:
        for connection in list(endpoint.connections):
            connection.end(1001, "the servo has ended")
    await asyncio.sleep(_LOOK)


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
        self.access, self.connections, self.room, self.alive = access, set(), _CLIENTS, monotonic()
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
            connection.rest()
        return answer

    def close(self, connection: Connection) -> None:
        if (session := self._sessions.pop(connection, None)) is not None:
            self._service.close(session)

    def reply(self, method: str, target: str, body: bytes) -> HttpReply:
        return reply(self._service, method, target, body)


@final
class _EventEndpoint(Endpoint):
    """Send events to a connection; what it sends is not read."""

    def __init__(self, access: Access) -> None:
        self.access, self.connections, self.room, self.alive = access, set(), _CLIENTS, monotonic()
        self.first: Callable[[], str] = str  #: the first message to a new client

    def tell(self, name: str, category: str, level: str, data: dict[str, Any], message: str = "") -> None:
        """One event to all; who is slow to read misses it."""
        text = write_event(name, category, level, data, message)
        for connection in list(self.connections):
            if connection.unread < _BEHIND:
                connection.send(text)

    def open(self, connection: Connection) -> None:
        connection.send(self.first())

    def answer(self, connection: Connection, message: bytes, arrival: float) -> str | None:
        return None

    def close(self, connection: Connection) -> None:
        return

    def reply(self, method: str, target: str, body: bytes) -> HttpReply:
        return HttpReply(404, {"ok": False, "error": "this port has events only, over a WebSocket"})
