"""Sockets of client programs: arrival times of messages, and the account that owns the peer."""

from __future__ import annotations

import errno
import ipaddress
import os
import socket
import struct
import sys
from contextlib import suppress
from functools import cache
from time import monotonic_ns, sleep, time_ns
from typing import final

__all__ = ["STALL", "DatagramTimes", "StreamTimes", "UdpOwners", "is_own_account", "listener_owner", "tcp_owner"]


# --------------------------------------------------------------------------------------------------
# Arrival times of messages on the computer's monotonic clock, so that the age of a queued command is known.
#
# A program that is stopped, or starved of processor time, finds queued messages in its sockets. Dated by the time of
# reading, all of them would be new. The kernel timestamps datagrams. Of a stream it does not: its timestamps are those
# of the newest bytes of a segment. There, all queued data counts as received at the time of the last read.


STALL = 0.02  #: gap between two reads after which received data counts as queued [s]

_SO_TIMESTAMPNS = 35  #: of Linux
_TIME = struct.Struct("@ll")
_CLOCK_STEP_NS = 5_000_000  #: change of the difference of two clocks above which the computer's clock was set


@final
class DatagramTimes:
    """Arrival times of datagrams of watched sockets: call `begin_batch` before reading, then `find` for each.

    room  bytes for the kernel's ancillary data, for `recvmsg`
    """

    room = 64

    def __init__(self) -> None:
        self._shift = self._last_shift = _measure_shift()
        self._polled_at = self._before = monotonic_ns()

    @staticmethod
    def watch(opened: socket.socket, *, wait: bool = True) -> None:
        """Enable the kernel's receive timestamps on `opened`, and wait until they are active.

        wait=False: they are active already, for another socket of this process."""
        if sys.platform == "linux":
            opened.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
            if wait:
                _wait_for_stamps()

    def begin_batch(self) -> None:
        """Begin a batch: its datagrams arrived since the last batch, unless the kernel has timestamped them."""
        self._last_shift, self._shift = self._shift, _measure_shift()
        self._before, self._polled_at = self._polled_at, monotonic_ns()

    def find(self, notes: list[tuple[int, int, bytes]]) -> float:
        """Return the arrival time of the datagram with the ancillary data `notes`, on the monotonic clock [s]."""
        # The clock was set: timestamps are invalid.
        if abs(self._shift - self._last_shift) > _CLOCK_STEP_NS:  # safety: clock-step
            return 1e-9 * self._before
        for level, kind, data in notes:
            if level == socket.SOL_SOCKET and kind == _SO_TIMESTAMPNS and len(data) >= _TIME.size:
                seconds, nanoseconds = _TIME.unpack(data[: _TIME.size])
                return 1e-9 * float(min(seconds * 1_000_000_000 + nanoseconds - self._shift, monotonic_ns()))
        return 1e-9 * self._polled_at


def _wait_for_stamps() -> None:
    """Wait until Linux timestamps datagrams on arrival, for at most 0.1 s.

    If no other socket of the computer has enabled timestamps, they begin with a delay (`net_enable_timestamp` uses a
    worker); earlier datagrams are dated by the time of reading.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        probe.settimeout(0.1)
        probe.bind(("127.0.0.1", 0))
        until = monotonic_ns() + 100_000_000
        while monotonic_ns() < until:
            probe.sendto(b"", probe.getsockname())
            sleep(0.001)
            read = time_ns()
            try:
                _, notes, *_ = probe.recvmsg(1, DatagramTimes.room)
            except TimeoutError:
                return
            for level, kind, data in notes:
                if level == socket.SOL_SOCKET and kind == _SO_TIMESTAMPNS and len(data) >= _TIME.size:
                    seconds, nanoseconds = _TIME.unpack(data[: _TIME.size])
                    if seconds * 1_000_000_000 + nanoseconds < read:
                        return


def _measure_shift() -> int:
    """Offset of the kernel's timestamp clock from the monotonic clock [ns]."""
    best, shift = 1 << 62, 0
    for _ in range(3):
        before, real, after = monotonic_ns(), time_ns(), monotonic_ns()
        if after - before < best:
            best, shift = after - before, real - (before + after) // 2
    return shift


