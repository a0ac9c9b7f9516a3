"""A recording as arrays, even if it was truncated; a long one is read in pieces."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, final

import numpy as np

from haptorb.display.html import facts_html
from haptorb.errors import RecordingError, RecordingWarning, UnknownName, quote
from haptorb.files.file_kind import FileKind
from haptorb.files.text_file import open_regular
from haptorb.numerics.arrays import Array
from haptorb.runtime.recording.column import FieldColumn
from haptorb.runtime.recording.data_frames import make_data_frame, make_dataset
from haptorb.runtime.recording.export import Export
from haptorb.runtime.recording.mcap_reader import MAGIC, McapReader, MissingRows, is_mcap
from haptorb.runtime.recording.mcap_schema import TOPIC
from haptorb.runtime.recording.recorded_memory import memory_columns, memory_units, split_memory
from haptorb.runtime.recording.recording_plot import plot
from haptorb.runtime.recording.recording_summary import describe_damage, draw_force, list_facts, summarize
from haptorb.runtime.row import Field, RowLayout

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame
    from xarray import Dataset

__all__ = ["Recording"]

_LOOK = 256 * 1024  #: bytes by which a file of another kind is recognised
_WHOLE = 32 * 1024 * 1024  #: bytes of a file that is read, and checked, at once when it is opened


@final
class Recording:
    """Rows and metadata of a haptorb recording (MCAP).

    `recording["p"]` is the field `p` of all ticks, shape (n, 3), or (n,) for a single number.
    """

    def __init__(self, path: str | Path) -> None:
        """Read the file. Raises RecordingError if it is not there, is no MCAP file, or holds no haptorb rows.

        Warns, with a RecordingWarning, if rows are missing because the file is damaged. All rows of a file of up to
        32 MiB are checked now, those of a longer one by `check`.
        """
        self.path = Path(path)
        with _open_file(self.path) as file, self._explain():
            size = os.fstat(file.fileno()).st_size
            self._reader = reader = McapReader(self.path)
            self.truncated = reader.truncated  #: the file has no end: the recorder was killed, or still writes
            self.notes = reader.notes  #: every metadata record: (name, values), in order
            self.fields = reader.fields  #: as the file's own schema describes them
            if not self.fields:
                cut = "it was cut short before its first rows" if self.truncated else f"topic {TOPIC} is missing"
                raise RecordingError(f"not a haptorb recording: {cut}")
            self.long = size > _WHOLE  #: rows are read from the file on request
            self._whole: Array | None = None
            if not self.long:
                parts: list[Array] = []
                reader.check(take=parts.append)
                self._whole = np.concatenate(parts) if parts else np.empty((0, reader.width))
        self._at: dict[str, slice] = {}
        start = 0
        for field in self.fields:
            self._at[field.name] = slice(start, start + field.width)
            start += field.width
        self._note_damage()

    @property
    def checked(self) -> bool:
        """Whether all rows were compared with their checksums: those of a long file are by `check`."""
        return self._reader.checked

    def check(
        self, first: int = 0, last: int | None = None, report: Callable[[float], None] = lambda share: None
    ) -> bool:
        """Compare rows `first` up to `last` (all) with their checksums; True if some are damaged.

        Damaged rows are then left out: later rows have lower numbers, `missing` and `damage` state where rows are
        missing, and a RecordingWarning does, too. A file of up to 32 MiB was checked when it was opened. `report`
        receives the share that is done.
        """
        if self.checked:
            return False
        with self._explain():
            found = bool(self._reader.check(first, last, report))
        if found:
            self.__dict__.pop("rows", None)
            self.__dict__.pop("memory", None)
        self._note_damage()
        return found

    @property
    def channel(self) -> int:
        """Number of the channel of the rows in the file."""
        return self._reader.channel

    def list_contents(self) -> Iterator[list[Any]]:
        """Schemas, channels and messages of all topics, chunk by chunk, as far as they are undamaged."""
        return self._reader.list_contents()

    def _note_damage(self) -> None:
        """State what is missing, as far as it is known, and warn of what was not known before."""
        before = getattr(self, "damage", ())
        with self._explain():
            missing, harmless = self._reader.list_missing()
        self.missing: tuple[MissingRows, ...] = tuple(missing)  #: rows that cannot be read, as far as is known
        inside = [one for one in missing if not (self.truncated and one.row == len(self))]
        self.damage = describe_damage(  #: what cannot be read though the file goes on after it, a sentence each
            inside, harmless, self._reader.lost_notes, self._read_time(0)
        )
        if self.damage and self.damage != before:
            warnings.warn(f"{self.path}: {'; '.join(self.damage)}", RecordingWarning, stacklevel=3)

    def _read_time(self, row: int) -> float:
        """On the loop's clock [s]; 0 where there is none."""
        try:
            return float(self["t"][row])
        except (RecordingError, UnknownName, IndexError):
            return 0.0

    @contextmanager
    def _explain(self) -> Iterator[None]:
        """Name the file in what is wrong with it."""
        try:
            yield
        except RecordingError as cause:
            if str(self.path) in str(cause):
                raise
            raise RecordingError(f"{self.path}: {cause}") from cause
        except MemoryError as cause:
            raise RecordingError(f"{self.path} is too large for the memory of this computer") from cause
        except OSError as cause:
            raise RecordingError(f"cannot read {self.path}: {cause.strerror}") from cause

    def __len__(self) -> int:
        """Rows recorded."""
        return len(self._reader) if self._whole is None else len(self._whole)

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
        if self._whole is None:
            return self._reader.read(first, last, columns)
        return self._whole[first:last, columns]

    @cached_property
    def rows(self) -> Array:
        """(n, width) all numbers of all ticks, bit for bit, in the units of their fields; damaged ones are left out.

        Raises RecordingError if they need more memory than there is.
        """
        self.check()
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
        self.check()
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
        self.check()
        return make_data_frame(self)

    def to_xarray(self) -> Dataset:
        """All rows as a Dataset over `t` [s]: one variable per field, with `units` and `long_name` in its `attrs`.

        Raises InputError if xarray is not installed.
        """
        self.check()
        return make_dataset(self)

    def __repr__(self) -> str:
        return summarize(self)

    def _repr_html_(self) -> str:
        return facts_html(f"Recording {self.path.name}", list_facts(self), draw_force(self))

    def plot(self, path: str | Path | None = None) -> Figure:
        """A figure of the run: force asked and given, currents, temperatures, lateness; written to `path` (PNG, SVG,
        PDF) if one is given. Raises RecordingError if there are no rows, or if `path` cannot be written."""
        self.check()
        return plot(self, path)


@contextmanager
def _open_file(path: Path) -> Iterator[BinaryIO]:
    """The file, if it begins like MCAP."""
    with open_regular(path, "recording", RecordingError) as file:
        head = file.read(len(MAGIC))
        if not is_mcap(head):
            other = FileKind.RECORDING.explain_other(path, head + file.read(_LOOK))
            raise RecordingError(
                other or f"{path} is not an MCAP file: record one with `haptorb run --record FILE.mcap`"
            )
        yield file
