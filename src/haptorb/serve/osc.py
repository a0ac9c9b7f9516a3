"""Server of `--serve osc:[HOST:]PORT`: rows and commands as OSC messages on one UDP port."""

from __future__ import annotations

import logging
import select
import socket
import struct
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from hmac import compare_digest
from math import isfinite
from time import monotonic, sleep, time
from typing import Any, TypeAlias, final

import numpy as np
from pythonosc.osc_message_builder import OscMessageBuilder

from haptorb.arrays import Array
from haptorb.errors import InputError, UnknownName, quote
from haptorb.recording.row import RowLayout
from haptorb.runtime.shared_memory import BUTTONS
from haptorb.runtime.sockets import DatagramTimes, UdpOwners, is_own_account
from haptorb.runtime.trackers.osc_feed import read_packet
from haptorb.serve.base import (
    KINDS,
    MAX_WAIT_S,
    ServedDevice,
    ServerPreparation,
    check_port,
    open_port,
)
from haptorb.web.access import LOOPBACK, SERVE_TOKEN, choose_serve_token, is_loopback
from haptorb.worlds import CATALOGUE, find_world
from haptorb.worlds.base import Parameter, parameters

__all__ = [
    "DEFAULT_RATE_HZ",
    "FORM",
    "INCOMING",
    "LEASE_TIME_S",
    "MAX_DATAGRAMS",
    "MAX_SUBSCRIBERS",
    "OUTGOING",
    "PORT",
    "REPLIES",
    "AskParameters",
    "ChangeWorld",
    "CommandForce",
    "Incoming",
    "Letter",
    "OscInbox",
    "OscSession",
    "Outgoing",
    "Request",
    "RowBundle",
    "Sender",
    "SetParameter",
    "Subscribe",
    "Subscriber",
    "Subscribers",
    "Unsubscribe",
    "WorldRequests",
    "make_message",
    "make_parameter_answer",
    "pad_text",
    "parse_request",
    "prepare",
    "serve",
]


# --------------------------------------------------------------------------------------------------
# OSC messages that answer a request.


_MAX_TEXT_CHARACTERS = 400  #: longest text in a message [characters]


def make_message(address: str, *values: str | float | int) -> bytes:
    """Encode a message: floats as float32, integers as int32, texts cut to 400 characters.

    >>> make_message("/haptorb/error", "no")
    b'/haptorb/error\\x00\\x00,s\\x00\\x00no\\x00\\x00'
    """
    builder = OscMessageBuilder(address)
    for value in values:
        builder.add_arg(value[:_MAX_TEXT_CHARACTERS] if isinstance(value, str) else value)
    return bytes(builder.build().dgram)


def make_parameter_answer(parameter: Parameter, value: Any) -> bytes:
    """Encode a parameter: name, value or values, low, high and unit, in that order."""
    numbers = value if isinstance(value, tuple) else (value,)
    return make_message(
        "/haptorb/parameter",
        parameter.name, *map(float, numbers), float(parameter.low), float(parameter.high), parameter.unit,
    )  # fmt: skip


# --------------------------------------------------------------------------------------------------
# Reception of datagrams: the newest of each sender, each with its arrival time.
#
# A program that sent one valid message gets a connected socket on the same port: the kernel queues its datagrams there,
# so that a flood from other programs, which fills the shared socket, cannot displace them.


Sender: TypeAlias = tuple[str, int]  #: IP address and port of a program
Letter: TypeAlias = tuple[float, bytes]  #: arrival of a datagram on the monotonic clock [s], and its content

MAX_DATAGRAMS = 32  #: newest datagrams of one sender that are used per poll; older ones are dropped
_MAX_SHARED_READS = 512  #: datagrams read from the shared socket per poll
_MAX_OWN_READS = 64  #: datagrams read from a connected socket per poll
_MAX_SENDERS = 64  #: senders read per poll
_MAX_OWN_SOCKETS = 32  #: programs with a connected socket
_MAX_MESSAGE_BYTES = 1024  #: no valid message is longer [bytes]
_RECEIVE_BUFFER_BYTES = 1 << 18  #: the kernel's buffer between two polls [bytes]
_SO_RXQ_OVFL = 40  #: socket option of Linux: each datagram comes with the number that the kernel dropped
_DROP_COUNT = struct.Struct("@I")
_ANCILLARY_BYTES = DatagramTimes.room + 64  #: for the kernel's ancillary data of a datagram [bytes]


