"""The records of an MCAP file in order, as far as they are whole: also of a file that was cut at any byte.

The usual readers begin at the end of the file, where a killed writer has written nothing.
"""

from __future__ import annotations

import os
import struct
import threading
from collections.abc import Callable, Iterator
from io import BytesIO
from typing import Any, BinaryIO
from zlib import crc32

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Footer, Metadata, Schema
from mcap.stream_reader import get_chunk_data_stream
from numpy.typing import NDArray
from zstandard import ZstdDecompressor, ZstdError, frame_content_size

from haptorb.errors import RecordingError

__all__ = [
    "MAGIC",
    "MESSAGE_OVERHEAD",
    "READABLE",
    "RECORD_HEAD",
    "Block",
    "check_chunk_size",
    "count_records",
    "open_messages",
    "open_record",
    "records",
    "total_room",
]

MAGIC = b"\x89MCAP0\r\n"
RECORD_HEAD = 9  #: opcode and length before every record

_MESSAGE_HEAD = 22  #: channel, sequence and two times before a message's data
MESSAGE_OVERHEAD = RECORD_HEAD + _MESSAGE_HEAD  #: bytes of a message beside its data
_CHUNK = 64 * 1024 * 1024  #: bytes of a chunk before compression: ours have 32 kB, those of other tools a few MB
_RATIO = 200  #: all chunks together over the file's size: rows with running times in them do not shrink so far
_RECORDS = 20_000  #: records of any file, and one more for every _EACH bytes of it: an index has 16 for each message
_EACH = 16
_TOO_MANY = "the recording has more records than a file of its size can have: haptorb did not write it"
_READ: dict[int, Callable[[ReadDataStream], Any]] = {
    Opcode.SCHEMA: Schema.read,
    Opcode.CHANNEL: Channel.read,
    Opcode.METADATA: Metadata.read,
    Opcode.FOOTER: Footer.read,
}
_CHUNK_HEAD = struct.Struct("<QQQII4sQ")  #: two times, size, checksum, compression of four letters, packed size
_ZSTD_HEAD = 18  #: the longest head of a packed frame
_OF_THREAD = threading.local()  #: its unpacker: one is a third faster than a new one for each chunk, and of one thread
READABLE = frozenset(_READ)  #: opcodes of what is not a message and not passed over


class Block:
    """Messages of one channel in a row, all of the same size: `data` (n, bytes)."""

    def __init__(self, channel: int, data: NDArray[np.uint8]) -> None:
        self.channel, self.data = channel, data


def total_room(size: int) -> int:
    """Bytes that all chunks of a file of `size` bytes may have when they are unpacked."""
    return _CHUNK + _RATIO * size


def count_records(size: int) -> int:
    """The most records that a file of `size` bytes can have, if haptorb wrote it."""
    return _RECORDS + size // _EACH


def check_chunk_size(claimed: int, room: int) -> None:
    """Raise RecordingError if a chunk claims more bytes than a chunk of ours can have, or than there are left."""
    if claimed > min(_CHUNK, room):  # safety: chunk-size
        raise RecordingError(
            f"a chunk of the recording claims {claimed} bytes; at most {min(_CHUNK, room)} are possible, so "
            "haptorb did not write this file"
        )


def records(file: BinaryIO) -> Iterator[Schema | Channel | Metadata | Footer | Block]:
    """Records in order; ends without a word at the first that is not whole. Other kinds are passed over.

    Raises RecordingError, before memory or time is taken, for chunks that say they are far larger than a recording's,
    and for more records than a file of its size can have.
    """
    size = os.fstat(file.fileno()).st_size
    left, room, most = size - len(MAGIC), total_room(size), count_records(size)
    file.seek(len(MAGIC))
    while left >= RECORD_HEAD:
        head = file.read(RECORD_HEAD)
        length = int.from_bytes(head[1:], "little")
        left -= RECORD_HEAD + length
        if left < 0:
            return
        try:
            found, took = open_record(head[0], file.read(length), room, most)
        except (McapError, ZstdError, ValueError, OverflowError, MemoryError, struct.error):
            return  # not whole after all: what follows cannot be trusted either
        room -= took
        most -= max(len(found), 1)
        if most <= 0:
            raise RecordingError(_TOO_MANY)
        yield from found


