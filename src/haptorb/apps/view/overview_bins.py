"""A recording of any length at a glance: least and greatest of each interval, and where something happened."""

from __future__ import annotations

from typing import Any, final

import numpy as np

from haptorb.numerics.arrays import Array
from haptorb.runtime.recording.recording import Recording

__all__ = ["BINS", "CHANNELS", "OverviewBins"]

BINS = 1200  #: intervals: about one for each pixel of a wide screen
_TRIPPED = 4  #: state of the guard
_MOST = 400  #: events of a kind that are kept

#: name, unit, field, numbers of it; of three numbers the length counts, else each one
CHANNELS = (
    ("force given", "N", "given", slice(0, 3)),
    ("force asked", "N", "asked", slice(0, 3)),
    ("torque given", "N·m", "given", slice(3, 6)),
    ("torque asked", "N·m", "asked", slice(3, 6)),
    ("currents", "A", "currents", slice(None)),
    ("temperature", "K", "winding", slice(None)),
)
_EVENTS = ("world", "guard", "trip", "tick")


@final
class OverviewBins:
    """Takes rows in order, as many at a time as there are.

    ranges  (channels, 2, bins) least and greatest in the channel's unit; NaN where there are no rows
    events  ("trip", "world" or "gap", time on the loop's clock [s], code of the trip, number of the world's change, or
            how many rows are missing), in order, at most 400 of each
    """

    def __init__(self, recording: Recording, start: float, end: float) -> None:
        """`start` and `end`: first and last time of the recording [s]."""
        known = {field.name for field in recording.fields}
        wanted = ["t", *(name for *_, name, _ in CHANNELS), *_EVENTS]
        self._recording = recording
        self._fields = [name for name in dict.fromkeys(wanted) if name in known]
        self._widths = {field.name: field.width for field in recording.fields}
        self._start, self._step = start, max(end - start, 1e-9) / BINS
        self.ranges = np.full((len(CHANNELS), 2, BINS), np.nan)
        self.events: list[tuple[str, float, float]] = []
        self._counts = {"trip": 0, "world": 0, "gap": 0}
        self._last: dict[str, float] = {}

    def add(self, first: int, last: int, *, events: bool = True) -> None:
        """Take in rows `first` up to `last`; without `events` only their ranges."""
        rows = self._recording.read(first, last, self._fields)
        parts, at = {}, 0
        for name in self._fields:
            parts[name] = rows[:, at : at + self._widths[name]]
            at += self._widths[name]
        t = parts["t"][:, 0]
        with np.errstate(invalid="ignore", over="ignore"):
            place = (t - self._start) / self._step
            usable = np.isfinite(place)
            bins = np.clip(np.where(usable, place, 0.0), 0, BINS - 1).astype(np.int64)
            for number, (_, _, name, numbers) in enumerate(CHANNELS):
                if name in parts:
                    self._add_range(number, parts[name][:, numbers], bins, usable)
        if events:
            self._note_events({name: parts[name][:, 0] for name in _EVENTS if name in parts}, t)

    def _add_range(self, channel: int, values: Array, bins: Any, usable: Any) -> None:
        if values.shape[1] == 0:
            return
        if CHANNELS[channel][2] in ("given", "asked"):
            size = np.sqrt(np.square(values).sum(axis=1))
            least, most = size, size
        else:
            least, most = values.min(axis=1), values.max(axis=1)
        known = usable & np.isfinite(least) & np.isfinite(most)
        np.fmin.at(self.ranges[channel, 0], bins[known], least[known])
        np.fmax.at(self.ranges[channel, 1], bins[known], most[known])

    def _note_events(self, numbers: dict[str, Array], t: Array) -> None:
        """Where the guard tripped, the world changed, or rows are missing."""
        before = {
            name: np.concatenate(([self._last.get(name, np.nan)], column[:-1])) for name, column in numbers.items()
        }
        if "guard" in numbers:
            off = (numbers["guard"] == _TRIPPED) & (before["guard"] != _TRIPPED)
            for row in np.flatnonzero(off)[:_MOST]:
                self._note("trip", t[row], numbers["trip"][row] if "trip" in numbers else 0.0)
        if "world" in numbers:
            changed = np.isfinite(before["world"]) & (numbers["world"] != before["world"])
            for row in np.flatnonzero(changed)[:_MOST]:
                self._note("world", t[row], numbers["world"][row])
        if "tick" in numbers:
            with np.errstate(invalid="ignore", over="ignore"):
                steps = numbers["tick"] - before["tick"]
            for row in np.flatnonzero(steps > 1.5)[:_MOST]:
                self._note("gap", t[row], steps[row] - 1.0)
        self._last = {name: float(column[-1]) for name, column in numbers.items()} if len(t) else self._last

    def _note(self, kind: str, t: float, code: float) -> None:
        if self._counts[kind] < _MOST and np.isfinite(t) and np.isfinite(code):
            self._counts[kind] += 1
            self.events.append((kind, float(t), float(code)))
