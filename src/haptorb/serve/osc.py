"""`--serve osc:[HOST:]PORT`: one UDP port for what goes out and what comes in."""

from __future__ import annotations

import logging
import select
import socket
import struct
from collections import deque
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
from haptorb.runtime.trackers.osc import read_packet
from haptorb.serve.base import (
    KINDS,
    LATE,
    LOOPBACK,
    TOKEN,
    ServedDevice,
    ServerPreparation,
    check_port,
    choose_serve_token,
    is_loopback,
    open_port,
)
from haptorb.worlds import CATALOGUE, find_world
from haptorb.worlds.base import Parameter, parameters

__all__ = [
    "FORM",
    "INCOMING",
    "LEASE",
    "MOST",
    "NEWEST",
    "OUTGOING",
    "PORT",
    "RATE",
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
# OSC messages that go back to the program that sent one.


_MAX_TEXT_CHARACTERS = 400  #: characters of a text


def make_message(address: str, *values: str | float | int) -> bytes:
    """The message of `values`: numbers as float32, whole numbers as int32, texts cut to 400 characters.

    >>> make_message("/haptorb/error", "no")
    b'/haptorb/error\\x00\\x00,s\\x00\\x00no\\x00\\x00'
    """
    builder = OscMessageBuilder(address)
    for value in values:
        builder.add_arg(value[:_MAX_TEXT_CHARACTERS] if isinstance(value, str) else value)
    return bytes(builder.build().dgram)


def make_parameter_answer(parameter: Parameter, value: Any) -> bytes:
    """Name, value or values, low, high and unit of a parameter, in that order."""
    numbers = value if isinstance(value, tuple) else (value,)
    return make_message(
        "/haptorb/parameter",
        parameter.name, *map(float, numbers), float(parameter.low), float(parameter.high), parameter.unit,
    )  # fmt: skip


# --------------------------------------------------------------------------------------------------
# The datagrams that came since the last look: the newest of each sender, each with the time at which it came.
#
# A program that was understood once gets a socket of its own on the same port: the system puts its datagrams there, and
# a flood of others, which fills the socket that all share, no longer pushes them out.


Sender: TypeAlias = tuple[str, int]  #: address and port of a program
Letter: TypeAlias = tuple[float, bytes]  #: when a datagram came, on the monotonic clock [s], and what it says

NEWEST = 32  #: datagrams of one sender that count in one look; older ones are overtaken
_AT_ONCE = 512  #: datagrams taken from the shared socket in one look
_OWN_AT_ONCE = 64  #: and from a program's own
_SENDERS = 64  #: that are read in one look
_OWN = 32  #: programs with a socket of their own
_MAX_MESSAGE_BYTES = 1024  #: no message that is understood is longer [bytes]
_BUFFER = 1 << 18  #: what the system keeps of them until the next look [bytes]
_OVERFLOW = 40  #: SO_RXQ_OVFL of Linux: each datagram comes with the count of those that the system dropped
_COUNT = struct.Struct("@I")
_NOTES = DatagramTimes.room + 64  #: bytes for the kernel's notes with a datagram


@final
class OscInbox:
    """Reads `opened`, a UDP socket, and those that it opens beside it, without ever waiting."""

    def __init__(self, opened: socket.socket) -> None:
        self._shared, self._own = opened, dict[Sender, socket.socket]()
        self._lost: dict[socket.socket, int] = {}
        self._gone = 0
        self._times = DatagramTimes()
        _prepare(opened)
        self.received = 0  #: datagrams taken from the system
        self.overtaken = 0  #: of those, not read: too many came from one sender, or from too many senders
        self.refused = 0  #: of those, too long for a message that is understood

    @property
    def sockets(self) -> list[socket.socket]:
        """All that something may come from, to wait for."""
        return [self._shared, *self._own.values()]

    @property
    def lost(self) -> int:
        """Datagrams that the system dropped because they came faster than they were taken."""
        return self._gone + sum(self._lost.values())

    def keep(self, sender: Sender) -> None:
        """Give `sender`, which was understood, a socket of its own, if it has none and there is room."""
        if sender in self._own or len(self._own) >= _OWN:
            return
        own = socket.socket(self._shared.family, socket.SOCK_DGRAM)
        try:
            # Shared for this moment only: else another program of this computer could take the port, too.
            for one in (self._shared, own):
                one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            own.bind(self._shared.getsockname())
            own.connect(sender)
            _prepare(own)
        except OSError:
            own.close()
            return
        finally:
            with suppress(OSError):
                self._shared.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 0)
        own.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 0)
        self._own[sender] = own

    def release(self, sender: Sender) -> None:
        """`sender` is not connected any more."""
        if (own := self._own.pop(sender, None)) is not None:
            self._gone += self._lost.pop(own, 0)
            own.close()

    def close(self) -> None:
        """Close the port."""
        for sender in list(self._own):
            self.release(sender)
        self._shared.close()

    def take(self) -> tuple[dict[Sender, deque[Letter]], bool]:
        """The newest datagrams of each sender, oldest first; and whether so many came that others may wait."""
        found: dict[Sender, deque[Letter]] = {}
        more = False
        self._times.look()
        for own in self._own.values():
            more |= self._take_from(own, _OWN_AT_ONCE, found)
        more |= self._take_from(self._shared, _AT_ONCE, found)
        return found, more

    def _take_from(self, source: socket.socket, most: int, found: dict[Sender, deque[Letter]]) -> bool:
        for _ in range(most):
            try:
                data, notes, _, sender = source.recvmsg(_MAX_MESSAGE_BYTES + 1, _NOTES)
            except BlockingIOError:
                return False
            except OSError:  # "port unreachable" in reply to a bundle
                continue
            self.received += 1
            self._note_lost(source, notes)
            if len(data) > _MAX_MESSAGE_BYTES:
                self.refused += 1
                continue
            name: Sender = (sender[0], sender[1])
            if name not in found:
                if len(found) >= _SENDERS:
                    self.overtaken += 1
                    continue
                found[name] = deque(maxlen=NEWEST)
            self.overtaken += len(found[name]) == NEWEST
            found[name].append((self._times.find(notes), data))
        return True

    def _note_lost(self, source: socket.socket, notes: list[tuple[int, int, bytes]]) -> None:
        for level, kind, data in notes:
            if level == socket.SOL_SOCKET and kind == _OVERFLOW and len(data) >= _COUNT.size:
                self._lost[source] = max(self._lost.get(source, 0), _COUNT.unpack(data[: _COUNT.size])[0])


