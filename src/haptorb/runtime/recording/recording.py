"""A recording as arrays, even if it was truncated; a long one is read in pieces."""

from __future__ import annotations

import os
import stat
from collections.abc import Sequence
from functools import cached_property
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, final

import numpy as np

from haptorb.display.html import facts_html
from haptorb.errors import RecordingError, UnknownName, quote
from haptorb.files.text_file import open_at_once
from haptorb.numerics.arrays import Array
from haptorb.runtime.recording.chunk_index import ChunkIndex
from haptorb.runtime.recording.column import FieldColumn
from haptorb.runtime.recording.contents import Contents
from haptorb.runtime.recording.data_frames import make_data_frame, make_dataset
from haptorb.runtime.recording.export import Export
from haptorb.runtime.recording.mcap_rows import MAGIC, records
from haptorb.runtime.recording.mcap_schema import TOPIC
from haptorb.runtime.recording.recorded_memory import memory_columns, memory_units, split_memory
from haptorb.runtime.recording.recording_plot import plot
from haptorb.runtime.recording.recording_summary import draw_force, list_facts, summarize
from haptorb.runtime.row import Field, RowLayout

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame
    from xarray import Dataset

__all__ = ["Recording"]

_WHOLE = 32 * 1024 * 1024  #: bytes of a file that is read, and checked, at once when it is opened


