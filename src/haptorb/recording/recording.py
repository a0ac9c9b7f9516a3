"""A recording as arrays, even if it was truncated; a long one is read in pieces."""

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

from haptorb.arrays import Array
from haptorb.control.allocation import Saturation
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
# The memory of worlds in a recording: numbers of the rows by the names of each world's fields.


def split_memory(numbers: Array, changes: Array, worlds: Sequence[Mapping[str, str]]) -> dict[str, Array]:
    """World and field → its numbers in all ticks, (n, ...) in the field's unit [SI]; NaN in ticks of other worlds.

    numbers (n, room) are the rows' memory, changes (n,) the number of the world in each of these ticks, worlds the
    notes of all. A field for which rows had no room is left out. Raises RecordingError for a note of a world that
    haptorb did not write.
    """
    found: dict[str, Array] = {}
    for change, name, fields in _list_fields(worlds):
        rows = changes == change
        for key, shape, place in _place_fields(name, fields, numbers.shape[1]):
            values = found.setdefault(key, np.full((len(numbers), *shape), np.nan))
            if values.shape[1:] == shape:  # a file that was saved again may have changed it
                values[rows] = numbers[rows, place].reshape(-1, *shape)
    return found


def memory_columns(worlds: Sequence[Mapping[str, str]], room: int) -> tuple[Field, ...]:
    """One Field [SI] for each that `split_memory` finds in rows with `room` numbers of memory."""
    units: dict[str, str] = memory_units(worlds)
    found: dict[str, Field] = {}
    for _, name, fields in _list_fields(worlds):
        for key, shape, _ in _place_fields(name, fields, room):
            found.setdefault(key, Field(key, prod(shape), units[key], "remembered by the world"))
    return tuple(found.values())


def _place_fields(
    world: str, fields: Sequence[Mapping[str, Any]], room: int
) -> Iterator[tuple[str, tuple[int, ...], slice]]:
    """(key, shape, numbers) of the fields for which there is room."""
    start = 0
    for field in fields:
        shape = tuple(field["shape"])
        first, start = start, start + prod(shape)
        if start > room:
            return
        yield _name_column(world, field), shape, slice(first, start)


def memory_units(worlds: Sequence[Mapping[str, str]]) -> dict[str, str]:
    """World and field → unit [SI], of the notes of all `worlds` of a recording."""
    return {
        _name_column(name, field): foreign_text(field["unit"], 40)
        for _, name, fields in _list_fields(worlds)
        for field in fields
    }


def _name_column(world: str, field: Mapping[str, Any]) -> str:
    """Of tables and archives: the recording may be anybody's."""
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
    """Raise ValueError for a field that no memory has: another program may have written the file."""
    for field in fields:
        if not isinstance(field["name"], str) or not isinstance(field["unit"], str):
            raise ValueError("name and unit must be texts")
        if len(field["shape"]) > 4 or any(type(n) is not int or not 1 <= n <= 65_536 for n in field["shape"]):
            raise ValueError("a shape must be whole numbers")
        if prod(field["shape"]) > 65_536:
            raise ValueError("a field has too many numbers")


# --------------------------------------------------------------------------------------------------
# Summary of a recording: one line, a table of facts, and a plot of the force.


_TRIPPED = 4  #: state of the guard
_PARTS = 5  #: damaged parts that are described one by one
_CUT = "missing: the file is truncated (the recorder was killed, or still writes)"


class Summarized(Protocol):
    """The summary of a recording."""

    path: Path
    fields: tuple[Field, ...]
    truncated: bool
    long: bool
    missing: tuple[MissingRows, ...]
    damage: tuple[str, ...]

    @property
    def checked(self) -> bool:
        """Whether all rows were compared with their checksums."""

    @property
    def programs(self) -> list[dict[str, str]]:
        """The programs that commanded."""

    @property
    def lost(self) -> int:
        """Rows that the recorder could not fetch in time."""

    @property
    def metadata(self) -> Mapping[str, Mapping[str, str]]:
        """The device, the run and the versions."""

    @property
    def worlds(self) -> list[dict[str, str]]:
        """The worlds that were rendered."""

    def __getitem__(self, name: str) -> FieldColumn:
        """A field of all ticks, shape (n, width), or (n,) where the width is 1, in the field's own unit [SI]."""

    def __len__(self) -> int:
        """Rows recorded."""


