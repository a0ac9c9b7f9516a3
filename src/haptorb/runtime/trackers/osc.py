"""Poses as OSC messages over UDP: the documented layout, a socket of its own, a token beyond this computer.

    /haptorb/pose  [token]  x y z  qx qy qz qw  [t]
    /haptorb/lost  [token]  [t]

Metres and a unit quaternion in the stator frame, as floats, doubles or integers; t [s] on the sender's own clock, as a
double: a 4-byte float that is coarser than 0.1 ms is no clock, and the pose then counts from its arrival.
Poses of two programs make no path of one tool, so only the first sender counts: another one counts only when the
first was silent for two seconds, and then the pose counts as lost first.

On loopback, where a token is not needed, only programs of the account count that runs the servo. A message counts from
its arrival at the socket, not from when it is read.
"""

from __future__ import annotations

import ipaddress
import select
import socket
import struct
from collections.abc import Callable, Iterator
from hmac import compare_digest
from math import isfinite
from typing import Any, final

import numpy as np

from haptorb.errors import DriverError, InputError, quote
from haptorb.runtime.sockets import DatagramTimes, UdpOwners, is_own_account
from haptorb.runtime.trackers.base import Feed, RawPose, RejectedPose, SenderClock
from haptorb.runtime.trackers.formats import FormatReader, ReadPose

__all__ = ["LOST", "POSE", "OscFeed", "Single", "loopback", "osc_socket", "read_packet"]


# --------------------------------------------------------------------------------------------------
# The messages of an OSC packet that anybody may have sent: a message, or a bundle of messages and bundles.
#
# python-osc reads the messages. It is not given bundles: a negative size in one keeps its reader in an endless loop
# (python-osc 1.10.2).


_BUNDLE = b"#bundle\x00"
_HEAD = 16  #: "#bundle" and the time tag [bytes]
_DEPTH = 4  #: bundles within bundles
_TYPES = frozenset(b",ihfdsTFN")  #: that messages may have; python-osc logs each one that it does not know


class Single(float):
    """A number that was sent with 4 bytes: seven digits, so that a large one tells no milliseconds."""

    @property
    def resolution(self) -> float:
        """Distance to the next number that could have been sent."""
        return float(np.spacing(np.float32(abs(self))))


def read_packet(data: bytes, depth: int = _DEPTH) -> list[tuple[str, list[Any]]]:
    """(address, values) of each message in `data`, in order, regardless of the time tags of bundles.

    Raises InputError if `data` is no OSC packet, or has more than `depth` bundles within each other; then none of its
    messages counts.

    >>> read_packet(b"/a\\0\\0,i\\0\\0\\0\\0\\0\\x07")
    [('/a', [7])]
    """
    # Here, so that only who uses OSC needs its package.
    from pythonosc.osc_message import OscMessage

    if data.startswith(_BUNDLE):
        return _read_bundle(data, depth)
    if not data.startswith(b"/") or len(data) % 4:
        raise InputError("an OSC packet begins with / or #bundle, and has a multiple of 4 bytes")
    return [_read_message(OscMessage, data)]


