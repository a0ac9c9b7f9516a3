"""Rows into an MCAP file, in chunks so small that a kill at any moment loses less than a tenth of a second.

No clock and no process in here: `recorder_process` feeds it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import BinaryIO, final

from mcap.writer import CompressionType, Writer

from haptorb.numerics.arrays import Array
from haptorb.runtime.recording.mcap_schema import CDR_HEADER, ENCODING, MESSAGE_ENCODING, NAME, TOPIC, schema
from haptorb.runtime.row import RowLayout
from haptorb.version import __version__

__all__ = ["CHUNK", "Recorder"]

CHUNK = 32_000  #: bytes before compression
_LONGEST = 0.04  #: time in a chunk [s]: at slow rates a full chunk would be too much to lose


@final
class Recorder:
    """Writes rows of `layout` at about `rate` [Hz] to the open binary `file`.

    `unix_minus_monotonic` [ns] turns the rows' monotonic clock into the time of day that MCAP tools show.
    """

    def __init__(self, file: BinaryIO, layout: RowLayout, rate: float, unix_minus_monotonic: int) -> None:
        self.written = 0  #: rows, of which the last ones may still wait for their chunk to be full
        self.safe_rows = 0  #: rows that are in the file
        self._size = 0
        self._file = file
        self._wall = layout["wall"].start
        self._offset = unix_minus_monotonic
        size = len(CDR_HEADER) + 8 * layout.width
        chunk = min(CHUNK, int(rate * _LONGEST) * size)
        self._writer = Writer(file, chunk_size=max(chunk, 1), compression=CompressionType.ZSTD)
        self._writer.start(profile="ros2", library=f"haptorb {__version__}")
        schema_id = self._writer.register_schema(NAME, ENCODING, schema(layout).encode())
        self._channel = self._writer.register_channel(TOPIC, MESSAGE_ENCODING, schema_id)
        counts = {key: str(getattr(layout, key)) for key in ("channels", "sensors", "contacts", "memory")}
        self.note("layout", {**counts, "rate_hz": str(rate)})
        self.note("clock", {"unix_minus_monotonic_ns": str(unix_minus_monotonic)})

    def note(self, name: str, values: Mapping[str, str]) -> None:
        """Add a metadata record 'haptorb/NAME'."""
        self._writer.add_metadata(f"haptorb/{name}", dict(values))
        self._size = self._file.tell()

    def append(self, rows: Array) -> None:
        """Add rows (n, width), then hand everything that is complete to the operating system."""
        write, channel, offset, full = self._writer.add_message, self._channel, self._offset, self.safe_rows
        for row in rows:
            time = int(row[self._wall] * 1e9) + offset
            write(channel, time, CDR_HEADER + row.tobytes(), time, self.written & 0xFFFFFFFF)
            self.written += 1
            if (size := self._file.tell()) != self._size:  # a chunk is full, and with it all rows so far
                self._size, full = size, self.written
        self._file.flush()
        self.safe_rows = full

    def finish(self) -> None:
        """Write what is left, the index and the end mark; the file is then complete."""
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._file.flush()
        self.safe_rows = self.written
