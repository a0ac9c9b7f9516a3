"""Reading of recordings as arrays, including truncated ones; long files are read on demand."""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cached_property
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Protocol, final

import numpy as np

from haptorb.arrays import Array, whole_number
from haptorb.control.saturation import Saturation
from haptorb.display import curves_svg, facts_html, format_quantity
from haptorb.errors import RecordingError, RecordingWarning, UnknownName, quote
from haptorb.file_kind import FileKind
from haptorb.files import foreign_name, foreign_text, open_regular
from haptorb.recording.export import Export, make_data_frame, make_dataset
from haptorb.recording.mcap import MAGIC, TOPIC, McapReader, MissingRows, is_mcap
from haptorb.recording.plot import plot
from haptorb.recording.row import Field, FieldColumn, RowLayout, resolve_name

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame
    from xarray import Dataset

__all__ = [
    "Recording",
    "describe_damage",
    "draw_force",
    "duration_of",
    "list_facts",
    "list_losses",
    "measure_run",
    "memory_columns",
    "memory_units",
    "split_memory",
    "summarize",
]


# --------------------------------------------------------------------------------------------------
# Memory of worlds in a recording: assigns the memory numbers of the rows to the named fields of each world.


def split_memory(numbers: Array, changes: Array, worlds: Sequence[Mapping[str, str]]) -> dict[str, Array]:
    """Split memory into "world.field" → values in all ticks, (n, ...), in the field's unit [SI].

    numbers  (n, room) memory of the rows, each number in the unit of its field [SI]
    changes  (n,) number of the world in each tick
    worlds   metadata records of all worlds

    Values are NaN in ticks of other worlds. A field for which the rows have no room is left out. Raises RecordingError
    for a metadata record that haptorb did not write.
    """
    found: dict[str, Array] = {}
    room = numbers.shape[1]
    memory_columns(worlds, room)  # raises for too many numbers
    for change, name, fields in _list_fields(worlds):
        rows = changes == change
        for key, shape, place in _place_fields(name, fields, room):
            if key not in found:
                found[key] = np.full((len(numbers), *shape), np.nan)
            values = found[key]
            if values.shape[1:] == shape:  # a new version of a world's file may have another shape
                values[rows] = numbers[rows, place].reshape(-1, *shape)
    return found


def memory_columns(worlds: Sequence[Mapping[str, str]], room: int) -> tuple[Field, ...]:
    """The Field [SI] of each array that `split_memory` returns for rows with `room` numbers of memory.

    Raises RecordingError for more numbers than worlds with such rows can have: each world has its own columns.
    """
    units: dict[str, str] = memory_units(worlds)
    found: dict[str, Field] = {}
    left = max(_MEMORIES * room, _MIN_MEMORY_COLUMNS)
    for _, name, fields in _list_fields(worlds):
        for key, shape, _ in _place_fields(name, fields, room):
            if key not in found:
                found[key] = Field(key, prod(shape), units[key], "remembered by the world")
                left -= prod(shape)
                if left < 0:  # safety: memory-columns
                    raise RecordingError(
                        f"the worlds of the recording have more memory than {_MEMORIES} times the {room} numbers of a "
                        "row: haptorb did not write it"
                    )
    return tuple(found.values())


_MEMORIES = 8  #: worlds whose memory fills a row
_MIN_MEMORY_COLUMNS = 8192  #: however short the rows are


def _place_fields(
    world: str, fields: Sequence[Mapping[str, Any]], room: int
) -> Iterator[tuple[str, tuple[int, ...], slice]]:
    """(key, shape, slice of the memory) of each field for which there is room."""
    start = 0
    for field in fields:
        shape = tuple(field["shape"])
        first, start = start, start + prod(shape)
        if start > room:
            return
        yield _name_column(world, field), shape, slice(first, start)


def memory_units(worlds: Sequence[Mapping[str, str]]) -> dict[str, str]:
    """Unit [SI] of each "world.field", from the metadata records of all `worlds` of a recording."""
    return {
        _name_column(name, field): foreign_text(field["unit"], 40)
        for _, name, fields in _list_fields(worlds)
        for field in fields
    }