def _prepare(opened: socket.socket) -> None:
    opened.setblocking(False)
    opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
    opened.setsockopt(socket.SOL_SOCKET, _OVERFLOW, 1)
    DatagramTimes.watch(opened)


# --------------------------------------------------------------------------------------------------
# The OSC addresses that are sent and understood: one table for server and documentation.
#
# Numbers go out as float32, counts and codes as int32, for most OSC programs know no other numbers. Vectors are in the
# stator's frame; quaternions are scalar last.


@final
@dataclass(frozen=True)
class Outgoing:
    """A message of each bundle: the numbers `first` to `last` of a row's `field`, in `unit`; or the buttons."""

    address: str
    field: str
    values: str  #: names of the values
    unit: str
    about: str
    whole: bool = False  #: whether they are counts or codes, sent as integers
    first: int = 0
    last: int | None = None


@final
@dataclass(frozen=True)
class Incoming:
    """A message that the server understands."""

    address: str
    values: str
    unit: str
    about: str


#: the messages of a bundle, one bundle for a tick
OUTGOING = (
    Outgoing("/haptorb/tick", "tick", "n", "1", "number of the tick, modulo 2³¹", whole=True),
    Outgoing("/haptorb/time", "t", "t", "s", "time of the sample since the start"),
    Outgoing("/haptorb/valid", "valid", "v", "1", "1: the pose is valid, 0: it is not", whole=True),
    Outgoing("/haptorb/position", "p", "x y z", "m", "position of the mover"),
    Outgoing("/haptorb/orientation", "q", "x y z w", "1", "orientation of the mover, quaternion"),
    Outgoing("/haptorb/velocity", "v", "x y z", "m/s", "velocity of the mover"),
    Outgoing("/haptorb/angular_velocity", "w", "x y z", "rad/s", "angular velocity of the mover"),
    Outgoing("/haptorb/force", "modelled", "x y z", "N", "force of the measured currents on the mover", last=3),
    Outgoing("/haptorb/torque", "modelled", "x y z", "N·m", "torque of the measured currents on the mover", first=3),
    Outgoing("/haptorb/force/asked", "asked", "x y z", "N", "force asked by the worlds, after the guard", last=3),
    Outgoing("/haptorb/torque/asked", "asked", "x y z", "N·m", "torque asked by the worlds, after the guard", first=3),
    Outgoing("/haptorb/object/position", "object", "x y z", "m", "position of the object, a motor's target"),
    Outgoing("/haptorb/object/orientation", "object_q", "x y z w", "1", "orientation of the object, quaternion"),
    Outgoing("/haptorb/object/force", "object_wrench", "x y z", "N", "force of the worlds on the object", last=3),
    Outgoing("/haptorb/object/torque", "object_wrench", "x y z", "N·m", "torque of the worlds on the object", first=3),
    Outgoing("/haptorb/buttons", "buttons", "a b c", "1", "1: the button is pressed", whole=True),
    Outgoing("/haptorb/guard", "guard", "n", "1", "0 off, 1 ramping, 2 running, 3 derated, 4 tripped", whole=True),
    Outgoing("/haptorb/trip", "trip", "n", "1", "code of the last trip, 0 for none", whole=True),
)