@final
class StreamTimes:
    """Arrival times of the bytes of a stream, which a program reads as soon as there are any, unless it stalls."""

    def __init__(self) -> None:
        self._waiting_since: float | None = None

    def wait(self, since: float) -> None:
        """Record that nothing was read since then [s]: queued data counts as arrived then, until all of it is read."""
        if self._waiting_since is None:
            self._waiting_since = since

    def find(self, descriptor: int, now: float) -> float:
        """Return the arrival time of the bytes just read from `descriptor` at `now`, on the monotonic clock [s]: the
        latest possible one, and the earliest possible one of queued bytes."""
        if self._waiting_since is None:
            return now
        import fcntl
        import termios

        since = self._waiting_since
        left = struct.unpack("@i", fcntl.ioctl(descriptor, termios.FIONREAD, b"\0" * 4))[0]
        if not left:  # otherwise the sender's queue has refilled this one while it was read
            self._waiting_since = None
        return since


# --------------------------------------------------------------------------------------------------
# Account that owns the peer of a loopback socket, from the kernel.
#
# An unmodified client cannot send a token; the account of its process is known without it. A socket whose process has
# ended belongs to nobody: the kernel would report root.


_SOCK_DIAG = 4  #: netlink protocol for socket queries
_BY_FAMILY = 20  #: SOCK_DIAG_BY_FAMILY
_REQUEST = 1
_NOBODY = -1
_ESTABLISHED, _HALF_CLOSED, _LISTENING = 1, 8, 10  #: states in which a process owns the socket
_HEAD = struct.Struct("=IHHII")  #: nlmsghdr: length, type, flags, sequence, port
_ASKED = struct.Struct("=BBBBI 2s2s16s16sI8s")  #: inet_diag_req_v2: family, protocol, states, then the socket's ends
_FOUND = struct.Struct("=BBBB 2s2s16s16sI8s IIIII")  #: inet_diag_msg: family, state, the ends, expires to inode
_KERNEL_TIMEOUT_S = 0.2  #: for the kernel's answer

Address = tuple[str, int]


def is_own_account(owner: int | None) -> bool:
    """Whether `owner` (a user id; None: unknown) is the account of this process."""
    return owner is not None and owner == os.geteuid()  # safety: own-account


def tcp_owner(peer: Address, own: Address) -> int | None:
    """User id of the peer's process of the connection from `peer` to `own` (address, port); None: no process.

    Both are addresses of this computer. It takes some 10 µs where the kernel answers netlink queries, and milliseconds
    where its table must be read.
    """
    with suppress(OSError):
        if (owner := _find(peer, own)) != _NOBODY or _is_answered():
            return None if owner == _NOBODY else owner
    owners = {
        row.owner
        for row in _rows(_read_tables("tcp"))
        if row.near == (_unmapped(peer[0]), peer[1]) and row.far == (_unmapped(own[0]), own[1])
        if row.node and row.state in (_ESTABLISHED, _HALF_CLOSED)
    }
    return owners.pop() if len(owners) == 1 else None


@final
class UdpOwners:
    """Snapshot of the owners of this computer's UDP ports. Reading it takes 0.1 ms."""

    def __init__(self) -> None:
        self._lines = _read_tables("udp")
        self._found: dict[Address, int | None] = {}

    def find(self, host: str, port: int) -> int | None:
        """User id of the processes bound to `port` of `host`, an address of this computer; None if there are none, if
        they belong to several accounts, or if it is a port of this account that another one may bind, too: what was
        sent before this snapshot need not be from a process that is in it."""
        if (host, port) not in self._found:
            self._found[host, port] = self._find_owner(host, port)
        return self._found[host, port]

    def _find_owner(self, host: str, port: int) -> int | None:
        here = _unmapped(host)
        owners = {
            row.owner
            for row in _rows(self._lines, port)
            if row.near[1] == port and row.node and (row.near[0] == here or row.near[0].is_unspecified)
        }
        owner = owners.pop() if len(owners) == 1 else None  # safety: one-owner
        if is_own_account(owner) and _can_be_shared(here, port):  # safety: port-not-shared
            return None
        return owner