def _name_column(world: str, field: Mapping[str, Any]) -> str:
    """Column name "world.field", sanitised because recordings are untrusted."""
    return f"{foreign_name(world)}.{foreign_name(field['name'])}"  # safety: foreign-column


def _list_fields(worlds: Sequence[Mapping[str, str]]) -> Iterator[tuple[int, str, list[Any]]]:
    """(change, name, fields) of each world with memory."""
    for note in worlds:
        try:
            world = json.loads(note["world"])
            fields = world.get("memory", [])
            if fields:
                _check_fields(fields)
                yield int(note["change"]), str(world["name"]), fields
        except (KeyError, TypeError, ValueError, AttributeError, RecursionError) as cause:
            raise RecordingError(f"a note of a world was not written by haptorb: {quote(note)}") from cause


def _check_fields(fields: Sequence[Mapping[str, Any]]) -> None:
    """Raise ValueError for an invalid memory field: another program may have written the file."""
    for field in fields:
        if not isinstance(field["name"], str) or not isinstance(field["unit"], str):
            raise ValueError("name and unit must be texts")
        if len(field["shape"]) > 4 or any(type(n) is not int or not 1 <= n <= 65_536 for n in field["shape"]):
            raise ValueError("a shape must be whole numbers")
        if prod(field["shape"]) > 65_536:
            raise ValueError("a field has too many numbers")


# --------------------------------------------------------------------------------------------------
# Summary of a recording: one line, a table of facts, and a plot of the force.


_TRIPPED = 4  #: guard state `tripped`
_MAX_DAMAGED_PARTS = 5  #: damaged parts that are described individually
_CUT = "missing: the file is truncated (the recorder was killed, or still writes)"


class Summarized(Protocol):
    """Interface to a recording that is summarised."""

    path: Path
    fields: tuple[Field, ...]
    truncated: bool
    long: bool
    missing: tuple[MissingRows, ...]
    damage: tuple[str, ...]

    @property
    def checked(self) -> bool:
        """Whether the checksums of all rows have been verified."""

    @property
    def programs(self) -> list[dict[str, str]]:
        """Programs that commanded the device through a server."""

    @property
    def lost(self) -> int:
        """Number of rows that the recorder could not fetch in time."""

    @property
    def metadata(self) -> Mapping[str, Mapping[str, str]]:
        """Metadata records by name: device, run, versions and others."""

    @property
    def worlds(self) -> list[dict[str, str]]:
        """Rendered worlds, in order."""

    def __getitem__(self, name: str) -> FieldColumn:
        """The field `name` over all ticks, shape (n, width), or (n,) if the width is 1, in its unit [SI]."""

    def __len__(self) -> int:
        """Number of recorded rows."""


def summarize(recording: Summarized) -> str:
    """One-line summary: file, device, duration, rows, trips, and damage."""
    device = foreign_text(recording.metadata.get("device", {}).get("name", "unknown device"), 60)
    wrong = [f"{_count(lost, 'row')} lost"] if (lost := _count_lost_rows(recording)) else []
    wrong += [f"damaged: {_count_missing(recording.missing)}"] if recording.damage else []
    wrong += ["cut short"] if recording.truncated else []
    parts = [
        device,
        f"{duration_of(recording):.4g} s",
        _count(len(recording), "row"),
        *([] if recording.long else [_count(_count_trips(recording), "trip")]),
        *wrong,
    ]
    return f"<Recording {recording.path.name}: {', '.join(parts)}>"


def list_facts(recording: Summarized, *, whole: bool | None = None) -> list[tuple[str, str]]:
    """(name, text with unit) of the facts about a run: device, worlds, duration, peak values, timing, damage.

    whole: whether to evaluate all ticks for peak values and timing; by default, unless the recording is long.
    """
    device, run = recording.metadata.get("device", {}), recording.metadata.get("run", {})
    seconds, rows = duration_of(recording), len(recording)
    rate = f", {(rows - 1) / seconds:.4g} per second" if seconds > 0 else ""
    facts = [
        ("file", str(recording.path)),
        ("device", device.get("title") or device.get("name", "unknown")),
        ("driver", run.get("driver", "")),
        ("controller model", run.get("model", "")),
        ("worlds", ", ".join(dict.fromkeys(map(_name_world, recording.worlds)))),
        ("programs", "; ".join(map(_describe_program, recording.programs))),
        ("length", f"{seconds:.4g} s, {rows} rows{rate}"),
    ]
    if rows and (whole or (whole is None and not recording.long)):
        facts += _describe_run(measure_run(recording))
    lost = _count_lost_rows(recording)
    facts.append(("rows lost", "unknown" if lost is None else str(lost)))
    facts.append(("damage", "; ".join(recording.damage)))
    if not recording.checked:
        facts.append(("checksums", "not compared: `haptorb info --all` does, or recording.check()"))
    if repaired := recording.metadata.get("repair"):
        facts.append(("repaired", f"from {repaired.get('of', 'another file')}: {repaired.get('damage') or 'its end'}"))
    facts.append(("end", _CUT if recording.truncated else "complete"))
    return [(name, foreign_text(text, 1000)) for name, text in facts if text]