@final
class Recording:
    """Rows and metadata of a haptorb recording (MCAP).

    `recording["p"]` is the field `p` of all ticks, shape (n, 3), or (n,) for a single number.
    """

    def __init__(self, path: str | Path) -> None:
        """Read the file. Raises RecordingError if it is not there, is no MCAP file, or holds no haptorb rows."""
        self.path = Path(path)
        contents = Contents()
        with _open_file(self.path) as file:
            try:
                whole = os.fstat(file.fileno()).st_size <= _WHOLE
                source = _read_all(file, contents) if whole else ChunkIndex(self.path, contents)
            except RecordingError as cause:
                raise RecordingError(f"{self.path}: {cause}") from cause
            except MemoryError as cause:
                raise RecordingError(f"{self.path} is too large for the memory of this computer") from cause
            except OSError as cause:
                raise RecordingError(f"cannot read {self.path}: {cause.strerror}") from cause
        self.truncated = contents.truncated  #: the file has no end: the recorder was killed, or still writes
        self.notes = contents.notes  #: every metadata record: (name, values), in order
        self.fields = contents.fields  #: as the file's own schema describes them
        if not self.fields:
            cut = "it was cut short before its first rows" if self.truncated else f"topic {TOPIC} is missing"
            raise RecordingError(f"{self.path} is not a haptorb recording: {cut}")
        self.long = isinstance(source, ChunkIndex)  #: rows are read from the file on request
        self._source = source
        self._at: dict[str, slice] = {}
        start = 0
        for field in self.fields:
            self._at[field.name] = slice(start, start + field.width)
            start += field.width

    def __len__(self) -> int:
        """Rows recorded."""
        return len(self._source)

    def __getitem__(self, name: str) -> FieldColumn:
        """A field of all ticks, shape (n, width), or (n,) where the width is 1. UnknownName if there is no such.

        `recording["p"][a:b]` reads no more of a long file than these ticks.
        """
        if name not in self._at:
            raise UnknownName("field", name, self._at)
        columns = self._at[name]
        return FieldColumn(
            lambda first, last: self._read(first, last, columns), len(self), columns.stop - columns.start
        )

    def read(self, first: int, last: int, fields: Sequence[str]) -> Array:
        """(last − first, k) those fields side by side, in their own units [SI]; UnknownName for a missing one.

        A long file is read once, for any number of fields.
        """
        known = {field.name for field in self.columns} | set(self._at)
        for name in fields:
            if name not in known:
                raise UnknownName("field", name, known)
        rows = self._read(first, last, slice(None))
        if list(fields) == list(self._at):
            return rows
        parts = {name: rows[:, self._at[name]] for name in fields if name in self._at}
        if len(parts) < len(set(fields)):
            memory = split_memory(rows[:, self._at["memory"]], rows[:, self._at["world"].start], self.worlds)
            parts |= {name: values.reshape(len(rows), prod(values.shape[1:])) for name, values in memory.items()}
        return np.concatenate([parts[name] for name in fields], axis=1)

    @cached_property
    def columns(self) -> tuple[Field, ...]:
        """The fields of a table: those of the row, and those of worlds' memories, such as `ball.place`."""
        if "memory" not in self._at:
            return self.fields
        at = self._at["memory"]
        others = tuple(field for field in self.fields if field.name != "memory")
        return others + memory_columns(self.worlds, at.stop - at.start)

    def _read(self, first: int, last: int, columns: slice) -> Array:
        if isinstance(self._source, ChunkIndex):
            return self._source.read(first, last, columns)
        return self._source[first:last, columns]

    @cached_property
    def rows(self) -> Array:
        """(n, width) all numbers of all ticks, bit for bit, in the units of their fields.

        Raises RecordingError if they need more memory than there is.
        """
        try:
            return self._read(0, len(self), slice(None))
        except MemoryError as cause:
            raise RecordingError(f"{self.path} is too large for the memory of this computer") from cause

    @property
    def t(self) -> FieldColumn:
        """(n,) time on the loop's clock [s]."""
        return self["t"]

    @cached_property
    def metadata(self) -> dict[str, dict[str, str]]:
        """The last metadata record of every name, without its 'haptorb/': device, run, versions, clock, layout, end."""
        return {name.removeprefix("haptorb/"): values for name, values in self.notes}

    @property
    def worlds(self) -> list[dict[str, str]]:
        """The worlds in order: change (number), tick (approximate), world (JSON)."""
        return [values for name, values in self.notes if name == "haptorb/world"]

    @cached_property
    def memory(self) -> dict[str, Array]:
        """Memory of worlds: `memory["ball.place"]` is the field `place` of the world `ball` in all
        ticks, shape (n, 3), or (n,) for a single number; NaN in ticks of other worlds."""
        if "memory" not in self._at:
            return {}
        rows = self._read(0, len(self), slice(None))
        return split_memory(rows[:, self._at["memory"]], rows[:, self._at["world"].start], self.worlds)

    @property
    def memory_units(self) -> dict[str, str]:
        """The unit of each field of `memory`."""
        return memory_units(self.worlds)

    @property
    def errors(self) -> list[dict[str, str]]:
        """Error messages of worlds and drivers, in order: tick (approximate), text (with file and line of a world)."""
        return [values for name, values in self.notes if name == "haptorb/error"]

    @property
    def lost(self) -> int:
        """Rows that the recorder lost. RecordingError if the file states no number."""
        return sum(self._parse_count(values, "rows") for name, values in self.notes if name == "haptorb/gap")

    @property
    def layout(self) -> RowLayout:
        """The layout of `rows`. Raises RecordingError if another version of haptorb wrote another layout."""
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

        Fields of coils, sensors, contacts and memory may have any width.
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

        UTF-8. The file is written completely or not at all.

        Raises RecordingError if the file exists and `overwrite` is not set, or if it cannot be written.
        """
        path = Path(path)
        try:
            if path.exists() and not overwrite:
                raise RecordingError(f"{path} exists; choose another name, or replace it with overwrite=True")
        except OSError as cause:
            raise RecordingError(f"cannot write {path}: {cause.strerror}") from cause
        Export.of(self, "csv").write(path)

    def to_pandas(self) -> DataFrame:
        """All rows as a DataFrame: one column per number, named `p[0]`, the index `t` [s].

        `attrs["units"]` and `attrs["about"]` describe each column. Raises InputError if pandas is not installed.
        """
        return make_data_frame(self)

    def to_xarray(self) -> Dataset:
        """All rows as a Dataset over `t` [s]: one variable per field, with `units` and `long_name` in its `attrs`.

        Raises InputError if xarray is not installed.
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


def _read_all(file: BinaryIO, contents: Contents) -> Array:
    """(n, width) all rows of `file`, until it or its readable part ends."""
    parts = [rows for rows in map(contents.add, records(file)) if rows is not None]
    return np.concatenate(parts) if parts else np.empty((0, contents.width))


def _open_file(path: Path) -> BinaryIO:
    """The file, if it begins like MCAP."""
    try:
        file = open(path, "rb", opener=open_at_once)  # noqa: SIM115 (the caller closes it)
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