def _can_be_shared(host: ipaddress.IPv4Address | ipaddress.IPv6Address, port: int) -> bool:
    """Whether every socket at the UDP port has SO_REUSEADDR, with which any account may bind it again."""
    family = socket.AF_INET if host.version == 4 else socket.AF_INET6
    with socket.socket(family, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((str(host), port))
        except OSError as cause:
            return cause.errno != errno.EADDRINUSE
    return True


def listener_owner(port: int) -> int | None:
    """User id of the processes of this computer that listen on the TCP port `port`; None if there are none, or if they
    belong to several accounts."""
    rows = [
        row for row in _rows(_read_tables("tcp"), port) if row.near[1] == port and row.state == _LISTENING and row.node
    ]
    owners = {row.owner for row in rows}
    return owners.pop() if len(owners) == 1 else None


def _find(peer: Address, own: Address) -> int:
    """As `tcp_owner`, by a netlink query; _NOBODY: there is none. Raises OSError where the kernel does not answer."""
    source, target = (_unmapped(one[0]).packed for one in (peer, own))
    ends = peer[1].to_bytes(2, "big"), own[1].to_bytes(2, "big")
    family = socket.AF_INET if len(source) == 4 else socket.AF_INET6
    asked = _ASKED.pack(family, socket.IPPROTO_TCP, 0, 0, 0xFFFFFFFF, *ends, source, target, 0, b"\xff" * 8)
    with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW | socket.SOCK_CLOEXEC, _SOCK_DIAG) as kernel:
        kernel.settimeout(_KERNEL_TIMEOUT_S)
        kernel.send(_HEAD.pack(_HEAD.size + len(asked), _BY_FAMILY, _REQUEST, 1, 0) + asked)
        answer = kernel.recv(4096)
    if _HEAD.unpack_from(answer)[1] != _BY_FAMILY:
        number = -struct.unpack_from("=i", answer, _HEAD.size)[0]
        if number == errno.ENOENT:
            return _NOBODY
        raise OSError(number, os.strerror(number))
    _, state, _, _, near, far, *_, owner, node = _FOUND.unpack_from(answer, _HEAD.size)
    whole = (near, far) == ends and node and state in (_ESTABLISHED, _HALF_CLOSED)  # safety: orphaned-socket
    return int(owner) if whole else _NOBODY


@cache
def _is_answered() -> bool:
    """Whether the kernel answers such queries: its module for TCP is loaded."""
    with socket.socket() as listening, socket.socket() as client:
        listening.bind(("127.0.0.1", 0))
        listening.listen(1)
        client.connect(listening.getsockname())
        return _find(client.getsockname(), listening.getsockname()) != _NOBODY


@final
class _Row:
    """One socket in a table of the kernel: local and remote end (address, port), state, user id, inode."""

    def __init__(self, words: list[bytes]) -> None:
        self.near, self.far = _read_end(words[1]), _read_end(words[2])
        self.state, self.owner, self.node = int(words[3], 16), int(words[7]), int(words[9])


def _read_tables(kind: str) -> list[bytes]:
    """Read the lines of the kernel's tables of `kind` ("tcp" or "udp"), for IPv4 and IPv6."""
    found = []
    for table in (kind, f"{kind}6"):
        with suppress(OSError), open(f"/proc/net/{table}", "rb") as file:
            found += file.read().splitlines()[1:]
    return found


def _rows(lines: list[bytes], port: int | None = None) -> list[_Row]:
    """Parse `lines` of the tables; with `port`, only those that contain it."""
    mark = b"" if port is None else b":%04X" % port
    return [_Row(line.split()) for line in lines if mark in line]


def _read_end(word: bytes) -> tuple[ipaddress.IPv4Address | ipaddress.IPv6Address, int]:
    digits, _, port = word.partition(b":")
    # Words of 32 bits, each in native byte order.
    raw = b"".join(int(digits[i : i + 8], 16).to_bytes(4, sys.byteorder) for i in range(0, len(digits), 8))
    return _unmapped(str(ipaddress.ip_address(raw))), int(port, 16)


def _unmapped(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address:
    """Parse the address `host`; an IPv4-mapped IPv6 address becomes IPv4."""
    found = ipaddress.ip_address(host.partition("%")[0])
    return found.ipv4_mapped or found if isinstance(found, ipaddress.IPv6Address) else found
