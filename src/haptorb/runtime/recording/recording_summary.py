"""A recording in one line, in a dozen facts, and as one small picture of the force."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np

from haptorb.control.allocation.allocator import Saturation
from haptorb.display.html import curves_svg
from haptorb.display.quantity_text import format_quantity
from haptorb.errors import RecordingError, quote
from haptorb.files.foreign_text import foreign_text
from haptorb.numerics.arrays import Array
from haptorb.runtime.recording.column import FieldColumn
from haptorb.runtime.recording.mcap_reader import MissingRows
from haptorb.runtime.row import Field

__all__ = ["describe_damage", "draw_force", "duration_of", "list_facts", "list_losses", "measure_run", "summarize"]

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


def draw_force(recording: Summarized) -> str:
    """The size of the force asked and given [N] over time [s], as SVG; of a device without forces the torque [N·m].

    Empty without rows, and for a long recording: `plot` draws it.
    """
    known = {field.name for field in recording.fields}
    if recording.long or not {"t", "asked", "given"} <= known or len(recording) < 2:
        return ""
    given, name = np.asarray(recording["given"]), "given"
    if not np.isfinite(given).any() and "modelled" in known:
        given, name = np.asarray(recording["modelled"]), "modelled"
    asked = np.asarray(recording["asked"])
    if asked.ndim != 2 or asked.shape[1] != 6 or given.shape != asked.shape:
        return ""
    turning = not (np.nan_to_num(given[:, :3]).any() or np.nan_to_num(asked[:, :3]).any())
    part = slice(3, 6) if turning else slice(0, 3)
    curves = [(name, _size(given[:, part])), ("asked", _size(asked[:, part]))]
    return curves_svg(np.asarray(recording["t"]), curves, "s", "torque [N·m]" if turning else "force [N]")


def measure_run(recording: Summarized) -> dict[str, float]:
    """Largest values and counts over all ticks, the unit [SI] at the end of each name; of the fields that are there.

    NaN for what no tick contains.
    """
    known = {field.name for field in recording.fields}
    found = {}
    for name in ("asked", "given"):
        if name in known and recording[name].ndim == 2 and recording[name].shape[1] == 6:
            values = recording[name][:]
            found[f"largest_{name}_force_n"] = _largest(_size(values[:, :3]))
            found[f"largest_{name}_torque_nm"] = _largest(_size(values[:, 3:]))
    if "currents" in known:
        found["largest_current_a"] = _largest(np.abs(recording["currents"]))
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
    """What `measure_run` has found, in words."""
    facts = []
    for name in ("asked", "given"):
        if f"largest_{name}_force_n" in found:
            force, torque = found[f"largest_{name}_force_n"], found[f"largest_{name}_torque_nm"]
            text = f"{format_quantity(force, 'N')}, {format_quantity(torque, 'N·m')}"
            facts.append((f"largest {name}", text if np.isfinite(force) else "unknown"))
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
