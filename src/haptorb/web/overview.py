"""Overview of a recording for the page: immediate for a short recording, incremental for a long one."""

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
# Overview of a recording of any length: minimum and maximum per interval, and events.


BINS = 1200  #: intervals: about one for each pixel of a wide screen
_GUARD_TRIPPED = 4  #: code of the guard's state
_MAX_EVENTS = 400  #: stored events of each kind

#: name, unit, field, elements of it; of a vector of three the norm, else each element
CHANNELS = (
    ("force delivered", "N", "wrench_actual", slice(0, 3)),
    ("force commanded", "N", "wrench_commanded", slice(0, 3)),
    ("torque delivered", "N·m", "wrench_actual", slice(3, 6)),
    ("torque commanded", "N·m", "wrench_commanded", slice(3, 6)),
    ("currents", "A", "current_measured", slice(None)),
    ("temperature", "K", "winding", slice(None)),
)
_EVENT_FIELDS = ("world", "guard", "trip", "tick")


@final
class OverviewBins:
    """Accumulator of ranges and events over rows, which are added in order.

    ranges  (channels, 2, bins) minimum and maximum in the channel's unit; NaN where there are no rows
    events  ("trip", "world" or "gap", time on the loop's clock [s], code of the trip, number of the world's change, or
            count of missing rows), in order, at most 400 of each kind
    """

    def __init__(self, recording: Recording, start: float, end: float) -> None:
        """`start` and `end`: first and last time of the recording [s]."""
        known = {field.name for field in recording.fields}
        wanted = ["t", *(name for *_, name, _ in CHANNELS), *_EVENT_FIELDS]
        self._recording = recording
        self._fields = [name for name in dict.fromkeys(wanted) if name in known]
        self._widths = {field.name: field.width for field in recording.fields}
        self._start, self._step = start, max(end - start, 1e-9) / BINS
        self.ranges = np.full((len(CHANNELS), 2, BINS), np.nan)
        self.events: list[tuple[str, float, float]] = []
        self._counts = {"trip": 0, "world": 0, "gap": 0}
        self._last: dict[str, float] = {}

    def add(self, first: int, last: int, *, events: bool = True) -> None:
        """Add rows `first` up to `last`; without `events` only their ranges."""
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
            self._find_events({name: parts[name][:, 0] for name in _EVENT_FIELDS if name in parts}, t)

    def _add_range(self, channel: int, values: Array, bins: Any, usable: Any) -> None:
        if values.shape[1] == 0:
            return
        if CHANNELS[channel][2] in ("wrench_actual", "wrench_commanded"):
            size = np.sqrt(np.square(values).sum(axis=1))
            least, most = size, size
        else:
            least, most = values.min(axis=1), values.max(axis=1)
        known = usable & np.isfinite(least) & np.isfinite(most)
        np.fmin.at(self.ranges[channel, 0], bins[known], least[known])
        np.fmax.at(self.ranges[channel, 1], bins[known], most[known])

    def _find_events(self, numbers: dict[str, Array], t: Array) -> None:
        """Add events where the guard tripped, the world changed, or rows are missing."""
        before = {
            name: np.concatenate(([self._last.get(name, np.nan)], column[:-1])) for name, column in numbers.items()
        }
        if "guard" in numbers:
            off = (numbers["guard"] == _GUARD_TRIPPED) & (before["guard"] != _GUARD_TRIPPED)
            for row in np.flatnonzero(off)[:_MAX_EVENTS]:
                self._add_event("trip", t[row], numbers["trip"][row] if "trip" in numbers else 0.0)
        if "world" in numbers:
            changed = np.isfinite(before["world"]) & (numbers["world"] != before["world"])
            for row in np.flatnonzero(changed)[:_MAX_EVENTS]:
                self._add_event("world", t[row], numbers["world"][row])
        if "tick" in numbers:
            with np.errstate(invalid="ignore", over="ignore"):
                steps = numbers["tick"] - before["tick"]
            for row in np.flatnonzero(steps > 1.5)[:_MAX_EVENTS]:
                self._add_event("gap", t[row], steps[row] - 1.0)
        self._last = {name: float(column[-1]) for name, column in numbers.items()} if len(t) else self._last

    def _add_event(self, kind: str, t: float, code: float) -> None:
        if self._counts[kind] < _MAX_EVENTS and np.isfinite(t) and np.isfinite(code):
            self._counts[kind] += 1
            self.events.append((kind, float(t), float(code)))


_END_TIMEOUT_S = 1.0  #: for the process to end [s]
_PAUSE_INTERVAL_S = 0.1  #: between two requests to pause [s]


@final
class Overview:
    """Overview of a recording, computed after `start`, for a long recording in a process that `close` ends.

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
        self._pause_time = -math.inf  # time of the last request to pause [s]

    def start(self) -> None:
        """Start the computation, unless it has started; a short recording is computed before it returns."""
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

    def pause(self) -> None:
        """Pause the process for a moment, to leave processor time to scrubbing."""
        process, now = self._process, time.monotonic()
        if (
            process is None
            or process.stdin is None
            or self._done >= self._rows
            or now < self._pause_time + _PAUSE_INTERVAL_S
        ):
            return
        self._pause_time = now
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
        """Encode the overview: length of a JSON text (uint32, little-endian), that text padded to four bytes, and
        (channels, 2, bins) float32, minimum and maximum in the unit of each channel.

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