@final
class OscInbox:
    """Non-blocking reader of the UDP socket `opened` and of the connected sockets that it opens on the same port."""

    def __init__(self, opened: socket.socket) -> None:
        self._shared, self._own = opened, dict[Sender, socket.socket]()
        self._lost: dict[socket.socket, int] = {}
        self._lost_closed = 0
        self._times = DatagramTimes()
        _configure_socket(opened)
        self.received = 0  #: datagrams read
        self.overtaken = 0  #: of those, dropped: too many from one sender, or too many senders
        self.refused = 0  #: of those, too long for a valid message

    @property
    def sockets(self) -> list[socket.socket]:
        """All sockets to wait on."""
        return [self._shared, *self._own.values()]

    @property
    def lost(self) -> int:
        """Datagrams that the kernel dropped because they were not read in time."""
        return self._lost_closed + sum(self._lost.values())

    def open_own(self, sender: Sender) -> None:
        """Open a connected socket for `sender`, which sent a valid message, if it has none and there is room."""
        if sender in self._own or len(self._own) >= _MAX_OWN_SOCKETS:
            return
        own = socket.socket(self._shared.family, socket.SOCK_DGRAM)
        try:
            _configure_socket(own, others_are_stamped=True)  # before: the port can be shared for two calls only
            # With SO_REUSEPORT the kernel lets in only sockets of this account, with SO_REUSEADDR those of all. The
            # kernel compares with any one socket of the port: all need the option. It is off again afterwards, so that
            # a program of this account does not take a part of the messages unnoticed.
            for one in (*self.sockets, own):
                one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)  # safety: osc-port-of-account
            own.bind(self._shared.getsockname())
            own.connect(sender)  # until then it may receive messages of others: each is dated and named by its sender
        except OSError:
            own.close()
            return
        finally:
            for one in (*self.sockets, own):
                with suppress(OSError):
                    one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 0)
        self._own[sender] = own

    def release(self, sender: Sender) -> None:
        """Close the connected socket of `sender`, if it has one."""
        if (own := self._own.pop(sender, None)) is not None:
            self._lost_closed += self._lost.pop(own, 0)
            own.close()

    def close(self) -> None:
        """Close the port."""
        for sender in list(self._own):
            self.release(sender)
        self._shared.close()

    def read_newest(self) -> tuple[dict[Sender, list[Letter]], bool]:
        """Read the newest datagrams of each sender, oldest first; and whether more may be queued."""
        found: dict[Sender, list[Letter]] = {}
        more = False
        self._times.begin_batch()
        for own in self._own.values():
            more |= self._read_socket(own, _MAX_OWN_READS, found)
        more |= self._read_socket(self._shared, _MAX_SHARED_READS, found)
        # A program's older messages may still be in the shared socket, or in one that was not connected yet.
        for name, letters in found.items():
            letters.sort(key=_read_arrival)
            self.overtaken += max(len(letters) - MAX_DATAGRAMS, 0)
            found[name] = letters[-MAX_DATAGRAMS:]
        return found, more

    def _read_socket(self, source: socket.socket, most: int, found: dict[Sender, list[Letter]]) -> bool:
        for _ in range(most):
            try:
                data, notes, _, sender = source.recvmsg(_MAX_MESSAGE_BYTES + 1, _ANCILLARY_BYTES)
            except BlockingIOError:
                return False
            except OSError:  # ICMP "port unreachable" after a bundle was sent
                continue
            self.received += 1
            self._count_lost(source, notes)
            if len(data) > _MAX_MESSAGE_BYTES:
                self.refused += 1
                continue
            name: Sender = (sender[0], sender[1])
            if name not in found:
                if len(found) >= _MAX_SENDERS:
                    self.overtaken += 1
                    continue
                found[name] = []
            found[name].append((self._times.find(notes), data))
        return True

    def _count_lost(self, source: socket.socket, notes: list[tuple[int, int, bytes]]) -> None:
        for level, kind, data in notes:
            if level == socket.SOL_SOCKET and kind == _SO_RXQ_OVFL and len(data) >= _DROP_COUNT.size:
                self._lost[source] = max(self._lost.get(source, 0), _DROP_COUNT.unpack(data[: _DROP_COUNT.size])[0])


def _read_arrival(letter: Letter) -> float:
    return letter[0]


def _configure_socket(opened: socket.socket, *, others_are_stamped: bool = False) -> None:
    opened.setblocking(False)
    opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER_BYTES)
    opened.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)
    DatagramTimes.watch(opened, wait=not others_are_stamped)


# --------------------------------------------------------------------------------------------------
# OSC addresses, sent and accepted: one table for server and documentation.
#
# Numbers are sent as float32, counts and codes as int32, because most OSC programs know no other types. Vectors are in
# the stator's frame; quaternions are scalar last.


