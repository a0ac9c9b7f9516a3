"""Export of recordings to pandas, xarray, CSV, Parquet and NumPy; files are written in blocks and atomically."""

from __future__ import annotations

import bisect
import csv
import json
import math
import shutil
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, Any, Final, Protocol, final

import numpy as np

from haptorb.arrays import Array
from haptorb.errors import InputError, RecordingError, UnknownName
from haptorb.files import escape_formula, foreign_text, replace_file
from haptorb.recording.row import STAGES, Field, FieldColumn, resolve_name

if TYPE_CHECKING:
    from pandas import DataFrame
    from xarray import Dataset

__all__ = [
    "FORMATS",
    "Export",
    "coil_names",
    "column_heads",
    "column_names",
    "describe_notes",
    "make_data_frame",
    "make_dataset",
    "units_of",
]


# --------------------------------------------------------------------------------------------------
# Conversion of a recording to pandas and xarray, with the unit of every column in `attrs`.
#
# Both packages are optional and imported by the first call.


_PLACE, _TURN, _WRENCH = ("x", "y", "z"), ("x", "y", "z", "w"), ("F_x", "F_y", "F_z", "T_x", "T_y", "T_z")
_HOOK = ("deflection", "place", "point_x", "point_y", "point_z", "force_x", "force_y", "force_z")
#: fields with named components: field → (dimension, names of the components)
_PARTS: dict[str, tuple[str, tuple[str, ...]]] = {
    **dict.fromkeys(("p", "v", "w", "hand_goal", "object"), ("axis", _PLACE)),
    **dict.fromkeys(("q", "hand_goal_q", "object_q"), ("quaternion", _TURN)),
    **dict.fromkeys(("wrench_commanded", "wrench_model", "wrench_actual", "object_wrench"), ("component", _WRENCH)),
    "stages": ("stage", STAGES),
    "clutch_share": ("motion", ("translation", "rotation")),
    "contacts": ("hook", tuple(f"{part}_{hook}" for hook in (1, 2) for part in _HOOK)),
}
_CHANNELS = frozenset({"current_commanded", "current_measured", "duty_applied", "resistance", "boundary", "winding"})


class RecordingNotes(Protocol):
    """Metadata of a recording."""

    path: Path
    truncated: bool
    damage: tuple[str, ...]

    @property
    def metadata(self) -> Mapping[str, Mapping[str, str]]:
        """Metadata records by name: device, run, versions and others."""


class Rows(RecordingNotes, Protocol):
    """Interface to the rows of a recording."""

    @property
    def columns(self) -> tuple[Field, ...]:
        """All fields, with the memory of each world split into its named fields."""

    def read(self, first: int, last: int, fields: Sequence[str]) -> Array:
        """Rows `first` to `last` − 1 of `fields`, side by side, shape (last − first, k), in the fields' units [SI]."""

    def __len__(self) -> int:
        """Number of recorded rows."""


