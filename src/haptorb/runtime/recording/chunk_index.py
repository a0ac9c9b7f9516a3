"""Where the rows of a long recording lie in its file, without unpacking chunks.

An hour has 100 000 chunks and gigabytes of rows. The summary at the file's end lists them; where a killed recorder has
written none, the heads of all records do, within a second. A range of rows is unpacked on request.
"""

from __future__ import annotations

import mmap
import os
import struct
import zlib
from pathlib import Path
from typing import final

import numpy as np
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from numpy.typing import NDArray
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
_END = struct.Struct("<BQQQI8s")  #: of a file: its footer, with the summary's place and checksum, and the magic bytes
_METADATA_PLACE = struct.Struct("<QQ")  #: of a record of metadata, and its length with the head
_CHUNK_PLACE = slice(RECORD_HEAD + 16, RECORD_HEAD + 32)  #: in a record that lists a chunk: its place, and its length
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
            if not self._read_summary(view):
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
        if (rows := self._contents.open_rows(data)) is not None:
            return rows
        found, _ = open_record(Opcode.CHUNK, data, total_room(len(data)), count_records(len(data)))
        parts = [rows for rows in map(self._contents.add, found) if rows is not None]
        return np.concatenate(parts) if parts else np.empty((0, self._contents.width))

    def _explain_damage(self, number: int) -> RecordingError:
        first = int(self._starts[number])
        return RecordingError(
            f"{self._path} is damaged at row {first}: rows 0 to {first - 1} before it, and those from "
            f'{int(self._starts[number + 1])} on, can be read: recording["p"][:{first}]'
        )

    def _read_summary(self, view: mmap.mmap) -> bool:
        """Take from the summary where chunks and notes are; False if there is none that is whole."""
        size = len(view)
        if size < len(MAGIC) + _END.size:
            return False
        opcode, length, start, _, checksum, magic = _END.unpack_from(view, size - _END.size)
        end = size - _END.size
        if opcode != Opcode.FOOTER or length != 20 or magic != MAGIC or not len(MAGIC) <= start < end:
            return False
        if zlib.crc32(view[start : size - len(MAGIC) - 4]) != checksum:
            return False
        summary = Contents()
        places = []
        chunks = np.empty((0, 3), dtype=np.uint64)
        at = start
        try:
            while at + RECORD_HEAD <= end:
                opcode, length = _HEAD.unpack_from(view, at)
                if opcode == Opcode.CHUNK_INDEX:
                    listed, at = _read_listed_chunks(view, at, end)
                    chunks = np.concatenate((chunks, listed))
                    continue
                at += RECORD_HEAD
                if opcode == Opcode.METADATA_INDEX:
                    places.append(_METADATA_PLACE.unpack_from(view, at))
                elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    summary.add(open_record(opcode, view[at : at + length], size, 1)[0][0])
                at += length
            notes = [
                open_record(Opcode.METADATA, view[place + RECORD_HEAD : place + long], size, 1)[0][0]
                for place, long in sorted(places)
                if view[place] == Opcode.METADATA and place + long <= start
            ]
        except (*_DAMAGE, IndexError):
            return False
        ends = chunks[:, 0] + chunks[:, 1]
        if not summary.fields or len(notes) < len(places) or (ends > start).any():
            return False
        self._take_listed_chunks(view, chunks, summary.width)
        for note in notes:
            self._contents.add(note)
        self._contents.truncated = False
        return True

    def _take_listed_chunks(self, view: mmap.mmap, chunks: NDArray[np.uint64], width: int) -> None:
        """Note where the `chunks` (n, 3) lie: place and length of each record, and its bytes when unpacked."""
        room, most = total_room(len(view)), count_records(len(view))
        each = MESSAGE_OVERHEAD + len(CDR_HEADER) + 8 * width
        check_chunk_size(int(chunks[:, 2].max(initial=0)), room - int(chunks[:-1, 2].sum()))
        plain = (chunks[:, 2] % each == 0) & (chunks[:, 2] > 0)
        first = int(plain.argmax()) if plain.any() else len(chunks)
        if not plain[first:].all():  # something else is among the rows: look at each
            first = len(chunks)
        for place, length in chunks[:first, :2].tolist():
            room -= self._take_chunk(view, place + RECORD_HEAD, length - RECORD_HEAD, room, most)
        self._offsets += (chunks[first:, 0] + RECORD_HEAD).tolist()
        self._lengths += (chunks[first:, 1] - RECORD_HEAD).tolist()
        self._counts += (chunks[first:, 2] // each).tolist()

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


def _read_listed_chunks(view: mmap.mmap, at: int, end: int) -> tuple[NDArray[np.uint64], int]:
    """(n, 3) place, length and unpacked bytes of the chunks that the records from `at` on list, which are all of one
    length; and where those records end."""
    size = RECORD_HEAD + int(_HEAD.unpack_from(view, at)[1])
    block = np.frombuffer(view[at : at + (end - at) // size * size], np.uint8).reshape(-1, size)
    alike = (block[:, :RECORD_HEAD] == block[0, :RECORD_HEAD]).all(axis=1)
    count = len(block) if alike.all() else int(alike.argmin())
    numbers = np.concatenate((block[:count, _CHUNK_PLACE], block[:count, -8:]), axis=1)
    return np.ascontiguousarray(numbers).view("<u8").astype(np.uint64), at + count * size


def _release_memory(view: mmap.mmap, first: int, last: int) -> int:
    """Have the system forget the pages of `view` from `first` up to `last`, where it can; returns where it ended."""
    end = last // mmap.PAGESIZE * mmap.PAGESIZE
    if hasattr(mmap, "MADV_DONTNEED"):
        view.madvise(mmap.MADV_DONTNEED, first, end - first)
    return end
