"""Sockets of other programs: when a message arrived, and which account owns the other end."""

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
# When what a socket holds came in, on the computer's monotonic clock: a command that waited is as old as it is.
#
# A program that is stopped, or that has no processor, finds in its sockets what came meanwhile. Dated by when it is
# read, all that would be new. Of datagrams the kernel says when they came. Of a stream it does not: its time stamps are
# those of the newest bytes that lie together. There, all that waited counts as having come when it was last read.


STALL = 0.02  #: a reader that has not looked for so long has let what came wait [s]

_STAMPS = 35  #: SO_TIMESTAMPNS of Linux
_TIME = struct.Struct("@ll")
_REALTIME = 0  #: CLOCK_REALTIME
_STEP = 5_000_000  #: by so much more than it takes to read two clocks, the computer's clock was set [ns]


@final
class DatagramTimes:
    """Of the datagrams of sockets that it may `watch`: call `look` before a batch is read, then `find` for each.

    room  bytes for the kernel's notes, for `recvmsg`
    """

    room = 64

    def __init__(self) -> None:
        self._shift = self._last_shift = _measure_shift()
        self._looked = self._before = monotonic_ns()

    @staticmethod
    def watch(opened: socket.socket) -> None:
        """Have the kernel note when each datagram of `opened` comes, and wait until it does."""
        if sys.platform == "linux":
            opened.setsockopt(socket.SOL_SOCKET, _STAMPS, 1)
            _wait_for_stamps()

    def look(self) -> None:
        """What is found from now on came since the last look, unless the kernel says when."""
        self._last_shift, self._shift = self._shift, _measure_shift()
        self._before, self._looked = self._looked, monotonic_ns()

    def find(self, notes: list[tuple[int, int, bytes]]) -> float:
        """When the datagram with these `notes` of the kernel came, on the monotonic clock [s]."""
        if abs(self._shift - self._last_shift) > _STEP:  # the clock of the stamps was set: they say nothing
            return 1e-9 * self._before
        for level, kind, data in notes:
            if level == socket.SOL_SOCKET and kind == _STAMPS and len(data) >= _TIME.size:
                seconds, nanoseconds = _TIME.unpack(data[: _TIME.size])
                return 1e-9 * float(min(seconds * 1_000_000_000 + nanoseconds - self._shift, monotonic_ns()))
        return 1e-9 * self._looked


def _wait_for_stamps() -> None:
    """Return when Linux dates datagrams by when they come, after 0.1 s at the latest.

    Where no other socket of the computer asked for it, it begins a moment after it was asked (`net_enable_timestamp`
    leaves it to a worker), and dates by its reading what came before.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, _STAMPS, 1)
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
                if level == socket.SOL_SOCKET and kind == _STAMPS and len(data) >= _TIME.size:
                    seconds, nanoseconds = _TIME.unpack(data[: _TIME.size])
                    if seconds * 1_000_000_000 + nanoseconds < read:
                        return


def _measure_shift() -> int:
    """By how much the clock of the kernel's time stamps is ahead of the monotonic one [ns]."""
    best, shift = 1 << 62, 0
    for _ in range(3):
        before, real, after = monotonic_ns(), time_ns(), monotonic_ns()
        if after - before < best:
            best, shift = after - before, real - (before + after) // 2
    return shift


@final
class StreamTimes:
    """Of the bytes of one stream, which a program reads as soon as there are any, unless it pauses or stalls."""

    def __init__(self) -> None:
        self._waiting_since: float | None = None

    def wait(self, since: float) -> None:
        """Nothing was read since then [s]: what waits is as old, until all of it has been read."""
        if self._waiting_since is None:
            self._waiting_since = since

    def find(self, descriptor: int, now: float) -> float:
        """When the bytes that were just read from `descriptor`, at `now`, came at the latest, on the monotonic clock
        [s]; of those that waited the earliest that can be."""
        if self._waiting_since is None:
            return now
        import fcntl
        import termios

        since = self._waiting_since
        left = struct.unpack("@i", fcntl.ioctl(descriptor, termios.FIONREAD, b"\0" * 4))[0]
        if not left:  # the sender's own queue moved up while this one was read
            self._waiting_since = None
        return since


# --------------------------------------------------------------------------------------------------
# Which account of this computer is at the other end of a socket on loopback, as the kernel says.
#
# A client that is not modified cannot show a token; whose process has the other end is known without its help. A socket
# whose end has no process any more belongs to nobody: the kernel would name it root's.