def _describe_program(program: Mapping[str, str]) -> str:
    """Program name, and its start and end on the loop's clock.

    >>> _describe_program({"name": "demo", "start_s": "0.5", "end_s": "2.25", "end": "exited"})
    'demo from 0.5 s to 2.25 s (exited)'
    """
    end = f"to {program.get('end_s')} s ({program.get('end')})" if program.get("end_s") else "on"
    return f"{program.get('name', 'unknown')} from {program.get('start_s', '?')} s {end}"


def list_losses(recording: Summarized) -> list[str]:
    """List the losses of a damaged or truncated recording, one sentence each."""
    if not recording.truncated:
        return list(recording.damage)
    last = recording.missing[-1:]
    counted = last and last[0].end is None and last[0].rows
    rows = f", with {_count(counted, 'row')}" if counted else ""
    end = f" after {duration_of(recording):.4g} s" if len(recording) else ""
    return [*recording.damage, f"the end{end}{rows} is {_CUT}"]


def describe_damage(
    missing: Sequence[MissingRows], harmless: Sequence[tuple[int, int]], notes: Sequence[str], first: float
) -> tuple[str, ...]:
    """Describe the unreadable parts of a recording, one sentence each.

    missing   missing rows
    harmless  unreadable byte ranges (first, end) in which no row is missing
    notes     names of unreadable metadata records
    first     time of the first tick, from which stated times are counted [s]

    >>> describe_damage([MissingRows(20, 14, 3.02, 3.035)], [], ["run"], 3.0)
    ('14 rows are missing between 0.02 s and 0.035 s: the file is damaged there', "the note 'run' cannot be read")
    """
    found = [
        f"{_count_missing([one])} {_place(one, first)}: the file is damaged there"
        for one in missing[:_MAX_DAMAGED_PARTS]
    ]
    if others := missing[_MAX_DAMAGED_PARTS:]:
        found.append(f"{_count_missing(others)} in {_count(len(others), 'more part')} of the file, which are damaged")
    found += [f"the note {quote(name)} cannot be read" for name in notes]
    if harmless:
        size, at = sum(end - begin for begin, end in harmless), harmless[0][0]
        found.append(
            f"{_count(size, 'byte')} from byte {at} on cannot be read: no row is missing there, but a note may be"
        )
    return tuple(found)


def _place(one: MissingRows, first: float) -> str:
    if one.start is None:
        return "before the first tick that can be read" if one.end is not None else "of all"
    start = f"{one.start - first:.6g} s"
    return f"between {start} and {one.end - first:.6g} s" if one.end is not None else f"after {start}"


def _count_missing(missing: Sequence[MissingRows]) -> str:
    """Number of missing rows, as far as known, as a clause with its verb."""
    known = sum(one.rows for one in missing if one.rows is not None)
    if all(one.rows is not None for one in missing):
        return f"{_count(known, 'row')} {'is' if known == 1 else 'are'} missing"
    return f"at least {_count(known, 'row')} are missing" if known else "rows (their number is unknown) are missing"


_WRENCHES = ("commanded", "actual")