#: what a program may send
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
        "Force of the world `remote` on the mover, or on a motor's target. It fades out 50 ms after the last message.",
    ),
)

#: what goes back to the sender of a message, to its own port or to that of its subscription
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
# What a program asks by an OSC message: understood, or refused with a reason.


RATE = 100.0  #: bundles a second, unless a program asks for others [Hz]
_FASTEST = 4000.0  #: [Hz]
_NAME = 64  #: of a world or parameter [characters]
_PARAMETER = "/haptorb/parameter/"


@final
@dataclass(frozen=True)
class Subscribe:
    """Bundles, `rate` a second [Hz], to `port` of the sender's computer; 0: the port that it sends from."""

    port: int
    rate: float


@final
@dataclass(frozen=True)
class Unsubscribe:
    """No more bundles to `port`; 0: the port that the sender sends from."""

    port: int


@final
@dataclass(frozen=True)
class AskParameters:
    """The name of the world and its parameters."""


@final
@dataclass(frozen=True)
class SetParameter:
    """Another value of a parameter of the present world, in its own unit: one number, or several."""

    name: str
    value: float | tuple[float, ...]


@final
@dataclass(frozen=True)
class ChangeWorld:
    """Another world, with its default parameters."""

    name: str


@final
@dataclass(frozen=True)
class CommandForce:
    """The force (3,) of the world `remote` [N], stator frame."""

    force: tuple[float, ...]


Request: TypeAlias = Subscribe | Unsubscribe | AskParameters | SetParameter | ChangeWorld | CommandForce


def parse_request(address: str, values: Sequence[Any]) -> Request:
    """What a message asks. Raises InputError if its address or values are none of `addresses.INCOMING`.

    >>> parse_request("/haptorb/force", [0.5, 0, 1])
    CommandForce(force=(0.5, 0.0, 1.0))
    """
    if address.startswith(_PARAMETER):
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
    (rate,) = _read_numbers(address, values[1:] or [RATE], 1)
    if not 0 < rate <= _FASTEST:
        raise InputError(f"{address}: the rate must be above 0 and at most {_FASTEST:g} Hz; got {rate:g}")
    return Subscribe(port, rate)


def _read_port(address: str, value: Any) -> int:
    (number,) = _read_numbers(address, [value], 1)
    if not number.is_integer() or not 0 <= number <= 65535:
        raise InputError(f"{address}: a port is a whole number from 1 to 65535, or 0; got {number:g}")
    return int(number)


def _read_parameter(address: str, values: Sequence[Any]) -> SetParameter:
    name = address.removeprefix(_PARAMETER)
    if not name.isidentifier() or len(name) > _NAME:
        raise InputError(f"{address[:80]} names no parameter; send {_PARAMETER}NAME with a value")
    numbers = _read_numbers(address, values, None)
    return SetParameter(name, numbers[0] if len(numbers) == 1 else numbers)


def _read_name(address: str, values: Sequence[Any]) -> str:
    if len(values) != 1 or not isinstance(values[0], str) or not 0 < len(values[0]) <= _NAME:
        raise InputError(f"{address} has one value, a name of at most {_NAME} characters; got {quote(list(values))}")
    return values[0]


def _read_numbers(address: str, values: Sequence[Any], count: int | None) -> tuple[float, ...]:
    """`values` as finite numbers, `count` of them, or one to three."""
    wanted = "one to three" if count is None else str(count)
    many = len(values)
    if not (1 <= many <= 3 if count is None else many == count):
        raise InputError(f"{address} has {wanted} numbers; got {many} values")
    for value in values:
        if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value):  # safety: osc-finite
            raise InputError(f"{address} has {wanted} finite numbers; got {quote(value)}")
    return tuple(float(value) for value in values)


