"""Poses as OSC messages over UDP; senders on other computers need a token.

    /haptorb/pose  [token]  x y z  qx qy qz qw  [t]
    /haptorb/lost  [token]  [t]

Metres and a unit quaternion in the stator frame, as floats, doubles or integers; t [s] on the sender's own clock, as a
double: a 4-byte float that is coarser than 0.1 ms is not used, and the pose then has the time of its arrival.
Poses of two programs are not the path of one tool, so only the first sender is accepted: another one is accepted only
when the first was silent for two seconds, and then the pose first counts as lost.

On loopback, where a token is not needed, only programs of the account that runs the servo are accepted. A message is
dated by its arrival at the socket, not by the time of reading.
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
from haptorb.runtime.trackers.base import Feed, RawPose, RejectedPose
from haptorb.runtime.trackers.formats import FormatReader, ReadPose
from haptorb.runtime.trackers.sender_clock import SenderClock

__all__ = ["LOST", "POSE", "OscFeed", "Single", "loopback", "osc_socket", "read_packet"]


# --------------------------------------------------------------------------------------------------
# Parsing of untrusted OSC packets: a message, or a bundle of messages and bundles.
#
# python-osc parses the messages, but not the bundles: a negative size in one causes an endless loop in its parser
# (python-osc 1.10.2).


_BUNDLE = b"#bundle\x00"
_HEAD = 16  #: "#bundle" and the time tag [bytes]
_MAX_DEPTH = 4  #: maximum nesting of bundles
_TYPES = frozenset(b",ihfdsTFN")  #: accepted type tags; python-osc logs each one that it does not know


class Single(float):
    """A single-precision number: seven digits, so that a large one does not resolve milliseconds."""

    @property
    def resolution(self) -> float:
        """Distance to the next single-precision number."""
        return float(np.spacing(np.float32(abs(self))))


def read_packet(data: bytes, depth: int = _MAX_DEPTH) -> list[tuple[str, list[Any]]]:
    """Parse the messages (address, values) in `data`, in order, regardless of the time tags of bundles.

    Raises InputError if `data` is not an OSC packet, or has more than `depth` nested bundles; then all of its messages
    are rejected.

    >>> read_packet(b"/a\\0\\0,i\\0\\0\\0\\0\\0\\x07")
    [('/a', [7])]
    """
    # Imported here, so that only users of OSC need its package.
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
    except Exception as cause:  # a parser's failure on untrusted bytes
        raise InputError(f"an OSC message cannot be read: {cause}") from cause


def _read_bundle(data: bytes, depth: int) -> list[tuple[str, list[Any]]]:
    if depth <= 0:
        raise InputError(f"an OSC packet has at most {_MAX_DEPTH} bundles within each other")
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
_MAX_MESSAGE_BYTES = 1024  #: no message of the layout is longer; longer ones are rejected unparsed
_MAX_BUNDLE_BYTES = 8192  #: of another program's format, which may contain many objects
_MAX_BATCH = 256  #: most datagrams read in one batch
_SENDER_TIMEOUT_S = 2.0  #: silence after which another sender is accepted
_LOST_TIME_S = 0.05  #: time for which the pose is lost at a change of sender: some ticks of any loop must see it


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
    """Open a UDP socket on `host` and `port`; DriverError if it is in use, not permitted or not this computer's."""
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
    """Receives poses on an open socket. With a `token`, messages that do not begin with it are rejected. With a
    `reader`, poses are in its format instead of the layout above."""

    def __init__(self, listening: socket.socket, token: str = "", reader: FormatReader | None = None) -> None:
        self._socket = listening
        self._socket.setblocking(False)
        self._token = token.encode()
        self._times = DatagramTimes()
        self._times.watch(listening)
        self._reader, self._longest = reader, _MAX_MESSAGE_BYTES if reader is None else _MAX_BUNDLE_BYTES
        self._clock = SenderClock()
        self._numbers: list[float] = []  # of the pose before
        self._other = ""  # the first message with another layout
        self._sender: object = None
        self._last_message = float("-inf")  # time of its last message of the layout
        self._accept_from = float("-inf")  # its poses count from then on

    @property
    def remark(self) -> str:
        """Remark on an unknown message, or why the sender's times are not used; else empty."""
        return (self._reader.remark if self._reader else self._other) or self._clock.remark

    def receive(self, timeout: float) -> Iterator[RawPose | RejectedPose]:
        """Receive up to 256 datagrams; wait for the first for at most `timeout` [s]."""
        select.select([self._socket], [], [], timeout)
        self._times.begin_batch()
        known: dict[object, bool] = {}  # sender → whether it is accepted; checked in each batch
        for _ in range(_MAX_BATCH):
            try:
                data, notes, _, sender = self._socket.recvmsg(self._longest + 1, DatagramTimes.room)
            except BlockingIOError:
                return
            except OSError:  # "port unreachable", although this socket sends nothing
                continue
            if sender not in known:
                known[sender] = bool(self._token) or is_own_account(UdpOwners().find(*sender[:2]))
            if not known[sender]:  # safety: tracker-account
                yield RejectedPose("another_account")
                continue
            yield from self.read(data, self._times.find(notes), sender)

    def read(self, data: bytes, arrival: float, sender: object = "the only one") -> Iterator[RawPose | RejectedPose]:
        """Parse one datagram of `sender` (its address and port)."""
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
        """Whether a message begins with the token, which is removed from `values`; true if none is required."""
        if self._token:  # safety: sender-token
            tags = values.pop(0) if values else None
            return isinstance(tags, str) and compare_digest(tags.encode("utf-8", "replace"), self._token)
        return True

    def _accept(self, pose: ReadPose, arrival: float, sender: object) -> RawPose | RejectedPose:
        """Accept the pose if `sender` is the only one."""
        if sender != self._sender:  # safety: one-sender
            if arrival - self._last_message <= _SENDER_TIMEOUT_S:
                return RejectedPose("another_sender")
            replaced, self._sender, self._last_message = self._sender is not None, sender, arrival
            if replaced:
                self._clock, self._accept_from = SenderClock(), arrival + _LOST_TIME_S
                return RawPose((), (), arrival, arrival, False)
        self._last_message = arrival
        if arrival < self._accept_from:  # safety: sender-replaced
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