def draw_force(recording: Summarized) -> str:
    """SVG plot of the magnitudes of commanded and actual force [N] (torque [N·m] if all forces are zero) over time [s].

    Empty for a long recording, which `plot` draws, and without the necessary rows and fields.
    """
    known = {field.name for field in recording.fields}
    if recording.long or not {"t", "wrench_commanded", "wrench_actual"} <= known or len(recording) < 2:
        return ""
    given, name = np.asarray(recording["wrench_actual"]), "actual"
    if not np.isfinite(given).any() and "wrench_model" in known:
        given, name = np.asarray(recording["wrench_model"]), "by the controller model"
    asked = np.asarray(recording["wrench_commanded"])
    if asked.ndim != 2 or asked.shape[1] != 6 or given.shape != asked.shape:
        return ""
    turning = not (np.nan_to_num(given[:, :3]).any() or np.nan_to_num(asked[:, :3]).any())
    part = slice(3, 6) if turning else slice(0, 3)
    curves = [(name, _size(given[:, part])), ("commanded", _size(asked[:, part]))]
    return curves_svg(np.asarray(recording["t"]), curves, "s", "torque [N·m]" if turning else "force [N]")


def measure_run(recording: Summarized) -> dict[str, float]:
    """Peak values and counts over all ticks, for the recorded fields; each name ends with its unit [SI].

    NaN for a quantity without a finite value.
    """
    known = {field.name for field in recording.fields}
    found = {}
    for name in _WRENCHES:
        field = f"wrench_{name}"
        if field in known and recording[field].ndim == 2 and recording[field].shape[1] == 6:
            values = recording[field][:]
            found[f"largest_{name}_force_n"] = _largest(_size(values[:, :3]))
            found[f"largest_{name}_torque_nm"] = _largest(_size(values[:, 3:]))
    if "current_measured" in known:
        found["largest_current_a"] = _largest(np.abs(recording["current_measured"]))
    if "winding" in known:
        found["warmest_winding_k"] = _largest(recording["winding"][:])
    if "saturated" in known:
        held = recording["saturated"][:]
        found |= {f"held_back_by_{one.name.lower()}": float(np.mean(held == one)) for one in Saturation if one}
    if "lateness" in known:
        late = recording["lateness"][:]
        finite = bool(np.isfinite(late).all())
        found["lateness_99_s"] = float(np.quantile(late, 0.99, method="lower")) if finite else float("nan")
    if "missed" in known:
        found["deadlines_skipped"] = float(np.nansum(recording["missed"]))
    return {**found, "trips": _count_trips(recording)}


def _describe_run(found: Mapping[str, float]) -> list[tuple[str, str]]:
    """Format the results of `measure_run`."""
    facts = []
    for name in _WRENCHES:
        if f"largest_{name}_force_n" in found:
            force, torque = found[f"largest_{name}_force_n"], found[f"largest_{name}_torque_nm"]
            text = f"{format_quantity(force, 'N')}, {format_quantity(torque, 'N·m')}"
            facts.append((f"largest {name} wrench", text if np.isfinite(force) else "unknown"))
    if "largest_current_a" in found:
        facts.append(("largest current", format_quantity(found["largest_current_a"], "A")))
    if "warmest_winding_k" in found:
        facts.append(("warmest winding", f"{found['warmest_winding_k'] - 273.15:.1f} °C"))
    shares = [(100 * found.get(f"held_back_by_{one.name.lower()}", 0.0), one.text) for one in Saturation if one]
    held_back = ", ".join(f"{share:.2g} % of the ticks by {limit}" for share, limit in shares if share)
    facts.append(("wrench limited", held_back))
    if "lateness_99_s" in found:
        facts.append(("lateness", f"99 % up to {format_quantity(found['lateness_99_s'], 's')}"))
    if "deadlines_skipped" in found:
        facts.append(("deadlines missed", f"{found['deadlines_skipped']:.0f}"))
    return [*facts, ("trips", f"{found['trips']:.0f}")]


def _size(vectors: Array) -> Array:
    with np.errstate(over="ignore", invalid="ignore"):
        size: Array = np.linalg.norm(vectors, axis=1)
    return size


def _largest(values: Array) -> float:
    """Largest finite value; NaN if there is none."""
    known = values[np.isfinite(values)]
    return float(known.max()) if known.size else float("nan")


def duration_of(recording: Summarized) -> float:
    """Time from the first tick to the last [s]."""
    if len(recording) < 2 or "t" not in {field.name for field in recording.fields}:
        return 0.0
    t = recording["t"]
    return float(t[-1] - t[0])