@final
@dataclass(frozen=True)
class Outgoing:
    """Message of each bundle: elements `first` to `last` of a row's `field`, in `unit`; or the buttons."""

    address: str
    field: str
    values: str  #: names of the values
    unit: str
    about: str
    whole: bool = False  #: whether the values are counts or codes, sent as integers
    first: int = 0
    last: int | None = None


@final
@dataclass(frozen=True)
class Incoming:
    """Message that the server accepts, or a reply."""

    address: str
    values: str
    unit: str
    about: str


#: messages of a bundle, one bundle per tick
OUTGOING = (
    Outgoing("/haptorb/tick", "tick", "n", "1", "number of the tick, modulo 2³¹", whole=True),
    Outgoing("/haptorb/time", "t", "t", "s", "time of the sample since the start"),
    Outgoing("/haptorb/valid", "valid", "v", "1", "1: the pose is valid, 0: it is not", whole=True),
    Outgoing("/haptorb/position", "p", "x y z", "m", "position of the mover"),
    Outgoing("/haptorb/orientation", "q", "x y z w", "1", "orientation of the mover, quaternion"),
    Outgoing("/haptorb/velocity", "v", "x y z", "m/s", "velocity of the mover"),
    Outgoing("/haptorb/angular_velocity", "w", "x y z", "rad/s", "angular velocity of the mover"),
    Outgoing("/haptorb/force", "wrench_model", "x y z", "N", "force of the measured currents on the mover", last=3),
    Outgoing(
        "/haptorb/torque", "wrench_model", "x y z", "N·m", "torque of the measured currents on the mover", first=3
    ),
    Outgoing(
        "/haptorb/force/commanded", "wrench_commanded", "x y z", "N", "force of the worlds, after the guard", last=3
    ),
    Outgoing(
        "/haptorb/torque/commanded",
        "wrench_commanded",
        "x y z",
        "N·m",
        "torque of the worlds, after the guard",
        first=3,
    ),
    # as it was called before 0.2.0
    Outgoing("/haptorb/force/asked", "wrench_commanded", "x y z", "N", "earlier name of force/commanded", last=3),
    Outgoing("/haptorb/torque/asked", "wrench_commanded", "x y z", "N·m", "earlier name of torque/commanded", first=3),
    Outgoing("/haptorb/object/position", "object", "x y z", "m", "position of the object that a motor moves"),
    Outgoing("/haptorb/object/orientation", "object_q", "x y z w", "1", "orientation of the object, quaternion"),
    Outgoing("/haptorb/object/force", "object_wrench", "x y z", "N", "force of the worlds on the object", last=3),
    Outgoing("/haptorb/object/torque", "object_wrench", "x y z", "N·m", "torque of the worlds on the object", first=3),
    Outgoing("/haptorb/buttons", "buttons", "a b c", "1", "1: the button is pressed", whole=True),
    Outgoing("/haptorb/guard", "guard", "n", "1", "0 off, 1 ramping, 2 running, 3 derated, 4 tripped", whole=True),
    Outgoing("/haptorb/trip", "trip", "n", "1", "code of the last trip, 0 for none", whole=True),
)

#: messages that a program may send
INCOMING = (
    Incoming(
        "/haptorb/subscribe",
        "[port] [rate]",
        "1, Hz",
        "Subscribe: send bundles to this port of the sender (default: its own port), at this rate at most (default: "
        "100). Lasts 10 s; renew it every few seconds.",
    ),
    Incoming("/haptorb/unsubscribe", "[port]", "1", "Unsubscribe."),
    Incoming("/haptorb/parameters", "", "", "Request the world and its parameters."),
    Incoming(
        "/haptorb/parameter/NAME",
        "value ...",
        "as `haptorb worlds WORLD` says",
        "Set the parameter NAME of the current world; one number, or three for a direction.",
    ),
    Incoming("/haptorb/world", "NAME", "", "Change the world, with its default parameters."),
    Incoming(
        "/haptorb/force",
        "x y z",
        "N",
        "Force of the world `remote` on the mover, or on a motor's object. It fades out 50 ms after the last message.",
    ),
)

#: replies to the sender of a message, to its own port or to that of its subscription
REPLIES = (
    Incoming("/haptorb/subscribed", "rate", "Hz", "Rate of the bundles."),
    Incoming("/haptorb/world", "NAME", "", "The current world: reply to `/haptorb/parameters` and `/haptorb/world`."),
    Incoming(
        "/haptorb/parameter",
        "NAME value low high unit",
        "as stated",
        "A parameter, its value or values, and its range: reply to `/haptorb/parameters`.",
    ),
    Incoming("/haptorb/error", "text", "", "Why a message was refused. At most ten per second and sender."),
)