def _read_message(parse: Callable[[bytes], Any], data: bytes) -> tuple[str, list[Any]]:
    start = (data.find(b"\x00") // 4 + 1) * 4
    if not _TYPES.issuperset(data[start:].split(b"\x00", 1)[0]):
        raise InputError("an OSC message has values of the types i, h, f, d, s, T, F, N")
    try:
        message = parse(data)
        tags = data[start + 1 :].split(b"\x00", 1)[0]
        return message.address, [
            Single(value) if tag == ord("f") else value for tag, value in zip(tags, message.params, strict=True)
        ]
    except Exception as cause:  # a parser's failure on bytes that any program may send
        raise InputError(f"an OSC message cannot be read: {cause}") from cause


def _read_bundle(data: bytes, depth: int) -> list[tuple[str, list[Any]]]:
    if depth <= 0:
        raise InputError(f"an OSC packet has at most {_DEPTH} bundles within each other")
    if len(data) < _HEAD:
        raise InputError(f"an OSC bundle has at least {_HEAD} bytes; got {len(data)}")
    found, at = [], _HEAD
    while at < len(data):
        if at + 4 > len(data):
            raise InputError("an OSC bundle ends within the size of an element")
        (size,) = struct.unpack_from(">i", data, at)
        at += 4
        if size <= 0 or size % 4 or at + size > len(data):
            raise InputError(f"an element of an OSC bundle cannot have {size} bytes")
        found += read_packet(data[at : at + size], depth - 1)
        at += size
    return found


POSE, LOST = "/haptorb/pose", "/haptorb/lost"

_LAYOUT = f"expected {POSE} with x y z qx qy qz qw and perhaps t"
_MAX_MESSAGE_BYTES = 1024  #: no message of the layout is longer; what is, is not even parsed [bytes]
_MAX_BUNDLE_BYTES = 8192  #: of another program's, which may tell of many objects [bytes]
_BURST = 256  #: datagrams taken at once before the pose is written again
_SILENT = 2.0  #: a sender that says nothing for so long may be replaced [s]
_LOST = 0.05  #: so long the pose is lost in between: some ticks of any loop must see it [s]


def loopback(host: str) -> bool:
    """Whether only programs on this computer can reach `host`.

    >>> loopback("127.0.0.1"), loopback("::1"), loopback("0.0.0.0"), loopback("localhost")
    (True, True, False, True)
    """
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def osc_socket(host: str, port: int) -> socket.socket:
    """A UDP socket bound to `host` and `port`; DriverError if it is taken, not allowed or not this computer's."""
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
    except OSError as cause:
        raise DriverError(
            f"tracker osc: there is no host '{host}' ({cause.strerror}); check its name or address"
        ) from cause
    opened = socket.socket(family, kind, protocol)
    try:
        opened.bind(address)
    except OSError as cause:
        opened.close()
        raise DriverError(
            f"tracker osc: cannot listen on {host}, UDP port {port}: {cause.strerror}. Choose another port, end the "
            "program that uses it, or name an address of this computer"
        ) from cause
    return opened


@final
class OscFeed(Feed):
    """Listens on an open socket. With a `token`, messages that do not begin with it are a stranger's. With a `reader`,
    poses come in its format instead of the layout above."""

    def __init__(self, listening: socket.socket, token: str = "", reader: FormatReader | None = None) -> None:
        self._socket = listening
        self._socket.setblocking(False)
        self._token = token.encode()
        self._times = DatagramTimes()
        self._times.watch(listening)
        self._reader, self._longest = reader, _MAX_MESSAGE_BYTES if reader is None else _MAX_BUNDLE_BYTES
        self._clock = SenderClock()
        self._numbers: list[float] = []  # of the pose before
        self._other = ""  # the first message that is none of the layout
        self._sender: object = None
        self._spoke = float("-inf")  # when it last said something of the layout
        self._heard_from = float("-inf")  # its poses count from then on

    @property
    def remark(self) -> str:
        """Which other message came, or why the sender's times are not used; empty if nothing is unusual."""
        return (self._reader.remark if self._reader else self._other) or self._clock.remark

    def receive(self, patience: float) -> Iterator[RawPose | RejectedPose]:
        """What came in up to 256 datagrams; at most `patience` [s] for the first."""
        select.select([self._socket], [], [], patience)
        self._times.begin_batch()
        known: dict[object, bool] = {}  # sender → whether its messages count; looked up in each batch
        for _ in range(_BURST):
            try:
                data, notes, _, sender = self._socket.recvmsg(self._longest + 1, DatagramTimes.room)
            except BlockingIOError:
                return
            except OSError:  # "port unreachable" in reply to a message that we did not send
                continue
            if sender not in known:
                known[sender] = bool(self._token) or is_own_account(UdpOwners().find(*sender[:2]))
            if not known[sender]:  # safety: tracker-account
                yield RejectedPose("another_account")
                continue
            yield from self.read(data, self._times.find(notes), sender)

    def read(self, data: bytes, arrival: float, sender: object = "the only one") -> Iterator[RawPose | RejectedPose]:
        """What one datagram of `sender` (its address and port) says."""
        if len(data) > self._longest:
            yield RejectedPose("garbage")
            return
        try:
            messages = read_packet(data)
        except InputError:
            yield RejectedPose("garbage")
            return
        if not messages:
            yield RejectedPose("garbage")
        if self._reader is None:
            for address, values in messages:
                yield self._message(address, values, arrival, sender)
            return
        own = [(address, values) for address, values in messages if self._take_token(values)]
        yield from (RejectedPose("stranger") for _ in range(len(messages) - len(own)))
        for one in self._reader.read(own) if own else ():
            yield self._accept(one, arrival, sender) if isinstance(one, ReadPose) else one

    def _message(self, address: str, values: list[object], arrival: float, sender: object) -> RawPose | RejectedPose:
        if not self._take_token(values):
            return RejectedPose("stranger")
        numbers = [float(x) for x in values if isinstance(x, int | float) and not isinstance(x, bool)]
        first = {POSE: 7, LOST: 0}.get(address)
        if first is None or len(numbers) != len(values) or len(numbers) not in (first, first + 1):
            kinds = ", ".join("a number" if isinstance(one, int | float) else type(one).__name__ for one in values[:9])
            self._other = (
                self._other or f"a message {quote(address)[:80]} with {len(values)} values ({kinds}) came; {_LAYOUT}"
            )
            return RejectedPose("garbage")
        sent = numbers[first] if len(numbers) > first else None
        time = values[first] if len(values) > first else None
        resolution = time.resolution if isinstance(time, Single) else 0.0
        if sent is not None and not isfinite(sent):
            return RejectedPose("not_finite")
        pose = ReadPose(tuple(numbers[:3]), tuple(numbers[3:7]), address != LOST, sent, resolution)
        return self._accept(pose, arrival, sender)

    def _take_token(self, values: list[object]) -> bool:
        """Whether a message begins with the token, which is taken out of `values`; true if none is needed."""
        if self._token:  # safety: sender-token
            tags = values.pop(0) if values else None
            return isinstance(tags, str) and compare_digest(tags.encode("utf-8", "replace"), self._token)
        return True

    def _accept(self, pose: ReadPose, arrival: float, sender: object) -> RawPose | RejectedPose:
        """What `sender` says counts if it is the only one."""
        if sender != self._sender:  # safety: one-sender
            if arrival - self._spoke <= _SILENT:
                return RejectedPose("another_sender")
            replaced, self._sender, self._spoke = self._sender is not None, sender, arrival
            if replaced:
                self._clock, self._heard_from = SenderClock(), arrival + _LOST
                return RawPose((), (), arrival, arrival, False)
        self._spoke = arrival
        if arrival < self._heard_from:  # safety: sender-replaced
            return RejectedPose("another_sender")
        numbers = [*pose.p, *pose.q]
        changed, self._numbers = numbers != self._numbers, numbers
        stamp = (
            arrival if pose.sent is None else self._clock.stamp(pose.sent, arrival, pose.resolution, changed=changed)
        )
        return RawPose(pose.p, pose.q, stamp, arrival) if pose.valid else RawPose((), (), stamp, arrival, False)

    def close(self) -> None:
        """Close the port."""
        self._socket.close()
