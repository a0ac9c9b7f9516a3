"""A recording as arrays: read whole, also where a kill or a full disk cut it short."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, final

import numpy as np
from numpy.typing import NDArray

from haptorb.display.html import facts_html
from haptorb.errors import RecordingError, UnknownName, quote
from haptorb.files.replace_file import replace_file
from haptorb.files.text_file import open_at_once
from haptorb.numerics.arrays import Array
from haptorb.runtime.recording.data_frames import column_heads, list_columns, make_data_frame, make_dataset
from haptorb.runtime.recording.mcap_rows import MAGIC, Block, records
from haptorb.runtime.recording.mcap_schema import CDR_HEADER, NAME, TOPIC, fields_of
from haptorb.runtime.recording.recorded_memory import memory_units, read_memory
from haptorb.runtime.recording.recording_plot import plot
from haptorb.runtime.recording.recording_summary import draw_force, list_facts, summarize
from haptorb.runtime.row import Field, RowLayout

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame
    from xarray import Dataset

__all__ = ["Recording"]


@final
class Recording:
    """Rows of a haptorb recording (MCAP), and what was noted beside them.

    `recording["p"]` is the field `p` of all ticks, shape (n, 3), or (n,) for a single number.
    """

    def __init__(self, path: str | Path) -> None:
        """Read the file. Raises RecordingError if it is not there, is no MCAP file, or holds no haptorb rows."""
        self.path = Path(path)
        self.truncated = True  #: the file has no end: the recorder was killed, or still writes
        self.notes: list[tuple[str, dict[str, str]]] = []  #: every metadata record: (name, values), in order
        self.fields: tuple[Field, ...] = ()  #: as the file's own schema describes them
        self._channel = 0
        with _open_file(self.path) as file:
            try:
                parts = list(self._parts(file))
            except RecordingError as cause:
                raise RecordingError(f"{self.path}: {cause}") from cause
            except OSError as cause:
                raise RecordingError(f"cannot read {self.path}: {cause.strerror}") from cause
        if not self.fields:
            cut = "it was cut short before its first rows" if self.truncated else f"topic {TOPIC} is missing"
            raise RecordingError(f"{self.path} holds no haptorb recording: {cut}")
        width = sum(field.width for field in self.fields)
        try:
            self.rows: Array = np.concatenate(parts) if parts else np.empty((0, width))  #: (n, width) bit for bit
        except MemoryError as cause:
            raise RecordingError(f"{self.path} is too large for the memory of this computer") from cause
        self._at: dict[str, slice] = {}
        start = 0
        for field in self.fields:
            self._at[field.name] = slice(start, start + field.width)
            start += field.width

    def __len__(self) -> int:
        """Rows recorded."""
        return len(self.rows)

    def __getitem__(self, name: str) -> Array:
        """A field of all ticks, shape (n, width), or (n,) where the width is 1. UnknownName if there is no such."""
        if name not in self._at:
            raise UnknownName("field", name, self._at)
        values: Array = self.rows[:, self._at[name]]
        return values[:, 0] if values.shape[1] == 1 else values

    @property
    def t(self) -> Array:
        """(n,) time on the loop's clock [s]."""
        return self["t"]

    @cached_property
    def metadata(self) -> dict[str, dict[str, str]]:
        """The last metadata record of every name, without its 'haptorb/': device, run, versions, clock, layout, end."""
        return {name.removeprefix("haptorb/"): values for name, values in self.notes}

    @property
    def worlds(self) -> list[dict[str, str]]:
        """The worlds that were felt, in order: change (number), tick (about which), world (JSON)."""
        return [values for name, values in self.notes if name == "haptorb/world"]

    @cached_property
    def memory(self) -> dict[str, Array]:
        """What worlds with memory remembered: `memory["ball.place"]` is the field `place` of the world `ball` in all
        ticks, shape (n, 3), or (n,) for a single number; NaN in ticks of other worlds."""
        return read_memory(self)

    @property
    def memory_units(self) -> dict[str, str]:
        """The unit of each field of `memory`."""
        return memory_units(self.worlds)

    @property
    def errors(self) -> list[dict[str, str]]:
        """What failed worlds and drivers said, in order: tick (about which), text (with file and line of a world)."""
        return [values for name, values in self.notes if name == "haptorb/error"]

    @property
    def lost(self) -> int:
        """Rows that the recorder could not fetch in time. RecordingError if the file says no number."""
        return sum(self._parse_count(values, "rows") for name, values in self.notes if name == "haptorb/gap")

    @property
    def layout(self) -> RowLayout:
        """The layout of `rows`. Raises RecordingError if another version of haptorb ordered them otherwise."""
        noted = self.metadata.get("layout", {})
        # rows without a note of contacts had two, of any device; those without one of memory had none
        without = {"channels": 0, "sensors": 0, "contacts": 2, "memory": 0}
        layout = RowLayout(*(self._parse_count(noted, key) if key in noted else n for key, n in without.items()))
        mine = [(field.name, field.width) for field in layout.fields if field.width]
        if mine != [(field.name, field.width) for field in self.fields]:
            raise RecordingError(f"{self.path} was written by another version of haptorb; read its fields by name")
        return layout

    def require(self, *names: str) -> None:
        """Raise RecordingError unless there are fields `names` as wide as this version of haptorb writes them.

        Those of coils, sensors, contacts and memory may have any width.
        """
        wide = {field.name: field.width for field in RowLayout(0, 0).fields if field.width}
        found = {field.name: field.width for field in self.fields}
        for name in names:
            if found.get(name) is None or found[name] != wide.get(name, found[name]):
                raise RecordingError(
                    f"{self.path}: field '{name}' must have {wide.get(name, 'some')} numbers; got "
                    f"{found.get(name, 0)}: another version of haptorb wrote it, or another program"
                )

    def _parse_count(self, values: dict[str, str], key: str) -> int:
        text = values.get(key, "")
        if not (text.isascii() and text.isdecimal() and len(text) <= 15):
            raise RecordingError(f"{self.path}: a note's '{key}' must be a whole number; got {quote(text)}")
        return int(text)

    def to_csv(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write all rows as text, one column per number, headed `p[0] [m]` as in the console's CSV, every digit kept.

        UTF-8. Nothing is written half.

        Raises RecordingError if the file exists and `overwrite` is not set, or if it cannot be written.
        """
        path = Path(path)
        try:
            if path.exists() and not overwrite:
                raise RecordingError(f"{path} exists; choose another name, or replace it with overwrite=True")
        except OSError as cause:
            raise RecordingError(f"cannot write {path}: {cause.strerror}") from cause
        columns = list_columns(self)
        heads = [head for field, _ in columns for head in column_heads(field)]
        rows = np.concatenate([values.reshape(len(self), field.width) for field, values in columns], axis=1)
        try:
            with replace_file(path) as part, part.open("w", encoding="utf-8") as file:
                file.write(",".join(heads) + "\n")
                for row in rows.tolist():
                    file.write(",".join(map(repr, row)) + "\n")
        except OSError as cause:
            raise RecordingError(f"cannot write {path}: {cause.strerror}") from cause

    def to_pandas(self) -> DataFrame:
        """All rows as a DataFrame: one column per number, named `p[0]`, the index `t` [s].

        `attrs["units"]` and `attrs["about"]` say of each column what it is. Raises InputError if pandas is not there.
        """
        return make_data_frame(self)

    def to_xarray(self) -> Dataset:
        """All rows as a Dataset over `t` [s]: one variable per field, with `units` and `long_name` in its `attrs`.

        Raises InputError if xarray is not there.
        """
        return make_dataset(self)

    def __repr__(self) -> str:
        return summarize(self)

    def _repr_html_(self) -> str:
        return facts_html(f"Recording {self.path.name}", list_facts(self), draw_force(self))

    def plot(self, path: str | Path | None = None) -> Figure:
        """A figure of the run: force asked and given, currents, temperatures, lateness; written to `path` (PNG, SVG,
        PDF) if one is given. Raises RecordingError if there are no rows, or if `path` cannot be written."""
        return plot(self, path)

    def _parts(self, file: BinaryIO) -> Iterator[Array]:
        """Arrays of rows, chunk by chunk, until the file or its readable part ends."""
        from mcap.records import Channel, Footer, Metadata, Schema

        schemas: dict[int, Schema] = {}
        for found in records(file):
            if isinstance(found, Block) and found.channel == self._channel and self.fields:
                yield self._decode(found.data)
            elif isinstance(found, Schema):
                schemas[found.id] = found
            elif isinstance(found, Channel) and found.topic == TOPIC:
                kind = schemas.get(found.schema_id)
                if kind is None or kind.name != NAME:
                    raise RecordingError(f"topic {TOPIC} is not of type {NAME}; another program wrote it")
                fields = fields_of(kind.data.decode("utf-8", "replace"))
                if self.fields and fields != self.fields:
                    raise RecordingError(f"topic {TOPIC} is there twice, with different fields")
                self.fields, self._channel = fields, found.id
            elif isinstance(found, Metadata):
                self.notes.append((found.name, dict(found.metadata)))
            elif isinstance(found, Footer):
                self.truncated = False

    def _decode(self, block: NDArray[np.uint8]) -> Array:
        """Rows (n, width) from messages (n, bytes): four bytes of CDR header, then the row itself."""
        width = sum(field.width for field in self.fields)
        if block.shape[1] != len(CDR_HEADER) + 8 * width:
            raise RecordingError(f"a message has {block.shape[1]} bytes; its schema says {4 + 8 * width}")
        decoded: Array = np.ascontiguousarray(block[:, len(CDR_HEADER) :]).view("<f8")
        return decoded


def _open_file(path: Path) -> BinaryIO:
    """The file, if it begins like MCAP."""
    try:
        file = open(path, "rb", opener=open_at_once)  # noqa: SIM115 (whoever asked for it closes it)
    except OSError as cause:
        raise RecordingError(f"cannot read {path}: {cause.strerror}") from cause
    except ValueError as cause:  # a zero byte in its name
        raise RecordingError(f"cannot read {quote(str(path))}: not the name of a file") from cause
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        file.close()
        raise RecordingError(f"cannot read {path}: not a regular file")
    if file.read(len(MAGIC)) != MAGIC:
        file.close()
        raise RecordingError(f"{path} is not an MCAP file: record one with `haptorb run --record FILE.mcap`")
    return file