def summarize(recording: Summarized) -> str:
    """File, device, length, and what is wrong with it, in one line."""
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
    """Names and figures with units: what ran, how long, how well, and the largest force.

    whole: look at every tick for the latter; by default only at those of a recording that is not long.
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
    """Name and times on the loop's clock.

    >>> _describe_program({"name": "demo", "start_s": "0.5", "end_s": "2.25", "end": "exited"})
    'demo from 0.5 s to 2.25 s (exited)'
    """
    end = f"to {program.get('end_s')} s ({program.get('end')})" if program.get("end_s") else "on"
    return f"{program.get('name', 'unknown')} from {program.get('start_s', '?')} s {end}"


def list_losses(recording: Summarized) -> list[str]:
    """What is missing of the recording because its file is damaged or cut, a sentence each."""
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
    """What cannot be read, a sentence each: the rows of `missing`, with times after the `first` tick [s], `notes` by
    their names, and bytes (first, end) of which no row is missing.

    >>> describe_damage([MissingRows(20, 14, 3.02, 3.035)], [], ["run"], 3.0)
    ('14 rows are missing between 0.02 s and 0.035 s: the file is damaged there', "the note 'run' cannot be read")
    """
    found = [f"{_count_missing([one])} {_place(one, first)}: the file is damaged there" for one in missing[:_PARTS]]
    if others := missing[_PARTS:]:
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
    """How many rows, as far as is known, with the verb."""
    known = sum(one.rows for one in missing if one.rows is not None)
    if all(one.rows is not None for one in missing):
        return f"{_count(known, 'row')} {'is' if known == 1 else 'are'} missing"
    return f"at least {_count(known, 'row')} are missing" if known else "rows (their number is unknown) are missing"


_WRENCHES = ("commanded", "actual")


def draw_force(recording: Summarized) -> str:
    """The size of commanded and actual force [N] over time [s], as SVG; of a device without forces the torque [N·m].

    Empty without rows, and for a long recording: `plot` draws it.
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
    """Largest values and counts over all ticks, the unit [SI] at the end of each name; of the fields that are there.

    NaN for what no tick contains.
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
    """Of what is finite; NaN where nothing is."""
    known = values[np.isfinite(values)]
    return float(known.max()) if known.size else float("nan")


def duration_of(recording: Summarized) -> float:
    """Time from the first tick to the last [s]."""
    if len(recording) < 2 or "t" not in {field.name for field in recording.fields}:
        return 0.0
    t = recording["t"]
    return float(t[-1] - t[0])


def _count_trips(recording: Summarized) -> int:
    """How many times the guard switched off."""
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


_HEAD_BYTES = 256 * 1024  #: bytes by which a file of another kind is recognised
_WHOLE = 32 * 1024 * 1024  #: bytes of a file that is read, and checked, at once when it is opened


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
        If the file is missing, is no MCAP file, or has no rows of haptorb.

    Warns
    -----
    RecordingWarning
        If the file is damaged or truncated; `missing`, `damage` and `truncated` state what is lost.
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
        """Compare rows with their checksums.

        Damaged rows are then left out: later rows have lower numbers, and `missing`, `damage` and a RecordingWarning
        state where rows are missing. A file of up to 32 MiB was checked when it was opened.

        Parameters
        ----------
        first : int
            First row.
        last : int, optional
            Row after the last one; None: to the end.
        report : callable
            Receives the share that is done, 0 to 1.

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
    def programs(self) -> list[dict[str, str]]:
        """Programs that commanded through a server, in order: server, name, session (as in the rows), start_s and end_s
        on the loop's clock [s], and how it ended; end_s empty: it commanded to the end."""
        found = {(one.get("server"), one.get("session")): one for name, one in self.notes if name == "haptorb/program"}
        return list(found.values())

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
        """Check that the recording has given fields, as wide as this version of haptorb writes them.

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
        if not (text.isascii() and text.isdecimal() and len(text) <= 15):
            raise RecordingError(f"{self.path}: a note's '{key}' must be a whole number; got {quote(text)}")
        return int(text)

    def to_csv(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write all rows as text, one column per number, headed `p[0] [m]` as in the console's CSV, every digit kept.

        UTF-8. The file is written completely or not at all.

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
    """The file, if it begins like MCAP."""
    with open_regular(path, "recording", RecordingError) as file:
        head = file.read(len(MAGIC))
        if not is_mcap(head):
            other = FileKind.RECORDING.explain_other(path, head + file.read(_HEAD_BYTES))
            raise RecordingError(
                other or f"{path} is not an MCAP file: record one with `haptorb run --record FILE.mcap`"
            )
        yield file