def open_record(opcode: int, data: bytes, room: int, most: int) -> tuple[list[Any], int]:
    """The record itself, or what is in it; and how many bytes that was, at most `room`, in at most `most` records.

    Raises RecordingError for a chunk that haptorb did not write, and ValueError for one that is not whole.
    """
    if opcode != Opcode.CHUNK:
        return list(_parse_record(opcode, data)), 0
    chunk = Chunk.read(ReadDataStream(BytesIO(data)))
    if chunk.compression == "lz4":
        raise RecordingError("a chunk of the recording is compressed with lz4; only zstd is read (mcap compress)")
    if chunk.compression not in ("", "zstd"):
        raise ValueError(f"compression {chunk.compression!r}")
    sizes = [chunk.uncompressed_size]
    if chunk.compression == "zstd":
        sizes.append(frame_content_size(chunk.data))  # -1: it does not say, and takes what the record says
    check_chunk_size(max(sizes), room)
    if chunk.uncompressed_size == 0:
        return [], 0
    stream, length = get_chunk_data_stream(chunk, validate_crc=True)
    return _parse_chunk(stream.read(length) if length else b"", most), length


def open_messages(data: bytes, channel: int, length: int) -> NDArray[np.uint8] | None:
    """(n, length) the messages [bytes] of the chunk `data`; None if it has others than those of `channel`, so long.

    Twice as fast as `open_record`, which reads all that this does not, and reports what is wrong with it.
    """
    head = struct.pack("<BQH", Opcode.MESSAGE, _MESSAGE_HEAD + length, channel)
    whole = MESSAGE_OVERHEAD + length
    if len(data) < _CHUNK_HEAD.size:
        return None
    _, _, size, checksum, letters, name, packed = _CHUNK_HEAD.unpack_from(data)
    body = memoryview(data)[_CHUNK_HEAD.size :]
    if (letters, name) != (4, b"zstd") or packed != len(body) or not 0 < size <= _CHUNK or size % whole:
        return None
    if frame_content_size(data[_CHUNK_HEAD.size : _CHUNK_HEAD.size + _ZSTD_HEAD]) != size:
        return None
    if not hasattr(_OF_THREAD, "unpacker"):
        _OF_THREAD.unpacker = ZstdDecompressor()
    try:
        unpacked = _OF_THREAD.unpacker.decompress(body, max_output_size=size)
    except ZstdError:
        return None
    if len(unpacked) != size or (checksum and crc32(unpacked) != checksum):
        return None
    block = np.frombuffer(unpacked, np.uint8).reshape(-1, whole)
    if not (block[:, : len(head)] == np.frombuffer(head, np.uint8)).all():
        return None
    return block[:, MESSAGE_OVERHEAD:]


def _parse_record(opcode: int, data: bytes) -> Iterator[Any]:
    if opcode == Opcode.MESSAGE:
        yield Block(int.from_bytes(data[:2], "little"), np.frombuffer(data, np.uint8, offset=_MESSAGE_HEAD)[None])
    elif opcode in _READ:
        yield _READ[opcode](ReadDataStream(BytesIO(data)))


def _parse_chunk(data: bytes, most: int) -> list[Any]:
    """A chunk's records; messages that are alike in channel and size as one block: fifty times faster than singly."""
    at = 0
    found: list[Any] = []
    for _ in range(most):
        if at + RECORD_HEAD > len(data):
            return found
        whole = RECORD_HEAD + int.from_bytes(data[at + 1 : at + RECORD_HEAD], "little")
        if data[at] != Opcode.MESSAGE:
            found += _parse_record(data[at], data[at + RECORD_HEAD : at + whole])
            at += whole
            continue
        alike, count = data[at : at + RECORD_HEAD + 2], 1
        while data[at + count * whole : at + count * whole + RECORD_HEAD + 2] == alike:
            count += 1
        block = np.frombuffer(data, np.uint8, count=count * whole, offset=at).reshape(count, whole)
        found.append(Block(int.from_bytes(alike[RECORD_HEAD:], "little"), block[:, MESSAGE_OVERHEAD:]))
        at += count * whole
    raise RecordingError(_TOO_MANY)