# --------------------------------------------------------------------------------------------------
# Parsing of OSC messages into requests; an invalid message is refused with a reason.


DEFAULT_RATE_HZ = 100.0  #: default rate of bundles [Hz]
_MAX_RATE_HZ = 4000.0  #: highest rate of bundles [Hz]
_MAX_NAME_CHARACTERS = 64  #: of a world or parameter [characters]
_PARAMETER_PREFIX = "/haptorb/parameter/"


@final
@dataclass(frozen=True)
class Subscribe:
    """Request: send bundles at `rate` [Hz] to `port` of the sender's computer; 0: the port that it sends from."""

    port: int
    rate: float


@final
@dataclass(frozen=True)
class Unsubscribe:
    """Request: stop bundles to `port`; 0: the port that the sender sends from."""

    port: int


@final
@dataclass(frozen=True)
class AskParameters:
    """Request: reply with the name of the world and its parameters."""


@final
@dataclass(frozen=True)
class SetParameter:
    """Request: set a parameter of the current world, in its own unit, to one number or several."""

    name: str
    value: float | tuple[float, ...]


@final
@dataclass(frozen=True)
class ChangeWorld:
    """Request: change the world, with its default parameters."""

    name: str


@final
@dataclass(frozen=True)
class CommandForce:
    """Request: set the force (3,) of the world `remote` [N], stator frame."""

    force: tuple[float, ...]


Request: TypeAlias = Subscribe | Unsubscribe | AskParameters | SetParameter | ChangeWorld | CommandForce


def parse_request(address: str, values: Sequence[Any]) -> Request:
    """Parse a message. Raises InputError if its address or values are not in `INCOMING`.

    >>> parse_request("/haptorb/force", [0.5, 0, 1])
    CommandForce(force=(0.5, 0.0, 1.0))
    """
    if address.startswith(_PARAMETER_PREFIX):
        return _read_parameter(address, values)
    match address:
        case "/haptorb/force":
            return CommandForce(_read_numbers(address, values, 3))
        case "/haptorb/subscribe":
            return _read_subscription(values)
        case "/haptorb/unsubscribe":
            return Unsubscribe(_read_port(address, values[0] if values else 0))
        case "/haptorb/parameters":
            return AskParameters()
        case "/haptorb/world":
            return ChangeWorld(_read_name(address, values))
    raise UnknownName("OSC address", address[:80], [one.address for one in INCOMING])


def _read_subscription(values: Sequence[Any]) -> Subscribe:
    address = "/haptorb/subscribe"
    if len(values) > 2:
        raise InputError(f"{address} has at most two values, port and rate; got {len(values)}")
    port = _read_port(address, values[0] if values else 0)
    (rate,) = _read_numbers(address, values[1:] or [DEFAULT_RATE_HZ], 1)
    if not 0 < rate <= _MAX_RATE_HZ:
        raise InputError(f"{address}: the rate must be above 0 and at most {_MAX_RATE_HZ:g} Hz; got {rate:g}")
    return Subscribe(port, rate)


def _read_port(address: str, value: Any) -> int:
    (number,) = _read_numbers(address, [value], 1)
    if not number.is_integer() or not 0 <= number <= 65535:
        raise InputError(f"{address}: a port is a whole number from 1 to 65535, or 0; got {number:g}")
    return int(number)


def _read_parameter(address: str, values: Sequence[Any]) -> SetParameter:
    name = address.removeprefix(_PARAMETER_PREFIX)
    if not name.isidentifier() or len(name) > _MAX_NAME_CHARACTERS:
        raise InputError(f"{address[:80]} names no parameter; send {_PARAMETER_PREFIX}NAME with a value")
    numbers = _read_numbers(address, values, None)
    return SetParameter(name, numbers[0] if len(numbers) == 1 else numbers)


def _read_name(address: str, values: Sequence[Any]) -> str:
    if len(values) != 1 or not isinstance(values[0], str) or not 0 < len(values[0]) <= _MAX_NAME_CHARACTERS:
        raise InputError(
            f"{address} has one value, a name of at most {_MAX_NAME_CHARACTERS} characters; got {quote(list(values))}"
        )
    return values[0]


def _read_numbers(address: str, values: Sequence[Any], count: int | None) -> tuple[float, ...]:
    """Check that `values` are finite numbers, `count` of them, or one to three for None."""
    wanted = "one to three" if count is None else str(count)
    many = len(values)
    if not (1 <= many <= 3 if count is None else many == count):
        raise InputError(f"{address} has {wanted} numbers; got {many} values")
    for value in values:
        if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value):  # safety: osc-finite
            raise InputError(f"{address} has {wanted} finite numbers; got {quote(value)}")
    return tuple(float(value) for value in values)


