"""The datagrams that came since the last look: the newest of each sender, each with the time at which it came.

A program that was understood once gets a socket of its own on the same port: the system puts its datagrams there, and a
flood of others, which fills the socket that all share, no longer pushes them out.
"""

from __future__ import annotations

import socket
import struct
from collections import deque
from contextlib import suppress
from typing import TypeAlias, final

from haptorb.runtime.realtime.arrival_time import DatagramTimes

__all__ = ["NEWEST", "Letter", "OscInbox", "Sender"]

Sender: TypeAlias = tuple[str, int]  #: address and port of a program
Letter: TypeAlias = tuple[float, bytes]  #: when a datagram came, on the monotonic clock [s], and what it says

NEWEST = 32  #: datagrams of one sender that count in one look; older ones are overtaken
_AT_ONCE = 512  #: datagrams taken from the shared socket in one look
_OWN_AT_ONCE = 64  #: and from a program's own
_SENDERS = 64  #: that are read in one look
_OWN = 32  #: programs with a socket of their own
_LONGEST = 1024  #: no message that is understood is longer [bytes]
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
                data, notes, _, sender = source.recvmsg(_LONGEST + 1, _NOTES)
            except BlockingIOError:
                return False
            except OSError:  # "port unreachable" in reply to a bundle
                continue
            self.received += 1
            self._note_lost(source, notes)
            if len(data) > _LONGEST:
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