def units_of(field: Field) -> tuple[str, ...]:
    """Unit of each column of `field`; "N, N·m" of a wrench expands to three forces and three torques.

    >>> units_of(Field("wrench_commanded", 6, "N, N·m", ""))
    ('N', 'N', 'N', 'N·m', 'N·m', 'N·m')
    """
    units = tuple(field.unit.split(", "))
    if len(units) == 1:
        return units * field.width
    if len(units) == 2 and field.width % 6 == 0:
        return tuple(unit for unit in units for _ in range(3)) * (field.width // 6)
    if len(units) == 4 and field.width % 8 == 0:  # a contact: two lengths, a point, a force
        return tuple(unit for unit, many in zip(units, (1, 1, 3, 3), strict=True) for _ in range(many)) * (
            field.width // 8
        )
    return (field.unit,) * field.width


def column_names(field: Field) -> tuple[str, ...]:
    """Column names of `field` in tables.

    >>> column_names(Field("p", 3, "m", ""))
    ('p[0]', 'p[1]', 'p[2]')
    """
    return (field.name,) if field.width == 1 else tuple(f"{field.name}[{i}]" for i in range(field.width))


def column_heads(field: Field) -> tuple[str, ...]:
    """CSV headings of `field`: column name, and the unit unless dimensionless.

    >>> column_heads(Field("p", 3, "m", ""))[2], column_heads(Field("tick", 1, "1", ""))
    ('p[2] [m]', ('tick',))
    """
    pairs = zip(column_names(field), units_of(field), strict=True)
    return tuple(f"{name} [{unit}]" if unit not in ("", "1") else name for name, unit in pairs)


def coil_names(metadata: Mapping[str, Mapping[str, str]], count: int) -> list[str]:
    """Coil names of the recorded device; numbers from 1 if the metadata contains no valid list of `count` names.

    >>> coil_names({"device": {"coils": '["x", "y"]'}}, 2), coil_names({}, 2)
    (['x', 'y'], ['1', '2'])
    """
    try:
        names = json.loads(metadata.get("device", {}).get("coils", ""))
    except ValueError:  # older recordings contain no names
        names = None
    if isinstance(names, list) and len(names) == count and all(isinstance(name, str) for name in names):
        return names
    return [str(1 + i) for i in range(count)]


def make_data_frame(recording: Rows) -> DataFrame:
    """Convert all rows to a DataFrame (n, width), one column per number; see `Recording.to_pandas`.

    Units [SI] are in `attrs`. Raises InputError if pandas is not installed.
    """
    try:
        import pandas
    except ImportError as cause:
        raise InputError(f"to_pandas needs pandas ({cause}): pip install 'haptorb[notebook]'") from cause
    names, units, about = [], {}, {}
    for field in recording.columns:
        for name, unit in zip(column_names(field), units_of(field), strict=True):
            names.append(name)
            units[name], about[name] = unit, field.about
    numbers = recording.read(0, len(recording), [field.name for field in recording.columns])
    frame = pandas.DataFrame(numbers, columns=names)
    if "t" in names:
        frame = frame.set_index("t")
    frame.attrs = {**describe_notes(recording), "units": units, "about": about}
    return frame


def make_dataset(recording: Rows) -> Dataset:
    """Convert all rows to a Dataset over `t` (n,) [s], one variable per field; see `Recording.to_xarray`.

    Raises InputError if xarray is not installed.
    """
    try:
        import xarray
    except ImportError as cause:
        raise InputError(f"to_xarray needs xarray ({cause}): pip install 'haptorb[notebook]'") from cause
    variables: dict[str, Any] = {}
    coordinates: dict[str, Any] = {}
    start, numbers = 0, recording.read(0, len(recording), [field.name for field in recording.columns])
    for field in recording.columns:
        attributes = {"units": field.unit, "long_name": field.about}
        values = numbers[:, start] if field.width == 1 else numbers[:, start : start + field.width]
        start += field.width
        if field.name == "t":
            coordinates["t"] = ("t", values, attributes)
            continue
        if values.ndim == 1:
            variables[field.name] = ("t", values, attributes)
            continue
        dimension, labels = _PARTS.get(field.name, ("", ()))
        if len(labels) == field.width:
            coordinates[dimension] = (dimension, list(labels))
        else:
            dimension = "channel" if field.name in _CHANNELS else f"{field.name}_part"
            if field.name in _CHANNELS:
                coordinates[dimension] = (dimension, list(range(1, field.width + 1)))
                coordinates["coil"] = (dimension, coil_names(recording.metadata, field.width))
        variables[field.name] = (("t", dimension), values, attributes)
    return xarray.Dataset(variables, coordinates, describe_notes(recording))


def describe_notes(recording: RecordingNotes) -> dict[str, str]:
    """Metadata of an exported table: file, device, driver, rate [Hz], model, and missing rows."""
    device, run = recording.metadata.get("device", {}), recording.metadata.get("run", {})
    known = {
        "recording": recording.path.name,
        "device": device.get("name", ""),
        "driver": run.get("driver", ""),
        "rate_hz": run.get("rate_hz", ""),
        "model": run.get("model", ""),
        "damage": "; ".join(recording.damage),
        "truncated": "true" if recording.truncated else "",
        "repaired": recording.metadata.get("repair", {}).get("damage", ""),
    }
    return {key: foreign_text(value) for key, value in known.items() if value}


Progress = Callable[[float], None]  #: called with the completed fraction, 0 to 1

_PIECE_ROWS = 20_000  #: rows per block, at most
_PIECE_NUMBERS = 8_000_000  #: numbers per block, at most: 64 MB


class RecordingReader(Protocol):
    """Interface to a recording that is exported."""

    path: Path
    truncated: bool
    damage: tuple[str, ...]

    def check(self, first: int = 0, last: int | None = None, report: Progress = lambda share: None) -> bool:
        """Verify the checksums of rows `first` to `last` − 1 and exclude damaged rows; True if there are any."""

    @property
    def columns(self) -> tuple[Field, ...]:
        """All fields, with the memory of each world split into its named fields."""

    @property
    def metadata(self) -> Mapping[str, Mapping[str, str]]:
        """Metadata records by name: device, run, versions and others."""

    def __getitem__(self, name: str) -> FieldColumn:
        """The field `name` over all ticks, shape (n, width), or (n,) if the width is 1, in its unit [SI]."""

    def __len__(self) -> int:
        """Number of recorded rows."""

    def read(self, first: int, last: int, fields: Sequence[str]) -> Array:
        """Rows `first` to `last` − 1 of `fields`, side by side, shape (last − first, k), in the fields' units [SI]."""


@final
@dataclass(frozen=True)
class Export:
    """Selected `fields` and `ticks` of a recording, to be written in the format `form`."""

    recording: RecordingReader
    form: str
    fields: tuple[Field, ...]
    ticks: range

    @classmethod
    def of(
        cls,
        recording: RecordingReader,
        form: str,
        fields: Sequence[str] | None = None,
        start: float | None = None,
        end: float | None = None,
        report: Progress = lambda share: None,
    ) -> Export:
        """Select `fields` (default: all) between `start` and `end` [s after the first tick], without damaged rows.

        `report` receives the fraction of these rows whose checksums have been verified.

        Raises UnknownName for an unknown field or format, InputError for a time range without a tick.
        """
        if form not in FORMATS:
            raise UnknownName("format", form, FORMATS)
        chosen = _choose_fields(recording, fields)
        return cls(recording, form, chosen, _find_sound_ticks(recording, start, end, report))

    def write(self, path: Path, report: Progress = lambda share: None) -> None:
        """Write the export to `path`, atomically. Raises RecordingError if it cannot be written."""
        try:
            with replace_file(path) as part:
                FORMATS[self.form](self, part, report)
        except OSError as cause:
            raise RecordingError(f"cannot write {path}: {cause.strerror}") from cause

    def pieces(self, report: Progress) -> Iterator[Array]:
        """Iterate over blocks of rows (n, k): the fields side by side, in their units [SI]."""
        names = [field.name for field in self.fields]
        rows = max(min(_PIECE_ROWS, _PIECE_NUMBERS // max(sum(field.width for field in self.fields), 1)), 1)
        for first in range(self.ticks.start, self.ticks.stop, rows):
            last = min(first + rows, self.ticks.stop)
            yield self.recording.read(first, last, names)
            report((last - self.ticks.start) / len(self.ticks))


def _choose_fields(recording: RecordingReader, names: Sequence[str] | None) -> tuple[Field, ...]:
    known = {field.name: field for field in recording.columns}
    if names is None:
        return recording.columns
    names = [resolve_name(name) for name in names]
    for name in names:
        if name not in known:
            raise UnknownName("field", name, known)
    if not names:
        raise InputError("no field is named: name at least one, or leave out the option for all")
    return tuple(known[name] for name in dict.fromkeys(names))


def _find_sound_ticks(recording: RecordingReader, start: float | None, end: float | None, report: Progress) -> range:
    """Range of undamaged ticks between `start` and `end` [s after the first tick]."""
    if start is None and end is None:
        recording.check(report=report)
    while True:
        try:
            ticks = _find_ticks(recording, start, end)
        except RecordingError:
            if not recording.check(report=report):  # the search read a damaged row: exclude it and search again
                raise
            continue
        if not recording.check(ticks.start, ticks.stop, report):
            return ticks


def _find_ticks(recording: RecordingReader, start: float | None, end: float | None) -> range:
    """Range of ticks between `start` and `end`, by bisection, which reads few rows of the file."""
    for name, value in (("start", start), ("end", end)):
        if value is not None and not math.isfinite(value):
            raise InputError(f"{name} must be a time in seconds after the first tick; got {value}")
    rows = len(recording)
    if start is None and end is None:
        return range(rows)
    if not rows or "t" not in {field.name for field in recording.columns}:
        raise InputError(f"{recording.path} has no ticks with a time: leave out start and end")
    t = recording["t"]
    zero, length = float(t[0]), float(t[-1]) - float(t[0])
    first = 0 if start is None else bisect.bisect_left(range(rows), zero + start, key=lambda n: float(t[n]))
    last = rows if end is None else bisect.bisect_right(range(rows), zero + end, key=lambda n: float(t[n]))
    if first >= last:
        begin, stop = 0.0 if start is None else start, length if end is None else end
        raise InputError(f"no tick lies between {begin:g} s and {stop:g} s; the recording lasts {length:.4g} s")
    return range(first, last)


def _write_csv(export: Export, path: Path, report: Progress) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        heads = [escape_formula(head) for field in export.fields for head in column_heads(field)]
        csv.writer(file, lineterminator="\n").writerow(heads)
        for piece in export.pieces(report):
            for row in piece.tolist():
                file.write(",".join(map(repr, row)) + "\n")


def _write_parquet(export: Export, path: Path, report: Progress) -> None:
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError as cause:
        raise RecordingError("Parquet needs pyarrow: pip install 'haptorb[parquet]', or export as CSV") from cause
    columns = [
        pyarrow.field(name, pyarrow.float64(), metadata={"unit": unit, "description": field.about})
        for field in export.fields
        for name, unit in zip(column_names(field), units_of(field), strict=True)
    ]
    schema = pyarrow.schema(columns, metadata=describe_notes(export.recording))
    with parquet.ParquetWriter(path, schema, compression="zstd") as writer:
        for piece in export.pieces(report):
            arrays = [pyarrow.array(np.ascontiguousarray(column)) for column in piece.T]
            writer.write_table(pyarrow.Table.from_arrays(arrays, schema=schema))


def _write_npz(export: Export, path: Path, report: Progress) -> None:
    """Write one array per field, and `about`: JSON with the unit and meaning of each field, and notes of the run."""
    about = {field.name: {"unit": field.unit, "about": field.about} for field in export.fields}
    notes = {"fields": about, "recording": describe_notes(export.recording)}
    with ExitStack() as stack:
        parts = [stack.enter_context(TemporaryFile(dir=path.parent)) for _ in export.fields]  # reads a long file once
        ends = np.cumsum([field.width for field in export.fields])[:-1]
        for piece in export.pieces(report):
            for part, columns in zip(parts, np.split(piece, ends, axis=1), strict=True):
                part.write(np.ascontiguousarray(columns, dtype="<f8").tobytes())
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            with archive.open("about.npy", "w") as file:
                np.lib.format.write_array(file, np.array(json.dumps(notes, ensure_ascii=False)))
            for field, part in zip(export.fields, parts, strict=True):
                shape = (len(export.ticks),) if field.width == 1 else (len(export.ticks), field.width)
                with archive.open(f"{field.name}.npy", "w", force_zip64=True) as file:
                    np.lib.format.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": shape})
                    part.seek(0)
                    shutil.copyfileobj(part, file)


#: format → its writer
FORMATS: Final[Mapping[str, Callable[[Export, Path, Progress], None]]] = {
    "csv": _write_csv,
    "parquet": _write_parquet,
    "npz": _write_npz,
}