_SOCK_DIAG = 4  #: protocol of netlink that answers questions about sockets
_BY_FAMILY = 20  #: SOCK_DIAG_BY_FAMILY
_REQUEST = 1
_NOBODY = -1
_ESTABLISHED, _HALF_CLOSED, _LISTENING = 1, 8, 10  #: states in which a process has the socket
_HEAD = struct.Struct("=IHHII")  #: nlmsghdr: length, type, flags, sequence, port
_ASKED = struct.Struct("=BBBBI 2s2s16s16sI8s")  #: inet_diag_req_v2: family, protocol, states, then the socket's ends
_FOUND = struct.Struct("=BBBB 2s2s16s16sI8s IIIII")  #: inet_diag_msg: family, state, the ends, expires to inode
_KERNEL_TIMEOUT_S = 0.2  #: for the kernel [s]

Address = tuple[str, int]


def is_own_account(owner: int | None) -> bool:
    """Whether `owner` (a user id; None: unknown) is the account of this process."""
    return owner is not None and owner == os.geteuid()  # safety: own-account


def tcp_owner(peer: Address, own: Address) -> int | None:
    """User id of the process at the other end of the connection from `peer` to `own` (address, port); None: nobody's.

    Both are of this computer. It takes some ten microseconds where the kernel answers questions, and milliseconds where
    its table must be read.
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
    """Who has which UDP port of this computer at this moment. Reading it takes a tenth of a millisecond."""

    def __init__(self) -> None:
        self._lines = _read_tables("udp")

    def find(self, host: str, port: int) -> int | None:
        """User id of the processes that send from, and receive at, `port` of `host`, an address of this computer; None
        if there are none, or if they are of several accounts."""
        here = _unmapped(host)
        owners = {
            row.owner
            for row in _rows(self._lines, port)
            if row.near[1] == port and row.node and (row.near[0] == here or row.near[0].is_unspecified)
        }
        return owners.pop() if len(owners) == 1 else None  # safety: one-owner


def listener_owner(port: int) -> int | None:
    """User id of the processes of this computer that listen on the TCP port `port`; None if there are none, or if they
    are of several accounts."""
    rows = [
        row for row in _rows(_read_tables("tcp"), port) if row.near[1] == port and row.state == _LISTENING and row.node
    ]
    owners = {row.owner for row in rows}
    return owners.pop() if len(owners) == 1 else None


def _find(peer: Address, own: Address) -> int:
    """As `tcp_owner`, asked of the kernel; _NOBODY: there is none. Raises OSError where it does not answer."""
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
    """Whether the kernel answers such questions: its module for TCP is there."""
    with socket.socket() as listening, socket.socket() as client:
        listening.bind(("127.0.0.1", 0))
        listening.listen(1)
        client.connect(listening.getsockname())
        return _find(client.getsockname(), listening.getsockname()) != _NOBODY


@final
class _Row:
    """One socket in a table of the kernel: its own end, the far one (address, port), state, user id, inode."""

    def __init__(self, words: list[bytes]) -> None:
        self.near, self.far = _read_end(words[1]), _read_end(words[2])
        self.state, self.owner, self.node = int(words[3], 16), int(words[7]), int(words[9])


def _read_tables(kind: str) -> list[bytes]:
    """The lines of the kernel's tables of `kind` ("tcp" or "udp"), for IPv4 and IPv6."""
    found = []
    for table in (kind, f"{kind}6"):
        with suppress(OSError), open(f"/proc/net/{table}", "rb") as file:
            found += file.read().splitlines()[1:]
    return found


def _rows(lines: list[bytes], port: int | None = None) -> list[_Row]:
    """What `lines` of the tables say; with `port`, only those that contain it."""
    mark = b"" if port is None else b":%04X" % port
    return [_Row(line.split()) for line in lines if mark in line]


def _read_end(word: bytes) -> tuple[ipaddress.IPv4Address | ipaddress.IPv6Address, int]:
    digits, _, port = word.partition(b":")
    # Words of 32 bits, each in this computer's own order.
    raw = b"".join(int(digits[i : i + 8], 16).to_bytes(4, sys.byteorder) for i in range(0, len(digits), 8))
    return _unmapped(str(ipaddress.ip_address(raw))), int(port, 16)


def _unmapped(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address:
    """The address `host`; one of IPv4 as such, however it is written."""
    found = ipaddress.ip_address(host.partition("%")[0])
    return found.ipv4_mapped or found if isinstance(found, ipaddress.IPv6Address) else found
