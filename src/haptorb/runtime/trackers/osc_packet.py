"""The messages of an OSC packet that anybody may have sent: a message, or a bundle of messages and bundles.

python-osc reads the messages. It is not given bundles: a negative size in one keeps its reader in an endless loop
(python-osc 1.10.2).
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

from haptorb.errors import InputError

__all__ = ["read_packet"]

_BUNDLE = b"#bundle\x00"
_HEAD = 16  #: "#bundle" and the time tag [bytes]
_DEPTH = 4  #: bundles within bundles
_TYPES = frozenset(b",ihfdsTFN")  #: that messages may have; python-osc logs each one that it does not know


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
        return message.address, list(message.params)
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
