"""Frames on the serial line: A5 5A, length, type, sequence, payload, CRC-16, as the firmware's `core/frame.c` has them.

The check sum is CRC-16/CCITT-FALSE over length, type, sequence and payload, low byte first. Writing, finding and
checking are compiled: what runs once a millisecond finds the processor's caches full of other data, and the
interpreter then takes six times as long as in a loop of its own.
"""

from __future__ import annotations

from typing import NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from haptorb.errors import InputError
from haptorb.numerics.arrays import Records, fields
from haptorb.numerics.compiled import kernel

__all__ = [
    "HEAD",
    "HELD",
    "PAYLOAD_MAX",
    "SYNC",
    "Frame",
    "FrameParser",
    "Numbers",
    "Octets",
    "crc16",
    "encode",
    "find_frame",
    "seal_frame",
]

SYNC = b"\xa5\x5a"
PAYLOAD_MAX = 40  #: bytes
HEAD = 5  #: bytes before the payload: sync, length, type, sequence

_TAIL = 2
_FRAME_MAX = HEAD + PAYLOAD_MAX + _TAIL
_CHUNK = 512  #: taken from the line at once

Octets = NDArray[np.uint8]
Numbers = NDArray[np.int64]

#: What of the line's bytes is still to be looked at.
HELD = fields(
    ("begin", "i8"),  # the first byte that has not been looked at
    ("end", "i8"),  # one past the last
    ("damaged", "i8"),  # frames so far
)


class Frame(NamedTuple):
    """One message: what kind, which number, and what it carries."""

    type: int
    sequence: int
    payload: bytes


@kernel
def _check(line: Octets, first: int, last: int) -> int:
    """CRC-16/CCITT-FALSE of the bytes `first` ≤ i < `last`; eight shifts of the polynomial in one, as `core/crc.c`."""
    crc = 0xFFFF
    for i in range(first, last):
        x = (crc >> 8) ^ line[i]
        x ^= x >> 4
        crc = ((crc << 8) ^ (x << 12) ^ (x << 5) ^ x) & 0xFFFF
    return crc


@kernel
def seal_frame(line: Octets, kind: int, sequence: int, length: int) -> int:
    """Head and check sum around a payload of `length` bytes that is in `line` from HEAD on; the frame's length."""
    line[0], line[1], line[2], line[3], line[4] = 0xA5, 0x5A, length, kind, sequence
    end = HEAD + length
    crc = _check(line, 2, end)
    line[end], line[end + 1] = crc & 0xFF, crc >> 8
    return end + _TAIL


@kernel
def find_frame(line: Octets, held: Records) -> int:
    """Where the next whole frame begins in `line`; −1: nowhere, and what may be the beginning of one is in front.

    held is (1,) HELD.
    """
    h = held[0]
    at, end = h.begin, h.end
    while True:
        while at < end and not (line[at] == 0xA5 and (at + 1 == end or line[at + 1] == 0x5A)):
            at += 1
        if end - at < 3:
            break
        length = line[at + 2]
        if length > PAYLOAD_MAX:
            h.damaged += 1
            at += 1
            continue
        last = at + HEAD + length
        if end < last + _TAIL:
            break
        if _check(line, at + 2, last) != line[last] | line[last + 1] << 8:  # safety: frame-damaged
            h.damaged += 1
            at += 1
            continue
        h.begin = last + _TAIL
        if h.begin == end:
            h.begin, h.end = 0, 0
        return int(at)
    for i in range(end - at):
        line[i] = line[at + i]
    h.begin, h.end = 0, end - at
    return -1


def crc16(data: bytes) -> int:
    """CRC-16/CCITT-FALSE: polynomial 0x1021, start 0xFFFF.

    >>> hex(crc16(b"123456789"))
    '0x29b1'
    """
    return int(_check(np.frombuffer(data, np.uint8), 0, len(data)))


def encode(frame: Frame) -> bytes:
    """The bytes of `frame` on the line; InputError if its payload is too long or a number is no byte.

    >>> encode(Frame(0x06, 6, b"")).hex(" ")
    'a5 5a 00 06 06 fc 06'
    """
    length = len(frame.payload)
    if length > PAYLOAD_MAX:
        raise InputError(f"a frame's payload has at most {PAYLOAD_MAX} bytes; got {length}")
    if not (0 <= frame.type <= 255 and 0 <= frame.sequence <= 255):
        raise InputError(f"a frame's type and sequence are bytes; got {frame.type} and {frame.sequence}")
    line = np.empty(_FRAME_MAX, np.uint8)
    line[HEAD : HEAD + length] = np.frombuffer(frame.payload, np.uint8)
    return line[: seal_frame(line, frame.type, frame.sequence, length)].tobytes()


@final
class FrameParser:
    """Finds frames in a stream of bytes. After a damaged one it looks again from the byte behind its sync.

    Never holds more than one frame's bytes. For those who read the line themselves: bytes go into `room`, and `took`
    says how many; `line` and `held` are as `find_frame` takes them.
    """

    def __init__(self) -> None:
        self.line = np.zeros(_FRAME_MAX + _CHUNK, np.uint8)
        self.held = np.zeros(1, HELD)
        self._begin, self._end = self.held["begin"], self.held["end"]
        self._all = self.line.data
        find_frame(self.line, self.held)  # compiled before anybody waits

    @property
    def bad_frames(self) -> int:
        """Check sums that were wrong and lengths that no frame has."""
        return int(self.held["damaged"][0])

    @property
    def free_space(self) -> memoryview:
        """Where the next bytes go: always some, as what has been found already is given up for it."""
        begin, end = int(self._begin[0]), int(self._end[0])
        if begin:
            self.line[: end - begin] = self.line[begin:end].copy()
            self._begin[0], self._end[0] = 0, end - begin
            return self._all[end - begin :]
        return self._all[end:]

    def commit(self, count: int) -> None:
        """So many bytes were put into `room`."""
        self._end[0] += count

    def frame(self, at: int) -> Frame:
        """The frame that `find_frame` found."""
        whole = self.line[at : at + HEAD + int(self.line[at + 2])].tobytes()
        return Frame(whole[3], whole[4], whole[HEAD:])

    def next(self) -> Frame | None:
        """The next whole frame of what has come."""
        at = find_frame(self.line, self.held)
        return None if at < 0 else self.frame(at)

    def feed(self, data: bytes) -> list[Frame]:
        """The frames that are complete after `data`.

        >>> parser = FrameParser()
        >>> parser.feed(b"noise" + encode(Frame(1, 2, b"x"))[:6]), parser.feed(encode(Frame(1, 2, b"x"))[6:])
        ([], [Frame(type=1, sequence=2, payload=b'x')])
        """
        frames = []
        for begin in range(0, len(data), _CHUNK):
            part = data[begin : begin + _CHUNK]
            self.free_space[: len(part)] = part
            self.commit(len(part))
            while (frame := self.next()) is not None:
                frames.append(frame)
        return frames
