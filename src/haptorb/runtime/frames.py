"""Frames on the serial line: A5 5A, length, type, sequence, payload, CRC-16, as the firmware's `core/frame.c` has them.

The check sum is CRC-16/CCITT-FALSE over length, type, sequence and payload, low byte first.
"""

from __future__ import annotations

from binascii import crc_hqx
from typing import NamedTuple, final

from haptorb.errors import InputError

__all__ = ["PAYLOAD_MAX", "SYNC", "Frame", "FrameParser", "crc16", "encoded"]

SYNC = b"\xa5\x5a"
PAYLOAD_MAX = 40  #: bytes

_HEAD = 5  # sync, length, type, sequence
_TAIL = 2


class Frame(NamedTuple):
    """One message: what kind, which number, and what it carries."""

    type: int
    sequence: int
    payload: bytes


def crc16(data: bytes) -> int:
    """CRC-16/CCITT-FALSE: polynomial 0x1021, start 0xFFFF.

    >>> hex(crc16(b"123456789"))
    '0x29b1'
    """
    return crc_hqx(data, 0xFFFF)


def encoded(frame: Frame) -> bytes:
    """The bytes of `frame` on the line; InputError if its payload is too long or a number is no byte.

    >>> encoded(Frame(0x06, 6, b"")).hex(" ")
    'a5 5a 00 06 06 fc 06'
    """
    if len(frame.payload) > PAYLOAD_MAX:
        raise InputError(f"a frame's payload has at most {PAYLOAD_MAX} bytes; got {len(frame.payload)}")
    if not (0 <= frame.type <= 255 and 0 <= frame.sequence <= 255):
        raise InputError(f"a frame's type and sequence are bytes; got {frame.type} and {frame.sequence}")
    body = bytes((len(frame.payload), frame.type, frame.sequence)) + frame.payload
    return SYNC + body + crc16(body).to_bytes(2, "little")


@final
class FrameParser:
    """Finds frames in a stream of bytes. After a damaged one it looks again from the byte behind its sync.

    `damaged` counts check sums that were wrong and lengths that no frame has. Never holds more than one frame's bytes.
    """

    def __init__(self) -> None:
        self._bytes = bytearray()
        self.damaged = 0

    def feed(self, data: bytes) -> list[Frame]:
        """The frames that are complete after `data`.

        >>> parser = FrameParser()
        >>> parser.feed(b"noise" + encoded(Frame(1, 2, b"x"))[:6]), parser.feed(encoded(Frame(1, 2, b"x"))[6:])
        ([], [Frame(type=1, sequence=2, payload=b'x')])
        """
        held = self._bytes
        held += data
        frames = []
        at = 0
        while True:
            at = held.find(SYNC, at)
            if at < 0:
                at = len(held) - 1 if held.endswith(SYNC[:1]) else len(held)
                break
            if len(held) < at + 3:
                break
            length = held[at + 2]
            if length > PAYLOAD_MAX:
                self.damaged += 1
                at += 1
                continue
            end = at + _HEAD + length + _TAIL
            if len(held) < end:
                break
            if crc16(bytes(held[at + 2 : end - _TAIL])) != int.from_bytes(held[end - _TAIL : end], "little"):
                self.damaged += 1
                at += 1
                continue
            frames.append(Frame(held[at + 3], held[at + 4], bytes(held[at + _HEAD : end - _TAIL])))
            at = end
        del held[:at]
        return frames

    def clear(self) -> None:
        """Forget what has come so far."""
        self._bytes.clear()
