"""MCAP files of recordings: writer of rows in chunks, and reader that tolerates damaged and truncated files."""

from __future__ import annotations

import mmap
import os
import re
import struct
import threading
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, cast, final

import numpy as np
from lz4.frame import LZ4FrameDecompressor
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, MetadataIndex, Schema, Statistics
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray
from zstandard import ZstdDecompressor, ZstdError, frame_content_size

from haptorb.arrays import Array
from haptorb.errors import RecordingError, quote
from haptorb.files import foreign_text
from haptorb.recording.row import EARLIER_NAMES, Field, RowLayout
from haptorb.version import __version__

__all__ = [
    "CDR_HEADER",
    "CHUNK",
    "ENCODING",
    "MAGIC",
    "MESSAGE_ENCODING",
    "MESSAGE_OVERHEAD",
    "NAME",
    "TOPIC",
    "Block",
    "McapReader",
    "MissingRows",
    "Recorder",
    "describe_fields",
    "fields_of",
    "is_mcap",
    "schema",
]


# --------------------------------------------------------------------------------------------------
# Conversion between a row's layout and a ROS 2 message definition, a schema that MCAP tools can read.
#
# All fields are float64, so a message is the four-byte header of little-endian CDR followed by the bytes of the row. A
# row is read bit for bit as the loop published it.


_MAX_WIDTH = 65_536  #: limit of the length of a row [numbers]

NAME = "haptorb/msg/Tick"
ENCODING = "ros2msg"
MESSAGE_ENCODING = "cdr"
TOPIC = "/haptorb/tick"
CDR_HEADER = b"\x00\x01\x00\x00"

_LINE = re.compile(
    r"float64(?:\[(?P<width>[0-9]{1,6})\])? (?P<name>[a-z][a-z0-9_]{0,63})(?:  # \[(?P<unit>[^\]]*)\] (?P<about>.*))?"
)


def schema(layout: RowLayout) -> str:
    """ROS 2 message definition of `layout`, with unit and meaning of every field, without fields of zero width.

    >>> schema(RowLayout(channels=3, sensors=0)).splitlines()[13]
    'float64 age  # [s] age of the pose'
    """
    return describe_fields(layout.fields)


def describe_fields(fields: Iterable[Field]) -> str:
    """ROS 2 message definition of a row of `fields`."""
    lines = []
    for field in fields:
        if field.width:
            kind = "float64" if field.width == 1 else f"float64[{field.width}]"
            lines.append(f"{kind} {field.name}  # [{field.unit}] {field.about}")
    return "\n".join(lines) + "\n"


def fields_of(text: str) -> tuple[Field, ...]:
    """Parse the fields of a `schema`, with their present names. Raises RecordingError for anything but float64."""
    fields: list[Field] = []
    for line in text.splitlines():
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        match = _LINE.fullmatch(line)
        if match is None:
            raise RecordingError(f"the recording's schema has a field not written by haptorb: {quote(line)}")
        width = int(match["width"] or 1)
        if not 1 <= width + sum(field.width for field in fields) <= _MAX_WIDTH or width < 1:
            raise RecordingError(
                f"the recording's schema has more than {_MAX_WIDTH} numbers in a row, or none: {quote(line)}"
            )
        name = EARLIER_NAMES.get(match["name"], match["name"])
        if name in {field.name for field in fields}:
            raise RecordingError(f"the recording's schema has the field '{match['name']}' twice")
        unit, about = foreign_text(match["unit"] or "", 40), foreign_text(match["about"] or "", 1000)
        fields.append(Field(name, width, unit, about))
    return tuple(fields)


# --------------------------------------------------------------------------------------------------
# Writer of rows to an MCAP file. The chunks are small, so that a kill at any time loses less than 0.1 s of rows.
#
# It reads no clock and starts no process; `haptorb.runtime.recorder_process` calls it.


CHUNK = 32_000  #: size of a chunk before compression [bytes]
_MAX_CHUNK_S = 0.04  #: limit of the duration of a chunk [s], because a full chunk takes long at low rates


class _CountedFile:
    """Counts the bytes written to an open binary file, because a pipe has no position."""

    def __init__(self, file: BinaryIO) -> None:
        self.size = 0
        self._write, self.flush = file.write, file.flush

    def write(self, content: bytes) -> int:
        self.size += len(content)
        return self._write(content)

    def tell(self) -> int:
        """Position, for the MCAP writer."""
        return self.size


