"""Where the rows of a long recording lie in its file: found by the heads of its records, without unpacking chunks.

An hour has 100 000 chunks and gigabytes of rows. Its heads are read in a second, and then a stretch of rows is unpacked
when somebody asks for it.
"""

from __future__ import annotations

import mmap
import os
import struct
from pathlib import Path
from typing import final

import numpy as np
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from zstandard import ZstdError

from haptorb.errors import RecordingError
from haptorb.numerics.arrays import Array
from haptorb.runtime.recording.contents import Contents
from haptorb.runtime.recording.mcap_rows import (
    MAGIC,
    MESSAGE_OVERHEAD,
    READABLE,
    RECORD_HEAD,
    check_chunk_size,
    count_records,
    open_record,
    total_room,
)
from haptorb.runtime.recording.mcap_schema import CDR_HEADER

__all__ = ["ChunkIndex"]

_HEAD = struct.Struct("<BQ")  #: of a record: what it is, and its length
_RELEASE = 16 * 1024 * 1024  #: bytes of the file after which those that were looked at need no more memory
_SIZES = struct.Struct("<QQQI")  #: of a chunk: its first and last time, its bytes when unpacked, their checksum
_DAMAGE = (McapError, ZstdError, ValueError, OverflowError, MemoryError, struct.error)


@final
class ChunkIndex:
    """The chunks of `path`, and how many rows each has; what else the file says goes into `contents`.

    A file whose end is missing is read up to its last whole chunk. Raises RecordingError for chunks that claim more
    than a recording can have.
    """

    def __init__(self, path: Path, contents: Contents) -> None:
        self._path, self._contents = path, contents
        self._offsets: list[int] = []  # of the chunks with rows, behind their record heads
        self._lengths: list[int] = []
        self._counts: list[int] = []
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as view:
            self._walk(view)
        self._starts = np.concatenate(([0], np.cumsum(np.array(self._counts, dtype=np.int64))))
        self._unpacked: tuple[int, Array] | None = None  # number and rows of the last chunk: neighbours share it

    def __len__(self) -> int:
        """Rows in all chunks."""
        return int(self._starts[-1])

    def read(self, first: int, last: int, columns: slice) -> Array:
        """(n, k) those columns of rows `first` up to `last`, n of them, each number in the unit of its field [SI].

        Raises RecordingError where a chunk is damaged, or the file has changed since it was opened.
        """
        width = len(range(*columns.indices(self._contents.width)))
        out = np.empty((max(last - first, 0), width))
        number = int(np.searchsorted(self._starts, first, side="right")) - 1
        done = 0
        try:
            with self._path.open("rb") as file:
                while done < len(out):
                    rows = self._unpack(file.fileno(), number)
                    begin = first + done - int(self._starts[number])
                    part = rows[begin : begin + len(out) - done, columns]
                    out[done : done + len(part)] = part
                    done += len(part)
                    number += 1
        except OSError as cause:
            raise RecordingError(f"cannot read {self._path}: {cause.strerror}") from cause
        return out

    def _unpack(self, descriptor: int, number: int) -> Array:
        """(n, width) the rows of chunk `number`."""
        if self._unpacked is not None and self._unpacked[0] == number:
            return self._unpacked[1]
        data = os.pread(descriptor, self._lengths[number], self._offsets[number])
        try:
            rows = self._rows_of(data)
        except _DAMAGE as cause:
            raise self._explain_damage(number) from cause
        if len(rows) != self._counts[number]:
            raise self._explain_damage(number)
        self._unpacked = (number, rows)
        return rows

    def _rows_of(self, data: bytes) -> Array:
        found, _ = open_record(Opcode.CHUNK, data, total_room(len(data)), count_records(len(data)))
        parts = [rows for rows in map(self._contents.add, found) if rows is not None]
        return np.concatenate(parts) if parts else np.empty((0, self._contents.width))

    def _explain_damage(self, number: int) -> RecordingError:
        first = int(self._starts[number])
        return RecordingError(
            f"{self._path} is damaged at row {first}: rows 0 to {first - 1} before it, and those from "
            f'{int(self._starts[number + 1])} on, can be read: recording["p"][:{first}]'
        )

    def _walk(self, view: mmap.mmap) -> None:
        """Visit every record's head; unpack a chunk only where its size does not tell how many rows it has."""
        size, at, released = len(view), len(MAGIC), 0
        room, most = total_room(size), count_records(size)
        while at + RECORD_HEAD <= size:
            opcode, length = _HEAD.unpack_from(view, at)
            at += RECORD_HEAD
            if at + length > size:
                return
            if at - released > _RELEASE:
                released = _release_memory(view, released, at)
            try:
                if opcode == Opcode.CHUNK:
                    room -= self._take_chunk(view, at, length, room, most)
                elif opcode in READABLE:
                    for found in open_record(opcode, view[at : at + length], room, most)[0]:
                        self._contents.add(found)
            except _DAMAGE:
                return  # not whole: what follows cannot be trusted either
            most -= 1
            if most <= 0:
                raise RecordingError("the recording has more records than a file of its size can have")
            at += length

    def _take_chunk(self, view: mmap.mmap, at: int, length: int, room: int, most: int) -> int:
        """Note where the chunk at `at` lies, if it has rows; returns how many bytes it has when unpacked."""
        unpacked = int(_SIZES.unpack_from(view, at)[2])
        check_chunk_size(unpacked, room)
        each = MESSAGE_OVERHEAD + len(CDR_HEADER) + 8 * self._contents.width
        count, rest = divmod(unpacked, each)
        if not self._contents.fields or rest:  # something else is in it: the first one also has the schema
            found, _ = open_record(Opcode.CHUNK, view[at : at + length], room, most)
            count = sum(len(rows) for rows in map(self._contents.add, found) if rows is not None)
        if count:
            self._offsets.append(at)
            self._lengths.append(length)
            self._counts.append(count)
        return unpacked


def _release_memory(view: mmap.mmap, first: int, last: int) -> int:
    """Have the system forget the pages of `view` from `first` up to `last`, where it can; returns where it ended."""
    end = last // mmap.PAGESIZE * mmap.PAGESIZE
    if hasattr(mmap, "MADV_DONTNEED"):
        view.madvise(mmap.MADV_DONTNEED, first, end - first)
    return end
