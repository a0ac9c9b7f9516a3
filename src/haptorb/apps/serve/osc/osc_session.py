"""One run's programs that speak OSC: what they send is done, refused or counted, and rows go to who subscribed."""

from __future__ import annotations

import socket
from collections.abc import Sequence
from contextlib import suppress
from hmac import compare_digest
from time import monotonic, time
from typing import Any, final

from haptorb.apps.serve.osc.osc_answers import make_message, make_parameter_answer
from haptorb.apps.serve.osc.osc_inbox import OscInbox, Sender
from haptorb.apps.serve.osc.requests import (
    AskParameters,
    ChangeWorld,
    CommandForce,
    SetParameter,
    Subscribe,
    Unsubscribe,
    parse_request,
)
from haptorb.apps.serve.osc.row_bundle import RowBundle
from haptorb.apps.serve.osc.subscribers import Subscribers
from haptorb.apps.serve.osc.world_requests import WorldRequests
from haptorb.apps.serve.served_device import ServedDevice
from haptorb.errors import InputError
from haptorb.numerics.arrays import Array
from haptorb.runtime.trackers.osc_packet import read_packet

__all__ = ["OscSession"]

_ERRORS = 0.1  #: between two answers of refusal to one program [s]
_PROGRAMS = 64  #: that are remembered; of more, those that were silent for longest are forgotten
_FORGET = 30.0  #: a program that said nothing for so long is not connected any more [s]


@final
class _Program:
    def __init__(self, sender: Sender, session: int) -> None:
        self.sender, self.session = sender, session
        self.answers_to = sender
        self.last_time = 0.0
        self.count, self.rate = 0, 0.0
        self.next_error = 0.0


@final
class OscSession:
    """Serves the rows and the force of `served` through `opened`, a UDP socket.

    token   first value of every message if other computers reach the socket; empty: none is needed
    """

    def __init__(self, opened: socket.socket, served: ServedDevice, token: str = "") -> None:
        self._socket, self._served, self._token = opened, served, token.encode()
        self._inbox = OscInbox(opened)
        self._bundle = RowBundle(served.layout, time() - monotonic())
        self._t = served.layout["t"].start
        self._subscribers = Subscribers()
        self._world_requests = WorldRequests(served)
        self._programs: dict[Sender, _Program] = {}
        self.refused = 0  #: packets and messages that were none of the documented ones, or were not allowed
        self.dropped = 0  #: bundles that the system could not take

    @property
    def sockets(self) -> list[socket.socket]:
        """What to wait for: something may come from each."""
        return self._inbox.sockets

    def close(self) -> None:
        """Close the port."""
        self._inbox.close()

    @property
    def lively(self) -> bool:
        """Whether rows go anywhere."""
        return bool(self._subscribers.current)

    def read_messages(self) -> bool:
        """Do what programs sent since the last call; True if they send more than is read."""
        found, more = self._inbox.take()
        now = monotonic()
        for sender, packets in found.items():
            program = self._find_program(sender, now)
            force: tuple[float, ...] | None = None
            for packet in packets:
                try:
                    messages = read_packet(packet)
                except InputError as cause:
                    self._refuse(program, cause, now)
                    continue
                for address, values in messages:
                    try:
                        force = self._do(program, address, values, now) or force
                    except InputError as cause:
                        self._refuse(program, cause, now)
            if force is not None:
                self._command(program, force, now)
        self._world_requests.tell(now)
        return more

    def _command(self, program: _Program, force: tuple[float, ...], now: float) -> None:
        if not self._served.command(program.session, force):
            held = self._served.holder not in (0, program.session)
            reason = "another program holds the device" if held else "no such force can be rendered"
            self._refuse(program, InputError(reason), now)
        elif not self._served.renders_force:
            self._refuse(program, InputError("the current world does not render clients' forces; choose 'remote'"), now)

    def _do(self, program: _Program, address: str, values: list[Any], now: float) -> tuple[float, ...] | None:
        """Do what a message asks; the force, if it asks for one: of several at once, the last counts."""
        program.count += 1
        if self._token:  # safety: osc-token
            tag = values.pop(0) if values else None
            if not (isinstance(tag, str) and compare_digest(tag.encode("utf-8", "replace"), self._token)):
                self.refused += 1
                return None
        request = parse_request(address, values)
        self._inbox.keep(program.sender)
        match request:
            case CommandForce(force):
                return force
            case Subscribe(port, rate):
                to = (program.sender[0], port or program.sender[1])
                self._subscribers.add(to, rate, now)
                program.answers_to = to
                self._answer(program, make_message("/haptorb/subscribed", rate))
            case Unsubscribe(port):
                self._subscribers.remove((program.sender[0], port or program.sender[1]))
            case AskParameters():
                self._describe_world(program)
            case SetParameter(name, value):
                self._world_requests.set(name, value, now)
            case ChangeWorld(name):
                self._world_requests.change(name, now)
                self._answer(program, make_message("/haptorb/world", name))
        return None

    def _describe_world(self, program: _Program) -> None:
        self._answer(program, make_message("/haptorb/world", self._world_requests.name))
        for parameter, value in self._world_requests.list_parameters():
            self._answer(program, make_parameter_answer(parameter, value))

    def send(self, rows: Array) -> None:
        """Send `rows` (n, width), oldest first, to whom they are due."""
        now = monotonic()
        self._subscribers.expire(now)
        buttons = tuple(self._served.buttons.values())
        for row in rows if self.lively else ():
            data = b""
            for one in self._subscribers.current:
                if one.is_due(float(row[self._t])):
                    data = data or self._bundle.pack(row, buttons)
                    if self._send(data, one.to):
                        one.sent += 1
                    else:
                        one.dropped += 1
                        self.dropped += 1

    def report(self, address: str, seconds: float) -> None:
        """Tell people who is connected, where messages came at which rate since `seconds` [s]; and what was lost."""
        now = monotonic()
        for sender in [one for one, program in self._programs.items() if now - program.last_time > _FORGET]:
            del self._programs[sender]
            self._inbox.release(sender)
        clients = []
        for program in self._programs.values():
            program.rate, program.count = program.count / seconds, 0
            clients.append(
                {
                    "name": f"{program.sender[0]}:{program.sender[1]}",
                    "session": program.session,
                    "rate_hz": round(program.rate, 1),
                    "holds": self._served.holder == program.session,
                }
            )
        inbox = self._inbox
        self._served.report(
            "osc", address, clients, received=inbox.received, refused=self.refused + inbox.refused,
            unread=inbox.overtaken + inbox.lost, not_sent=self.dropped,
        )  # fmt: skip

    def _find_program(self, sender: Sender, now: float) -> _Program:
        found = self._programs.get(sender)
        if found is None:
            if len(self._programs) >= _PROGRAMS:
                oldest = min(self._programs.values(), key=lambda one: one.last_time)
                del self._programs[oldest.sender]
                self._inbox.release(oldest.sender)
            found = self._programs[sender] = _Program(sender, self._served.open_session())
        found.last_time = now
        return found

    def _refuse(self, program: _Program, cause: InputError, now: float) -> None:
        self.refused += 1
        if now >= program.next_error:
            program.next_error = now + _ERRORS
            self._answer(program, make_message("/haptorb/error", str(cause)))

    def _answer(self, program: _Program, data: bytes) -> None:
        self._send(data, program.answers_to)

    def _send(self, data: bytes, to: Sequence[Any]) -> bool:
        with suppress(OSError):  # the buffer is full, or the port closed: never wait
            self._socket.sendto(data, tuple(to))
            return True
        return False
