"""When what a socket holds came in, on the computer's monotonic clock: a command that waited is as old as it is.

A program that is stopped, or that has no processor, finds in its sockets what came meanwhile. Dated by when it is
read, all that would be new. Of datagrams the kernel says when they came. Of a stream it does not: its time stamps are
those of the newest bytes that lie together. There, all that waited counts as having come when it was last read.
"""

from __future__ import annotations

import socket
import struct
import sys
from time import monotonic_ns, time_ns
from typing import final

__all__ = ["STALL", "DatagramTimes", "StreamTimes"]

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
        """Have the kernel note when each datagram of `opened` comes."""
        if sys.platform == "linux":
            opened.setsockopt(socket.SOL_SOCKET, _STAMPS, 1)

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