# --------------------------------------------------------------------------------------------------
# A row as an OSC bundle: the messages of `OUTGOING`, stamped with the start time of the tick.


_NTP_EPOCH_OFFSET_S = 2_208_988_800  #: from the epoch of OSC's time tags, 1900, to that of Unix [s]
_FRACTIONS_PER_SECOND = 1 << 32  #: resolution of a time tag
_INT32_MODULUS = 1 << 31  #: counts are sent modulo this


@final
class RowBundle:
    """Encoder of rows of `layout` as OSC bundles; `utc` is added to `wall` of a row to get seconds since 1970 UTC [s].

    Every bundle has the same format, so it is compiled once and a bundle is one call of `struct.pack`.
    """

    def __init__(self, layout: RowLayout, utc: float, messages: Sequence[Outgoing] = OUTGOING) -> None:
        self._utc = utc
        self._wall = layout["wall"].start
        formats, self._parts = [], list[bytes | int | None]()
        places, whole = list[int](), list[bool]()
        for message in messages:
            indices = _find_numbers(layout, message)
            kind = "i" if message.whole else "f"
            head = pad_text(message.address) + pad_text("," + kind * len(indices))
            formats.append(f"i{len(head)}s{kind * len(indices)}")
            self._parts += [len(head) + 4 * len(indices), head, *[None] * len(indices)]
            places += indices
            whole += [message.whole] * len(indices)
        self._format = struct.Struct(">8sII" + "".join(formats))
        self._places = np.array(places)
        self._whole = whole
        self._value_indices = [i for i, part in enumerate(self._parts) if part is None]

    def pack(self, row: Array, buttons: Sequence[bool] = (False,) * len(BUTTONS)) -> bytes:
        """Encode `row` (width,), in the units of its layout, and the pressed `buttons`.

        Unknown counts and codes are −1."""
        filled: list[object] = list(self._parts)
        numbers = np.concatenate([row, buttons])[self._places].tolist()
        for gap, number, whole in zip(self._value_indices, numbers, self._whole, strict=True):
            filled[gap] = _to_integer(number) if whole else _to_single(number)
        moment = row[self._wall] + self._utc + _NTP_EPOCH_OFFSET_S
        seconds = int(moment // 1)
        return self._format.pack(
            b"#bundle\x00", seconds % _FRACTIONS_PER_SECOND, int((moment - seconds) * _FRACTIONS_PER_SECOND), *filled
        )


def _find_numbers(layout: RowLayout, message: Outgoing) -> range:
    """Indices of the values of `message` in a row followed by the buttons."""
    if message.field == "buttons":
        return range(layout.width, layout.width + len(BUTTONS))
    field = layout[message.field]
    return range(field.start, field.stop)[message.first : message.last]


def _to_integer(number: float) -> int:
    return int(number) % _INT32_MODULUS if number == number and number >= 0.0 else -1


def _to_single(number: float) -> float:
    return number if abs(number) < 3e38 else float("nan")  # out of range of a float32: NaN


def pad_text(text: str) -> bytes:
    """Encode `text` as an OSC string: terminated by one to four zero bytes, length a multiple of 4 bytes.

    >>> pad_text("/abc"), pad_text(",ff")
    (b'/abc\\x00\\x00\\x00\\x00', b',ff\\x00')
    """
    data = text.encode("utf-8", "replace")
    return data + bytes(4 - len(data) % 4)


# --------------------------------------------------------------------------------------------------
# Subscriptions: port, rate and expiry.


LEASE_TIME_S = 10.0  #: lifetime of a subscription; a new request renews it [s]
MAX_SUBSCRIBERS = 16  #: subscribers at most


@final
@dataclass
class Subscriber:
    """Subscription of a port, at `rate` [Hz]: next bundle at `due` on the loop's clock, expiry `until` on the monotonic
    clock [s].

    any_account  whether the port may belong to another account: its program sent the token
    """

    to: Sender
    rate: float
    until: float
    any_account: bool = False
    due: float = float("-inf")
    sent: int = 0
    dropped: int = 0  #: bundles that were not sent because the socket's buffer was full

    def is_due(self, t: float) -> bool:
        """Whether the row of time `t` [s] is due; if so, schedule the next one, evenly spaced at `rate`."""
        if t < self.due - 1e-6:
            return False
        gap = 1.0 / self.rate
        # From `due`, not from the later `t`, which would lower the rate; after a gap there is no catch-up.
        self.due = (self.due if t - self.due < gap else t) + gap
        return True


@final
class Subscribers:
    """The current subscriptions, at most `MAX_SUBSCRIBERS`."""

    def __init__(self) -> None:
        self._known: dict[Sender, Subscriber] = {}

    @property
    def current(self) -> list[Subscriber]:
        """All subscriptions, oldest first."""
        return list(self._known.values())

    def add(self, to: Sender, rate: float, now: float, *, any_account: bool = False) -> Subscriber:
        """Add or renew the subscription of `to` at `rate` [Hz]. Raises InputError if there are too many."""
        known = self._known.get(to)
        if known is None:
            if len(self._known) >= MAX_SUBSCRIBERS:
                raise InputError(f"at most {MAX_SUBSCRIBERS} programs can subscribe at a time: end one of them")
            known = self._known[to] = Subscriber(to, rate, now + LEASE_TIME_S)
        elif known.rate != rate:
            known.rate, known.due = rate, float("-inf")
        known.until, known.any_account = now + LEASE_TIME_S, any_account
        return known

    def remove(self, to: Sender) -> None:
        """Remove the subscription of `to`, if it has one."""
        self._known.pop(to, None)

    def expire(self, now: float) -> None:
        """Remove the subscriptions that were not renewed."""
        for one in self.current:
            if one.until < now:
                self.remove(one.to)


# --------------------------------------------------------------------------------------------------
# Requests for a world and its parameters: checked as the console checks them, and sent together.
#
# A fader sends a hundred values a second. The newest of each parameter is requested, at most twenty times a second.


_REQUEST_INTERVAL_S = 0.05  #: between two requests [s]
_REQUEST_TIMEOUT_S = 2.0  #: a request that was not applied by then is dropped [s]

Value: TypeAlias = float | tuple[float, ...]


@final
class WorldRequests:
    """Pending request for the world of `served` and its parameters."""

    def __init__(self, served: ServedDevice) -> None:
        self._served = served
        self._name, self._values = "", dict[str, Value]()
        self._sent: object = None
        self._next, self._until = 0.0, 0.0

    @property
    def name(self) -> str:
        """Name of the requested world while a request is pending, else of the current one."""
        return self._name or str(self._served.world.get("name", ""))

    def list_parameters(self) -> list[tuple[Parameter, Value]]:
        """Parameters of the current world with their values, in their own units."""
        world = self._served.world
        known = CATALOGUE.get(world.get("name", ""))
        values = world.get("values", {})
        if known is None:  # a user's world: only the loop's process knows the ranges
            return [(_describe_user_parameter(name, value), _to_value(value)) for name, value in values.items()]
        return [(one, _to_value(values.get(name, one.default))) for name, one in parameters(known).items()]

    def set(self, name: str, value: Value, now: float) -> None:
        """Request `value` for the parameter `name`, in its own unit. Raises UnknownName or InputError if invalid."""
        world = self.name
        if world in CATALOGUE:
            find_world(world)().replace(**{name: value}).for_device(self._served.device)
        else:
            known = self._served.world.get("values", {})
            if name not in known:
                raise UnknownName(f"parameter of world '{world}'", name, known)
            if isinstance(value, tuple) is not isinstance(known[name], list):
                raise InputError(f"parameter {name} has another number of values; got {quote(value)}")
        self._name = world
        self._values[name] = value
        self._until = now + _REQUEST_TIMEOUT_S

    def change(self, name: str, now: float) -> None:
        """Request the world `name` with its default values.

        Raises UnknownName or InputError if there is none, or none for this device."""
        if name != self._served.world.get("name"):
            find_world(name)().for_device(self._served.device)
        self._name, self._values, self._until = name, {}, now + _REQUEST_TIMEOUT_S

    def send_due(self, now: float) -> None:
        """Send the pending request if it is due; drop it once it is applied or has timed out."""
        if not self._name or now < self._next:
            return
        if now > self._until or self._is_applied():
            self._name, self._values, self._sent = "", {}, None
            return
        request = (self._name, dict(self._values))
        if request != self._sent:
            self._served.request_world(*request)
            self._sent, self._next = request, now + _REQUEST_INTERVAL_S

    def _is_applied(self) -> bool:
        world = self._served.world
        values: Mapping[str, Any] = world.get("values", {})
        return world.get("name") == self._name and all(
            _to_value(values.get(name)) == value for name, value in self._values.items()
        )


def _to_value(value: Any) -> Value:
    return tuple(value) if isinstance(value, list) else value


def _describe_user_parameter(name: str, value: Any) -> Parameter:
    return Parameter(name, "", float("-inf"), float("inf"), "", _to_value(value))


# --------------------------------------------------------------------------------------------------
# The OSC clients of a run: executes, refuses or counts their messages, and sends rows to subscribers.


_ERROR_INTERVAL_S = 0.1  #: between two error replies to one program [s]
_MAX_PROGRAMS = 64  #: programs; another one replaces the one that was silent for longest, never the holder
_CLOCK_TOLERANCE_S = 1e-4  #: error of the difference of two arrival times of different polls [s]
_PROGRAM_TIMEOUT_S = 30.0  #: a program that sent nothing for this long is no longer listed [s]


@final
class _Program:
    def __init__(self, sender: Sender, session: int) -> None:
        self.sender, self.session = sender, session
        self.answers_to = sender
        self.last_time = 0.0
        self.count, self.rate = 0, 0.0
        self.next_error = 0.0
        self.newest_force = float("-inf")  # arrival of the newest force


@final
class OscSession:
    """OSC server of the device `served` on `opened`, a UDP socket.

    token   first value of every message from another account; empty: only this account may send
    beyond  whether other computers reach the socket: then every message needs the token
    """

    def __init__(self, opened: socket.socket, served: ServedDevice, token: str = "", *, beyond: bool = False) -> None:
        self._socket, self._served, self._token, self._beyond = opened, served, token.encode(), beyond
        self._inbox = OscInbox(opened)
        self._bundle = RowBundle(served.layout, time() - monotonic())
        self._t = served.layout["t"].start
        self._subscribers = Subscribers()
        self._world_requests = WorldRequests(served)
        self._programs: dict[Sender, _Program] = {}
        self.refused = 0  #: packets and messages that were invalid or not authorized
        self.dropped = 0  #: bundles that were not sent because the socket's buffer was full
        self._next_account_error = 0.0

    @property
    def sockets(self) -> list[socket.socket]:
        """All sockets to wait on."""
        return self._inbox.sockets

    def close(self) -> None:
        """Close the port."""
        self._inbox.close()

    @property
    def has_subscribers(self) -> bool:
        """Whether there is a subscription."""
        return bool(self._subscribers.current)

    def read_messages(self) -> bool:
        """Execute the messages received since the last call; True if more may be queued."""
        found, more = self._inbox.read_newest()
        now = monotonic()
        owners = None if self._beyond or not found else UdpOwners()
        for sender, letters in found.items():
            own = owners is not None and is_own_account(owners.find(*sender))
            if not own and not self._token:  # safety: osc-account
                self._refuse_account(sender, len(letters), now)
                continue
            program = self._find_program(sender, now) if own else self._programs.get(sender)
            force: tuple[float, ...] | None = None
            since = now
            for arrival, packet in letters:
                try:
                    messages = read_packet(packet)
                except InputError as cause:
                    self._refuse(program, cause, now)
                    continue
                for address, values in messages:
                    authorized = self._has_token(values)
                    if not (authorized or own):  # safety: osc-token
                        self.refused += 1
                        continue
                    program = program or self._find_program(sender, now)
                    try:
                        asked = self._execute(program, address, values, arrival, now, authorized=authorized)
                        force, since = (force, since) if asked is None else (asked, arrival)
                    except InputError as cause:
                        self._refuse(program, cause, now)
            if force is not None and program is not None:
                if since < program.newest_force - _CLOCK_TOLERANCE_S:  # it was read late, from the shared socket
                    self._inbox.overtaken += 1
                    continue
                program.newest_force = since
                self._command(program, force, since, now)
        self._world_requests.send_due(now)
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

    def _execute(
        self, program: _Program, address: str, values: list[Any], arrival: float, now: float, *, authorized: bool
    ) -> tuple[float, ...] | None:
        """Execute a message, except a force, which is returned: of several in one poll, the last counts.

        authorized: it begins with the token."""
        program.count += 1
        if authorized:
            del values[0]
        request = parse_request(address, values)
        self._inbox.open_own(program.sender)
        late = now - arrival > MAX_WAIT_S  # safety: late-requests
        match request:
            case CommandForce(force):
                return force
            case Subscribe(port, rate):
                to = (program.sender[0], port or program.sender[1])
                if not authorized and is_loopback(to[0]) and not is_own_account(UdpOwners().find(*to)):
                    raise InputError(
                        f"port {to[1]} is not open, belongs to another account, or may be bound by other programs, too "
                        f"(SO_REUSEADDR): open it for this program alone, or send the token {SERVE_TOKEN}"
                    )
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
        """Send `rows` (n, width), oldest first, to the subscribers for which they are due."""
        now = monotonic()
        self._subscribers.expire(now)
        buttons = tuple(self._served.buttons.values())
        owners: UdpOwners | None = None
        for row in rows if self.has_subscribers else ():
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
        """Publish the connected programs, their message rates over the last `seconds` [s], and the loss counts."""
        now = monotonic()
        for sender in [one for one, program in self._programs.items() if now - program.last_time > _PROGRAM_TIMEOUT_S]:
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
        """Find or list the program of `sender`, which may use this server: others would replace those that may."""
        found = self._programs.get(sender)
        if found is None:
            if len(self._programs) >= _MAX_PROGRAMS:
                holder = self._served.holder
                others = [one for one in self._programs.values() if one.session != holder]  # safety: osc-holder-stays
                oldest = min(others, key=lambda one: one.last_time)
                del self._programs[oldest.sender]
                self._inbox.release(oldest.sender)
            found = self._programs[sender] = _Program(sender, self._served.open_session())
        found.last_time = now
        return found

    def _refuse_account(self, sender: Sender, count: int, now: float) -> None:
        """Refuse `count` packets of another account, with an error reply at most ten times a second in total."""
        self.refused += count
        if now >= self._next_account_error:
            self._next_account_error = now + _ERROR_INTERVAL_S
            text = (
                "this server is for programs of the account that runs the servo, from a port that no other program may "
                f"bind (SO_REUSEADDR); others need {SERVE_TOKEN}"
            )
            self._send(make_message("/haptorb/error", text), sender)

    def _refuse(self, program: _Program | None, cause: InputError, now: float) -> None:
        """Count a refusal, and reply to `program`. One without the token gets no reply: its address may be forged."""
        self.refused += 1
        if program is not None and now >= program.next_error:
            program.next_error = now + _ERROR_INTERVAL_S
            self._answer(program, make_message("/haptorb/error", str(cause)))

    def _answer(self, program: _Program, data: bytes) -> None:
        self._send(data, program.answers_to)

    def _send(self, data: bytes, to: Sequence[Any]) -> bool:
        with suppress(OSError):  # the buffer is full, or the port is closed; do not block
            self._socket.sendto(data, tuple(to))
            return True
        return False


FORM = KINDS["osc"].form
PORT = 9000  #: default port

_ACTIVE_POLL_INTERVAL_S = 0.002  #: polling interval of the rows with subscribers [s]
_IDLE_POLL_INTERVAL_S = 0.05  #: and without [s]
_FLOOD_PAUSE_S = 0.004  #: pause after a poll that did not read all queued datagrams [s]
_REPORT_INTERVAL_S = 0.25  #: between two reports [s]


def prepare(where: str) -> ServerPreparation:
    """Parse [HOST:]PORT and open the port. Raises InputError if it is not available."""
    host, _, port = where.rpartition(":")
    host = host.strip("[]") or LOOPBACK
    number = check_port(port, FORM) if where else PORT
    token = choose_serve_token(host)
    try:
        opened = open_port(number, f"--serve {FORM}", host=host, datagrams=True)
    except UnicodeError as cause:
        raise InputError(f"--serve {FORM}: '{host}' is no address of this computer") from cause
    bound = opened.getsockname()[1]
    address = f"[{host}]:{bound}" if ":" in host else f"{host}:{bound}"
    beyond = not is_loopback(host)
    remarks = (f"OSC messages to {address} must begin with this token: {token}",) if beyond else ()
    return ServerPreparation(
        {"address": address, "token": token, "beyond": beyond}, f"osc.udp://{address}", [opened.detach()], remarks
    )


def serve(spec: dict[str, Any], descriptors: list[int], served: ServedDevice) -> None:
    """Serve until `served.over`; `spec` and `descriptors` are those of `prepare`."""
    logging.disable(logging.WARNING)  # python-osc logs each invalid packet, and any program may send some
    opened = socket.socket(fileno=descriptors[0])
    session = OscSession(opened, served, spec["token"], beyond=spec["beyond"])
    last = monotonic()
    while not served.over:
        select.select(
            session.sockets, [], [], _ACTIVE_POLL_INTERVAL_S if session.has_subscribers else _IDLE_POLL_INTERVAL_S
        )
        flooded = session.read_messages()
        session.send(served.read_rows())
        now = monotonic()
        if now - last >= _REPORT_INTERVAL_S:
            session.report(spec["address"], now - last)
            last = now
        if flooded:  # leave processor time to the loop
            sleep(_FLOOD_PAUSE_S)
    session.report(spec["address"], max(monotonic() - last, 1e-3))
    session.close()
