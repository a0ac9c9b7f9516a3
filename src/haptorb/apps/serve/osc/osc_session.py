"""One run's programs that speak OSC: what they send is done, refused or counted, and rows go to who subscribed."""

from __future__ import annotations

import socket
from collections.abc import Sequence
from contextlib import suppress
from hmac import compare_digest
from time import monotonic, time
from typing import Any, final

from haptorb.apps.serve.access import TOKEN
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
from haptorb.apps.serve.ports import is_loopback
from haptorb.apps.serve.served_device import LATE, ServedDevice
from haptorb.errors import InputError
from haptorb.numerics.arrays import Array
from haptorb.runtime.realtime.socket_owner import UdpOwners, is_own_account
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
        self.own = False  # whether a program of this account sends from there


@final
class OscSession:
    """Serves the rows and the force of `served` through `opened`, a UDP socket.

    token   first value of every message of who is not of this account; empty: nobody else may send any
    beyond  other computers reach the socket: every message needs the token
    """

    def __init__(self, opened: socket.socket, served: ServedDevice, token: str = "", *, beyond: bool = False) -> None:
        self._socket, self._served, self._token, self._beyond = opened, served, token.encode(), beyond
        self._inbox = OscInbox(opened)
        self._bundle = RowBundle(served.layout, time() - monotonic())
        self._t = served.layout["t"].start
        self._subscribers = Subscribers()
        self._world_requests = WorldRequests(served)
        self._programs: dict[Sender, _Program] = {}
        self.refused = 0  #: packets and messages that were none of the documented ones, or were not allowed
        self.dropped = 0  #: bundles that the system could not take
        self._next_account_error = 0.0

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
        owners = None if self._beyond or not found else UdpOwners()
        for sender, letters in found.items():
            own = owners is not None and is_own_account(owners.find(*sender))
            if not own and not self._token:  # safety: osc-account
                self._refuse_account(sender, len(letters), now)
                continue
            program = self._find_program(sender, now)
            program.own = own
            force: tuple[float, ...] | None = None
            since = now
            for arrival, packet in letters:
                try:
                    messages = read_packet(packet)
                except InputError as cause:
                    self._refuse(program, cause, now)
                    continue
                for address, values in messages:
                    try:
                        asked = self._do(program, address, values, arrival, now)
                        force, since = (force, since) if asked is None else (asked, arrival)
                    except InputError as cause:
                        self._refuse(program, cause, now)
            if force is not None:
                self._command(program, force, since, now)
        self._world_requests.tell(now)
        return more

    def _command(self, program: _Program, force: tuple[float, ...], since: float, now: float) -> None:
        stale = self._served.stale
        if not self._served.command(program.session, force, arrival=since):
            held = self._served.holder not in (0, program.session)
            reason = "another program holds the device" if held else "no such force can be rendered"
            if self._served.stale > stale:
                reason = f"the force had waited for {1e3 * (now - since):.0f} ms while the server did not read"
            self._refuse(program, InputError(reason), now)
        elif not self._served.renders_force:
            self._refuse(program, InputError("the current world does not render clients' forces; choose 'remote'"), now)

    def _do(
        self, program: _Program, address: str, values: list[Any], arrival: float, now: float
    ) -> tuple[float, ...] | None:
        """Do what a message asks; the force, if it asks for one: of several at once, the last counts."""
        program.count += 1
        authorized = self._has_token(values)
        if not (authorized or program.own):  # safety: osc-token
            self.refused += 1
            return None
        if authorized:
            del values[0]
        request = parse_request(address, values)
        self._inbox.keep(program.sender)
        late = now - arrival > LATE  # safety: late-requests
        match request:
            case CommandForce(force):
                return force
            case Subscribe(port, rate):
                to = (program.sender[0], port or program.sender[1])
                self._subscribers.add(to, rate, now, any_account=authorized)
                program.answers_to = to
                self._answer(program, make_message("/haptorb/subscribed", rate))
            case Unsubscribe(port):
                self._subscribers.remove((program.sender[0], port or program.sender[1]))
            case AskParameters():
                self._describe_world(program)
            case SetParameter() | ChangeWorld() if late:
                raise InputError(f"{address} had waited for {now - arrival:.1f} s while the server did not read")
            case SetParameter(name, value):
                self._world_requests.set(name, value, now)
            case ChangeWorld(name):
                self._world_requests.change(name, now)
                self._answer(program, make_message("/haptorb/world", name))
        return None

    def _has_token(self, values: list[Any]) -> bool:
        tag = values[0] if values and self._token else None
        return isinstance(tag, str) and compare_digest(tag.encode("utf-8", "replace"), self._token)

    def _describe_world(self, program: _Program) -> None:
        self._answer(program, make_message("/haptorb/world", self._world_requests.name))
        for parameter, value in self._world_requests.list_parameters():
            self._answer(program, make_parameter_answer(parameter, value))

    def send(self, rows: Array) -> None:
        """Send `rows` (n, width), oldest first, to whom they are due."""
        now = monotonic()
        self._subscribers.expire(now)
        buttons = tuple(self._served.buttons.values())
        owners: UdpOwners | None = None
        for row in rows if self.lively else ():
            data = b""
            for one in self._subscribers.current:
                if one.is_due(float(row[self._t])):
                    if not one.any_account and is_loopback(one.to[0]):
                        owners = owners or UdpOwners()
                        if not is_own_account(owners.find(*one.to)):  # safety: osc-reader-account
                            self._subscribers.remove(one.to)
                            continue
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

    def _refuse_account(self, sender: Sender, count: int, now: float) -> None:
        """Who is not of this account learns why, at most ten times a second in all."""
        self.refused += count
        if now >= self._next_account_error:
            self._next_account_error = now + _ERRORS
            text = f"this server is for programs of the account that runs the servo; others need {TOKEN}"
            self._send(make_message("/haptorb/error", text), sender)

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
