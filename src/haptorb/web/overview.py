"""The overview of a recording as the page gets it: at once for a short one, for a long one as far as it is."""

from __future__ import annotations

import json
import math
import os
import pickle
import struct
import subprocess
import threading
import time
from contextlib import suppress
from typing import Any, final

import numpy as np

from haptorb.arrays import Array
from haptorb.recording.recording import Recording
from haptorb.runtime.linux import start_python

__all__ = ["BINS", "CHANNELS", "Overview", "OverviewBins"]


# --------------------------------------------------------------------------------------------------
# A recording of any length at a glance: least and greatest of each interval, and where something happened.


BINS = 1200  #: intervals: about one for each pixel of a wide screen
_TRIPPED = 4  #: state of the guard
_MAX_EVENTS = 400  #: events of a kind that are kept

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
            for row in np.flatnonzero(off)[:_MAX_EVENTS]:
                self._note("trip", t[row], numbers["trip"][row] if "trip" in numbers else 0.0)
        if "world" in numbers:
            changed = np.isfinite(before["world"]) & (numbers["world"] != before["world"])
            for row in np.flatnonzero(changed)[:_MAX_EVENTS]:
                self._note("world", t[row], numbers["world"][row])
        if "tick" in numbers:
            with np.errstate(invalid="ignore", over="ignore"):
                steps = numbers["tick"] - before["tick"]
            for row in np.flatnonzero(steps > 1.5)[:_MAX_EVENTS]:
                self._note("gap", t[row], steps[row] - 1.0)
        self._last = {name: float(column[-1]) for name, column in numbers.items()} if len(t) else self._last

    def _note(self, kind: str, t: float, code: float) -> None:
        if self._counts[kind] < _MAX_EVENTS and np.isfinite(t) and np.isfinite(code):
            self._counts[kind] += 1
            self.events.append((kind, float(t), float(code)))


_END_TIMEOUT_S = 1.0  #: for the process to end [s]
_OFTEN = 0.1  #: between two wishes that it rest [s]


@final
class Overview:
    """Made by `start`; `close` ends the process of a long recording, if it still runs.

    start, end: first and last time of the recording on the loop's clock [s]
    """

    def __init__(self, recording: Recording, start: float, end: float) -> None:
        self._recording, self._start, self._end = recording, start, end
        self._rows = len(recording)
        self._done, self._trouble = 0, ""
        self._ranges = np.full((len(CHANNELS), 2, BINS), np.nan)
        self._events: list[tuple[str, float, float]] = []
        self._process: subprocess.Popen[bytes] | None = None
        self._started = False
        self._asked = -math.inf  # when it was to give way

    def start(self) -> None:
        """Start, unless it has started."""
        if self._started:
            return
        self._started = True
        if not self._recording.long:
            bins = OverviewBins(self._recording, self._start, self._end)
            bins.add(0, self._rows)
            self._done, self._ranges, self._events = self._rows, bins.ranges, bins.events
            return
        arguments = [str(self._recording.path), repr(self._start), repr(self._end)]
        arguments += ["--damaged"] if self._recording.missing else []
        self._process = start_python(
            "haptorb.web.overview_process", *arguments,
            isolated=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        )  # fmt: skip
        threading.Thread(target=self._listen, args=(self._process,), daemon=True).start()

    def _listen(self, process: subprocess.Popen[bytes]) -> None:
        assert process.stdout is not None
        with process.stdout as answers, suppress(EOFError, OSError, ValueError, pickle.UnpicklingError):
            while True:
                answer = pickle.load(answers)
                if isinstance(answer, str):
                    self._trouble = answer
                    return
                self._done, _, self._ranges, self._events = answer
        process.wait()
        if self._done < self._rows and not self._trouble:
            self._trouble = "the process that computes the overview ended"

    def give_way(self) -> None:
        """Pause a process at work for a moment: scrubbing needs the processors more."""
        process, now = self._process, time.monotonic()
        if process is None or process.stdin is None or self._done >= self._rows or now < self._asked + _OFTEN:
            return
        self._asked = now
        with suppress(OSError, ValueError):
            os.write(process.stdin.fileno(), b".")

    def close(self) -> None:
        """End the process, if there is one."""
        process, self._process = self._process, None
        if process is None:
            return
        assert process.stdin is not None
        with suppress(OSError):
            process.stdin.close()
        process.terminate()
        try:
            process.wait(_END_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    def encode(self) -> bytes:
        """The length of a JSON text (uint32, little-endian), that text padded to four bytes, and (channels, 2, bins)
        float32: least and greatest in the unit of each channel.

        The text: rows `done` of `rows`, `trouble`, `bins`, names and units of `channels`, `events` with their time
        after the first tick [s].
        """
        description: dict[str, Any] = {
            "done": min(self._done, self._rows),
            "rows": self._rows,
            "trouble": self._trouble,
            "bins": BINS,
            "channels": [{"name": name, "unit": unit} for name, unit, *_ in CHANNELS],
            "events": [{"kind": kind, "t": t - self._start, "code": code} for kind, t, code in self._events],
        }
        text = json.dumps(description, allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        with np.errstate(over="ignore"):
            return struct.pack("<I", len(text)) + text + self._ranges.astype("<f4").tobytes()
