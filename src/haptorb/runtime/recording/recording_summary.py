"""A recording in one line, in a dozen facts, and as one small picture of the force."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Protocol

import numpy as np

from haptorb.control.allocation.allocator import Saturation
from haptorb.display.html import curves_svg
from haptorb.display.quantity_text import format_quantity
from haptorb.errors import RecordingError
from haptorb.numerics.arrays import Array
from haptorb.runtime.row import Field

__all__ = ["draw_force", "list_facts", "summarize"]

_TRIPPED = 4  #: state of the guard


class Summarized(Protocol):
    """What is told of a recording."""

    path: Path
    fields: tuple[Field, ...]
    truncated: bool

    @property
    def lost(self) -> int:
        """Rows that the recorder could not fetch in time."""

    @property
    def metadata(self) -> Mapping[str, Mapping[str, str]]:
        """The device, the run and the versions."""

    @property
    def worlds(self) -> list[dict[str, str]]:
        """The worlds that were rendered."""

    def __getitem__(self, name: str) -> Array:
        """A field of all ticks, shape (n, width), or (n,) where the width is 1, in the field's own unit [SI]."""

    def __len__(self) -> int:
        """Rows recorded."""


def summarize(recording: Summarized) -> str:
    """File, device, length, and what is wrong with it, in one line."""
    device = recording.metadata.get("device", {}).get("name", "unknown device")
    wrong = [f"{_count(lost, 'row')} lost"] if (lost := _count_lost_rows(recording)) else []
    wrong += ["cut short"] if recording.truncated else []
    parts = [
        device,
        f"{_duration(recording):.4g} s",
        _count(len(recording), "row"),
        _count(_count_trips(recording), "trip"),
        *wrong,
    ]
    return f"<Recording {recording.path.name}: {', '.join(parts)}>"


def list_facts(recording: Summarized) -> list[tuple[str, str]]:
    """Names and figures with units: what ran, how long, how well, and the largest force."""
    device, run = recording.metadata.get("device", {}), recording.metadata.get("run", {})
    seconds, rows = _duration(recording), len(recording)
    rate = f", {(rows - 1) / seconds:.4g} per second" if seconds > 0 else ""
    facts = [
        ("file", str(recording.path)),
        ("device", device.get("title") or device.get("name", "unknown")),
        ("driver", run.get("driver", "")),
        ("model of the controller", run.get("model", "")),
        ("worlds", ", ".join(dict.fromkeys(map(_name_world, recording.worlds)))),
        ("length", f"{seconds:.4g} s, {rows} rows{rate}"),
    ]
    if rows:
        facts += _figures(recording)
    lost = _count_lost_rows(recording)
    facts.append(("rows lost", "unknown" if lost is None else str(lost)))
    facts.append(("end", "missing: the file was cut short" if recording.truncated else "complete"))
    return [(name, text) for name, text in facts if text]


def draw_force(recording: Summarized) -> str:
    """The size of the force asked and given [N] over time [s], as SVG; of a device without forces the torque [N·m].

    Empty without rows.
    """
    if not {"t", "asked", "given"} <= {field.name for field in recording.fields} or len(recording) < 2:
        return ""
    given, name = recording["given"], "given"
    if not np.isfinite(given).any() and "modelled" in {field.name for field in recording.fields}:
        given, name = recording["modelled"], "modelled"
    asked = recording["asked"]
    if asked.ndim != 2 or asked.shape[1] != 6 or given.shape != asked.shape:
        return ""
    turning = not (np.nan_to_num(given[:, :3]).any() or np.nan_to_num(asked[:, :3]).any())
    part = slice(3, 6) if turning else slice(0, 3)
    curves = [(name, _size(given[:, part])), ("asked", _size(asked[:, part]))]
    return curves_svg(recording["t"], curves, "s", "torque [N·m]" if turning else "force [N]")


def _figures(recording: Summarized) -> list[tuple[str, str]]:
    """Largest values, for the fields that are there."""
    known = {field.name for field in recording.fields}
    facts = []
    for name, title in (("asked", "asked"), ("given", "given")):
        if name in known and recording[name].ndim == 2 and recording[name].shape[1] == 6:
            values = recording[name]
            force, torque = (_largest(_size(part)) for part in (values[:, :3], values[:, 3:]))
            text = f"{format_quantity(force, 'N')}, {format_quantity(torque, 'N·m')}"
            facts.append((f"largest {title}", text if np.isfinite(force) else "unknown"))
    if "currents" in known:
        facts.append(("largest current", format_quantity(_largest(np.abs(recording["currents"])), "A")))
    if "winding" in known:
        facts.append(("warmest winding", f"{_largest(recording['winding']) - 273.15:.1f} °C"))
    if "saturated" in known:
        shares = [(100 * float(np.mean(recording["saturated"] == one)), one.text) for one in Saturation if one]
        held_back = ", ".join(f"{share:.2g} % of the ticks by {limit}" for share, limit in shares if share)
        facts.append(("wrench held back", held_back))
    if "lateness" in known:
        late = recording["lateness"]
        most = float(np.quantile(late, 0.99, method="lower")) if np.isfinite(late).all() else float("nan")
        facts.append(("lateness", f"99 % up to {format_quantity(most, 's')}"))
    if "missed" in known:
        facts.append(("deadlines skipped", f"{np.nansum(recording['missed']):.0f}"))
    return [*facts, ("trips", str(_count_trips(recording)))]


def _size(vectors: Array) -> Array:
    with np.errstate(over="ignore", invalid="ignore"):
        size: Array = np.linalg.norm(vectors, axis=1)
    return size


def _largest(values: Array) -> float:
    """Of what is finite; NaN where nothing is."""
    known = values[np.isfinite(values)]
    return float(known.max()) if known.size else float("nan")


def _duration(recording: Summarized) -> float:
    if len(recording) < 2 or "t" not in {field.name for field in recording.fields}:
        return 0.0
    t = recording["t"]
    return float(t[-1] - t[0])


def _count_trips(recording: Summarized) -> int:
    """How many times the guard switched off."""
    if "guard" not in {field.name for field in recording.fields} or not len(recording):
        return 0
    off = recording["guard"] == _TRIPPED
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