def _count_trips(recording: Summarized) -> int:
    """Number of trips of the guard."""
    if "guard" not in {field.name for field in recording.fields} or not len(recording):
        return 0
    off = np.asarray(recording["guard"]) == _TRIPPED
    return int(off[0]) + int((off[1:] & ~off[:-1]).sum())


def _count_lost_rows(recording: Summarized) -> int | None:
    try:
        return recording.lost
    except RecordingError:
        return None


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def _name_world(note: dict[str, str]) -> str:
    try:
        return str(json.loads(note.get("world", "")).get("name", ""))
    except (ValueError, AttributeError, RecursionError):
        return ""


_HEAD_BYTES = 256 * 1024  #: bytes read to recognise a file of another kind
_MAX_WHOLE_BYTES = 32 * 1024 * 1024  #: largest file that is read and verified at once [bytes]


@final
class Recording:
    """Rows and metadata of a recording (MCAP), read by field name.

    `recording["p"]` is the field p of all ticks: shape (n, 3), or (n,) for a field with one number, in SI units. A file
    above 32 MiB is read on demand.

    Parameters
    ----------
    path : str or Path
        File that `haptorb run --record` or `haptorb.Servo(record=…)` wrote.

    Raises
    ------
    RecordingError
        If the file is missing, is not an MCAP file, or contains no haptorb rows.

    Warns
    -----
    RecordingWarning
        If the file is damaged or truncated; `missing`, `damage` and `truncated` state what is lost.
    """

    def __init__(self, path: str | Path) -> None:
        """Open the file. Raises RecordingError if it is missing, is not an MCAP file, or contains no haptorb rows.

        Emits a RecordingWarning if rows are missing because the file is damaged. The checksums of a file of up to
        32 MiB are verified now, those of a longer one by `check`.
        """
        self.path = Path(path)
        with _open_file(self.path) as file, self._explain():
            size = os.fstat(file.fileno()).st_size
            self._reader = reader = McapReader(self.path)
            self.truncated = reader.truncated  #: the file's end is missing: the recorder was killed or still writes
            self.notes = reader.notes  #: every metadata record: (name, values), in order
            self.fields = reader.fields  #: from the schema in the file
            if not self.fields:
                cut = "it was cut short before its first rows" if self.truncated else f"topic {TOPIC} is missing"
                raise RecordingError(f"not a haptorb recording: {cut}")
            self.long = size > _MAX_WHOLE_BYTES  #: rows are read from the file on demand
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
        """Whether the checksums of all rows have been verified; `check` verifies those of a long file."""
        return self._reader.checked

    def check(
        self, first: int = 0, last: int | None = None, report: Callable[[float], None] = lambda share: None
    ) -> bool:
        """Verify the checksums of rows.

        Damaged rows are then excluded: the indices of later rows decrease, and `missing`, `damage` and a
        RecordingWarning state where rows are missing. A file of up to 32 MiB is verified when it is opened.

        Parameters
        ----------
        first : int
            First row.
        last : int, optional
            Row after the last one; None: to the end.
        report : callable
            Called with the completed fraction, 0 to 1.

        Returns
        -------
        bool
            True if rows are damaged.
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
        """MCAP channel ID of the rows."""
        return self._reader.channel

    def list_contents(self) -> Iterator[list[Any]]:
        """Iterate over the undamaged chunks: schemas, channels and messages of all topics."""
        return self._reader.list_contents()

    def _note_damage(self) -> None:
        """Update `missing` and `damage`, and emit a warning for new damage."""
        before = getattr(self, "damage", ())
        with self._explain():
            missing, harmless = self._reader.list_missing()
        self.missing: tuple[MissingRows, ...] = tuple(missing)  #: unreadable rows, as far as known
        inside = [one for one in missing if not (self.truncated and one.row == len(self))]
        self.damage = describe_damage(  #: unreadable parts, without a truncated end, one sentence each
            inside, harmless, self._reader.lost_notes, self._read_time(0)
        )
        if self.damage and self.damage != before:
            warnings.warn(f"{self.path}: {'; '.join(self.damage)}", RecordingWarning, stacklevel=3)

    def _read_time(self, row: int) -> float:
        """Time of row `row` on the loop's clock [s]; 0 if it cannot be read."""
        try:
            return float(self["t"][row])
        except (RecordingError, UnknownName, IndexError):
            return 0.0

    @contextmanager
    def _explain(self) -> Iterator[None]:
        """Convert errors in the context to RecordingErrors that name the file."""
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
        """Number of recorded rows."""
        return len(self._reader) if self._whole is None else len(self._whole)

    def __getitem__(self, name: str) -> FieldColumn:
        """The field `name` over all ticks, shape (n, width), or (n,) if the width is 1. Raises UnknownName.

        `recording["p"][a:b]` reads only these ticks of a long file.
        """
        name = resolve_name(name)
        if name not in self._at:
            raise UnknownName("field", name, self._at)
        columns = self._at[name]
        return FieldColumn(
            lambda first, last: self._read(first, last, columns), len(self), columns.stop - columns.start
        )

    def read(self, first: int, last: int, fields: Sequence[str]) -> Array:
        """Read fields of a range of rows, side by side; a long file is read once, for any number of fields.

        Parameters
        ----------
        first : int
            First row.
        last : int
            Row after the last one.
        fields : sequence of str
            Names of fields.

        Returns
        -------
        ndarray, shape (last − first, k)
            Their numbers, each field in its unit [SI].

        Raises
        ------
        UnknownName
            If there is no such field.
        """
        known = {field.name for field in self.columns} | set(self._at)
        fields = [resolve_name(name) for name in fields]
        for name in fields:
            if name not in known:
                raise UnknownName("field", name, known)
        rows = self._read(first, last, slice(None))
        if fields == list(self._at):
            return rows
        parts = {name: rows[:, self._at[name]] for name in fields if name in self._at}
        if len(parts) < len(set(fields)):
            memory = split_memory(rows[:, self._at["memory"]], rows[:, self._at["world"].start], self.worlds)
            parts |= {name: values.reshape(len(rows), prod(values.shape[1:])) for name, values in memory.items()}
        return np.concatenate([parts[name] for name in fields], axis=1)

    @cached_property
    def columns(self) -> tuple[Field, ...]:
        """Fields of an exported table: those of the row, and those of the worlds' memory, such as `ball.place`."""
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
        """All undamaged rows, shape (n, width), bit for bit as recorded, in the units of their fields.

        Raises RecordingError if they do not fit into memory.
        """
        self.check()
        try:
            return self._read(0, len(self), slice(None))
        except MemoryError as cause:
            raise RecordingError(f"{self.path} is too large for the memory of this computer") from cause

    @property
    def t(self) -> FieldColumn:
        """Time on the loop's clock, shape (n,) [s]."""
        return self["t"]

    @cached_property
    def metadata(self) -> dict[str, dict[str, str]]:
        """Last metadata record of each name, without its 'haptorb/': device, run, versions, clock, layout, end."""
        return {name.removeprefix("haptorb/"): values for name, values in self.notes}

    @property
    def worlds(self) -> list[dict[str, str]]:
        """Rendered worlds, in order: change (number), tick (approximate), world (JSON)."""
        return [values for name, values in self.notes if name == "haptorb/world"]

    @cached_property
    def memory(self) -> dict[str, Array]:
        """Memory of the worlds in all ticks, by "world.field"; NaN in ticks of other worlds.

        `memory["ball.place"]` is the field `place` of the world `ball`, shape (n, 3); (n,) for a single number.
        """
        if "memory" not in self._at:
            return {}
        self.check()
        rows = self._read(0, len(self), slice(None))
        return split_memory(rows[:, self._at["memory"]], rows[:, self._at["world"].start], self.worlds)

    @property
    def memory_units(self) -> dict[str, str]:
        """Unit of each field of `memory`."""
        return memory_units(self.worlds)

    @property
    def errors(self) -> list[dict[str, str]]:
        """Error messages of worlds and drivers, in order: tick (approximate), text (with file and line of a world)."""
        return [values for name, values in self.notes if name == "haptorb/error"]

    @property
    def programs(self) -> list[dict[str, str]]:
        """Programs that commanded the device through a server, in order.

        Keys: server, name, session (as in the rows), start_s and end_s on the loop's clock [s], and end (how the
        program ended). An empty end_s means that the program commanded to the end of the recording.
        """
        found = {(one.get("server"), one.get("session")): one for name, one in self.notes if name == "haptorb/program"}
        return list(found.values())

    @property
    def lost(self) -> int:
        """Number of rows that the recorder lost. Raises RecordingError if the file states an invalid number."""
        return sum(self._parse_count(values, "rows") for name, values in self.notes if name == "haptorb/gap")

    @property
    def layout(self) -> RowLayout:
        """Layout of `rows`. Raises RecordingError if the file has the layout of another version of haptorb."""
        noted = self.metadata.get("layout", {})
        # older recordings: without a count of contacts, two on any device; without one of memory, none
        without = {"channels": 0, "sensors": 0, "contacts": 2, "memory": 0}
        layout = RowLayout(*(self._parse_count(noted, key) if key in noted else n for key, n in without.items()))
        mine = [(field.name, field.width) for field in layout.fields if field.width]
        if mine != [(field.name, field.width) for field in self.fields]:
            raise RecordingError(f"{self.path} was written by another version of haptorb; read its fields by name")
        return layout

    def require(self, *names: str) -> None:
        """Check that the recording has the given fields, with the widths that this version of haptorb writes.

        Fields of coils, sensors, contacts and memory may have any width.

        Parameters
        ----------
        *names : str
            Names of the fields.

        Raises
        ------
        RecordingError
            If a field is missing, or has another width.
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
        if (count := whole_number(text, 15)) is None:
            raise RecordingError(f"{self.path}: a note's '{key}' must be a whole number; got {quote(text)}")
        return count

    def to_csv(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write all rows to a CSV file, one column per number, without rounding.

        The headings, such as `p[0] [m]`, are those of the console's CSV. Encoding: UTF-8. The file is written
        atomically.

        Parameters
        ----------
        path : str or Path
            File to write.
        overwrite : bool
            Whether it may replace a file.

        Raises
        ------
        RecordingError
            If the file exists and `overwrite` is not set, or if it cannot be written.
        """
        path = Path(path)
        try:
            if path.exists() and not overwrite:
                raise RecordingError(f"{path} exists; choose another name, or replace it with overwrite=True")
        except OSError as cause:
            raise RecordingError(f"cannot write {path}: {cause.strerror}") from cause
        Export.of(self, "csv").write(path)

    def to_pandas(self) -> DataFrame:
        """Return all rows as a DataFrame: one column per number, named `p[0]`, with the time `t` as its index.

        Returns
        -------
        pandas.DataFrame
            The rows in SI units; `attrs["units"]` and `attrs["about"]` describe each column, the index is in [s].

        Raises
        ------
        InputError
            If pandas is not installed.
        """
        self.check()
        return make_data_frame(self)

    def to_xarray(self) -> Dataset:
        """Return all rows as a Dataset over the time `t`: one variable per field.

        Returns
        -------
        xarray.Dataset
            The rows in SI units, with `units` and `long_name` in the `attrs` of each variable; t is in [s].

        Raises
        ------
        InputError
            If xarray is not installed.
        """
        self.check()
        return make_dataset(self)

    def __repr__(self) -> str:
        return summarize(self)

    def _repr_html_(self) -> str:
        return facts_html(f"Recording {self.path.name}", list_facts(self), draw_force(self))

    def plot(self, path: str | Path | None = None) -> Figure:
        """Plot the run: commanded and actual force, currents, temperatures, lateness.

        Parameters
        ----------
        path : str or Path, optional
            File to write (PNG, SVG, PDF).

        Returns
        -------
        matplotlib.figure.Figure
            The figure.

        Raises
        ------
        RecordingError
            If there are no rows, or `path` cannot be written.
        """
        self.check()
        return plot(self, path)


@contextmanager
def _open_file(path: Path) -> Iterator[BinaryIO]:
    """Open the file at `path`. Raises RecordingError unless it begins with the MCAP magic bytes."""
    with open_regular(path, "recording", RecordingError) as file:
        head = file.read(len(MAGIC))
        if not is_mcap(head):
            other = FileKind.RECORDING.explain_other(path, head + file.read(_HEAD_BYTES))
            raise RecordingError(
                other or f"{path} is not an MCAP file: record one with `haptorb run --record FILE.mcap`"
            )
        yield file