@final
class Recorder:
    """Writer of rows of `layout` at about `rate` [Hz] to the open binary `file`.

    `unix_minus_monotonic` [ns] converts the rows' monotonic clock to the Unix time that MCAP tools show.
    """

    def __init__(self, file: BinaryIO, layout: RowLayout, rate: float, unix_minus_monotonic: int) -> None:
        self.written = 0  #: rows appended, including those of the incomplete chunk
        self.safe_rows = 0  #: rows that are in the file
        self._size = 0
        self._file = _CountedFile(file)
        self._wall = layout["wall"].start
        self._offset = unix_minus_monotonic
        size = len(CDR_HEADER) + 8 * layout.width
        chunk = min(CHUNK, int(rate * _MAX_CHUNK_S) * size)
        self._writer = Writer(cast("BinaryIO", self._file), chunk_size=max(chunk, 1), compression=CompressionType.ZSTD)
        self._writer.start(profile="ros2", library=f"haptorb {__version__}")
        schema_id = self._writer.register_schema(NAME, ENCODING, schema(layout).encode())
        self._channel = self._writer.register_channel(TOPIC, MESSAGE_ENCODING, schema_id)
        counts = {key: str(getattr(layout, key)) for key in ("channels", "sensors", "contacts", "memory")}
        self.add_metadata("layout", {**counts, "rate_hz": str(rate)})
        self.add_metadata("clock", {"unix_minus_monotonic_ns": str(unix_minus_monotonic)})

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a metadata record 'haptorb/NAME'."""
        self._writer.add_metadata(f"haptorb/{name}", dict(values))
        self._size = self._file.size

    def append(self, rows: Array) -> None:
        """Append rows (n, width), then flush complete chunks to the operating system."""
        write, channel, offset, full = self._writer.add_message, self._channel, self._offset, self.safe_rows
        for row in rows:
            time = int(row[self._wall] * 1e9) + offset
            write(channel, time, CDR_HEADER + row.tobytes(), time, self.written & 0xFFFFFFFF)
            self.written += 1
            if (size := self._file.size) != self._size:  # a chunk was written, with all rows so far
                self._size, full = size, self.written
        self._file.flush()
        self.safe_rows = full

    def finish(self) -> None:
        """Write the last chunk, the index and the footer; the file is then complete."""
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._file.flush()
        self.safe_rows = self.written


# --------------------------------------------------------------------------------------------------
# Reader of rows and metadata of an MCAP file: all undamaged chunks of a damaged or truncated file of any length.
#
# The summary at the end of the file lists the chunks. If it is missing or damaged, the records are scanned from the
# start; after damage, the scan resumes at the next consistent record. A chunk is consistent if the lengths in its
# header agree. Its checksum is verified when it is decompressed, and determines whether its rows are valid.


MAGIC = b"\x89MCAP0\r\n"

_HEAD = struct.Struct("<BQ")  #: header of a record: opcode and length
_MESSAGE_HEAD = 22  #: channel ID, sequence number and two times before the data of a message [bytes]
MESSAGE_OVERHEAD = _HEAD.size + _MESSAGE_HEAD  #: bytes of a message in addition to its data
_CHUNK_HEAD = struct.Struct("<QQQII")  #: start and end time, size, checksum, length of the compression's name
_PACKED = struct.Struct("<Q")  #: after that name: size of the compressed records [bytes]
_FOOTER = struct.Struct("<BQQQI8s")  #: footer record: summary offsets and checksum; then the magic bytes
_COMPRESSIONS = (b"", b"lz4", b"zstd")
_RELEASE = 16 * 1024 * 1024  #: scanned bytes after which their mapped pages are released

_CHUNK = 64 * 1024 * 1024  #: limit of a chunk before compression [bytes]; haptorb: 32 kB, other tools: a few MB
_RATIO = 200  #: limit of the compression ratio of all chunks: rows with their varying times compress less
_RECORDS = 20_000  #: limit of records, plus one per _EACH bytes of the file: an index has 16 per message
_EACH = 16
_MAX_RUN_BYTES = 1024 * 1024  #: messages outside chunks that are read at once [bytes]
_FIRST_CHUNKS = 16  #: chunks searched for the channel before copies without a checksum are used
_DAMAGE = (McapError, ZstdError, RuntimeError, ValueError, OverflowError, MemoryError, IndexError, struct.error)
_TOO_MANY = "the recording has more records than a file of its size can have: haptorb did not write it"

#: starts of records at which a scan can resume after damage: chunk, metadata, schema, channel
_RESUME = re.compile(
    rb"\x06[\s\S]{5}\0{3}[\s\S]{28}(?:\x04\0\0\0zstd|\x03\0\0\0lz4|\0\0\0\0)"
    rb"|\x0c[\s\S]{5}\0{3}[\s\S]{4}haptorb/"
    rb"|\x03[\s\S]{5}\0{3}[\s\S]{2}" + struct.pack("<I", len(NAME)) + NAME.encode() +
    rb"|\x04[\s\S]{5}\0{3}[\s\S]{4}" + struct.pack("<I", len(TOPIC)) + TOPIC.encode()
)  # fmt: skip
_OF_THREAD = threading.local()  #: the thread's decompressor: not thread-safe; a third faster than one per chunk


class MissingRows(NamedTuple):
    """Position and number of consecutive missing rows.

    row         number of readable rows before them
    rows        number of missing rows; None: unknown
    start, end  time of the last readable tick before and of the first after them, on the loop's clock [s]; None: none
    """

    row: int
    rows: int | None
    start: float | None
    end: float | None


class Block:
    """Consecutive messages of one channel and one size: `records` (n, bytes), with their headers."""

    def __init__(self, records: NDArray[np.uint8]) -> None:
        self.records = records
        self.channel = int.from_bytes(records[0, _HEAD.size : _HEAD.size + 2].tobytes(), "little")

    @property
    def data(self) -> NDArray[np.uint8]:
        """Data of the messages, without headers, shape (n, bytes)."""
        return self.records[:, MESSAGE_OVERHEAD:]

    def numbers(self) -> tuple[int, int]:
        """Sequence numbers of the first and the last message."""
        pair = self.records[:: max(len(self.records) - 1, 1), _HEAD.size + 2 : _HEAD.size + 6].tobytes()
        return int.from_bytes(pair[:4], "little"), int.from_bytes(pair[-4:], "little")

    def messages(self) -> Iterator[tuple[int, int, int, bytes]]:
        """Iterate over the messages: sequence number, log time and publish time [ns], and data."""
        for record in self.records:
            _, sequence, log_time, publish_time = struct.unpack_from("<HIQQ", record, _HEAD.size)
            yield sequence, log_time, publish_time, record[MESSAGE_OVERHEAD:].tobytes()


class _Chunks:
    """Positions and sizes of the chunks, in file order: one entry per chunk in each list."""

    def __init__(self) -> None:
        self.places: list[int] = []  #: offsets of the records' contents, after their headers [bytes]
        self.lengths: list[int] = []
        self.sizes: list[int] = []  #: decompressed sizes that headers or summary state [bytes]
        self.packed: list[bool] = []  #: False: not a chunk, but messages outside chunks

    def add(self, place: int, length: int, size: int, *, packed: bool = True) -> None:
        """Append a chunk."""
        self.places.append(place)
        self.lengths.append(length)
        self.sizes.append(size)
        self.packed.append(packed)


class _Records:
    """Contents of a file's records other than rows; outside chunks, only those in the summary have a checksum."""

    def __init__(self) -> None:
        self.chunks = _Chunks()
        self.schemas: list[Schema] = []
        self.channels: list[Channel] = []
        self.notes: list[tuple[str, dict[str, str]]] = []
        self.lost_notes: list[str] = []  #: names of unreadable metadata records
        self.holes: list[tuple[int, int]] = []  #: unreadable ranges: first byte, first readable byte after it
        self.messages: dict[int, int] = {}  #: channel ID → number of messages in the file
        self.sound = False  #: from a summary with a correct checksum


