"""The records of an MCAP file in order, as far as they are whole: also of a file that was cut at any byte.

The usual readers begin at the end of the file, where a killed writer has written nothing.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from io import BytesIO
from typing import Any, BinaryIO

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Footer, Metadata, Schema
from mcap.stream_reader import get_chunk_data_stream
from numpy.typing import NDArray
from zstandard import ZstdError

__all__ = ["MAGIC", "Block", "records"]

MAGIC = b"\x89MCAP0\r\n"

_HEAD = 9  #: opcode and length before every record
_MESSAGE_HEAD = 22  #: channel, sequence and two times before a message's data
_READ: dict[int, Callable[[ReadDataStream], Any]] = {
    Opcode.SCHEMA: Schema.read,
    Opcode.CHANNEL: Channel.read,
    Opcode.METADATA: Metadata.read,
    Opcode.CHUNK: Chunk.read,
    Opcode.FOOTER: Footer.read,
}


class Block:
    """Messages of one channel in a row, all of the same size: `data` (n, bytes)."""

    def __init__(self, channel: int, data: NDArray[np.uint8]) -> None:
        self.channel, self.data = channel, data


def records(file: BinaryIO) -> Iterator[Schema | Channel | Metadata | Footer | Block]:
    """Records in order; ends without a word at the first that is not whole. Other kinds are passed over."""
    left = os.fstat(file.fileno()).st_size - len(MAGIC)
    file.seek(len(MAGIC))
    while left >= _HEAD:
        head = file.read(_HEAD)
        length = int.from_bytes(head[1:], "little")
        left -= _HEAD + length
        if left < 0:
            return
        try:
            found = list(_opened(head[0], file.read(length)))
        except (McapError, ZstdError, ValueError, MemoryError):
            return  # not whole after all: what follows cannot be trusted either
        yield from found


def _opened(opcode: int, data: bytes) -> Iterator[Any]:
    """The record itself, or what is in it."""
    if opcode == Opcode.MESSAGE:
        yield Block(int.from_bytes(data[:2], "little"), np.frombuffer(data, np.uint8, offset=_MESSAGE_HEAD)[None])
    elif opcode in _READ:
        record = _READ[opcode](ReadDataStream(BytesIO(data)))
        if isinstance(record, Chunk):
            stream, length = get_chunk_data_stream(record, validate_crc=True)
            yield from _in_chunk(stream.read(length) if length else b"")
        else:
            yield record


def _in_chunk(data: bytes) -> Iterator[Any]:
    """A chunk's records; messages that are alike in channel and size as one block: fifty times faster than singly."""
    at = 0
    while at + _HEAD <= len(data):
        whole = _HEAD + int.from_bytes(data[at + 1 : at + _HEAD], "little")
        if data[at] != Opcode.MESSAGE:
            yield from _opened(data[at], data[at + _HEAD : at + whole])
            at += whole
            continue
        alike, count = data[at : at + _HEAD + 2], 1
        while data[at + count * whole : at + count * whole + _HEAD + 2] == alike:
            count += 1
        block = np.frombuffer(data, np.uint8, count=count * whole, offset=at).reshape(count, whole)
        yield Block(int.from_bytes(alike[_HEAD:], "little"), block[:, _HEAD + _MESSAGE_HEAD :])
        at += count * whole