# --------------------------------------------------------------------------------------------------
# A row as an OSC bundle: the messages of `addresses.OUTGOING`, stamped with the time at which the tick began.


_SINCE_1900 = 2_208_988_800  #: seconds from the epoch of OSC's time tags to that of Unix
_FRACTIONS = 1 << 32  #: of a second, in a time tag
_INTEGERS = 1 << 31


@final
class RowBundle:
    """Packs rows of `layout`; `utc` leads from their clock `wall` to seconds since 1970 [s].

    Every bundle has the same form, so the form is made once and a bundle is one call of `struct.pack`.
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
        self._form = struct.Struct(">8sII" + "".join(formats))
        self._places = np.array(places)
        self._whole = whole
        self._gaps = [i for i, part in enumerate(self._parts) if part is None]

    def pack(self, row: Array, buttons: Sequence[bool] = (False,) * len(BUTTONS)) -> bytes:
        """The bundle of `row` (width,), in the units of its layout, with the `buttons` that are held down. A count or
        code that is not known is −1."""
        filled: list[object] = list(self._parts)
        numbers = np.concatenate([row, buttons])[self._places].tolist()
        for gap, number, whole in zip(self._gaps, numbers, self._whole, strict=True):
            filled[gap] = _to_integer(number) if whole else _to_single(number)
        moment = row[self._wall] + self._utc + _SINCE_1900
        seconds = int(moment // 1)
        return self._form.pack(b"#bundle\x00", seconds % _FRACTIONS, int((moment - seconds) * _FRACTIONS), *filled)


def _find_numbers(layout: RowLayout, message: Outgoing) -> range:
    """Where the numbers of `message` lie in a row, behind which the buttons stand."""
    if message.field == "buttons":
        return range(layout.width, layout.width + len(BUTTONS))
    field = layout[message.field]
    return range(field.start, field.stop)[message.first : message.last]


def _to_integer(number: float) -> int:
    return int(number) % _INTEGERS if number == number and number >= 0.0 else -1


def _to_single(number: float) -> float:
    return number if abs(number) < 3e38 else float("nan")  # what a float32 cannot hold is no number


def pad_text(text: str) -> bytes:
    """`text` as OSC has it: ended by one to four zeros, so that its length is a multiple of 4 bytes.

    >>> pad_text("/abc"), pad_text(",ff")
    (b'/abc\\x00\\x00\\x00\\x00', b',ff\\x00')
    """
    data = text.encode("utf-8", "replace")
    return data + bytes(4 - len(data) % 4)


# --------------------------------------------------------------------------------------------------
# Who gets bundles: at which port, how often, and until when.


LEASE = 10.0  #: a subscription holds for so long, and is renewed by another [s]
MOST = 16  #: subscribers


@final
@dataclass
class Subscriber:
    """A port that bundles go to, `rate` a second [Hz]; `due` on the loop's clock, `until` on the computer's [s].

    any_account  whoever has the port may read: its program has shown the token
    """

    to: Sender
    rate: float
    until: float
    any_account: bool = False
    due: float = float("-inf")
    sent: int = 0
    dropped: int = 0  #: that the system could not take: the way there is full

    def is_due(self, t: float) -> bool:
        """Whether the row of time `t` [s] goes to it: so that there are `rate` a second, at even distances."""
        if t < self.due - 1e-6:
            return False
        gap = 1.0 / self.rate
        # Not from `t`, which is later than was due: the rate would be too low. But nothing is made up for.
        self.due = (self.due if t - self.due < gap else t) + gap
        return True


@final
class Subscribers:
    """Everybody who gets bundles."""

    def __init__(self) -> None:
        self._known: dict[Sender, Subscriber] = {}

    @property
    def current(self) -> list[Subscriber]:
        """All of them, in the order in which they came."""
        return list(self._known.values())

    def add(self, to: Sender, rate: float, now: float, *, any_account: bool = False) -> Subscriber:
        """Send to `to` at `rate` [Hz], or renew that. Raises InputError if there are too many others."""
        known = self._known.get(to)
        if known is None:
            if len(self._known) >= MOST:
                raise InputError(f"at most {MOST} programs can subscribe at a time: end one of them")
            known = self._known[to] = Subscriber(to, rate, now + LEASE)
        elif known.rate != rate:
            known.rate, known.due = rate, float("-inf")
        known.until, known.any_account = now + LEASE, any_account
        return known

    def remove(self, to: Sender) -> None:
        """Send nothing more to `to`."""
        self._known.pop(to, None)

    def expire(self, now: float) -> None:
        """Forget those who did not renew."""
        for one in self.current:
            if one.until < now:
                self.remove(one.to)


# --------------------------------------------------------------------------------------------------
# Parameters of the present world that programs set: checked as the console checks them, and asked for together.
#
# A fader sends a hundred values a second. The newest of each parameter is asked for, at most twenty times a second.


_REQUEST_INTERVAL_S = 0.05  #: between two requests [s]
_REQUEST_TIMEOUT_S = 2.0  #: a request that was not met until then is forgotten [s]

Value: TypeAlias = float | tuple[float, ...]


@final
class WorldRequests:
    """What programs want of the world of `served`."""

    def __init__(self, served: ServedDevice) -> None:
        self._served = served
        self._name, self._values = "", dict[str, Value]()
        self._sent: object = None
        self._next, self._until = 0.0, 0.0

    @property
    def name(self) -> str:
        """Name of the world: of the requested one, until it is there."""
        return self._name or str(self._served.world.get("name", ""))

    def list_parameters(self) -> list[tuple[Parameter, Value]]:
        """The parameters of the present world with their values, in their own units."""
        world = self._served.world
        known = CATALOGUE.get(world.get("name", ""))
        values = world.get("values", {})
        if known is None:  # a person's own world: the range is known to the loop's process only
            return [(_describe_own(name, value), _to_value(value)) for name, value in values.items()]
        return [(one, _to_value(values.get(name, one.default))) for name, one in parameters(known).items()]

    def set(self, name: str, value: Value, now: float) -> None:
        """Wish for the parameter `name` to be `value`, in its own unit. Raises UnknownName or InputError if it cannot
        be."""
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
        """Wish for the world `name` with its default values. Raises UnknownName or InputError if there is none, or
        none for this device."""
        if name != self._served.world.get("name"):
            find_world(name)().for_device(self._served.device)
        self._name, self._values, self._until = name, {}, now + _REQUEST_TIMEOUT_S

    def tell(self, now: float) -> None:
        """Pass on what is requested and not there yet, if it is time."""
        if not self._name or now < self._next:
            return
        if now > self._until or self._is_true():
            self._name, self._values, self._sent = "", {}, None
            return
        request = (self._name, dict(self._values))
        if request != self._sent:
            self._served.request_world(*request)
            self._sent, self._next = request, now + _REQUEST_INTERVAL_S

    def _is_true(self) -> bool:
        world = self._served.world
        values: Mapping[str, Any] = world.get("values", {})
        return world.get("name") == self._name and all(
            _to_value(values.get(name)) == value for name, value in self._values.items()
        )


def _to_value(value: Any) -> Value:
    return tuple(value) if isinstance(value, list) else value


def _describe_own(name: str, value: Any) -> Parameter:
    return Parameter(name, "", float("-inf"), float("inf"), "", _to_value(value))


# --------------------------------------------------------------------------------------------------
# One run's programs that speak OSC: what they send is done, refused or counted, and rows go to who subscribed.


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


FORM = KINDS["osc"].form
PORT = 9000  #: unless another is given

_LIVELY = 0.002  #: between two looks for rows while a client receives them [s]
_IDLE = 0.05  #: and while none does [s]
_FLOODED = 0.004  #: rest after a look that did not reach the end of what came [s]
_REPORT = 0.25  #: between two reports [s]


def prepare(where: str) -> ServerPreparation:
    """Understand [HOST:]PORT and open the port. Raises InputError if it cannot be had."""
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
    logging.disable(logging.WARNING)  # python-osc logs what it does not know, and anybody may send that
    opened = socket.socket(fileno=descriptors[0])
    session = OscSession(opened, served, spec["token"], beyond=spec["beyond"])
    last = monotonic()
    while not served.over:
        select.select(session.sockets, [], [], _LIVELY if session.lively else _IDLE)
        flooded = session.read_messages()
        session.send(served.read_rows())
        now = monotonic()
        if now - last >= _REPORT:
            session.report(spec["address"], now - last)
            last = now
        if flooded:  # the processors belong to the loop first
            sleep(_FLOODED)
    session.report(spec["address"], max(monotonic() - last, 1e-3))
    session.close()