def is_mcap(head: bytes) -> bool:
    """Whether a file that begins with `head` is MCAP; up to three of its eight magic bytes may be damaged.

    >>> is_mcap(MAGIC), is_mcap(b"\\x89MCAX0\\r\\n"), is_mcap(b"time [s]"), is_mcap(b"")
    (True, True, False, False)
    """
    return len(head) >= len(MAGIC) and sum(a == b for a, b in zip(head, MAGIC, strict=False)) >= len(MAGIC) - 3


def _read_at(file: int, length: int, place: int) -> bytes:
    """Read `length` bytes of the open `file` at offset `place`; Windows has no `pread`."""
    if hasattr(os, "pread"):
        return os.pread(file, length, place)
    os.lseek(file, place, os.SEEK_SET)
    return os.read(file, length)


@final
class McapReader:
    """Reader of the undamaged chunks and the metadata of the recording `path`.

    fields      from the schema in the file; empty: the file has no haptorb rows
    width       length of a row
    channel     channel ID of the rows; -1: unknown
    notes       readable metadata records: (name, values), in order
    truncated   the file's end is missing: the recorder was killed or still writes
    lost_notes  names of unreadable metadata records
    checked     all chunks were decompressed and their checksums verified, see `check`

    Raises RecordingError, before it allocates memory, for more bytes or records than a recording can have.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.fields: tuple[Field, ...] = ()
        self.width = 0
        self.checked = False
        self._schemas: dict[int, Schema] = {}
        self.channel = -1
        self._oversized: RecordingError | None = None
        self._unpacked: tuple[int, Array] | None = None  # number and rows of the last chunk read
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as view:
            size = len(view)
            self.truncated = not _has_end(view)
            found = _read_summary(view) or _walk(view)
        self._room, self._most = _CHUNK + _RATIO * size, _RECORDS + size // _EACH
        self._found, self.notes, self.lost_notes = found, found.notes, found.lost_notes
        self._holes = found.holes
        self._places = np.array(found.chunks.places, dtype=np.int64)
        self._lengths = np.array(found.chunks.lengths, dtype=np.int64)
        self._packed = np.array(found.chunks.packed, dtype=bool)
        count = len(self._places)
        self._counts = np.zeros(count, dtype=np.int64)
        self._damaged = np.zeros(count, dtype=bool)
        self._numbers = np.full((count, 2), -1, dtype=np.int64)  # sequence numbers of first and last row; -1: unknown
        sizes = np.array(found.chunks.sizes, dtype=np.uint64)
        with self._open() as opened:
            self._find_fields(opened, sizes)
            if self.fields:
                self._count_rows(opened, sizes)
        found.chunks = _Chunks()
        if self._oversized is not None and not self._counts.any():
            raise self._oversized
        self._number_rows()

    def __len__(self) -> int:
        """Number of rows in the chunks that are not known to be damaged."""
        return int(self._starts[-1])

    def read(self, first: int, last: int, columns: slice) -> Array:
        """Columns of rows `first` to `last` − 1, shape (n, k), each number in the unit of its field [SI].

        Raises RecordingError if a chunk is damaged or the file has changed since it was opened.
        """
        width = len(range(*columns.indices(self.width)))
        out = np.empty((max(last - first, 0), width))
        at = int(np.searchsorted(self._starts, first, side="right")) - 1
        done = 0
        with self._open() as file:
            while done < len(out):
                rows = self._read_rows(file, at)
                begin = first + done - int(self._starts[at])
                part = rows[begin : begin + len(out) - done, columns]
                out[done : done + len(part)] = part
                done += len(part)
                at += 1
        return out

    def check(
        self,
        first: int = 0,
        last: int | None = None,
        report: Callable[[float], None] = lambda share: None,
        take: Callable[[Array], None] | None = None,
    ) -> int:
        """Verify the chunks of rows `first` to `last` − 1 (default: all); return the number of damaged chunks.

        Damaged chunks are excluded, so that the indices of later rows decrease. `take` receives the rows (n, width) of
        the others, each field in its unit [SI].
        """
        begin, end = 0, len(self._sound)
        if last is not None:
            begin = max(int(np.searchsorted(self._starts, first, side="right")) - 1, 0)
            end = int(np.searchsorted(self._starts, last, side="left"))
        chosen = self._sound[begin:end]
        left_out = 0
        with self._open() as file:
            for done, number in enumerate(chosen.tolist()):
                try:
                    blocks = self._open_blocks(file, number)
                except _DAMAGE:
                    self._damaged[number] = True
                    left_out += 1
                    continue
                self._counts[number] = sum(len(block.records) for block in blocks)
                if take is not None:
                    take(self._decode(blocks))
                if done % 256 == 0:
                    report(done / len(chosen))
        self.checked = self.checked or last is None
        self._unpacked = None
        self._number_rows()
        return left_out

    def list_missing(self) -> tuple[list[MissingRows], list[tuple[int, int]]]:
        """Known missing rows; and the unreadable byte ranges (first, end) in which no row is missing.

        Messages have sequence numbers: a gap in them is a missing row.
        """
        holes = [*self._holes]
        holes += [(int(self._places[n]) - _HEAD.size, int(self._places[n] + self._lengths[n]))
                  for n in np.flatnonzero(self._damaged)]  # fmt: skip
        places = self._places[self._sound]
        gaps: dict[int, tuple[int, int]] = {}
        for first, end in sorted(holes):
            gap = int(np.searchsorted(places, first))
            gaps[gap] = (min(first, gaps.get(gap, (first, 0))[0]), max(end, gaps.get(gap, (0, end))[1]))
        numbers = self._number_edges([*gaps, *([len(places)] if self.truncated else [])])
        jumps = np.flatnonzero((numbers[1:, 0] >= 0) & (numbers[:-1, 1] >= 0) & (_steps(numbers) != 1)) + 1
        gaps |= {int(gap): (0, 0) for gap in jumps if int(gap) not in gaps}
        total, count = self._count_written(), len(places)
        if count not in gaps and (self.truncated or (total is not None and count and 0 <= numbers[-1, 1] < total - 1)):
            gaps[count] = (0, 0)
        missing, harmless = [], []
        for gap in sorted(gaps):
            rows = self._count_missing(gap, numbers, total)
            if rows == 0:
                if gaps[gap][1]:
                    harmless.append(gaps[gap])
                continue
            row = int(self._starts[gap])
            start = self._read_time(row - 1) if row else None
            end_time = self._read_time(row) if row < len(self) else None
            missing.append(MissingRows(row, rows, start, end_time))
        return missing, harmless

    def list_contents(self) -> Iterator[list[Any]]:
        """Iterate over the undamaged chunks, after the records outside chunks: lists of Schema, Channel and Block."""
        yield [*self._found.schemas, *self._found.channels]
        with self._open() as file:
            for number in range(len(self._places)):
                if not self._damaged[number]:
                    try:
                        yield self._read_records(file, number)
                    except _DAMAGE:
                        continue

    @contextmanager
    def _open(self) -> Iterator[int]:
        """A descriptor of the file. Raises RecordingError if it cannot be read."""
        try:
            with self._path.open("rb") as file:
                yield file.fileno()
        except OSError as cause:
            raise RecordingError(f"cannot read {self._path}: {cause.strerror}") from cause

    def _read_rows(self, file: int, at: int) -> Array:
        """Rows of the chunk with index `at` among the undamaged chunks with rows, shape (n, width)."""
        number = int(self._sound[at])
        if self._unpacked is not None and self._unpacked[0] == number:
            return self._unpacked[1]
        try:
            rows = self._open_chunk(file, number)
        except _DAMAGE as cause:
            raise self._explain_damage(at) from cause
        if len(rows) != self._counts[number]:
            raise self._explain_damage(at)
        self._unpacked = (number, rows)
        return rows

    def _explain_damage(self, at: int) -> RecordingError:
        first, end = int(self._starts[at]), int(self._starts[at + 1])
        return RecordingError(
            f"{self._path} is damaged at row {first}: rows 0 to {first - 1} before it, and those from {end} on, can be "
            'read: recording["p"]'
            f"[:{first}]; recording.check() finds all damaged rows, and leaves them out"
        )

    def _open_chunk(self, file: int, number: int) -> Array:
        """Rows of chunk `number`, shape (n, width) [SI]. Raises one of _DAMAGE."""
        return self._decode(self._open_blocks(file, number))

    def _open_blocks(self, file: int, number: int) -> list[Block]:
        """Row messages of chunk `number`; stores their sequence numbers. Raises one of _DAMAGE."""
        body, whole = self._read_chunk(file, number), MESSAGE_OVERHEAD + len(CDR_HEADER) + 8 * self.width
        head = struct.pack("<BQH", Opcode.MESSAGE, whole - _HEAD.size, self.channel & 0xFFFF)
        blocks = []
        if body and not len(body) % whole:
            block = np.frombuffer(body, np.uint8).reshape(-1, whole)
            if block[:, : len(head)].tobytes() == head * len(block):
                blocks = [Block(block)]
        if not blocks:
            records = _parse_records(body, self._most)
            for record in records:
                self._apply_schema(record)
            blocks = [one for one in records if isinstance(one, Block) and one.channel == self.channel]
        if blocks:
            self._numbers[number] = blocks[0].numbers()[0], blocks[-1].numbers()[1]
        return blocks

    def _decode(self, blocks: list[Block]) -> Array:
        """Decode messages, a CDR header of four bytes and a row each, to rows (n, width)."""
        rows = [np.empty((0, self.width))]
        for block in blocks:
            if block.data.shape[1] != len(CDR_HEADER) + 8 * self.width:
                raise RecordingError(f"a message has {block.data.shape[1]} bytes; its schema says {4 + 8 * self.width}")
            rows.append(np.ascontiguousarray(block.data[:, len(CDR_HEADER) :]).view("<f8"))
        return rows[1] if len(rows) == 2 else np.concatenate(rows)

    def _read_records(self, file: int, number: int) -> list[Any]:
        return _parse_records(self._read_chunk(file, number), self._most)

    def _read_chunk(self, file: int, number: int) -> bytes:
        """Decompressed records of chunk `number`. Raises one of _DAMAGE."""
        length = int(self._lengths[number])
        data = _read_at(file, length, int(self._places[number]))
        if len(data) != length:
            raise ValueError("the file has become shorter")
        return _unpack(data) if self._packed[number] else data

    def _find_fields(self, file: int, sizes: NDArray[np.uint64]) -> None:
        """Find the fields in a valid summary, else in a chunk with the channel, else in a copy without checksum."""
        found = self._found
        if found.sound and found.channels:
            for record in (*found.schemas, *found.channels):
                self._apply_schema(record)
            return
        room = self._room
        for number in range(len(self._places)):
            if number == _FIRST_CHUNKS and (found.channels or any(s.name == NAME for s in found.schemas)):
                break
            try:
                data = self._read_chunk(file, number)
                room -= len(data)
                _check_room(room)
                records = _parse_records(data, self._most)
            except _Oversized as cause:
                self._oversized = self._oversized or cause
                self._damaged[number] = True
                continue
            except _DAMAGE:
                self._damaged[number] = True
                continue
            for record in records:
                self._apply_schema(record)
            if self.fields:
                return
        doubt: RecordingError | None = None
        try:
            for record in (*found.schemas, *found.channels):
                self._apply_schema(record)
        except RecordingError as cause:  # damaged, or written by another program
            doubt = cause
        self._check_fields_by_size(file, sizes)
        if doubt is not None and not self.fields:
            raise doubt

    def _check_fields_by_size(self, file: int, sizes: NDArray[np.uint64]) -> None:
        """Use the fields of the layout metadata, a second copy, if they fit the chunk sizes at least as well."""
        noted = next((values for name, values in self.notes if name == "haptorb/layout"), None)
        try:
            keys = ("channels", "sensors", "contacts", "memory")
            layout = None if noted is None else RowLayout(*(int(noted[key]) for key in keys))
        except (KeyError, ValueError, TypeError):
            layout = None
        if layout is None:
            return
        fields = tuple(field for field in layout.fields if field.width)
        fits = [int((sizes % (MESSAGE_OVERHEAD + len(CDR_HEADER) + 8 * width) == 0).sum()) if width else -1
                for width in (sum(field.width for field in fields), self.width)]  # fmt: skip
        if fits[0] and fits[0] >= fits[1]:
            self.fields, self.width = fields, sum(field.width for field in fields)
        if self.fields and self.channel < 0:
            self.channel = self._guess_channel(file)

    def _guess_channel(self, file: int) -> int:
        """Channel ID of the first readable message; -1 if there is none."""
        for number in np.flatnonzero(~self._damaged).tolist():
            try:
                blocks = [one for one in self._read_records(file, number) if isinstance(one, Block)]
            except _DAMAGE:
                continue
            if blocks:
                return blocks[0].channel
        return -1

    def _apply_schema(self, found: Any) -> None:
        """Set the fields from the channel of the haptorb topic. Raises RecordingError if type or fields conflict."""
        if isinstance(found, Schema):
            self._schemas[found.id] = found
        if not isinstance(found, Channel) or found.topic != TOPIC:
            return
        kind = self._schemas.get(found.schema_id)
        if kind is None or kind.name != NAME:
            raise RecordingError(f"topic {TOPIC} is not of type {NAME}; another program wrote it")
        fields = fields_of(kind.data.decode("utf-8", "replace"))
        if self.fields and fields != self.fields:
            raise RecordingError(f"topic {TOPIC} appears twice, with different fields")
        self.fields, self.channel = fields, found.id
        self.width = sum(field.width for field in fields)

    def _count_rows(self, file: int, sizes: NDArray[np.uint64]) -> None:
        """Count the rows of each chunk: from its size if it can contain only rows, else by decompression."""
        each = MESSAGE_OVERHEAD + len(CDR_HEADER) + 8 * self.width
        plain = (sizes % each == 0) & (sizes > 0) & (sizes <= _CHUNK)
        self._counts = np.where(plain & ~self._damaged, sizes // each, 0).astype(np.int64)
        _check_room(self._room - int(sizes[plain].sum()))
        room = self._room
        for number in np.flatnonzero(~plain & ~self._damaged).tolist():
            if not sizes[number]:
                continue
            try:
                room -= len(self._read_chunk(file, number))
                _check_room(room)
                self._counts[number] = len(self._open_chunk(file, number))
            except _Oversized as cause:
                self._oversized = self._oversized or cause
                self._damaged[number] = True
            except _DAMAGE:
                self._damaged[number] = True

    def _number_rows(self) -> None:
        self._sound = np.flatnonzero((self._counts > 0) & ~self._damaged)
        self._starts = np.concatenate(([0], np.cumsum(self._counts[self._sound])))

    def _number_edges(self, gaps: Sequence[int]) -> NDArray[np.int64]:
        """Sequence numbers of the first and last row of each undamaged chunk, shape (n, 2); -1: unknown.

        Decompresses the chunks beside the `gaps` and, if there are gaps, the last chunk.
        """
        count = len(self._sound)
        with self._open() as file:
            for at in {n for gap in gaps for n in (gap - 1, gap)} | ({count - 1} if gaps else set()):
                if 0 <= at < count and self._numbers[self._sound[at], 0] < 0:
                    try:
                        self._open_chunk(file, int(self._sound[at]))
                    except _DAMAGE:
                        continue
        numbers = self._numbers[self._sound]
        known = numbers[:, 0] >= 0
        spans = (numbers[:, 1] - numbers[:, 0]) % 2**32 + 1
        if 2 * (spans[known] != self._counts[self._sound][known]).sum() > known.sum():  # unnumbered messages
            return np.full_like(numbers, -1)
        return numbers

    def _count_written(self) -> int | None:
        """Number of rows written, from the end of the file; None: unknown."""
        noted = dict(self.notes).get("haptorb/end", {}).get("rows", "")
        if noted.isascii() and noted.isdecimal() and len(noted) <= 15:
            return int(noted)
        return self._found.messages.get(self.channel)

    def _count_missing(self, gap: int, numbers: NDArray[np.int64], total: int | None) -> int | None:
        """Number of rows missing between two undamaged chunks, before the first or after the last; None: unknown."""
        before = int(numbers[gap - 1, 1]) if gap else -1
        if gap and before < 0:
            return None
        if gap < len(numbers):
            after = int(numbers[gap, 0])
            return None if after < 0 else (after - before - 1) % 2**32
        return None if total is None else max(total - before - 1, 0)

    def _read_time(self, row: int) -> float | None:
        """Time of row `row` [s]; None if its chunk is damaged, or rows have no time."""
        at = 0
        for field in self.fields:
            if field.name == "t" and field.width == 1:
                try:
                    return float(self.read(row, row + 1, slice(at, at + 1))[0, 0])
                except RecordingError:
                    return None
            at += field.width
        return None


class _Oversized(RecordingError, ValueError):
    """A chunk claims more bytes than a chunk can have."""


def _check_size(claimed: int) -> None:
    if claimed > _CHUNK:  # safety: chunk-size
        raise _Oversized(
            f"a chunk of the recording claims {claimed} bytes; at most {_CHUNK} are possible: haptorb did not write it"
        )


def _check_room(left: int) -> None:
    """Raise RecordingError if the chunks claim more bytes than those of a file of its size can have."""
    if left < 0:
        raise RecordingError(
            f"the recording claims {-left} bytes more than the chunks of a file of its size can have: haptorb did not "
            "write it"
        )


def _unpack(data: bytes) -> bytes:
    """Decompress the chunk `data`. Raises one of _DAMAGE if it disagrees with its header or its checksum."""
    _, _, size, checksum, letters = _CHUNK_HEAD.unpack_from(data)
    name = data[_CHUNK_HEAD.size : _CHUNK_HEAD.size + min(letters, 8)]
    (packed,) = _PACKED.unpack_from(data, _CHUNK_HEAD.size + len(name))
    body = memoryview(data)[_CHUNK_HEAD.size + len(name) + _PACKED.size :]
    if name not in _COMPRESSIONS or packed != len(body):
        raise ValueError("the head of a chunk is damaged")
    _check_size(size)
    if not size:
        return b""
    if name == b"zstd":
        claimed = frame_content_size(data[-packed:][:18])  # -1: the frame does not state it; the chunk's header does
        _check_size(claimed)
        if claimed not in (-1, size):
            raise ValueError("a chunk has another size than its head says")
        if not hasattr(_OF_THREAD, "unpacker"):
            _OF_THREAD.unpacker = ZstdDecompressor()
        unpacked: bytes = _OF_THREAD.unpacker.decompress(body, max_output_size=size)
    elif name == b"lz4":
        unpacked = LZ4FrameDecompressor().decompress(body, max_length=size + 1)
    else:
        unpacked = bytes(body)
    if len(unpacked) != size or (checksum and zlib.crc32(unpacked) != checksum):
        raise ValueError("a chunk is not what its checksum says")
    return unpacked


def _parse_records(data: bytes, most: int) -> list[Any]:
    """Parse the records of a chunk into Schema, Channel and Block.

    Consecutive messages of one channel and size become one Block, 50 times faster than one by one.
    """
    at = 0
    found: list[Any] = []
    for _ in range(most):
        if at + _HEAD.size > len(data):
            return found
        whole = _HEAD.size + int.from_bytes(data[at + 1 : at + _HEAD.size], "little")
        if at + whole > len(data):
            raise ValueError("a record in a chunk is not whole")
        if data[at] != Opcode.MESSAGE:
            if data[at] in (Opcode.SCHEMA, Opcode.CHANNEL):
                found.append(_parse_exactly(data[at], data[at + _HEAD.size : at + whole]))
            at += whole
            continue
        if whole < MESSAGE_OVERHEAD:
            raise ValueError("a message is shorter than its head")
        count = _count_alike(data, at, whole)
        found.append(Block(np.frombuffer(data, np.uint8, count=count * whole, offset=at).reshape(count, whole)))
        at += count * whole
    raise RecordingError(_TOO_MANY)


def _count_alike(data: bytes | mmap.mmap, at: int, whole: int, most: int = 2**62) -> int:
    """Number of consecutive complete messages at `at` with the length `whole` and the channel of the first."""
    alike, count, size = data[at : at + _HEAD.size + 2], 1, len(data)
    while count < most and at + (count + 1) * whole <= size:
        if data[at + count * whole : at + count * whole + _HEAD.size + 2] != alike:
            break
        count += 1
    return count


def _parse_exactly(opcode: int, data: bytes) -> Schema | Channel | Metadata | Statistics | MetadataIndex:
    """Parse the record that fills `data` exactly. Raises one of _DAMAGE if it does not."""
    kinds: dict[int, Any] = {
        Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel, Opcode.METADATA: Metadata, Opcode.STATISTICS: Statistics,
        Opcode.METADATA_INDEX: MetadataIndex,
    }  # fmt: skip
    stream = BytesIO(data)
    found: Schema | Channel | Metadata | Statistics | MetadataIndex = kinds[opcode].read(ReadDataStream(stream))
    if stream.tell() != len(data):
        raise ValueError("a record has another length than its head says")
    return found


def _has_end(view: mmap.mmap) -> bool:
    """Whether the file has its end: the footer record or the magic bytes after it."""
    size = len(view)
    if size < len(MAGIC) + _FOOTER.size:
        return False
    opcode, length, *_, magic = _FOOTER.unpack_from(view, size - _FOOTER.size)
    return (opcode, length) == (Opcode.FOOTER, 20) or magic == MAGIC


def _read_summary(view: mmap.mmap) -> _Records | None:
    """Read the summary and the metadata records that it lists; None unless its checksum is correct."""
    size = len(view)
    if size < len(MAGIC) + _FOOTER.size:
        return None
    opcode, length, start, _, checksum, _ = _FOOTER.unpack_from(view, size - _FOOTER.size)
    end = size - _FOOTER.size
    if opcode != Opcode.FOOTER or length != 20 or not len(MAGIC) <= start < end or not checksum:
        return None
    if zlib.crc32(view[start : size - len(MAGIC) - 4]) != checksum:
        return None
    found, at = _Records(), start
    listed = [np.empty((0, 3), dtype=np.uint64)]
    places: list[MetadataIndex] = []
    counted: Statistics | None = None
    try:
        while at + _HEAD.size <= end:
            opcode, length = _HEAD.unpack_from(view, at)
            if opcode == Opcode.CHUNK_INDEX:
                some, at = _read_listed_chunks(view, at, end)
                listed.append(some)
                continue
            at += _HEAD.size
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA_INDEX, Opcode.STATISTICS):
                one = _parse_exactly(opcode, view[at : at + length])
                if isinstance(one, Schema):
                    found.schemas.append(one)
                elif isinstance(one, Channel):
                    found.channels.append(one)
                elif isinstance(one, MetadataIndex):
                    places.append(one)
                elif isinstance(one, Statistics):
                    counted = one
            at += length
    except _DAMAGE:
        return None
    chunks = np.concatenate(listed)
    chunks = chunks[np.argsort(chunks[:, 0], kind="stable")]
    places.sort(key=lambda one: one.offset)
    # An index may list a record once: the contents then make no more memory than the file allows.
    if not _are_apart([(int(first), int(length)) for first, length in chunks[:, :2].tolist()], start):
        return None
    if not _are_apart([(one.offset, one.length) for one in places], start):
        return None
    if counted is not None:
        found.messages = dict(counted.channel_message_counts)
        if counted.chunk_count != len(chunks) or counted.metadata_count != len(places):
            return None  # the index is incomplete
        if counted.message_count and not len(chunks):
            return None  # its messages are outside chunks
    elif not len(chunks):
        return None
    found.chunks.places = (chunks[:, 0] + _HEAD.size).tolist()
    found.chunks.lengths = (chunks[:, 1] - _HEAD.size).tolist()
    found.chunks.sizes = chunks[:, 2].tolist()
    found.chunks.packed = [True] * len(chunks)
    for place in places:
        try:
            note = _parse_exactly(Opcode.METADATA, view[place.offset + _HEAD.size : place.offset + place.length])
            assert isinstance(note, Metadata)
            if note.name != place.name:
                raise ValueError("a note has another name than the summary says")
            found.notes.append((note.name, dict(note.metadata)))
        except _DAMAGE:
            found.lost_notes.append(place.name)
    found.sound = True
    return found


def _are_apart(records: Sequence[tuple[int, int]], end: int) -> bool:
    """Whether `records`, each its first byte and its length with head, in order, overlap nowhere and stop at `end`."""
    at = len(MAGIC)
    for first, length in records:
        if first < at or length < _HEAD.size or first + length > end:  # safety: listed-once
            return False
        at = first + length
    return True


def _read_listed_chunks(view: mmap.mmap, at: int, end: int) -> tuple[NDArray[np.uint64], int]:
    """Read consecutive chunk index records of equal length at `at`; also returns the offset of their end.

    The array (n, 3) contains offset, length and decompressed size of each chunk [bytes].
    """
    size = _HEAD.size + int(_HEAD.unpack_from(view, at)[1])
    if not _HEAD.size + 48 <= size <= end - at:
        raise ValueError("a record of the index is not whole")
    block = np.frombuffer(view[at : at + (end - at) // size * size], np.uint8).reshape(-1, size)
    alike = (block[:, : _HEAD.size] == block[0, : _HEAD.size]).all(axis=1)
    count = len(block) if alike.all() else int(alike.argmin())
    places = slice(_HEAD.size + 16, _HEAD.size + 32)  # after the times of the chunk: its offset and its length
    numbers = np.concatenate((block[:count, places], block[:count, -8:]), axis=1)
    return np.ascontiguousarray(numbers).view("<u8").astype(np.uint64), at + count * size


def _walk(view: mmap.mmap) -> _Records:
    """Scan the headers of all records; after damage, resume at the next consistent record."""
    size, at, released, found = len(view), len(MAGIC), 0, _Records()
    most = _RECORDS + size // _EACH
    end = size - len(MAGIC) if view[size - len(MAGIC) :] == MAGIC else size
    while at < end:
        most -= 1
        if most <= 0:
            raise RecordingError(_TOO_MANY)
        if at - released > _RELEASE:
            released = _release_memory(view, released, at)
        length = _parse_record(view, at, found)
        if length is not None:
            at += length
            continue
        after, tried = _find_record(view, at + 1)
        most -= tried
        if after < size:
            found.holes.append((at, after))
        elif _has_end(view):
            found.holes.append((at, size))
        at = after
    return found


def _parse_record(view: mmap.mmap, at: int, found: _Records) -> int | None:
    """Add the record at `at` to `found` if it is consistent; return its length with header, else None."""
    size = len(view)
    if at + _HEAD.size > size:
        return None
    opcode, length = _HEAD.unpack_from(view, at)
    body, end = at + _HEAD.size, at + _HEAD.size + length
    if not opcode or end > size:
        return None
    if opcode == Opcode.CHUNK:
        if not _is_chunk(view, body, length):
            return None
        found.chunks.add(body, length, _CHUNK_HEAD.unpack_from(view, body)[2])
        return int(end - at)
    if opcode == Opcode.MESSAGE:
        if length < _MESSAGE_HEAD or not _is_head(view, end):
            return None
        whole = int(end - at)
        count = _count_alike(view, at, whole, max(_MAX_RUN_BYTES // whole, 1))
        found.chunks.add(at, count * whole, count * whole, packed=False)
        return count * whole
    if opcode == Opcode.MESSAGE_INDEX:
        return (
            int(end - at) if length >= 6 and int.from_bytes(view[body + 2 : body + 6], "little") == length - 6 else None
        )
    if opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA, Opcode.STATISTICS):
        try:
            one = _parse_exactly(opcode, view[body:end])
        except _DAMAGE:
            return None
        if isinstance(one, Metadata):
            found.notes.append((one.name, dict(one.metadata)))
        elif isinstance(one, Schema):
            found.schemas.append(one)
        elif isinstance(one, Channel):
            found.channels.append(one)
        elif isinstance(one, Statistics):
            found.messages = dict(one.channel_message_counts)
        return int(end - at)
    return int(end - at) if _is_head(view, end) else None


def _is_chunk(view: mmap.mmap, body: int, length: int) -> bool:
    """Whether the lengths in the header of a chunk agree."""
    if length < _CHUNK_HEAD.size + _PACKED.size:
        return False
    letters = int(_CHUNK_HEAD.unpack_from(view, body)[4])
    begin = body + _CHUNK_HEAD.size
    if letters > 4 or _CHUNK_HEAD.size + letters + _PACKED.size > length:
        return False
    if view[begin : begin + letters] not in _COMPRESSIONS:
        return False
    return _CHUNK_HEAD.size + letters + _PACKED.size + int(_PACKED.unpack_from(view, begin + letters)[0]) == length


def _is_head(view: mmap.mmap, at: int) -> bool:
    """Whether a record can begin, or the file can end, at `at`."""
    size = len(view)
    if at == size or (at == size - len(MAGIC) and view[at:] == MAGIC):
        return True
    if at + _HEAD.size > size:
        return not _has_end(view)
    opcode, length = _HEAD.unpack_from(view, at)
    return (0 < opcode <= int(Opcode.DATA_END) or opcode >= 0x80) and bool(at + _HEAD.size + length <= size)


def _find_record(view: mmap.mmap, at: int) -> tuple[int, int]:
    """Offset of the next consistent record (the file size if there is none), and number of candidates tried."""
    tried, found = 0, _RESUME.search(view, at)
    while found is not None:
        tried += 1
        if _parse_record(view, found.start(), _Records()) is not None:
            return found.start(), tried
        found = _RESUME.search(view, found.start() + 1)
    return len(view), tried


def _release_memory(view: mmap.mmap, first: int, last: int) -> int:
    """Release mapped pages of `view` from `first` to `last` if the system supports it; return their end."""
    end = last // mmap.PAGESIZE * mmap.PAGESIZE
    if hasattr(mmap, "MADV_DONTNEED"):
        view.madvise(mmap.MADV_DONTNEED, first, end - first)
    return end


def _steps(numbers: NDArray[np.int64]) -> NDArray[np.int64]:
    """Steps from the last row of each chunk to the first of the next, shape (n - 1,) [rows]."""
    steps: NDArray[np.int64] = (numbers[1:, 0] - numbers[:-1, 1]) % 2**32
    return steps
